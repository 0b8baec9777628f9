"""Fits of stored spectra with an adopted model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lbacal.instants import parse_instant
from lbacal_core.causes.model import AdoptedCause, Model
from lbacal_core.curves.validity import Scope
from lbacal_core.discovery.calibrate import fit_causes
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import read_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from service.usecases.fits import Fits, Wanted
from service.usecases.watch import YEAR_US
from service.usecases.windows import Neighbours
from tests.service.conftest import Clock

LATE = AdoptedCause("lst_offset", "CS002", "station", 0.15, 0.02)


@pytest.fixture(scope="module")
def spectra(superterp: Instrument, sky_power_file: Path) -> Spectra:
    """A year of two antennas, with temperatures."""
    settings = TwinSettings(stations=("CS002",), antennas=2, years=0.99, events_per_year=100)
    sky = read_sky_power(sky_power_file)
    found = simulate_campaign(settings, superterp, sky, np.random.default_rng(8)).spectra
    assert "temperature_c" in found.environment
    return found


@pytest.fixture(scope="module")
def fits(superterp: Instrument, sky_power_file: Path) -> Fits:
    return Fits(Simulation(superterp, read_sky_power(sky_power_file)), 50.0, Clock())


def hotter(spectra: Spectra) -> Spectra:
    environment = {**spectra.environment, "temperature_c": spectra.environment["temperature_c"] + 1.0}
    return replace(spectra, environment=environment)


def louder(spectra: Spectra) -> Spectra:
    power = spectra.power.copy()
    power[7, 3] *= 1.01
    return replace(spectra, power=power)


def test_a_dipole_with_too_few_events_for_a_budget_borrows_nothing_and_the_other_is_fitted(
    spectra: Spectra, fits: Fits
) -> None:
    """The curve that X had borrowed had no systematic error, and the refit of the paths ended in KeyError."""
    since, until = parse_instant("", "2014-01-01"), parse_instant("", "2015-01-01")
    wanted = Wanted("antenna", Scope("CS002"), since, until, Model(), "", "")
    (whole,) = fits.make(fits.fit_causes(spectra, Model()), wanted).pieces
    beside = Neighbours([replace(whole, since=until, until=until + YEAR_US)], {}, {})
    few = spectra.select((spectra.dipole == "Y") | np.isin(spectra.event_id, np.unique(spectra.event_id)[:40]))
    versions = fits.make(fits.fit_causes(few, Model()), wanted, beside).versions
    found = {(curve.dipole, curve.status) for version in versions for curve in version.curves}
    assert found == {("X", "too_few_events"), ("Y", "converged")}


@pytest.mark.long
def test_the_same_spectra_read_again_have_the_fit_of_their_causes_once(spectra: Spectra, fits: Fits) -> None:
    """Every scope of a station reads the same spectra: each fitted the causes to them anew."""
    model = Model((LATE,))
    first = fits.fit_causes(spectra, model)
    assert fits.fit_causes(replace(spectra, power=spectra.power.copy()), model) is first
    slow = fit_causes(spectra, fits.simulation.with_causes(model))
    np.testing.assert_array_equal(first.spectra.power, slow.spectra.power)


@pytest.mark.long
@pytest.mark.parametrize(
    "change",
    [
        lambda spectra: {"spectra": hotter(spectra)},
        lambda spectra: {"spectra": louder(spectra)},
        lambda _: {"model": Model((replace(LATE, is_free=False),))},
    ],
    ids=["a temperature", "a power", "the model"],
)
def test_a_fit_of_other_input_is_another(change: Any, spectra: Spectra, fits: Fits) -> None:
    asked = {"spectra": spectra, "model": Model((LATE,))}
    first = fits.fit_causes(**asked)
    other = fits.fit_causes(**{**asked, **change(spectra)})
    assert other is not first
    assert fits.fit_causes(**asked) is not first, "only the last one is kept"
