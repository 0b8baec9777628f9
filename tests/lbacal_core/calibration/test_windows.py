from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.windows import cut_window, find_hardware_changes, leave_out_changed, set_apart
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.spectra.spectra import Spectra

MHZ = np.array([30.0, 45.0, 60.0, 80.0])
DAYS = 100
ZERO = 1.4e9
"""Days of these tests are seconds from here, s UTC."""


def make_instrument(changes: dict[int, float], antennas: int = 4) -> Instrument:
    """Antennas of one station; those named change their cable on a day."""
    records = []
    for antenna in range(antennas):
        day = None if antenna not in changes else ZERO + changes[antenna]
        records.append(AntennaRecord("CS001", antenna, "80m", None, day))
        if day is not None:
            records.append(AntennaRecord("CS001", antenna, "50m", day, None))
    ones = np.ones(4)
    cables = {"80m": 0.5 * ones, "50m": 0.7 * ones}
    return Instrument("one", 52.9, 6.9, 50.0, MHZ, {"X": 45.0, "Y": 135.0}, ones, ones, cables, tuple(records))


@pytest.fixture
def spectra() -> Spectra:
    rows = [(day, antenna) for day in range(DAYS) for antenna in range(4)]
    day, antenna = (np.array(column) for column in zip(*rows, strict=True))
    return Spectra(
        frequency_mhz=MHZ, power=np.ones((len(rows), 4)), event_id=np.array([f"e{d}" for d in day]),
        time_unix=ZERO + day, station=np.full(len(rows), "CS001"), antenna=antenna,
        dipole=np.full(len(rows), "X"), blocks=np.full(len(rows), 100),
    )  # fmt: skip


def test_without_changes_a_window_is_whole(spectra):
    for scope in ("antenna", "station", "array"):
        (piece,) = cut_window(spectra, make_instrument({}), scope, ZERO, ZERO + 100.0)
        assert np.all(piece.rows(spectra))


def test_paths_are_cut_where_their_own_antenna_changed(spectra):
    pieces = cut_window(spectra, make_instrument({2: 30.0, 3: 60.0}), "antenna", ZERO, ZERO + 100.0)
    told = [
        (p.since_unix - ZERO, p.until_unix - ZERO, sorted(set(spectra.antenna[p.rows(spectra)].tolist())))
        for p in pieces
    ]
    assert told == [(0, 100, [0, 1]), (0, 30, [2]), (30, 100, [2]), (0, 60, [3]), (60, 100, [3])]
    assert sum(piece.rows(spectra).sum() for piece in pieces) == len(spectra)


def test_a_mean_leaves_out_the_few_that_changed(spectra):
    """A cable that was changed inside a year refused the whole station's refit."""
    (piece,) = cut_window(spectra, make_instrument({2: 30.0}), "station", ZERO, ZERO + 100.0)
    assert sorted(set(spectra.antenna[piece.rows(spectra)].tolist())) == [0, 1, 3]
    assert (piece.since_unix, piece.until_unix) == (ZERO, ZERO + 100.0)


def test_where_most_changed_the_mean_is_cut(spectra):
    pieces = cut_window(spectra, make_instrument({0: 30.0, 1: 30.0, 2: 60.0}), "station", ZERO, ZERO + 100.0)
    assert [(p.since_unix - ZERO, p.until_unix - ZERO) for p in pieces] == [(0, 30), (30, 60), (60, 100)]


def test_changes_outside_the_window_cut_nothing(spectra):
    for day in (-5.0, 0.0, 100.0, 200.0):
        assert len(cut_window(spectra, make_instrument({2: day}), "antenna", ZERO, ZERO + 100.0)) == 1


def test_what_changed_while_it_was_recorded_is_left_out(spectra):
    kept = leave_out_changed(spectra, make_instrument({1: 30.0}))
    assert kept is not None
    assert 1 not in kept.antenna
    assert leave_out_changed(spectra, make_instrument({1: 200.0})) is spectra
    assert leave_out_changed(spectra, make_instrument(dict.fromkeys(range(4), 50.0))) is None


def test_an_antenna_that_changed_is_set_apart_as_one_a_stretch(spectra):
    instrument = make_instrument({2: 30.0, 3: 60.0})
    apart, parts = set_apart(spectra, instrument)
    day = spectra.time_unix - ZERO
    assert np.all(apart.antenna[(spectra.antenna == 2) & (day >= 30)] == 2), "the longer stretch keeps its number"
    assert np.all(apart.antenna[(spectra.antenna == 3) & (day < 60)] == 3)
    (early,) = set(apart.antenna[(spectra.antenna == 2) & (day < 30)].tolist())
    (late,) = set(apart.antenna[(spectra.antenna == 3) & (day >= 60)].tolist())
    assert len({early, late, 0, 1, 2, 3}) == 6
    cables = {a: parts.cables_between("CS001", a, ZERO, ZERO + 100.0) for a in (0, 1, 2, 3, early, late)}
    assert cables == {0: ["80m"], 1: ["80m"], 2: ["50m"], 3: ["80m"], early: ["80m"], late: ["50m"]}
    assert set_apart(spectra, make_instrument({}))[0] is spectra


def test_changes_are_those_of_the_records():
    instrument = make_instrument({2: 30.0})
    assert find_hardware_changes(instrument) == {("CS001", 2): (ZERO + 30.0,)}
    assert find_hardware_changes(replace(instrument, antennas=instrument.antennas[:2])) == {}


def test_where_a_whole_station_changed_paths_and_mean_are_cut(spectra):
    everything = {("CS001", None): [ZERO + 40.0], ("CS001", 1): [ZERO + 70.0]}
    of_paths = cut_window(spectra, make_instrument({2: 30.0}), "antenna", ZERO, ZERO + 100.0, everything)
    told = [
        (p.since_unix - ZERO, p.until_unix - ZERO, sorted(set(spectra.antenna[p.rows(spectra)].tolist())))
        for p in of_paths
    ]
    assert told == [
        (0, 30, [2]), (30, 40, [2]), (40, 100, [2]), (0, 40, [0, 3]), (40, 100, [0, 3]),
        (0, 40, [1]), (40, 70, [1]), (70, 100, [1]),
    ]  # fmt: skip
    of_mean = cut_window(spectra, make_instrument({}), "station", ZERO, ZERO + 100.0, {("CS001", None): [ZERO + 40.0]})
    assert [(p.since_unix - ZERO, p.until_unix - ZERO) for p in of_mean] == [(0, 40), (40, 100)]


def test_a_step_in_a_year_in_which_the_antenna_has_a_record_was_never_cut(spectra):
    cuts = {("CS001", 2): [ZERO + 60.0, ZERO + 200.0]}
    pieces = cut_window(spectra, make_instrument({2: 30.0}), "antenna", ZERO, ZERO + 100.0, cuts)
    assert [(p.since_unix - ZERO, p.until_unix - ZERO) for p in pieces[1:]] == [(0, 30), (30, 60), (60, 100)]
