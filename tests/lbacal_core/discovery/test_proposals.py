from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Template, signature
from lbacal_core.discovery.findings import gain_in_chi_squared
from lbacal_core.discovery.hypothesis import list_targets
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.refit import fit_chain, refit
from lbacal_core.discovery.scan import Score, refine, scan
from lbacal_core.discovery.station import gather_stations
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep, GainTemperature
from lbacal_twin.faults.sky import DipoleSwap, RfiBroadband
from lbacal_twin.gains import EventGains
from tests.lbacal_core.discovery.worlds import look_at
from validation.anywhere import SETTINGS, draw_faulty

NAMED = {cause.identifier: cause for cause in CAUSES}


def best_of(spectra, simulation, cause):
    model = fit_chain(gather_stations(spectra, simulation)[0]).linear
    (score,) = scan(model, [NAMED[cause]], list_targets(model.station))
    return model, score


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.identifier)
def test_the_templates_about_one_contain_it_or_its_like(cause, station):
    conditions = station.conditions
    for template in cause.templates(conditions)[:: max(len(cause.templates(conditions)) // 5, 1)]:
        finer = cause.finer_templates(conditions, template)
        profile = cause.time_profile(conditions, template)
        nearest = min(np.abs(cause.time_profile(conditions, one) - profile).sum() for one in finer)
        assert nearest <= 1e-9 * np.abs(profile).sum() + 1.0  # a step between two events moves one event


def test_hours_between_those_of_the_scan_are_found_and_power_is_not_missing(spoil, simulation):
    model, score = best_of(spoil(RfiBroadband(size=0.05, index=0.0, hours=(17.0, 2.0))), simulation, "rfi_broadband")
    template = refine(model, score, Policy()).template
    assert template.parameters["utc_h"] == [17, 2]
    # As if the scan had preferred what is missing at all other hours.
    others = Template({**score.parameters, "utc_h": list(reversed(score.parameters["utc_h"]))})
    template = refine(model, replace(score, template=others), Policy()).template
    assert template.parameters["utc_h"] == [17, 2]


def test_the_date_of_a_strong_step_is_that_of_an_event(spoil, simulation):
    step = GainStep(size=0.2, where=Where(antennas=(2,)), date="2014-08-07")
    model, score = best_of(spoil(step), simulation, "gain_step")
    found = refine(model, score, Policy())
    date = np.datetime64("2014-08-07").astype("datetime64[s]").astype(float)
    times = model.station.conditions.time_unix
    assert found.template.parameters["date_unix"] == times[times >= date].min()
    assert found.template_sigma < 1e-3  # 100 standard deviations leave no other date open


@pytest.mark.long
def test_the_scatter_of_the_size_is_that_of_the_likelihood_over_the_templates(spoil, simulation, monkeypatch):
    """Against the plain sum over every 11th template one by one, each with its own score and size."""
    model, score = best_of(spoil(RfiBroadband(size=0.004, index=-2.0, hours=(6.0, 18.0))), simulation, "rfi_broadband")
    finer = type(score.cause).finer_templates
    monkeypatch.setattr(type(score.cause), "finer_templates", lambda *asked: finer(*asked)[::11])
    found = refine(model, score, Policy())
    conditions = model.station.conditions
    chi2, sizes, chosen = [], [], None
    for one in score.cause.finer_templates(conditions, score.template):
        vector = signature(score.cause, model.terms, conditions, one)
        (product,), ((information,),) = model.products([vector], [score.target])
        chi2.append(product**2 / information)
        sizes.append(product / information)
        chosen = len(sizes) - 1 if one == found.template else chosen
    chi2, sizes = np.array(chi2), np.array(sizes)
    weight = np.where(sizes > 0, np.exp((chi2 - chi2[chosen]) / 2), 0.0)
    expected = np.sqrt(np.average((sizes / sizes[chosen] - 1) ** 2, weights=weight))
    assert found.size == pytest.approx(sizes[chosen], rel=1e-3)
    assert found.template_sigma == pytest.approx(expected, rel=1e-3)
    assert found.template_sigma > 0.01
    assert found.over_templates == pytest.approx(2 * np.log(weight.mean()), rel=1e-3)


def test_a_cause_of_one_template_keeps_it(clean, simulation):
    model = fit_chain(gather_stations(clean, simulation)[0]).linear
    drift = NAMED["gain_drift"]
    score = Score(drift, Template(), list_targets(model.station)[0], 5.0, 0.1, events=300)
    found = refine(model, score, Policy())
    assert (found.template, found.size, found.template_sigma, found.over_templates) == (Template(), 0.1, 0.0, 0.0)


@pytest.mark.long
def test_an_exchange_of_the_only_two_letters_has_a_gain_on_held_out_events(world):
    """Its template names no pair of letters where there is one, and the gain asked for the pair: KeyError."""
    look = world.look(DipoleSwap(size=0.3))
    (found,) = [one for one in look.investigate().findings if one.hypothesis.cause.identifier == "dipole_swap"]
    assert found.held_out_gain > 0


def test_noise_times_effect_is_no_gain_in_chi_squared():
    """A drift seen at 5.6 sigma gained 15 of chi^2: residuals relative to two powers differ by noise times effect."""
    rng = np.random.default_rng([18, 209])
    instrument, faults = draw_faulty(rng, "gain_step")
    sky = compute_sky_power(instrument)
    spectra = simulate_campaign(SETTINGS, instrument, sky, rng, faults).spectra
    model, score = best_of(spectra, Simulation(instrument, sky), "gain_drift")
    before = fit_chain(model.station)
    fitted = refit(before, refine(model, score, Policy()))
    assert gain_in_chi_squared(before, fitted) == pytest.approx(score.z**2, rel=0.02)


@pytest.mark.long
def test_a_cause_that_the_means_alone_show_gains_what_they_show(world):
    """Common gains in front of N_RCU had been taken out of the deviations with the effect, and came out once more.

    Of two causes with 8.5 sigma one lost 85 of chi^2 in the deviations and a third, of 6.2 sigma, was chosen.
    """
    busy = replace(world, seed=20).with_settings(antennas=12, events_per_year=400)
    spectra = busy.spectra(GainTemperature(size=0.03), gains=EventGains(common_place="front"))
    look = look_at(spectra, world.simulation, with_modes=True)
    everyone = list_targets(look.data)[-1:]
    (score,) = scan(look.model.linear, [NAMED["gain_temperature"]], everyone)
    assert score.z > 6
    fitted = refit(look.model, refine(look.model.linear, score, Policy()))
    assert gain_in_chi_squared(look.model, fitted) == pytest.approx(score.z**2, rel=0.1)
