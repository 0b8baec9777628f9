import numpy as np
import pytest

from lbacal_core.calibration.chain_test import LARGEST_GAIN
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.gain_waves import GAIN_WAVES, GainWaves, see_gain_waves, waves_of_gain
from lbacal_core.calibration.lines import PathLines
from lbacal_core.calibration.singles import chain_forms
from lbacal_core.curves.curves import CONVERGED, MISFIT
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.simulation.prior import SKY_HARMONICS
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import harmonics_at
from tests import lst_waves


@pytest.fixture(scope="module")
def simulation():
    return Simulation(load_instrument("lofar-superterp"))


@pytest.fixture(scope="module")
def clean(simulation):
    return lst_waves.simulate(simulation, seed=3, antennas=4, events=300)


def test_the_score_is_that_of_every_channel_and_event_beside_free_lines_and_a_free_sky(simulation, monkeypatch):
    """The slow oracle: all changes of the power written out, the lines' derivatives among them."""
    seen = []
    monkeypatch.setattr(
        "lbacal_core.calibration.fit.see_gain_waves",
        lambda fitted, chain: seen.append(fitted) or see_gain_waves(fitted, chain),
    )
    few = lst_waves.simulate(simulation, seed=3, antennas=2, events=90)
    fit_calibration(lst_waves.with_gain(few, simulation, 0.04), simulation, "station")
    assert len(seen) == 2
    for fitted in seen:
        path = PathLines.of(fitted.power[0], fitted.sky_power, fitted.relative_variance[0], fitted.lines)
        series, basis = fitted.freedom.search_series(fitted.dipole), harmonics_at(fitted.lst_hours, SKY_HARMONICS)
        events, channels = path.power.shape
        gains = np.broadcast_to(waves_of_gain(fitted.lst_hours)[:, :, None], (10, events, channels))
        sky = np.einsum("eh,mhf->mef", basis, series) * path.slope * path.of_sky
        lines = np.concatenate([np.eye(channels)[:, None] * one for one in (path.of_sky, path.of_constant)])
        changes = np.concatenate([gains, sky, lines])
        weighed = np.empty_like(changes)
        residual, dual = path.power / path.model - 1.0, np.empty_like(path.power)
        for e in range(events):
            inverse = np.diag(path.weight * path.precision[e]) - path.shared[e].T @ path.shared[e]
            weighed[:, e], dual[e] = changes[:, e] @ inverse, residual[e] @ inverse
        flat = changes.reshape(len(changes), -1)
        total = flat @ weighed.reshape(len(changes), -1).T
        total[10 : 10 + len(sky), 10 : 10 + len(sky)] += np.eye(len(sky))
        score = flat @ dual.ravel()
        left = np.linalg.solve(total[10:, 10:], np.column_stack([total[10:, :10], score[10:]]))
        own = total[:10, 10:]
        slow = GainWaves(score[:10] - own @ left[:, -1], total[:10, :10] - own @ left[:, :-1])
        fast = see_gain_waves(fitted, chain_forms(simulation.instrument))
        assert fast.information == pytest.approx(slow.information, rel=1e-5, abs=1e-6 * np.trace(slow.information))
        assert fast.odds == pytest.approx(slow.odds, abs=1e-3)


@pytest.mark.parametrize("scope", ["antenna", "station"])
def test_a_gain_that_follows_lst_is_a_misfit_of_all_curves_and_nothing_is_said_of_clean_ones(simulation, clean, scope):
    report = fit_calibration(clean, simulation, scope)
    assert {curve.status for curve in report.curves} == {CONVERGED}
    assert GAIN_WAVES not in report.provenance.notes
    report = fit_calibration(lst_waves.with_gain(clean, simulation, 0.04), simulation, scope)
    assert {curve.status for curve in report.curves} == {MISFIT}
    assert "CS002" in report.provenance.notes[GAIN_WAVES]
    assert all(curve.c is not None for curve in report.curves)


def test_a_sky_at_its_word_has_no_such_test(simulation, clean):
    report = fit_calibration(lst_waves.with_gain(clean, simulation, 0.04), simulation.at_its_word(), "station")
    assert GAIN_WAVES not in report.provenance.notes


def test_odds_of_noise_are_below_one_and_those_of_a_wave_grow_with_its_square():
    information = np.eye(10) / 0.004**2
    assert GainWaves(np.zeros(10), information).odds < -1.0
    odds = [GainWaves(information @ np.r_[size, np.zeros(9)], information).odds for size in (0.02, 0.04)]
    assert odds[0] < LARGEST_GAIN < odds[1]
    assert odds[1] - odds[0] == pytest.approx(0.5 * (100.0 - 25.0), rel=0.1)
