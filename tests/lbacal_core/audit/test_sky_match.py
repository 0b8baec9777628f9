from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.sky_match import SkyMatch, load_models
from lbacal_core.audit.station import AuditedStation, mean_frequencies
from lbacal_core.instrument.instrument import Instrument

ALL = np.arange(6)


def match_of(station: AuditedStation, instrument: Instrument) -> SkyMatch:
    models = load_models(instrument, mean_frequencies(station.frequency_mhz), "gsm", "hamaker")
    return SkyMatch(station, instrument, lambda: models)


def tell(station: AuditedStation, instrument: Instrument) -> dict[str, tuple[str, float | None]]:
    lines = match_of(station, instrument).tell(ALL)
    return {line.check: (line.verdict, line.value) for line in lines}


def test_a_true_record_is_confirmed(station: AuditedStation, low_band: Instrument) -> None:
    said = tell(station, low_band)
    assert {check: verdict for check, (verdict, _) in said.items()} == {"clock": "right", "arms": "right"}


@pytest.mark.parametrize("hours", [-3.0, 1.75, 9.0])
def test_a_clock_that_is_off_is_measured(station: AuditedStation, low_band: Instrument, hours: float) -> None:
    late = replace(station, lst_hours=(station.lst_hours + hours) % 24)
    verdict, value = tell(late, low_band)["clock"]
    assert verdict == "wrong"
    assert value == pytest.approx(-hours, abs=1 / 60)


def test_turned_arms_are_measured_and_a_right_angle_is_an_exchange(
    station: AuditedStation, low_band: Instrument
) -> None:
    turned = replace(low_band, dipole_azimuth_deg={"X": 85.0, "Y": 175.0})
    verdict, value = tell(station, turned)["arms"]
    assert (verdict, value) == ("wrong", pytest.approx(-40.0, abs=1.0))
    exchanged = replace(low_band, dipole_azimuth_deg={"X": 135.0, "Y": 45.0})
    assert tell(station, exchanged)["exchange"][0] == "wrong"


def test_a_latitude_of_the_other_hemisphere_is_named(station: AuditedStation, low_band: Instrument) -> None:
    assert tell(station, replace(low_band, latitude_deg=-low_band.latitude_deg))["place"][0] == "wrong"


def test_minutes_determine_no_clock(station: AuditedStation, low_band: Instrument) -> None:
    short = replace(
        station, power=station.power[:, :, :1], time_unix=station.time_unix[:1], lst_hours=station.lst_hours[:1]
    )
    assert {verdict for verdict, _ in tell(short, low_band).values()} == {"undecided"}


def test_exchanged_letters_fit_better_exchanged(station: AuditedStation, low_band: Instrument) -> None:
    match = match_of(replace(station, power=station.power[:, ::-1]), low_band)
    assert match.gain_of_exchange(ALL) > 20


def test_a_longitude_beyond_90_deg_was_never_a_latitude_and_its_sign_is_a_shift_of_less_than_half_a_day(
    station: AuditedStation, low_band: Instrument
) -> None:
    """Decibels in Western Australia were told as an exchange of the two: at the pole that this gave no sky changes."""
    there = replace(low_band, longitude_deg=-116.6)
    shifted = replace(station, lst_hours=(station.lst_hours + 2 * -116.6 / 15) % 24)
    (line,) = match_of(shifted, there).tell(ALL)
    assert (line.check, line.verdict) == ("place", "wrong")
    assert "the longitude has the wrong sign (-507 min)" in line.sentence
    assert "exchanged" not in line.sentence
