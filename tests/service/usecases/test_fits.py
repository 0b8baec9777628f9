"""Fits of stored spectra with an adopted model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lbacal.engine import Engine
from lbacal.instants import parse_instant
from lbacal_core.calibration.singles import MIN_EVENTS
from lbacal_core.causes.model import AdoptedCause, Model
from lbacal_core.curves.curves import Repeated
from lbacal_core.curves.validity import Scope
from lbacal_core.discovery.calibrate import fit_causes
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import read_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from service.config import Settings
from service.factory import Factory
from service.usecases.fits import Fits, Wanted, _explain_repeated
from service.usecases.watch import YEAR_US
from service.usecases.windows import Neighbours
from tests.service.conftest import Clock, new_version

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


def test_a_version_says_how_many_events_its_causes_leave_out(spectra: Spectra, fits: Fits) -> None:
    """It had the same events as before, and nobody said that a temperature was missing of others."""
    since, until = parse_instant("", "2014-01-01"), parse_instant("", "2015-01-01")
    warm = AdoptedCause("gain_temperature", "CS002", "station", 0.02, 0.01, {"delay_h": 0.0})
    wanted = Wanted("station", Scope("CS002"), since, until, Model((warm,)), "", "test")
    unknown = np.isin(spectra.event_id, np.unique(spectra.event_id)[:7])
    gappy = {"temperature_c": np.where(unknown, np.nan, spectra.environment["temperature_c"])}
    for environment, reason in (
        (gappy, "test; 7 events left out: a covariate of a cause is not known"), (spectra.environment, "test"),
    ):  # fmt: skip
        whole = fits.fit_causes(replace(spectra, environment=environment), wanted.model)
        assert {version.reason for version in fits.make(whole, wanted).versions} == {reason}


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


def test_a_version_says_of_each_dipole_what_other_windows_gave_it_or_why_they_gave_nothing() -> None:
    (curve,) = new_version(Scope("CS001", 0, "X"), "one").curves
    few, many = replace(curve, events=MIN_EVENTS - 1), replace(curve, events=MIN_EVENTS)
    alone, shared = Repeated(1, 3.456), Repeated(4, 1.0)
    told = "too few events for a fit: C of X is that of other windows, with a gain of its own"
    assert _explain_repeated([replace(few, repeated=shared)]) == [told]
    assert _explain_repeated([replace(many, repeated=shared), many, few]) == []
    assert _explain_repeated([replace(one, repeated=alone) for one in (few, many)]) == 2 * [
        "X is fitted by itself: it does not repeat what other windows say (chi^2 per degree of freedom 3.46)"
    ]


def test_fits_are_made_where_the_service_was_told_to_compute(instrument_file: Path, tmp_path: Path) -> None:
    class Elsewhere(Engine):
        def call(self, _function: Any, _owner: Any, *of: Any) -> Any:
            return f"{of[-1]}, made elsewhere"

    settings = Settings(database_url=str(tmp_path / "none.sqlite"), instrument=str(instrument_file))
    assert Factory(settings, engine=Elsewhere()).fits.elsewhere(len, "a fit") == "a fit, made elsewhere"
