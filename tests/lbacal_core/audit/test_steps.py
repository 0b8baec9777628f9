from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.audit import audit
from lbacal_core.audit.station import AuditedStation
from lbacal_core.audit.steps import find_steps
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.spectra.spectra import Spectra

ALL = np.arange(6)


def step(station: AuditedStation, factor: float, rows: np.ndarray = ALL) -> AuditedStation:
    power = station.power.copy()
    power[rows, :, 10:] *= factor
    return replace(station, power=power)


def test_a_healthy_station_has_no_step(station: AuditedStation) -> None:
    assert find_steps(station, ALL) == []


@pytest.mark.parametrize("factor", [2.0, 0.25])
def test_a_step_is_found_with_size_and_date(station: AuditedStation, factor: float) -> None:
    (line,) = find_steps(step(station, factor), ALL)
    assert (line.check, line.verdict) == ("stepped", "wrong")
    assert line.value == pytest.approx(10 * np.log10(factor), abs=0.3)
    assert "about 2014-05-14 02:2" in line.sentence


def test_a_small_step_and_that_of_a_few_antennas_are_left_to_others(station: AuditedStation) -> None:
    assert find_steps(step(station, 1.2), ALL) == []
    assert find_steps(step(station, 4.0, np.array([0, 1])), ALL) == []


def test_a_slope_in_time_is_no_step(station: AuditedStation) -> None:
    rising = replace(station, power=station.power * np.linspace(1.0, 4.0, 24)[:, None])
    assert find_steps(rising, ALL) == []


def test_the_sky_is_not_asked_of_two_chains(spectra: Spectra, low_band: Instrument) -> None:
    late = spectra.time_unix[:, None] > np.median(spectra.time_unix)
    report = audit(replace(spectra, power=np.where(late, 4.0, 1.0) * spectra.power), low_band, antenna="hamaker")
    assert [line.check for line in report.lines] == ["stepped"]
