from service.usecases.due import explain_due

SAME = {"instrument": "a", "sky_power": "b", "model_version": 9}
WINDOW = SAME | {"spectra": [100, 0], "model": None, "changes": [], "decisions": None}
STEP = ["CS002", 2, 1_428_710_400_000_000]


def test_a_reason_names_the_inputs_that_are_others_than_before():
    """One sentence stood for every reason, in 27 of 27 jobs."""
    for now, reason in (
        ({"spectra": [148, 0]}, "+48 usable spectra"),
        ({"spectra": [100, 3]}, "a quality flag set or cleared"),
        ({"changes": [STEP]}, "CS002 antenna 2 changed on 2015-04-11"),
        (
            {"spectra": [99, 4], "decisions": {"cuts": [0, 1]}},
            "-1 usable spectra; a quality flag set or cleared; a decision about a change",
        ),
        ({"instrument": "c", "model_version": 10}, "another instrument; another model version"),
        ({}, "tried again"),
    ):
        assert explain_due(WINDOW, WINDOW | now) == reason
    assert explain_due(WINDOW | {"changes": [STEP]}, WINDOW) == "1 change counts no more"
    assert explain_due(WINDOW | {"changes": [STEP, [*STEP[:2], 0]]}, WINDOW) == "2 changes count no more"
    assert explain_due(None, WINDOW) == "the first of this window"
    assert explain_due(None, WINDOW | {"model": 1}) == "a cause adopted or withdrawn"
    several = {"changes": [[*STEP[:1], antenna, STEP[2]] for antenna in range(5)]}
    assert explain_due(WINDOW, WINDOW | several).endswith("CS002 antenna 2 changed on 2015-04-11; and 2 more changes")


def test_a_window_of_the_array_names_the_spectra_of_all_stations():
    array = SAME | {"spectra": [["CS002", [100, 0]]]}
    assert explain_due(array, SAME | {"spectra": [["CS002", [100, 0]], ["CS003", [50, 0]]]}) == "+50 usable spectra"


def test_drift_is_followed_again_because_it_was_measured_anew():
    assert explain_due({"drift": "a", "report": None}, {"drift": "b", "report": ["a", 5]}) == "drift measured anew"
    assert explain_due(None, {"drift": "b", "report": None}) == "drift measured anew"
