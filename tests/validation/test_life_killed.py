import pytest

from validation.life_killed import live
from validation.machinery.records import verdicts_of


@pytest.mark.long
def test_a_killed_worker_leaves_what_follows_from_spectra_and_decisions() -> None:
    """The suite's small instance of `./dev prove life_killed`."""
    row = live(0, acts=1)
    assert row["kills"] > 0
    assert (row["undone"], row["compared"]) == ([], 100)
    assert row["farthest_sigma"] <= 0.5, row
    assert row["twice"] > 5
    assert row["unlike"] == {}


def test_60_sequences_show_little_and_refute_what_is_common() -> None:
    whole = {"undone": [], "within": 100, "compared": 100, "farthest_sigma": 0.2, "twice": 30, "unlike": {}}
    whole["endless"] = False
    broken = whole | {"undone": ["array"], "within": 50, "farthest_sigma": 3.3, "unlike": {"a": 3.5}, "endless": True}
    for row, verdict in ((whole, "undecided"), (broken, "refuted")):
        found = verdicts_of("life_killed", "station", [row] * 60)
        assert (found["apart"], found["undone"], found["endless"]) == (verdict, verdict, verdict)
        assert found["unlike"] == ("shown" if row is whole else "refuted")
    assert verdicts_of("life_killed", "station", [whole] * 60)["within"] == "shown"
