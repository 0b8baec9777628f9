from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.continued import continue_fit
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.kept_lines import read_lines, write_lines
from lbacal_core.spectra.screening import LARGEST_SHARE_OF_LATER

EVENTS = 400


@pytest.fixture(scope="module")
def spectra(scene):
    return scene.spectra(np.random.default_rng(31), events=EVENTS, antennas=3, stations=2)


def part(spectra, first, last):
    number = np.array([int(name[1:]) for name in spectra.event_id])
    return spectra.select((number >= first) & (number < last))


def kept_of(scene, spectra, scope):
    report = fit_calibration(spectra, scene.simulation, scope)
    return read_lines(write_lines(report.lines))


@pytest.mark.parametrize("scope", ["antenna", "station", "array"])
@pytest.mark.parametrize("more", [1, 15])
def test_a_continued_fit_equals_the_fit_from_all_spectra_within_a_tenth_of_sigma_or_less(scene, spectra, scope, more):
    kept = kept_of(scene, part(spectra, 0, EVENTS - more), scope)
    found = continue_fit(kept, part(spectra, EVENTS - more, EVENTS), scene.simulation)
    whole = fit_calibration(spectra, scene.simulation, scope)
    off = [np.max(np.abs(found.curves[curve.path][0] - curve.c) / curve.c_sigma_stat) for curve in whole.curves]
    assert len(off) == {"antenna": 12, "station": 4, "array": 2}[scope]
    assert found.undecided == frozenset()
    stated = {error for *_, error in found.curves.values()}
    assert max(off) < min(stated) <= max(stated) < 0.1
    for curve in whole.curves:
        np.testing.assert_allclose(found.curves[curve.path][1], curve.c_sigma_stat, rtol=0.1)


@pytest.mark.parametrize("scope", ["antenna", "array"])
def test_events_that_move_c_move_it_alike_in_both(scene, spectra, scope):
    """Fifteen events that are brighter by 2.5 % in all channels: C moves by more than a tenth of sigma, and alike."""
    new = part(spectra, EVENTS - 15, EVENTS)
    brighter = replace(
        spectra, power=np.where(np.isin(spectra.event_id, new.event_id)[:, None], 1.025, 1) * spectra.power
    )
    before = fit_calibration(part(spectra, 0, EVENTS - 15), scene.simulation, scope)
    kept = read_lines(write_lines(before.lines))
    found = continue_fit(kept, part(brighter, EVENTS - 15, EVENTS), scene.simulation)
    whole = fit_calibration(brighter, scene.simulation, scope)
    moved = np.array([(new.c - old.c) / new.c_sigma_stat for new, old in zip(whole.curves, before.curves, strict=True)])
    told = np.array(
        [(found.curves[new.path][0] - old.c) / new.c_sigma_stat
         for new, old in zip(whole.curves, before.curves, strict=True)]
    )  # fmt: skip
    assert np.max(np.abs(moved)) > 0.2
    assert np.max(np.abs(moved - told)) < 0.1


def test_an_anomalous_spectrum_is_left_to_the_fit_from_spectra(scene, spectra):
    new = part(spectra, EVENTS - 1, EVENTS)
    for scope in ("antenna", "station"):
        kept = kept_of(scene, part(spectra, 0, EVENTS - 1), scope)
        for row, factor, channels in ((0, 1.6, slice(None)), (7, 0.6, slice(None)), (3, 4.0, 5)):
            power = new.power.copy()
            power[row, channels] *= factor
            found = continue_fit(kept, replace(new, power=power), scene.simulation)
            path = str(new.station[row]), int(new.antenna[row]), str(new.dipole[row])
            assert found.undecided == {path if scope == "antenna" else (path[0], None, path[2])}
            assert len(found.curves) == {"antenna": 12, "station": 4}[scope] - 1


def test_more_events_than_a_twentieth_are_left_to_the_fit_from_spectra(scene, spectra):
    most = int(LARGEST_SHARE_OF_LATER * (EVENTS - 20))
    kept = kept_of(scene, part(spectra, 0, EVENTS - most - 1), "antenna")
    few, many = (part(spectra, EVENTS - count, EVENTS) for count in (most, most + 1))
    assert continue_fit(kept, few, scene.simulation).undecided == frozenset()
    assert len(continue_fit(kept, many, scene.simulation).undecided) == 12


def test_a_path_without_enough_events_waits_until_it_has_them(scene, spectra):
    """An antenna that was dead for most of the year has 58 events: two more, and a fit from spectra gives it C."""
    number = np.array([int(name[1:]) for name in spectra.event_id])
    alive = spectra.select((spectra.antenna != 1) | (number >= EVENTS - 60))
    kept = kept_of(scene, part(alive, 0, EVENTS - 2), "antenna")
    one, two = (part(alive, EVENTS - 2, EVENTS - 2 + count) for count in (1, 2))
    found = continue_fit(kept, one, scene.simulation)
    assert (len(found.curves), found.undecided) == (8, frozenset())
    found = continue_fit(kept, two, scene.simulation)
    assert found.undecided == {(station, 1, dipole) for station in ("CS002", "CS003") for dipole in "XY"}
