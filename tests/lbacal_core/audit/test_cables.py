from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.antennas import compare_paths, find_wrong_cables, log_likelihood_of_unit
from lbacal_core.audit.station import AuditedStation
from lbacal_core.instrument.instrument import Instrument


@pytest.mark.parametrize(("antenna", "recorded"), [(0, "115"), (5, "50")])
def test_a_cable_on_record_that_is_not_there_is_named(
    station: AuditedStation, low_band: Instrument, antenna: int, recorded: str
) -> None:
    true = str(station.cables[antenna])
    claimed = station.with_cables({antenna: recorded}, low_band)
    lines, found = find_wrong_cables(claimed, compare_paths(claimed), low_band)
    assert found == {antenna: true}
    assert f"antenna {antenna} has the cable {true}, not {recorded}" in lines[0].sentence


def test_true_records_are_left_alone(station: AuditedStation, low_band: Instrument) -> None:
    assert find_wrong_cables(station, compare_paths(station), low_band) == ([], {})


def test_of_one_cable_only_the_spectrum_tells_the_unit(station: AuditedStation, low_band: Instrument) -> None:
    one = station.with_cables(dict.fromkeys(range(6), "80"), low_band)
    seen = replace(one, power=one.power.mean() * np.exp(0.02 * np.log(one.power / one.power.mean())))
    power, volt = (log_likelihood_of_unit(one, np.arange(6), unit, low_band) for unit in ("power", "volt"))
    assert power > volt
    assert log_likelihood_of_unit(seen, np.arange(6), "power", low_band) < power


@pytest.mark.parametrize("unit", ["power", "dB", "volt"])
def test_cables_tell_power_from_decibels_and_volts(station: AuditedStation, low_band: Instrument, unit: str) -> None:
    recorded = {
        "power": station.power,
        "dB": 10 * np.log10(station.power) + 200,
        "volt": station.power**0.5,
    }[unit]
    seen = replace(station, power=recorded)
    could_be = ("power", "volt", "dB") if unit == "dB" else ("power", "volt")
    likelihood = {name: log_likelihood_of_unit(seen, np.arange(6), name, low_band) for name in could_be}
    assert max(likelihood, key=lambda name: likelihood[name]) == unit
