from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.antenna_records import AntennaRecord
from lbacal_core.audit.audit import audit
from lbacal_core.instrument import Instrument
from lbacal_core.readers.average import average
from lbacal_core.readers.open import choose_channels, open_source
from lbacal_core.spectra import Spectra


def test_a_healthy_station_is_healthy(spectra: Spectra, low_band: Instrument) -> None:
    report = audit(spectra, low_band, antenna="hamaker")
    assert report.is_healthy
    assert report.as_dict()["stations"] == [
        {"station": "CS002", "antennas": 6, "spectra": 6 * 2 * 24, "hours": pytest.approx(22.937, abs=0.001)}
    ]


def test_two_faults_are_both_named(spectra: Spectra, low_band: Instrument) -> None:
    rows = spectra.antenna == 1
    dipole = np.where(rows, np.where(spectra.dipole == "X", "Y", "X"), spectra.dipole)
    power = spectra.power.copy()
    power[(spectra.antenna == 4) & (spectra.dipole == "X")] *= 1e-3
    report = audit(replace(spectra, dipole=dipole, power=power), low_band, antenna="hamaker")
    assert {(line.check, line.antennas) for line in report.lines if line.verdict == "wrong"} == {
        ("exchange", (1,)),
        ("dead", (4,)),
    }


def test_one_antenna_is_asked_what_it_saw_of_the_sky(spectra: Spectra, low_band: Instrument) -> None:
    """A single dipole, as EDGES or MIST, was refused whole: nothing is there to compare it with, but a sky is."""
    one = spectra.select(spectra.antenna == 2)
    healthy = {line.check: line.verdict for line in audit(one, low_band).lines}
    assert healthy == {"antennas": "undecided", "clock": "right", "arms": "right"}
    late = audit(replace(one, time_unix=one.time_unix + 3 * 3600.0), low_band)
    assert [line.check for line in late.lines if line.verdict == "wrong"] == ["clock"]


def test_half_a_station_exchanged_is_the_half_that_the_sky_contradicts(spectra: Spectra, low_band: Instrument) -> None:
    rows = spectra.antenna % 2 == 0
    dipole = np.where(rows, np.where(spectra.dipole == "X", "Y", "X"), spectra.dipole)
    report = audit(replace(spectra, dipole=dipole), low_band, antenna="hamaker")
    assert [line.antennas for line in report.lines if line.check == "exchange"] == [(0, 2, 4)]


@pytest.mark.long
@pytest.mark.shared
@pytest.mark.filterwarnings("ignore")  # pyuvdata's own, about the header of the file
def test_hera_antennas_of_one_snapshot_are_compared_and_no_clock_is_claimed(shared: Path) -> None:
    source = open_source(shared / "data" / "other" / "hera_2459122.25108_autos.uvh5")
    spectra = average(source, 60.0, choose_channels(source, band_mhz=(50, 110), width_mhz=1.0)).spectra
    flat = np.ones(spectra.frequency_mhz.size)
    instrument = Instrument(
        "HERA", -30.7215, 21.4283, 1052.0, spectra.frequency_mhz, {"X": 0.0, "Y": 90.0}, flat, flat, {"none": flat},
        [AntennaRecord("HERA", int(a), "none") for a in np.unique(spectra.antenna)],
    )  # fmt: skip
    report = audit(spectra, instrument, antenna="hamaker")
    assert {line.verdict for line in report.lines if line.check in ("clock", "arms")} == {"undecided"}
    wrong = {(line.check, line.antennas) for line in report.lines if line.verdict == "wrong"}
    assert wrong == {("dead", (93,)), ("dead", (123,))}  # a hundredth of the others' power, in the file itself


@pytest.mark.shared
def test_eda2_at_one_frequency_shows_three_antennas_that_hardly_receive(shared: Path) -> None:
    table = (shared / "data" / "other" / "eda2_autos_78mhz.csv").read_text().splitlines()
    values = [line.split(",") for line in table if line[0].isdigit()]
    paths = [(int(a), d, float(p)) for a, *both in values for d, p in zip("XY", both, strict=True) if float(p) > 0]
    one = np.ones(1)
    spectra = Spectra(
        np.array([78.125]), np.array([[power] for *_, power in paths]), np.full(len(paths), "e"),
        np.full(len(paths), 1_639_180_800.0), np.full(len(paths), "EDA2"), np.array([a for a, *_ in paths]),
        np.array([d for _, d, _ in paths]), np.ones(len(paths), dtype=np.int64),
    )  # fmt: skip
    instrument = Instrument(
        "EDA2", -26.7, 116.7, 370.0, np.array([78.125]), {"X": 90.0, "Y": 0.0}, one, one, {"none": one},
        [AntennaRecord("EDA2", antenna, "none") for antenna in range(256)],
    )  # fmt: skip
    lines = audit(spectra, instrument, antenna="hamaker").lines
    assert {a for line in lines if line.verdict == "wrong" for a in line.antennas} == {81, 129, 130}
    assert {line.verdict for line in lines if line.check in ("clock", "arms", "unit", "exchange")} == {"undecided"}
