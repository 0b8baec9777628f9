"""What an adopted cause gains on new data: measured, expected, and promised beforehand."""

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.model import PLAIN, AdoptedCause, Model
from lbacal_core.discovery.adopted import measure_gains, promise_of, true_share
from lbacal_core.discovery.calibrate import promise_of_structure
from lbacal_core.discovery.hypothesis import Hypothesis, Target
from lbacal_core.discovery.left_open import _without, investigate_openly, weigh_alternatives
from lbacal_core.discovery.refit import fit_chain, refit
from lbacal_core.discovery.station import gather_stations
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.faults.sky import LstOffset, ZenithWeighting
from tests.lbacal_core.discovery.worlds import look_at

LATE = AdoptedCause("lst_offset", "CS002", "station", 0.3, 0.012)


@pytest.fixture(scope="module")
def late(spoil):
    return spoil(LstOffset(size=0.3))


@pytest.fixture(scope="module")
def gain(late, simulation):
    (found,) = measure_gains(late, simulation.with_causes(Model((LATE,))))
    return found


def test_a_cause_that_is_there_gains_what_is_expected(gain):
    assert gain.events == 300
    assert gain.expected > 100
    assert abs(gain.gain - gain.expected) < 3 * gain.expected_sigma
    # SNR^2 / 2 and its error: SNR beside the error of the size
    snr = np.sqrt(2 * gain.expected)
    assert gain.expected_sigma == pytest.approx(snr * np.sqrt(1 + (snr * 0.012 / 0.3) ** 2))


@pytest.mark.parametrize("size", [0.3, pytest.param(2.0, marks=pytest.mark.long)])
def test_the_gain_is_the_difference_of_two_log_likelihoods(size, spoil, simulation):
    """Against chi^2 of the chain fitted with the cause and without it, each with all its parameters.

    A clock that is 2 h off: the derivative at half the size, times the size, was 6 % beside the two likelihoods.
    """
    late = spoil(LstOffset(size=size))
    (gain,) = measure_gains(late, simulation.with_causes(Model((replace(LATE, size=size),))))
    look = look_at(late, simulation)
    fitted = look.fit_as_is("lst_offset", look.template("lst_offset"))
    right, wrong = (look.with_effect(fitted, one).model.linear for one in (size, 0.0))
    chi2 = [one.with_levels(right.residuals.levels).chi_squared()[0] for one in (right, wrong)]
    assert gain.gain == pytest.approx(0.5 * (chi2[1] - chi2[0]), rel=0.005)  # free vectors of either fit


@pytest.mark.long
def test_gains_of_disjoint_events_add_up(gain, late, simulation):
    new = np.isin(late.event_id, np.unique(late.event_id)[::4])
    parts = [measure_gains(late, simulation.with_causes(Model((LATE,))), is_new=at)[0] for at in (new, ~new)]
    assert [part.events for part in parts] == [75, 225]
    assert sum(part.gain for part in parts) == pytest.approx(gain.gain)
    assert sum(part.expected for part in parts) == pytest.approx(gain.expected)


def test_a_cause_that_has_gone_costs(clean, simulation):
    (gain,) = measure_gains(clean, simulation.with_causes(Model((LATE,))))
    assert gain.gain < gain.expected - 5 * gain.expected_sigma
    assert gain.gain == pytest.approx(-gain.expected, abs=4 * np.sqrt(2 * gain.expected))


def test_a_step_before_the_data_gains_nothing(clean, simulation):
    step = AdoptedCause("gain_step", "CS002", "antenna 1", 0.05, 0.01, {"date_unix": clean.time_unix.min() - 9e6})
    (gain,) = measure_gains(clean, simulation.with_causes(Model((step,))))
    assert (gain.events, gain.gain, gain.expected, gain.expected_sigma) == (0, 0.0, 0.0, 0.0)


def test_each_cause_has_a_gain_of_its_own_beside_the_other(late, simulation):
    """The second cause is not there: it costs about what it would gain, and takes nothing from the first."""
    absent = AdoptedCause("ionospheric_absorption", "CS002", "station", 0.05, 0.004, {"exponent": 0.75})
    first, second = measure_gains(late, simulation.with_causes(Model((absent, LATE))))
    assert (first.number, second.number) == (0, 1)
    assert first.gain > 100
    assert second.gain < 0


def test_nothing_is_measured_without_causes_or_without_their_station(clean, simulation):
    assert measure_gains(clean, simulation.with_causes(PLAIN)) == []
    assert measure_gains(clean, simulation.with_causes(Model((replace(LATE, station="CS003"),)))) == []


FINDING = {
    "size": {"value": 0.3, "sigma": 0.01},
    "parameters": {},
    "gain": {"chi2_before": 1900.0, "chi2_after": 1000.0},
    "evidence": {"score_sigma": 30.0, "trials": 5.0, "events": 400},
}


def test_a_strong_finding_promises_half_its_squared_snr():
    promise = promise_of(FINDING)
    assert promise.gain == pytest.approx(450.0)
    # noise and the error of the size, and the noise levels of both years, 400 events each
    assert promise.sigma == pytest.approx(np.sqrt(2 * 30.0**2 + 45.0**2))


def test_structure_promises_what_is_no_noise_of_its_gain():
    """In words it is adopted as it is, less what its numbers gain by chance; as a term that was shrunk."""
    words = {"place": "receiver", "law": ["power", -2.0], "course": ["near", "solar rotation", 0.5, 0.1]}
    said = promise_of_structure({"sentences": [{"gain": {"chi2": 100.0}, "parameters": words}]})
    assert (said.gain, said.sigma) == (50.0 - 4.0, 10.0)  # its size and three numbers
    term = promise_of_structure({"sentences": [], "gain": {"chi2": 100.0, "terms": 20}})
    assert (term.gain, term.sigma) == pytest.approx((80.0**2 / 200.0, 0.8 * 10.0))
    assert promise_of_structure({"gain": {"chi2": 20.0, "terms": 20}}).gain == 0.0, "all of it is noise"


def test_a_weak_finding_promises_less_because_it_was_selected():
    weak = {**FINDING, "size": {"value": 0.05, "sigma": 0.01}, "gain": {"chi2_before": 1025.0, "chi2_after": 1000.0}}
    weak["evidence"] = {**FINDING["evidence"], "score_sigma": 5.0}
    promise = promise_of(weak)
    assert promise.gain < 0.9 * 12.5


@pytest.mark.long
def test_the_true_score_is_unbiased_above_the_threshold():
    """A search sees only scores above its threshold, 3.9 for one trial of each cause."""
    rng = np.random.default_rng(1)
    for true in (4.5, 6.0, 9.0):
        drawn = true + rng.standard_normal(4000)
        shares = np.array([true_share(z, 1.0) for z in drawn])
        seen = shares > 0
        corrected, found = np.mean((shares * drawn)[seen]), np.mean(drawn[seen])
        assert abs(corrected - true) < max(abs(found - true), 0.1)


@pytest.fixture(scope="module")
def weighted(spoil, simulation):
    """A year whose sky is weighted with another power of the cosine, and the hypothesis that it is."""
    spectra = spoil(ZenithWeighting(size=1.0))
    (station,) = gather_stations(spectra, simulation)
    first = fit_chain(station)
    cause = next(one for one in CAUSES if one.identifier == "zenith_weighting")
    target = Target("station", "station", np.ones(len(station.antenna), dtype=bool))
    last = refit(first, Hypothesis(cause, cause.templates(station.conditions)[0], target, 0.0))
    return spectra, first, last


@pytest.mark.long
def test_the_finding_itself_moves_c_by_what_it_was_off(weighted, clean, simulation):
    spectra, first, last = weighted
    (found,) = weigh_alternatives(first, last, last.hypotheses[0], [])
    assert found.weight == 1.0
    assert found.delta_chi2 == 0.0
    # the same hardware with and without the fault
    before, after = (fit_calibration(one, simulation, "antenna").curves for one in (spectra, clean))
    for letter in "XY":
        paths = [(a, b) for a, b in zip(before, after, strict=True) if a.dipole == letter]
        off = np.mean([np.log(a.c / b.c) for a, b in paths], axis=0)
        sigma = np.mean([a.c_sigma_stat / a.c for a, _ in paths], axis=0)
        assert np.median(np.abs(off)) > 2 * np.median(sigma)
        assert np.median(np.abs(found.d_ln_c[letter] + off)) < 0.5 * np.median(np.abs(off))


def test_what_fits_nearly_as_well_keeps_its_likelihood_and_its_own_change_of_c(weighted):
    _, first, last = weighted
    wider = [one for one in CAUSES if one.identifier == "pattern_width"]
    found, other = weigh_alternatives(first, last, last.hypotheses[0], wider)
    assert other.hypothesis.cause.identifier == "pattern_width"
    assert other.weight == pytest.approx(np.exp(-0.5 * max(other.delta_chi2, 0.0)))
    # a wider pattern takes up a part of the effect, so that it does not fit worse than no hypothesis
    assert other.delta_chi2 <= first.linear.chi_squared()[0] - last.linear.chi_squared()[0]
    assert np.max(np.abs(other.d_ln_c["X"] - found.d_ln_c["X"])) > 1e-3


def test_without_its_only_finding_a_model_is_the_chain_alone(weighted):
    _, first, last = weighted
    alone = _without(last, last.hypotheses[0])
    assert len(alone.hypotheses) == 0
    np.testing.assert_allclose(alone.baseline.solution.x, first.baseline.solution.x)


@pytest.mark.long
def test_a_finding_of_a_report_says_what_it_does_to_c_of_its_paths(spoil, simulation):
    step = GainStep(size=0.05, where=Where(antennas=(2,), dipoles=("Y",)), date="2014-08-07")
    report = investigate_openly(spoil(step), simulation)
    (finding,) = report["findings"]
    itself, *_ = finding["left_open"]
    assert itself["cause"] == "gain_step"
    assert itself["weight"] == 1.0
    assert list(itself["d_ln_c"]) == ["Y"]
    # 5 % more power in the last 40 % of the year: 1 % of C
    assert np.median(itself["d_ln_c"]["Y"]) == pytest.approx(0.01, abs=0.006)
