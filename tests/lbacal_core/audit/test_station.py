from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.station import AuditedStation, split_stations, spread
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.spectra.spectra import Spectra


def test_spectra_are_laid_out_by_antenna_dipole_and_time(spectra: Spectra, station: AuditedStation) -> None:
    row = np.flatnonzero((spectra.antenna == 4) & (spectra.dipole == "Y"))[7]
    np.testing.assert_array_equal(station.power[4, 1, 7], spectra.power[row])
    assert station.hours == pytest.approx(24.0)


def test_hours_are_those_of_sidereal_time_that_is_covered(station: AuditedStation) -> None:
    days = np.arange(24) * 86_164.09
    once = replace(station, time_unix=days, lst_hours=np.linspace(23.6, 24.4, 24) % 24)
    assert once.hours == pytest.approx(0.8)
    assert once.length == "48 min of sidereal time do"
    twice = replace(once, lst_hours=np.where(np.arange(24) % 2, once.lst_hours, (once.lst_hours + 12) % 24))
    assert twice.hours < 2.0


def test_missing_spectra_are_nan_and_nothing_else_is(spectra: Spectra, low_band: Instrument) -> None:
    kept = np.ones(len(spectra), dtype=bool)
    kept[np.flatnonzero((spectra.antenna == 2) & (spectra.dipole == "X"))[3]] = False
    station = next(split_stations(spectra.select(kept), low_band))
    assert np.argwhere(np.isnan(station.power[..., 0])).tolist() == [[2, 0, 3]]


def test_other_cables_change_what_is_before_them(station: AuditedStation, low_band: Instrument) -> None:
    changed = station.with_cables({1: "50"}, low_band)
    assert changed.cables[1] == "50"
    difference = changed.before_cable() - station.before_cable()
    np.testing.assert_allclose(difference[1, 0, 0], np.log(low_band.cables["80"] / low_band.cables["50"]))
    assert not difference[[0, 2, 3, 4, 5]].any()


def test_spread_is_that_of_a_normal_distribution_and_ignores_outliers() -> None:
    values = np.random.default_rng(1).normal(0.0, 2.0, 4001)
    values[:100] = 1e6
    assert spread(values) == pytest.approx(2.0, rel=0.1)


def test_other_channels_than_the_instruments_are_refused(spectra: Spectra, low_band: Instrument) -> None:
    with pytest.raises(BadInputError, match="frequency_mhz"):
        list(split_stations(replace(spectra, frequency_mhz=spectra.frequency_mhz + 0.5), low_band))


def test_clocks_of_antennas_that_differ_within_an_event_do_not_tear_it_apart(
    spectra: Spectra, low_band: Instrument
) -> None:
    late = replace(spectra, time_unix=spectra.time_unix + 0.01 * spectra.antenna)
    station = next(split_stations(late, low_band))
    assert station.time_unix.size == 24
    assert np.isfinite(station.power).all()
