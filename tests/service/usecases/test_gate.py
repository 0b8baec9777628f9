from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lbacal_core.calibration.slow_changes import SlowChange
from lbacal_core.curves.curves import CONVERGED, TOO_FEW_EVENTS, CalibrationCurve
from lbacal_core.curves.reference_chain import CableTable, ReferenceChain
from lbacal_core.curves.validity import Promotion, Scope
from lbacal_core.drift.members import name_members
from lbacal_core.grids import YEAR_S
from service.factory import Factory
from service.storage.changes import STEP, Change, Cut, Decision, Evidence, KeptChange
from service.storage.models import Announced, ModelChange
from service.storage.versions import Version
from service.usecases.gate import Gate, find_announced, find_predecessors, tell_change, tell_shapes
from tests.service.conftest import instant, new_version

GATE = Gate(change=0.1, error=0.05, coverage=0.4, band=0.7)
PATH = Scope("CS001", 0, "X")
FREQUENCY = np.arange(30.0, 81.0)
CS002 = Scope("CS002", None, None)


def curve(c=1e-3, error=0.01, dipole="X", status=CONVERGED):
    has_c = status == CONVERGED
    values = np.full(51, c) if has_c else None
    errors = np.full(51, error * c) if has_c else None
    return CalibrationCurve(
        "CS002", None, dipole, status, 900 if has_c else 3, FREQUENCY, values, errors, errors, 1.0, 1.0, {}
    )


def version(*curves, made=100, window=(0, 50)):
    inputs = {"made": made, "c": [None if one.c is None else one.c[0] for one in curves], "window": list(window)}
    return Version(CS002, *window, inputs, curves, made, "somebody", "a test")


BEFORE = version(curve(), curve(dipole="Y"))


def test_a_version_like_the_one_before_passes_and_so_does_the_first():
    new = version(curve(1.01e-3), curve(1.01e-3, dipole="Y"), made=200, window=(50, 100))
    assert GATE.objection(new, BEFORE) is None
    assert GATE.objection(new, None) is None


@pytest.mark.parametrize(("factor", "passes"), [(1.099, True), (1.101, False), (0.901, True), (0.899, False)])
@pytest.mark.parametrize("changed", ["X", "Y"])
def test_a_jump_of_either_curve_beyond_the_limit_waits_in_both_directions(factor, passes, changed):
    curves = [curve(1e-3 * (factor if dipole == changed else 1.0), dipole=dipole) for dipole in "XY"]
    objection = GATE.objection(version(*curves, made=200, window=(50, 100)), BEFORE)
    assert (objection is None) == passes
    if objection:
        assert f"CS002 {changed}: mean C differs by {factor - 1:+.1%}" in objection
        assert "10.0%" in objection


def test_a_jump_by_another_simulation_says_which_part_of_it_is_another():
    after = replace(version(curve(1.2e-3), made=200, window=(50, 100)), inputs={"sky_power": "b", "instrument": "c"})
    before = replace(BEFORE, inputs={"sky_power": "a", "instrument": "c"})
    assert str(GATE.objection(after, before)).endswith("at most 10.0% passes; it was made with another sky power")


@pytest.mark.parametrize(("scope", "factor", "passes"), [
    (PATH, 1.0, True), (PATH, 0.75**-0.5, True), (PATH, 1.3, False), (CS002, 1.0, False), (CS002, 0.75**-0.5, True),
])  # fmt: skip
def test_own_c_moves_by_no_record_of_its_cable_that_is_corrected(scope, factor, passes):
    """C of its own data, unchanged, was told to differ by 15.6 %, as another cable was taken out of it."""

    def through(loss, c):
        chain = ReferenceChain((("CS001", 0),), np.full(51, loss), CableTable({}, ()), None)
        return replace(version(curve(c)), scope=scope, chains={"X": chain})

    objection = GATE.objection(through(0.75, factor * 1e-3), through(1.0, 1e-3))
    assert (objection is None) == passes, objection


def test_each_dipole_is_compared_with_itself():
    before = version(curve(1e-3), curve(2e-3, dipole="Y"))
    same = version(curve(1e-3), curve(2e-3, dipole="Y"), made=200, window=(50, 100))
    assert GATE.objection(same, before) is None
    exchanged = version(curve(2e-3), curve(1e-3, dipole="Y"), made=200, window=(50, 100))
    assert GATE.objection(exchanged, before) is not None


@pytest.mark.parametrize(("error", "passes"), [(0.049, True), (0.051, False)])
def test_an_error_above_the_limit_waits_even_without_a_version_before(error, passes):
    new = version(curve(error=error), curve(dipole="Y"), made=200)
    assert (GATE.objection(new, None) is None) == passes
    if not passes:
        assert "error of C 5.1% in its 51 good channels with 900 events, at most 5.0% passes" in GATE.objection(
            new, None
        )


def test_a_change_in_force_between_two_versions_is_no_objection():
    """A cable that drift found, dated and sized at 21 % waited for a human, and C of before it stayed in effect."""
    later, earlier = (
        version(curve(c), curve(c, dipole="Y"), made=200, window=window)
        for c, window in ((1.24e-3, (50, 100)), (0.8e-3, (-50, 0)))
    )
    whole = Cut("CS002", None, 50, None, 1.2**-2.0)
    assert GATE.objection(later, BEFORE, None, [whole]) is None
    assert GATE.objection(later, BEFORE, None, [replace(whole, power=None)]) is None, "nobody knows its size"
    assert GATE.objection(earlier, BEFORE, None, [replace(whole, date=10)]) is None, "and the other way in time"
    for other in (replace(whole, date=500), replace(whole, antenna=3), replace(whole, power=1.2**2.0)):
        assert "differs by +24.0%" in str(GATE.objection(later, BEFORE, None, [other]))
    # of a window that is cut, the first part waited, and the mean over the change stayed in effect there
    for c, window, power in (
        (1.24e-3, (0, 20), 1.2**2.0),
        (0.8e-3, (20, 50), 1.2**2.0),
        (1.24e-3, (20, 50), 1.2**-2.0),
    ):
        part, cut = (
            version(curve(c), curve(c, dipole="Y"), made=200, window=window),
            replace(whole, date=20, power=power),
        )
        assert GATE.objection(part, BEFORE, None, [cut]) is None
        assert GATE.objection(part, BEFORE, None, [replace(cut, power=1.0 / power)]) is not None


def test_a_ramp_in_force_is_no_objection_and_its_opposite_is():
    """Beyond 10 % a year every year of an antenna that goes on rising waited for a human."""
    years = [(0, round(YEAR_S * 1e6)), (round(YEAR_S * 1e6), round(2 * YEAR_S * 1e6))]
    before, after = (
        version(curve(c), curve(c, dipole="Y"), made=made, window=window)
        for c, made, window in ((1e-3, 100, years[0]), (1.2e-3, 200, years[1]))
    )
    ramp = SlowChange(False, 0.0, 0.0, np.log(1.15), 0.01, (0.0, 0.0))
    assert GATE.objection(after, before, None, (), [ramp]) is None
    assert GATE.objection(replace(before, made=300), after, None, (), [ramp]) is None, "and the other way in time"
    season = replace(ramp, is_season=True)
    for other in ([], [replace(ramp, size=-ramp.size)], [replace(ramp, date_unix=1.9 * YEAR_S)], [season]):
        assert "differs by +20.0%" in str(GATE.objection(after, before, None, (), other))


def test_a_curve_that_did_not_converge_waits():
    new = version(curve(), curve(dipole="Y", status=TOO_FEW_EVENTS), made=200)
    assert "CS002 Y: too_few_events with 3 events" in GATE.objection(new, None)


def test_one_bad_channel_does_not_keep_a_curve_back_and_sixteen_do():
    """A path on 115 m of cable waited because its channel at 80 MHz was uncertain by 24 %."""
    for bad, passes in ((1, True), (15, True), (16, False)):
        good = curve()
        error = good.c_sigma_stat.copy()
        error[-bad:] = 0.24 * 1e-3
        flagged = replace(good, c_sigma_stat=error, flag=("ok",) * (51 - bad) + ("uncertain",) * bad)
        objection = GATE.objection(version(flagged, curve(dipole="Y"), made=200), None)
        assert (objection is None) == passes
    assert objection.endswith("35 of 51 channels are good, at least 70% pass; bad ones lie between 65 and 80 MHz")
    # their own error does not make them so: a good year waited, and nothing said why
    doubted = GATE.objection(version(replace(flagged, c_sigma_stat=good.c_sigma_stat), made=200), None)
    assert doubted.startswith(objection)
    assert "in 16 another antenna, likelier than 1% by these spectra, moves C by more than 13%" in doubted
    assert "antenna_doubt of the instrument file is 0 where the antenna was measured" in doubted


def test_a_mean_without_members_says_why_it_has_no_events():
    none = replace(curve(), c=None, c_sigma_stat=None, flag=None, status="too_few_events", events=0, lst_coverage=0.0)
    told = GATE.objection(version(none, curve(dipole="Y"), made=200), None)
    assert told.endswith("too_few_events with 0 events of antennas with the 60 that a fit needs")


def test_events_that_see_little_of_the_sidereal_day_wait():
    new = version(replace(curve(), lst_coverage=0.3), curve(dipole="Y"), made=200)
    assert "900 events see 7.2 h of the sidereal day, at least 9.6 h pass" in GATE.objection(new, None)


def test_a_version_made_from_earlier_data_of_the_same_window_does_not_replace_a_later_one():
    late = replace(BEFORE, made=300)
    assert "later data" in GATE.objection(version(curve(), curve(dipole="Y"), made=200), late)
    other_window = version(curve(), curve(dipole="Y"), made=200, window=(50, 100))
    assert GATE.objection(other_window, late) is None


def promote(factory, stored, *lines):
    with factory.database.write() as stores:
        for scope, valid_from, valid_to, name in lines:
            version = stored[name].id if name else None
            stores.ledger.append([Promotion(0, scope, valid_from, valid_to, version, 0)], lambda: 1000)


def predecessor(factory, scope, middle):
    with factory.database.read() as stores:
        return find_predecessors(stores, [scope], middle).get(scope)


def test_the_predecessor_covers_the_middle_of_the_window_or_is_nearest_in_time(factory, stored):
    old, new = stored["path"].id, stored["other"].id
    other, wider = Scope("CS002"), Scope("CS001")
    promote(factory, stored, (PATH, 0, 100, "path"), (PATH, 100, 200, "other"), (other, 0, 400, "station"))
    promote(factory, stored, (wider, 0, 400, "station"))
    assert [predecessor(factory, PATH, middle) for middle in (50, 150, 300, -100)] == [old, new, new, old]
    assert predecessor(factory, Scope("CS004", None, None), 50) is None


@pytest.mark.parametrize(
    ("last", "middle"),
    [
        # a jump is one from what was in effect earlier, however soon another version begins
        ([(PATH, 300, 400, "other")], 290),
        # a withdrawn version is no predecessor
        ([(PATH, 100, 200, "other"), (PATH, 100, 200, None)], 150),
    ],
)
def test_in_a_gap_the_last_version_before_it_is_the_predecessor(factory, stored, last, middle):
    promote(factory, stored, (PATH, 0, 100, "path"), *last)
    assert predecessor(factory, PATH, middle) == stored["path"].id


def test_a_window_that_is_whole_again_waited_for_the_step_that_a_person_had_dismissed(factory: Factory) -> None:
    """Only where what is in effect is of one side of it: later a jump of the whole window is a jump."""
    half, year = instant("2014-07-01"), (instant("2014-01-01"), instant("2015-01-01"))
    pieces = [
        new_version(PATH, f"{level}", level, since=since, until=until)
        for level, since, until in ((1.0, year[0], half), (1.3, half, year[1]))
    ]
    whole, other = (new_version(PATH, name, 1.15) for name in ("whole", "other"))
    change = Change("CS001", ((0, "X"),), STEP, half, 0, 0.3, 0.01)
    found, said = Evidence("drift", "x", 9.0, 1), Decision("dismissed", 2, "a person", "snow")
    kept = KeptChange(1, change, 1, (found,), (said,))
    with factory.database.write() as stores:
        stores.versions.add([*pieces, other])
        stores.ledger.append([Promotion(0, PATH, *one.window, one.id, 0) for one in pieces], factory.clock)
        asked = [GATE.judge(stores, [whole], of)[whole.id] for of in ([kept], [])]
        assert (asked[0], "differs by -11.5%" in str(asked[1])) == (None, True)
        stores.ledger.append([Promotion(0, PATH, *year, other.id, 0)], factory.clock)
        jump = new_version(PATH, "jump", 1.3)
        assert "differs by +13.0%" in str(GATE.judge(stores, [jump], [kept])[jump.id])


def with_model(one: Version, model: str | None) -> Version:
    """The version as a fit with a model made it."""
    return replace(one, inputs={**one.inputs, **({} if model is None else {"model": model})})


def announce(**changes: tuple[float, float]) -> ModelChange:
    """The adoption of a cause that announced changes of mean C, by dipole of CS002."""
    told = {f"CS002 {dipole}": Announced(*change) for dipole, change in changes.items()}
    return ModelChange(
        1, "CS002", "adopted", "new", "old", "cause", 0, None, 50, None, None, told, None, 60, "somebody", "a test"
    )


@pytest.mark.parametrize(("factor", "passes"), [(1.25, True), (1.28, True), (1.35, False), (1.12, False), (0.8, False)])
def test_a_jump_passes_that_the_adoption_announced_within_three_of_its_errors(factor: float, passes: bool) -> None:
    new = version(curve(1e-3 * factor), curve(1e-3 * factor, dipole="Y"), made=200)
    change = announce(X=(0.25, 0.02), Y=(0.25, 0.02))
    objection = GATE.objection(with_model(new, "new"), BEFORE, change)
    assert (objection is None) == passes
    if objection:
        assert "or +19.0% to +31.0% for the change of the model" in objection
    assert GATE.objection(with_model(new, "new"), with_model(BEFORE, "new"), change) is not None, (
        "the model is the same"
    )
    assert GATE.objection(with_model(new, "new"), BEFORE, None) is not None


def test_the_array_may_move_by_any_part_of_what_one_of_its_stations_does() -> None:
    change = announce(X=(0.25, 0.02))
    assert find_announced(change, CS002, "X") == pytest.approx((0.19, 0.31))
    assert find_announced(change, Scope(), "X") == pytest.approx((-0.06, 0.31))
    assert find_announced(change, Scope("CS003"), "X") == (0.0, 0.0)
    assert find_announced(change, Scope(), "Y") == (0.0, 0.0)


BAND = np.array([10.0, 50.0, 90.0])
TILT = "a tilt (+5.00 ± 1.05 % at 90 MHz, -4.76 % at 10 MHz)"
CURVATURE = "a curvature (-2.00 ± 0.49 % at 10 and 90 MHz, +1.02 % halfway)"
SLIGHT = "a curvature (-1.00 ± 0.50 % at 10 and 90 MHz, +0.50 % halfway)"


def make_change(mean: float, tilt: float, curvature: float) -> dict[str, Any]:
    shape = {"tilt": {"value": tilt, "sigma": 0.01}, "curvature": {"value": curvature, "sigma": 0.005}}
    return {"size": mean, "sigma": 0.01, "shape": shape}


@pytest.mark.parametrize(
    ("mean", "tilt", "curvature", "told"),
    [
        (-0.05, 0.001, 0.001, "-5.00 ± 1.00 %"),
        (-0.05, math.log(1.05), 0.0, f"-5.00 ± 1.00 % in the mean over the band and by {TILT}"),
        (0.001, 0.001, math.log(0.98), f"{CURVATURE} and by +0.10 ± 1.00 % in the mean over the band"),
        (-0.15, math.log(1.045), 0.0, "-15.00 ± 1.00 %"),
        (0.015, 0.0, math.log(0.99), f"{SLIGHT} and by +1.50 ± 1.00 % in the mean over the band"),
    ],
)
def test_the_part_of_a_change_that_carries_it_is_told(mean: float, tilt: float, curvature: float, told: str) -> None:
    change = make_change(mean, tilt, curvature)
    sentence = tell_change(mean, 0.01, change["shape"], BAND)
    assert sentence == told


def test_a_table_has_the_mean_in_a_column_and_names_the_shapes_beside_it() -> None:
    assert tell_shapes(make_change(-0.05, 0.001, 0.001), BAND) == ""
    assert tell_shapes(make_change(-0.05, math.log(1.05), math.log(0.98)), BAND) == f"{TILT} and {CURVATURE}"


def test_who_changed_is_named_up_to_a_number() -> None:
    members = [{"antenna": 3, "dipole": "X"}, {"antenna": None, "dipole": "Y"}, {"antenna": 4, "dipole": "X"}]
    assert name_members(members, 3) == "antenna 3 X, all Y, antenna 4 X"
    assert name_members(members, 1) == "antenna 3 X and 2 more"
