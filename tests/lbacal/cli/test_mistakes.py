"""Mistakes that people make, in commands, files and Python: each is one sentence that says what was expected."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from astropy import units as u

import lbacal
from lbacal_core.errors import LbacalError
from lbacal_core.lstcurve.curve import measured_curve
from lbacal_core.spectra.spectra import Spectra, read_spectra, write_spectra
from tests.lbacal.cli.conftest import make_instrument, make_sky_power, make_spectra

Lbacal = Callable[..., tuple[int, str, str]]
NU = np.arange(30.0, 81.0)
FIT = "fit spectra.h5 --instrument instrument.json --output C.ecsv --report fit.json"
PREDICT = "predict --station CS002 --antenna 1 --dipole X --at 2014-05-01 --simulation lofar-superterp"

COMMANDS = {
    "an instrument that does not ship": (FIT.replace("instrument.json", "lofar"), "is lofar-superterp meant?"),
    "its name in other letters": (FIT.replace("instrument.json", "LOFAR-Superterp"), "is lofar-superterp meant?"),
    "no such file": (FIT.replace("spectra.h5", "spectra2014.h5"), "spectra2014.h5: expected a spectra file, found no"),
    "a folder without spectra": (FIT.replace("spectra.h5", "empty"), "found none in this folder"),
    "an archive of NumPy": (FIT.replace("spectra.h5", "one.npz"), "lbacal import"),
    "a folder of archives": (FIT.replace("spectra.h5", "archives"), "lbacal import"),
    "a year of two digits": (f"{FIT} --year 14", "--year"),
    "the day first": (f"{FIT} --since 01.05.2014", "--since: expected an ISO 8601 date"),
    "a day that does not exist": (f"{FIT} --since 2014-02-30", "--since: expected"),
    "an interval from its end": (f"{FIT} --since 2015-01-01 --until 2014-01-01", "--until"),
    "a station in small letters": (f"{FIT} --station cs002", "is CS002 meant?"),
    "a command that is misspelt": ("investigat spectra.h5", "Did you mean 'investigate'"),
    "an option that is misspelt": (f"{FIT} --instrment lofar-superterp", "--instrument"),
    "no output": ("fit spectra.h5 --instrument instrument.json", "lbacal fit: missing option '--output'; see"),
    "a figure of an unknown kind": ("budget spectra.h5 --instrument instrument.json --plot b.jpeg", ".png, .pdf, .svg"),
    "a table of an unknown kind": (FIT.replace("C.ecsv", "C.xlsx"), "--output C.xlsx: expected a name that ends in"),
    "the output over the input": (FIT.replace("C.ecsv", "spectra.h5"), "spectra.h5"),
    "an output in no folder": (FIT.replace("C.ecsv", "a/C.ecsv"), "a/C.ecsv"),
    "a sky that does not ship": (
        "sky-power --instrument lofar-superterp --sky gsm2008 --output P.json", "is pygdsm-gsm2008 meant?",
    ),
    "an antenna that does not ship": (
        "sky-power --instrument lofar-superterp --antenna hammaker --output P.json", "is hamaker meant?",
    ),
    "an error of the sky that is none": ("budget spectra.h5 --instrument instrument.json --sky model", "paper, models"),
    "a finding that a report lacks": (f"{FIT} --with R.json#7", "R.json"),
    "realisations into a table": (f"{PREDICT} --realisations 3 --output P.csv", "an --output that ends in .h5"),
    "a time of day alone": (PREDICT.replace("2014-05-01", "12:00") + " --output P.json", "ISO 8601"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", COMMANDS)
def test_a_mistake_in_a_command_is_one_sentence(mistake: str, folder: Path, lbacal: Lbacal) -> None:
    line, said = COMMANDS[mistake]
    (folder / "empty").mkdir()
    (folder / "archives").mkdir()
    for name in ("one.npz", "archives/one.npz"):
        np.savez(folder / name, power=1.0)
    (folder / "R.json").write_text('{"findings": []}')
    before = (folder / "spectra.h5").read_bytes()
    code, out, error = lbacal(*line.split())
    assert (code, out, error.count("\n")) == (2, "", 1), error
    assert said in error
    assert (folder / "spectra.h5").read_bytes() == before


def of_instrument(**fields: Any) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda content: {**content, **fields}


FILES: dict[str, tuple[Callable[[dict[str, Any]], dict[str, Any]], str]] = {
    "Hz": (lambda content: {**content, "frequency_mhz": [1e6 * f for f in content["frequency_mhz"]]}, "looks like Hz"),
    "latitude and longitude exchanged": (
        of_instrument(latitude_deg=116.6, longitude_deg=-26.7), "are the two exchanged?",
    ),
    "arms in radians": (
        of_instrument(dipoles={"X": {"azimuth_deg": 0.785}, "Y": {"azimuth_deg": 2.356}}), "look like radians",
    ),
    "a gain in decibels": (of_instrument(receiver_gain=[-3.0] * 51), "receiver_gain, channel 0: expected a finite"),
    "a loss in decibels": (of_instrument(cables={"80 m": [3.0] * 51}), "cables.80 m, channel 0: expected"),
    "a channel too few": (of_instrument(antenna_gain=[1.0] * 50), "antenna_gain: expected 51 numbers, one a channel"),
    "a cable that is not listed": (
        of_instrument(antennas=[{"station": "CS002", "antenna": 0, "cable": "90 m"}]), "cable: expected one of 80 m",
    ),
    "an antenna twice": (
        lambda content: {**content, "antennas": content["antennas"] * 2}, "antennas",
    ),
    "a misspelt date": (
        of_instrument(antennas=[{"station": "CS002", "antenna": 0, "cable": "80 m", "untill": "2015-01-01"}]), "until",
    ),
    "no dipoles": (of_instrument(dipoles={}), "dipoles: expected one dipole or more"),
    "channels that fall": (
        lambda content: {**content, "frequency_mhz": content["frequency_mhz"][::-1]}, "channels rise",
    ),
    "a kind in capitals": (of_instrument(stages=[{"name": "a", "kind": "LNA", "gain": 100}]), "is lna meant?"),
    "a height in kilofeet": (of_instrument(height_m="high"), "height_m"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", FILES)
def test_a_mistake_in_an_instrument_is_one_sentence(mistake: str, folder: Path, lbacal: Lbacal) -> None:
    change, said = FILES[mistake]
    content = change(json.loads((folder / "instrument.json").read_text()))
    (folder / "instrument.json").write_text(json.dumps(content))
    code, out, error = lbacal(*FIT.split())
    assert (code, out, error.count("\n")) == (2, "", 1), error
    assert error.startswith("lbacal: instrument.json: ") or "instrument " in error
    assert said in error


def times(factor: float) -> Callable[[Spectra], Spectra]:
    return lambda spectra: replace(spectra, power=spectra.power * factor)


SPECTRA: dict[str, tuple[Callable[[Spectra], Spectra], str]] = {
    "decibels": (lambda one: replace(one, power=200 + 10 * np.log10(one.power)), "0 of 4 curves converged"),
    "a dipole in small letters": (lambda one: replace(one, dipole=np.char.lower(one.dipole)), "is X meant?"),
    "an unknown station": (lambda one: replace(one, station=np.full(len(one), "CS003")), "is CS002 meant?"),
    "an unknown antenna": (lambda one: replace(one, antenna=one.antenna + 5), "antennas 0 to 1 of it"),
    "other channels": (lambda one: replace(one, frequency_mhz=one.frequency_mhz + 0.5), "frequency"),
    "ten events": (lambda one: one.select(np.isin(one.event_id, [f"e{k}" for k in range(10)])), "events"),
}


@pytest.mark.parametrize("mistake", SPECTRA)
def test_a_mistake_in_spectra_is_said_and_never_converges(mistake: str, folder: Path, lbacal: Lbacal) -> None:
    change, said = SPECTRA[mistake]
    write_spectra(change(read_spectra(folder / "spectra.h5")), folder / "spectra.h5")
    code, out, error = lbacal(*FIT.split(), "--sky-power", "sky_power.json")
    assert code in (1, 2)
    assert said in error + out
    assert "Traceback" not in error


RAW: dict[str, tuple[Callable[[h5py.File], object], str]] = {
    "MJD for seconds": (lambda file: file["time_unix"].write_direct(np.full(480, 56800.0)), "time_unix, row 0"),
    "milliseconds": (lambda file: file["time_unix"].write_direct(1e3 * file["time_unix"][:]), "time_unix, row 0"),
    "a power of 0": (lambda file: file["power"].__setitem__((3, 4), 0.0), "power, row 3"),
    "no format": (lambda file: file.attrs.pop("format"), "lbacal-spectra-1"),
    "no antenna": (lambda file: file.pop("antenna"), "antenna"),
}


@pytest.mark.parametrize("mistake", RAW)
def test_a_mistake_in_a_spectra_file_is_one_sentence(mistake: str, folder: Path, lbacal: Lbacal) -> None:
    change, said = RAW[mistake]
    with h5py.File(folder / "spectra.h5", "a") as file:
        change(file)
    code, out, error = lbacal(*FIT.split())
    assert (code, out, error.count("\n")) == (2, "", 1), error
    assert said in error


SITE = lbacal.Site(52.9, 6.9)


SEEN = {"station": "CS002", "antenna": 1, "dipole": "X", "at": "2014-05-01"}


def see(**changed: Any) -> Any:
    return lbacal.predict("lofar-superterp", **{**SEEN, **changed})


def make(chain: Any = (), frequency: Any = NU, site: Any = SITE, **more: Any) -> Any:
    antenna = lbacal.Antenna("short-dipole", more.pop("arms", {"X": 45.0, "Y": 135.0}), **more)
    return lbacal.Instrument("mine", site, antenna, lbacal.Chain(chain), frequency)


PYTHON: dict[str, tuple[Callable[[], Any], str]] = {
    "Hz without a unit": (lambda: make(frequency=NU * 1e6), "looks like Hz"),
    "a gain of 0": (lambda: make([0.0]), "expected a power factor above 0, or decibels such as -20 * u.dB"),
    "dB as a factor": (lambda: make([lbacal.Stage("lna", -20)]), "decibels such as -20 * u.dB, found -20"),
    "a kind in capitals": (lambda: make([lbacal.Stage("LNA", 20 * u.dB)]), "is lna meant?"),
    "latitude and longitude exchanged": (lambda: make(site=lbacal.Site(116.6, -26.7)), "are the two exchanged?"),
    "radians": (lambda: make(arms={"X": 0.785, "Y": 2.356}), "look like radians"),
    "words for a doubt": (lambda: make(doubt="none"), "antenna: doubt: expected a finite number"),
    "a length for a gain": (lambda: make(gain=2 * u.m), "expected one in m2"),
    "a mass for a place": (lambda: make(site=lbacal.Site(3 * u.kg, 6.9)), "expected one in deg"),
    "a cable that amplifies": (lambda: lbacal.Instrument(
        "mine", SITE, lbacal.Antenna("short-dipole", {"X": 45.0}), lbacal.Chain(cable=3 * u.dB), NU), "at most 1"),
    "kelvin without a G_ant in m2": (
        lambda: make([lbacal.Stage("lna", 20 * u.dB, noise=150, error=10), lbacal.Stage("adc", noise="free")]),
        "gain_source",
    ),
    "a file of S11 that is not there": (lambda: lbacal.mismatch("ant.s1p")(NU), "ant.s1p: expected a Touchstone file"),
    "an impedance below 0": (lambda: lbacal.mismatch(-50.0)(NU), "real part is above 0"),
    "a table in Hz": (lambda: make([(NU * 1e6, np.ones(NU.size))]), "looks like Hz"),
    "an impedance in metres": (lambda: lbacal.mismatch(3 * u.m)(NU), "expected one in Ohm"),
    "impedances of other channels": (lambda: lbacal.mismatch(np.full(3, 73.0))(NU), "of each of 51 channels, found 3"),
    "gains of other channels": (lambda: make([[1.0, 2.0, 3.0]]), "one of each of 51 channels, found 3"),
    "a length for a cable's loss": (
        lambda: lbacal.Chain(cable=80 * u.m).cable_loss(NU), "decibels such as -20 * u.dB, found <Quantity 80. m>",
    ),
    "GHz without a unit": (lambda: make(frequency=NU / 1e3), "looks like GHz"),
    "a place as two numbers": (lambda: make(site=(52.9, 6.9)), "lbacal.Site(52.9, 6.9), found tuple"),
    "arms as a list": (lambda: make(arms=[45.0, 135.0]), "antenna: arms: expected one such as {'X': 225.0"),
    "an array for spectra": (lambda: lbacal.fit(np.ones((3, 51)), "lofar-superterp"), "lbacal.read, or the name of a"),
    "no file": (lambda: lbacal.read([]), "expected a file or a folder, or a list of them, found none"),
    "a seed below 0": (lambda: lbacal.simulate("lofar-superterp", seed=-1), "seed: expected a whole number"),
    "events as text": (lambda: lbacal.simulate("lofar-superterp", events="10"), "events: expected a whole number"),
    "antennas as text": (lambda: lbacal.simulate("lofar-superterp", antennas="2"), "antennas: expected a whole number"),
    "a date in words": (lambda: see(at="May 2014"), "ISO 8601"),
    "a time zone by its name": (lambda: see(at="2014-05-01T12:00 CET"), "ISO 8601"),
    "a decimal year": (lambda: see(at=2014.5), "astropy Time"),
    "a station in small letters": (lambda: see(station="cs002"), "is CS002 meant?"),
    "an antenna as text": (lambda: see(antenna="1"), "antenna: expected a number, found '1'"),
    "a dipole by its number": (lambda: see(dipole=0), "dipole: expected a letter, found 0"),
    "kelvin for deg C": (lambda: see(temperature=283), "temperature: expected deg C, -90 to 60, found 283"),
    "no temperature": (lambda: see(temperature=np.nan), "temperature: expected deg C, -90 to 60, found nan"),
    "half an event": (lambda: see().draw_events(1.5), "count: expected a number of events, 1 or more, found 1.5"),
    "a seed as text": (lambda: see().draw_events(3, seed="a"), "seed: expected a whole number, 0 or more, found 'a'"),
    "a rate in Hz": (lambda: lbacal.draw_traces([see()], 1024, 200e6), "so many samples that a bin lies between 29.5"),
    "metres for deg C": (lambda: see(temperature=3 * u.m), "expected one in deg_C, or a number"),
    "instrument and spectra exchanged": (
        lambda: lbacal.predict(make_spectra(make_instrument(), make_sky_power()), **SEEN),
        "instrument: expected a lbacal.Instrument, or the name or the file of one, found Spectra",
    ),
    "no instrument": (lambda: lbacal.simulate(None), "or the file of one, found None"),
    "nothing to load": (lambda: lbacal.Instrument.load(None), "such as lofar-superterp, or of a file, found None"),
    "a number to load": (lambda: lbacal.Instrument.load(5), "such as lofar-superterp, or of a file, found 5"),
    "no name to load": (lambda: lbacal.Instrument.load(""), "unknown instrument '', and no such file; known: "),
    "a file that is not there": (lambda: lbacal.Instrument.load("nothere.json"), "'nothere.json', and no such file"),
    "a number for a sky power": (
        lambda: lbacal.budget(make_spectra(make_instrument(), make_sky_power()), "lofar-superterp", 3),
        "sky_power: expected a P_sky, or the name of its file, found 3",
    ),
    "a fit for what extends it": (
        lambda: lbacal.predict("lofar-superterp", with_=see(), **SEEN), "such as 'R.json#0', found Prediction",
    ),
    "spectra for an LST curve": (
        lambda: lbacal.lst_curve(make_spectra(make_instrument(), make_sky_power())), "curve: expected the name of a",
    ),
    "a band of one number": (lambda: lbacal.lst_curve(measured_curve(), band=30), "band: expected two numbers"),
    "nothing to audit": (lambda: lbacal.audit(None, "lofar-superterp"), "data: expected the name of a file, found"),
    "a name of a figure for axes": (lambda: see().plot("x.png"), "expected axes of matplotlib (save(path) writes"),
    "a folder to save in": (lambda: see().save(Path(__file__).parent), "expected a file to write, found a folder"),
    "no antennas": (
        lambda: lbacal.Instrument(
            "mine", SITE, lbacal.Antenna("short-dipole", {"X": 45.0}), lbacal.Chain(), NU, antennas=0),
        "antennas: expected how many there are, 1 or more, or their numbers, found 0",
    ),
    "three angles of an arm": (lambda: make(arms={"X": (1, 2, 3)}), "an azimuth, or (azimuth, tilt)"),
    "a stage that is not in a list": (lambda: make(lbacal.Stage("lna", 20 * u.dB)), "a list of stages, such as"),
    "a length below 0": (lambda: lbacal.effective_length(-1.0, 75.0)(NU), "an effective length above 0, in m"),
    "a noise temperature below 0": (
        lambda: lbacal.lna_noise(75.0, -3.0, 8.0, 90.0)(NU), "amplifier: least noise temperature, K: expected 0 or"),
    "a fit for its curve": (
        lambda: lbacal.calibrate_trace(np.ones(1024), 200.0, see()), 'one curve of a fit such as found["CS002", 17'),
    "one prediction for a list": (lambda: lbacal.draw_together(see(), 10), "predictions: expected a list of them"),
    "events of two instants": (
        lambda: lbacal.draw_together([see(), see(at="2014-05-02")], 10), "predictions: expected those of one instant"
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", PYTHON)
def test_a_mistake_in_python_is_one_sentence_in_its_words(mistake: str) -> None:
    work, said = PYTHON[mistake]
    with pytest.raises(LbacalError) as caught:
        work()
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not any(word in str(caught.value) for word in ("JSON", "noise_temperature_k", "azimuth_deg."))


def test_there_are_more_than_sixty() -> None:
    assert len(COMMANDS) + len(FILES) + len(SPECTRA) + len(RAW) + len(PYTHON) >= 99
