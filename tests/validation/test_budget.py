"""A small instance of `./dev prove budget`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.budget import OTHER_ANTENNA, compute_budget
from lbacal_core.calibration.chain_form import FORM_OF_CHAIN
from lbacal_core.sky.power import compute_sky_power
from validation.budget import SETTINGS, believe, draw_antenna, draw_campaign, tell_campaign
from validation.machinery.parts import Row
from validation.machinery.records import verdicts_of
from validation.own_cable import SCOPES

SMALL = replace(SETTINGS, stations=SETTINGS.stations[:3], events_per_year=200)


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return [tell_campaign("models", SMALL, seed) for seed in range(5)]


def test_the_truth_lies_within_the_total_error_when_every_term_is_drawn(rows: list[Row]) -> None:
    for scope in SCOPES:
        # what is drawn is common to a campaign: 5 campaigns know a rate to 0.2
        assert np.mean([row[scope]["all"]["within_2"] for row in rows]) > 0.8
        assert np.mean([row[scope]["all"]["within_1"] for row in rows]) > 0.3
        # and yet the statistical error alone would not do
        assert np.mean([row[scope]["all"]["told"] for row in rows]) > 0.05


def test_a_departure_of_one_standard_deviation_is_no_misfit(rows: list[Row]) -> None:
    assert sum(row["misfits"] for row in rows) == 0


def test_what_is_drawn_is_in_the_data_and_not_in_what_the_fit_believes() -> None:
    believed = believe("models")
    none = tuple(replace(one, d_ln_p={p: 0.0 * size for p, size in one.d_ln_p.items()}) for one in believed.changes)
    drawn, plain = (
        draw_campaign(replace(believed, changes=changes), SMALL, np.random.default_rng(1)).spectra
        for changes in (believed.changes, none)
    )
    change = np.log(drawn.power / plain.power).mean(axis=0)
    assert np.ptp(change) > 0.02
    assert believed.simulation.sky_power.digest() == compute_sky_power(believed.simulation.instrument).digest()
    assert {record.cable for record in believed.simulation.instrument.antennas} == {"50", "80", "115"}


def test_the_judgement_refutes_errors_that_are_too_small(rows: list[Row]) -> None:
    boasting = [{**row, "own": {"all": {**row["own"]["all"], "within_1": 0.1, "within_2": 0.2}}} for row in rows]
    verdicts = verdicts_of("budget", "models", boasting)
    assert {verdicts["own_1"], verdicts["own_2"]} == {"refuted"}


def test_every_term_of_the_budget_is_drawn() -> None:
    """Another antenna was a term of the budget and of no campaign."""
    for sky_budget in ("models", "measured"):
        believed = believe(sky_budget)
        campaign = draw_campaign(believed, SMALL, np.random.default_rng(1))
        terms = {term.name for term in compute_budget(campaign.spectra, believed.simulation, sky_budget).terms}
        drawn = {change.name.partition(" (")[0] for change in believed.changes}
        # the form of the chain is drawn by `chain_form`, in the second world
        assert terms <= drawn | {"interference left", "shape of the antenna gain", OTHER_ANTENNA, FORM_OF_CHAIN}
        assert {"antenna pattern", "ground and losses"} < drawn
    rng = np.random.default_rng(2)
    others = [one for one in (draw_antenna(believed.prior, rng) for _ in range(4000)) if one is not None]
    # 4.7 % of campaigns, half of them the quarter-wave dipole
    assert len(others) == pytest.approx(190, abs=45)
    assert sum(one.name == "quarter-wave" for one in others) == pytest.approx(len(others) / 2, abs=25)
    assert len({one.name for one in others}) == 12
    assert believe("measured").simulation.instrument.sky == "measured"
