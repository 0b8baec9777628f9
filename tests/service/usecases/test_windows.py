"""Which windows are fitted together, and of which paths the hardware is the same."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lbacal.instants import DAY_US, SECOND_US
from lbacal_core.calibration.slow_changes import SlowChange
from lbacal_core.causes.model import Model
from lbacal_core.curves.kept_lines import KeptLines
from lbacal_core.curves.validity import Scope
from lbacal_core.discovery.calibrate import FittedCauses
from lbacal_core.grids import YEAR_S
from service.storage.changes import Cut
from service.storage.sums import KeptPiece
from service.usecases.fits import Wanted, _list_cuts, _name_sizes, _take_out
from service.usecases.windows import ALONE, Neighbours
from tests.service.conftest import instant

LINES = KeptLines(
    owners=[("CS002", 0, "X"), ("CS002", 1, "X"), ("CS003", 0, "X"), (None, None, "X")],
    spectra=np.array(["a", "b", "c", "d"]), typical_blocks=100.0,
    **dict.fromkeys(("events", "has_c", "is_good", "slope", "intercept"), np.ones(4)),
    **dict.fromkeys(("information", "radiometer", "constant", "behind", "scatter", "loss"), np.ones(4)),
)  # fmt: skip
EARLY, NEXT, LATE = (
    KeptPiece(instant(f"{year}-01-01"), instant(f"{year + 1}-01-01"), [LINES]) for year in (2012, 2013, 2016)
)
YEAR = instant("2014-01-01"), instant("2015-01-01")


def is_same(changes: dict[tuple[str, int | None], list[int]], piece: KeptPiece) -> list[bool]:
    ((_, beside),) = Neighbours([piece], changes, {}).beside(*YEAR)
    assert beside.lines is LINES
    return [bool(one) for one in beside.is_same]


def test_the_nearest_window_comes_first() -> None:
    assert [one for one, _ in Neighbours([EARLY, LATE, NEXT], {}, {}).beside(*YEAR)] == [NEXT, EARLY, LATE]
    assert [one for one, _ in ALONE.and_also(LATE).and_also(NEXT).beside(*YEAR)] == [NEXT, LATE]


def test_a_change_between_two_windows_parts_the_paths_that_it_concerns() -> None:
    between, before, after = (instant(day) for day in ("2013-06-01", "2012-06-01", "2015-06-01"))
    assert is_same({}, EARLY) == [True] * 4
    assert is_same({("CS002", 1): [between]}, EARLY) == [True, False, True, True]
    assert is_same({("CS002", None): [between]}, EARLY) == [False, False, True, True]
    assert is_same({("CS002", 1): [before, after]}, EARLY) == [True] * 4
    assert is_same({("CS003", 0): [after]}, LATE) == [True, True, False, True]
    assert is_same({("CS003", 0): [YEAR[1]]}, replace(LATE, since=YEAR[1])) == [True, True, False, True]


def test_a_mean_is_named_by_the_noise_of_the_antennas_whose_changes_are_taken_out_of_it() -> None:
    """By that of all antennas it had another name after a decision about one of them was taken and undone."""
    year = instant("2014-01-01"), instant("2015-01-01")
    change = Cut("CS002", 1, instant("2014-07-01"), power=0.9)
    wanted = Wanted("station", Scope("CS002"), *year, Model(), "test", "test", (change,))
    whole: Any = SimpleNamespace(model=Model())

    def name(own: str, other: str) -> dict[str, str]:
        behind = {("CS002", 1, "X"): (np.ones(3), own), ("CS002", 2, "X"): (np.ones(3), other)}
        return _name_sizes(whole, wanted, Neighbours((), {}, behind))

    assert name("a", "b") == name("a", "c") != name("c", "b")
    of_all = replace(wanted, scope="array", of=Scope(), changed=(replace(change, antenna=None),))
    behind = {("CS002", antenna, "X"): (np.ones(3), "a") for antenna in (1, 2)}
    fewer = {key: of for key, of in behind.items() if key[1] == 1}
    names = [_name_sizes(whole, of_all, Neighbours((), {}, one)) for one in (behind, fewer)]
    assert names[0] != names[1]


@pytest.mark.parametrize("dipoles", [None, ("X", "Y"), ("X",)])
def test_of_two_ramps_of_one_path_the_last_is_taken_out_of_a_mean(dipoles: tuple[str, ...] | None) -> None:
    """That of a person and that of drift were both, where one named the dipole and the other the antenna."""
    first = SlowChange(False, 0.0, 0.0, 0.1, 0.01, (0.0, 0.0))
    last = replace(first, size=-0.04)
    changes = (Cut("CS002", 1, 0, ("X",), slow=first), Cut("CS002", 1, 0, dipoles, slow=last))
    wanted = Wanted("station", Scope("CS002"), 0, 2, Model(), "test", "test", changes)
    frequency = np.array([30.0, 55.0, 80.0])
    simulation: Any = SimpleNamespace(instrument=SimpleNamespace(frequency_mhz=frequency))
    spectra: Any = SimpleNamespace(
        station=np.array(["CS002"]), antenna=np.array([1]), dipole=np.array(["X"]), time_unix=np.array([YEAR_S]),
        power=np.ones((1, 3)),
    )  # fmt: skip
    none: Any = None
    whole = FittedCauses(spectra, simulation, none, ())
    taken_out = _take_out(whole, wanted, Neighbours((), {}, {})).unchanged
    assert taken_out is not None
    assert taken_out(spectra) == pytest.approx(np.exp([[2.0 * last.size] * 3]))


def test_each_dipole_of_an_antenna_is_taken_out_of_a_mean_by_what_it_changed() -> None:
    cut = Cut("CS002", 1, 0, ("X", "Y"), 0.8, (0.1, 0.0), own=(("Y", 0.9, (0.0, 0.0)),))
    wanted = Wanted("station", Scope("CS002"), -1, 2, Model(), "test", "test", (cut,))
    assert replace(wanted, changed=(replace(cut, own=()),)).named != wanted.named
    spectra: Any = SimpleNamespace(
        station=np.array(["CS002"] * 2), antenna=np.array([1, 1]), dipole=np.array(["X", "Y"]),
        time_unix=np.array([YEAR_S] * 2), power=np.array([[0.8] * 3, [0.9] * 3]),
    )  # fmt: skip
    simulation: Any = SimpleNamespace(instrument=SimpleNamespace(frequency_mhz=np.array([30.0, 55.0, 80.0])))
    none: Any = None
    taken_out = _take_out(FittedCauses(spectra, simulation, none, ()), wanted, Neighbours((), {}, {})).unchanged
    assert taken_out is not None
    assert taken_out(spectra) == pytest.approx(np.array([np.exp([0.1, 0.0, -0.1]), [1.0, 1.0, 1.0]]))


def test_a_cut_that_agrees_with_a_date_on_record_of_its_antenna_is_that() -> None:
    year, recorded = (instant("2014-01-01"), instant("2015-01-01")), instant("2014-03-01")
    near, far = (Cut("CS002", 1, instant(day), sigma=2 * DAY_US) for day in ("2014-03-06", "2014-03-10"))
    others = (replace(near, antenna=2), replace(near, antenna=None))
    wanted = Wanted("antenna", Scope("CS002"), *year, Model(), "test", "test", (near, far, *others))
    record = SimpleNamespace(station="CS002", antenna=1, since=recorded / SECOND_US, until=None)
    instrument: Any = SimpleNamespace(antennas=[record])
    cut = {("CS002", one.antenna): [one.date / SECOND_US] for one in (far, *others)}
    assert _list_cuts(wanted, instrument) == cut
    assert _list_cuts(replace(wanted, changed=(replace(far, sigma=3 * DAY_US),)), instrument) == {}
