from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.audit import EVENTS, audit_quickly
from lbacal_core.calibration.chain_test import LIKELY_MISTAKE
from lbacal_core.curves.curves import FitReport
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.pipeline import calibrate
from lbacal_core.provenance import Provenance
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.spectra.spectra import Spectra, join_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings


def test_a_healthy_station_is_said_to_be_healthy_and_its_power_is_accepted(
    spectra: Spectra, low_band: Instrument
) -> None:
    found = audit_quickly(spectra, low_band)
    assert found.sentence == "nothing wrong between 6 antennas (paths, cables, letters of single antennas, steps, unit)"
    found.require_power("s.h5")


def test_a_dead_path_is_named_and_does_not_stop_the_work(spectra: Spectra, low_band: Instrument) -> None:
    power = spectra.power.copy()
    power[(spectra.antenna == 4) & (spectra.dipole == "X")] *= 1e-3
    found = audit_quickly(replace(spectra, power=power), low_band)
    assert found.sentence.startswith("1 wrong in 6 antennas (lbacal audit tells more): CS002: antenna 4 X is dead")
    found.require_power("s.h5")


def test_decibels_are_refused(spectra: Spectra, low_band: Instrument) -> None:
    lossy = replace(low_band, cables={name: loss**4 for name, loss in low_band.cables.items()})
    loss = np.array([low_band.cables[low_band.cable_of("CS002", int(a), 1.4e9)] for a in spectra.antenna])
    found = audit_quickly(replace(spectra, power=200.0 + 10 * np.log10(spectra.power * loss**3)), lossy)
    with pytest.raises(BadInputError, match=r"s.h5: power: expected power per MHz .*the power is in decibels"):
        found.require_power("s.h5")


@pytest.fixture(scope="module")
def year() -> Spectra:
    superterp = load_instrument("lofar-superterp")
    settings = TwinSettings(stations=("CS002",), antennas=6, events_per_year=200)
    return simulate_campaign(settings, superterp, compute_sky_power(superterp), np.random.default_rng(3)).spectra


def test_half_of_the_antennas_by_6_db_are_no_decibels(year: Spectra) -> None:
    """`fit` refused the file as decibels, ln odds 10; decibels described it no better than power did."""
    louder = replace(year, power=np.where(year.antenna[:, None] < 3, 4.0, 1.0) * year.power)
    found = audit_quickly(louder, load_instrument("lofar-superterp"))
    found.require_power("s.h5")
    assert "antennas with the cable 115 lie -4.8 dB from what loss and others say" in found.sentence


def test_power_times_four_in_the_first_half_of_the_year_is_a_misfit_and_two_chains(year: Spectra) -> None:
    """It was `converged`, and nothing was wrong: C stood for neither half."""
    superterp, middle = load_instrument("lofar-superterp"), np.median(year.time_unix)
    first = year.time_unix[:, None] < middle
    stepped = replace(year, power=np.where(first, 4.0, 1.0) * year.power)
    found = audit_quickly(stepped, superterp)
    assert "the power of all paths steps by -6.1 dB about 2014-07-01" in found.sentence
    assert {curve.status for curve in found.mark(calibrate(stepped, superterp)).curves} == {"misfit"}
    assert audit_quickly(year, superterp).sentence.startswith("nothing wrong")


def test_nothing_is_not_wrong_under_a_fit_that_names_a_mistake(spectra: Spectra, low_band: Instrument) -> None:
    """`likely mistake: dipoles X and Y exchanged`, then `audit: nothing wrong (... exchanged letters ...)`."""
    found = audit_quickly(spectra, low_band)
    fitted = FitReport((), Provenance({}))
    assert found.mark(fitted).provenance.notes["audit"] == found.sentence
    named = replace(fitted, provenance=fitted.provenance.with_note(LIKELY_MISTAKE, "dipoles X and Y exchanged"))
    assert "audit" not in found.mark(named).provenance.notes
    power = np.where((spectra.antenna == 4)[:, None], 1e-3, 1.0) * spectra.power
    dead = audit_quickly(replace(spectra, power=power), low_band)
    assert "antenna 4 X is dead" in dead.mark(named).provenance.notes["audit"]


def test_volts_of_five_antennas_passed_where_cables_alone_do_not_tell() -> None:
    superterp = load_instrument("lofar-superterp")
    settings = TwinSettings(stations=("CS002",), antennas=5, events_per_year=60)
    recorded = simulate_campaign(settings, superterp, compute_sky_power(superterp), np.random.default_rng(2)).spectra
    audit_quickly(recorded, superterp).require_power("s.h5")
    with pytest.raises(BadInputError, match=r"an amplitude \(volts\), not its square"):
        audit_quickly(replace(recorded, power=recorded.power**0.5), superterp).require_power("s.h5")


def test_no_spectra_are_left_to_what_comes_after(spectra: Spectra, low_band: Instrument) -> None:
    assert audit_quickly(spectra.select(np.zeros(0, dtype=np.int64)), low_band).report is None


def test_three_antennas_are_not_compared(spectra: Spectra, low_band: Instrument) -> None:
    found = audit_quickly(spectra.select(spectra.antenna < 3), low_band)
    assert found.sentence == "none: no station has 4 antennas to compare"
    found.require_power("s.h5")


def test_a_long_campaign_costs_no_more_than_a_hundred_events(spectra: Spectra, low_band: Instrument) -> None:
    copies = 3 * EVENTS // 24
    copied = [
        replace(spectra, event_id=np.char.add(spectra.event_id, f"-{k}"), time_unix=spectra.time_unix + 86_400.0 * k)
        for k in range(copies)
    ]
    many = join_spectra(copied)
    report = audit_quickly(many, low_band).report
    assert report is not None
    assert report.stations[0].time_unix.size == EVENTS


def test_one_channel_is_refused_before_a_fit_of_it_ends_in_a_traceback(spectra: Spectra, low_band: Instrument) -> None:
    one = replace(spectra, frequency_mhz=spectra.frequency_mhz[:1], power=spectra.power[:, :1])
    with pytest.raises(BadInputError, match=r"channels: expected at least 5 to fit a chain .*found 1"):
        audit_quickly(one, low_band)
