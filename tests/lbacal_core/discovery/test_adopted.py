"""Adopted causes in one station's data: which of them act, and the joint fit of their sizes."""

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.cause import REFERENCE_C
from lbacal_core.causes.model import PLAIN, AdoptedCause, Model
from lbacal_core.discovery.adopted import find_members, fit_adopted, list_hypotheses
from lbacal_core.discovery.baseline import fit_baseline
from lbacal_core.discovery.findings import change_of_c
from lbacal_core.discovery.refit import fit_chain, power_ratio, refit
from lbacal_core.discovery.station import gather_stations
from lbacal_core.errors import BadInputError
from lbacal_core.pipeline import calibrate
from lbacal_twin.faults.hardware import GainTemperature
from lbacal_twin.faults.sky import IonosphericAbsorption, LstOffset

DAY = 86_400
LATE = AdoptedCause("lst_offset", "CS002", "station", 0.15, 0.02)
"""Half of what is planted: a later year corrects the size."""
ABSORBS = AdoptedCause("ionospheric_absorption", "CS002", "station", 0.05, 0.01, {"exponent": 0.75})


@pytest.fixture(scope="module")
def late(spoil, simulation):
    (station,) = gather_stations(spoil(LstOffset(size=0.3)), simulation)
    return station


def test_a_free_size_becomes_that_of_the_data(late):
    fitted = fit_adopted(late, Model((LATE,)))
    (size,) = fitted.sizes
    assert size.is_fitted
    assert size.value == pytest.approx(0.3, abs=4 * size.sigma)
    assert size.sigma == pytest.approx(fitted.covariance[0, 0] ** 0.5)
    assert size.sigma < 0.02
    assert size.adopted is LATE


def test_a_fixed_size_and_one_that_is_kept_stay_as_they_were_adopted(late):
    (size,) = fit_adopted(late, Model((replace(LATE, is_free=False),))).sizes
    assert (size.value, size.sigma, size.is_fitted) == (0.15, pytest.approx(0.02), False)
    (size,) = fit_adopted(late, Model((LATE,)), are_sizes_kept=True).sizes
    assert size.value == 0.15


def test_the_error_of_a_fixed_size_moves_a_free_one(late):
    """Beside a clock that is uncertain by its sigma the absorption is less certain than beside a known one."""
    sure = replace(LATE, size=0.3, sigma=1e-6, is_free=False)
    unsure = replace(sure, sigma=1.0)
    sigmas = []
    for clock in (sure, unsure):
        fitted = fit_adopted(late, Model((clock, ABSORBS)))
        assert [size.adopted.cause for size in fitted.sizes] == ["lst_offset", "ionospheric_absorption"]
        assert np.linalg.eigvalsh(fitted.covariance)[0] > 0
        sigmas.append(fitted.sizes[1].sigma)
    assert sigmas[1] > 1.1 * sigmas[0]


def test_a_plain_model_is_the_chain_alone(late):
    fitted = fit_adopted(late, PLAIN)
    assert fitted.sizes == []
    assert fitted.model.station is late
    np.testing.assert_array_equal(fitted.model.baseline.residual, fit_baseline(late).residual)


def test_a_cause_of_another_station_or_of_another_time_does_not_act(late):
    ends = int(late.conditions.time_unix.min())
    for other in (replace(LATE, station="CS003"), replace(LATE, until_unix=ends), replace(LATE, target="antenna 99")):
        assert fit_adopted(late, Model((other,))).sizes == []


def test_a_step_before_the_first_event_belongs_to_the_chain(late):
    """C of a year after a step is that after the step: applied, the step would carry C back to before it."""
    begin = late.conditions.time_unix.min()
    step = AdoptedCause("gain_step", "CS002", "antenna 1", 0.1, 0.01, {"date_unix": begin - 30 * DAY})
    assert fit_adopted(late, Model((step,))).sizes == []
    inside = replace(step, parameters={"date_unix": begin + 100 * DAY})
    assert len(fit_adopted(late, Model((inside,))).sizes) == 1


def test_a_cause_with_ends_changes_no_event_outside(late):
    times = late.conditions.time_unix
    middle = int(np.median(times))
    ((_, one),) = list_hypotheses(Model((replace(LATE, since_unix=middle),)), late)
    ratio = power_ratio(late, fit_baseline(late).terms, [one])
    np.testing.assert_allclose(ratio[:, times < middle], 1.0, rtol=1e-12)  # rounding
    assert np.abs(ratio[:, times >= middle] - 1.0).max() > 1e-3


@pytest.mark.long
def test_a_size_fitted_between_its_ends_is_that_of_the_events_there(late):
    middle = int(np.median(late.conditions.time_unix))
    (size,) = fit_adopted(late, Model((replace(LATE, since_unix=middle),))).sizes
    (whole,) = fit_adopted(late, Model((LATE,))).sizes
    assert size.sigma > 1.2 * whole.sigma
    # The events before are late as well, and the chain is fitted to both: the size differs, not its sign.
    assert 0.1 < size.value < 0.5


@pytest.mark.parametrize("label", ["antenna x", "board 3", "", "station CS002"])
def test_a_target_that_no_report_names_is_refused(late, label):
    with pytest.raises(BadInputError, match="antenna N"):
        find_members(late, label)


def test_targets_are_found_by_their_names(late):
    assert find_members(late, "station").all()
    assert find_members(late, "antenna 1").sum() == 2
    assert late.dipole[find_members(late, "antenna 1 X")].tolist() == ["X"]
    cable = late.conditions.cables[late.class_of[0]]
    of_cable = find_members(late, f"cable {cable}")
    assert set(np.array(late.conditions.cables)[late.class_of][of_cable]) == {cable}


@pytest.fixture(scope="module")
def warm(spoil):
    return spoil(GainTemperature(size=0.06))


FOLLOWS = AdoptedCause("gain_temperature", "CS002", "station", 0.05, 0.01, {"delay_h": 0.0})


def test_a_finding_says_what_its_adoption_does_to_c(warm, simulation):
    """C belongs to one temperature, whatever the mean of the window was: here 12 K above it."""
    late = replace(warm, environment={**warm.environment, "temperature_c": warm.environment["temperature_c"] + 12.0})
    (station,) = gather_stations(late, simulation)
    recorded = station.conditions.covariates["temperature_c"]
    np.testing.assert_allclose(station.conditions.warmth()[:, 0] * 10.0 + REFERENCE_C, recorded)
    plain, fitted = fit_chain(station), fit_adopted(station, Model((FOLLOWS,)))
    # the gain is less where C belongs, and as much of it for each kelvin a larger part
    assert fitted.sizes[0].value == pytest.approx(0.06 / (1.0 - 0.06 * 1.2), abs=4 * fitted.sizes[0].sigma)
    (effect,) = fitted.model.hypotheses
    change = change_of_c(plain, refit(plain, replace(effect, size=0.0)), effect.target)
    curves = [calibrate(late, simulation.with_causes(model)).curves for model in (PLAIN, Model((FOLLOWS,)))]
    adopted = np.array([new.c / old.c for old, new in zip(*curves, strict=True)]) - 1.0
    assert np.median(adopted) == pytest.approx(0.5 * 0.06 * (recorded.mean() - REFERENCE_C) / 10.0, abs=0.01)
    assert np.median(change) == pytest.approx(np.median(adopted), abs=0.002)


def test_events_whose_temperature_is_unknown_are_left_out(warm, simulation):
    values = warm.environment["temperature_c"].copy()
    lost = np.isin(warm.event_id, np.unique(warm.event_id)[::3])
    values[lost] = np.nan
    (station,) = gather_stations(replace(warm, environment={"temperature_c": values}), simulation)
    used = fit_adopted(station, Model((FOLLOWS,))).model.station.is_used
    assert used.sum() == np.unique(warm.event_id[~lost]).size


def test_data_without_the_covariate_are_refused(warm, simulation):
    (station,) = gather_stations(replace(warm, environment={}), simulation)
    with pytest.raises(BadInputError, match="temperature_c"):
        fit_adopted(station, Model((FOLLOWS,)))


def test_causes_that_the_data_cannot_tell_apart_are_refused(late):
    twice = (ABSORBS, replace(ABSORBS, parameters={"exponent": 0.7501}))
    with pytest.raises(BadInputError, match="tell the adopted causes apart"):
        fit_adopted(late, Model(twice))


def test_two_sizes_are_fitted_together(spoil, simulation):
    spectra = spoil(IonosphericAbsorption(size=0.08))
    (station,) = gather_stations(spectra, simulation)
    fitted = fit_adopted(station, Model((LATE, ABSORBS)))
    clock, absorption = fitted.sizes
    assert clock.value == pytest.approx(0.0, abs=4 * clock.sigma)
    assert absorption.value == pytest.approx(0.08, abs=4 * absorption.sigma)
    assert abs(fitted.covariance[0, 1]) > 0.01 * clock.sigma * absorption.sigma
