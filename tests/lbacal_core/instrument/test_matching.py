"""Impedances against reflections: the same physics in another form, measured antennas, and a fit of both."""

from __future__ import annotations

import json
import runpy
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u

import lbacal
from lbacal_core.errors import BadInputError, LbacalError
from lbacal_core.instrument.instrument import parse_instrument
from lbacal_core.instrument.matching import T_0, match_noise, match_power
from lbacal_core.instrument.touchstone import read_touchstone

S11 = 0.5 * np.exp(1j * np.radians(-30.0))


@pytest.mark.parametrize(
    ("options", "frequency", "numbers"),
    [
        ("# MHz S MA R 50", "55", "0.5 -30"),
        ("#hz s ri r 50.0", "55e6", f"{S11.real} {S11.imag}"),
        ("# R 50 dB kHz", "55000", f"{20 * np.log10(0.5)} -30 ! two spaces"),
        ("#", "0.055", "0.5 -30"),  # GHz, MA and 50 ohm where nothing is said
    ],
)
def test_a_reflection_is_the_same_in_every_unit_and_form(
    options: str, frequency: str, numbers: str, tmp_path: Path
) -> None:
    (tmp_path / "a.S1P").write_text(f"! an antenna\n\n{options}\n  {frequency}\t{numbers}\n")
    nu, s, reference = read_touchstone(tmp_path / "a.S1P")
    np.testing.assert_allclose(nu, [55.0])
    np.testing.assert_allclose(s, [[[S11]]])
    assert reference == 50.0


def test_of_two_ports_s21_stands_before_s12_and_noise_parameters_behind_are_left_out(tmp_path: Path) -> None:
    rows = "40 11 0 21 0 12 0 22 0\n90 11 0 21 0 12 0 22 0\n40 1.2 0.3 20 0.2\n90 1.2 0.3 20 0.2\n"
    (tmp_path / "lna.s2p").write_text(f"# MHz S RI R 75\n{rows}")
    nu, s, reference = read_touchstone(tmp_path / "lna.s2p")
    np.testing.assert_array_equal(nu, [40.0, 90.0])
    np.testing.assert_array_equal(s[1], [[11, 12], [21, 22]])
    assert reference == 75.0


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.s1p", "", "a line such as # MHz S RI R 50), found none"),
        ("a.s1p", "40 0.5 0\n", "a line such as # MHz S RI R 50), found none"),
        ("a.s1p", "# MHz S MA R 50\n", "rows of finite numbers, their frequencies rising, found 0 rows"),
        ("a.s1p", "# MHz Y MA R 50\n40 0.5 0\n", "by Hz, kHz, MHz or GHz as RI, MA or DB, found Y"),
        ("a.s1p", "# MHz S MA R fifty\n40 0.5 0\n", "a.s1p: R: expected the reference impedance in ohm, found 'FIFTY'"),
        ("a.s1p", "# MHz S MA R\n40 0.5 0\n", "expected the reference impedance in ohm, found ''"),
        ("a.s1p", "# MHz S MA R 50\n40 nan 0\n", "rows of finite numbers"),
        ("a.s1p", "# MHz S MA R 50\n50 0.5 0\n40 0.5 0\n", "their frequencies rising"),
        ("a.s1p", "# MHz S MA R 50\n40 0,5 0\n", "rows of 3 numbers, 1 port(s)"),
        ("a.s1p", "# MHz S MA R 50\n40 .5 0 .5 0 .5 0 .5 0\n", "rows of 3 numbers, 1 port(s)"),
        ("a.s2p", "# MHz S MA R 50\n40 .5 0\n", "rows of 9 numbers, 2 port(s)"),
        ("a.csv", "frequency_mhz,gain\n40,0.5\n", "one port (.s1p) or two (.s2p), found '.csv'"),
    ],
)
def test_what_is_no_such_file_is_refused_in_one_sentence(name: str, content: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(LbacalError) as caught:
        read_touchstone(tmp_path / name)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_pickle_of_that_name_is_read_as_text_and_refused(tmp_path: Path) -> None:
    (tmp_path / "a.s1p").write_bytes(b"\x80\x04\x95\n\x00#")
    with pytest.raises(LbacalError, match="expected a Touchstone file"):
        read_touchstone(tmp_path / "a.s1p")


NU = np.arange(30.0, 81.0)
ANTENNA = 20.0 + 0.8 * NU + 1j * (4.0 * NU - 220.0)
"""A short dipole that is resonant at 55 MHz, ohm."""
LNA = 100.0 - 30.0j


def reflect(impedance: np.ndarray | complex) -> np.ndarray:
    """The reflection to 50 ohm."""
    return (np.asarray(impedance) - 50.0) / (np.asarray(impedance) + 50.0)


def test_the_share_of_the_power_is_that_of_the_reflections_of_both_sides() -> None:
    """(1 - |a|^2)(1 - |b|^2) / |1 - ab|^2 of the textbooks of microwaves."""
    a, b = reflect(ANTENNA), reflect(LNA)
    expected = (1 - np.abs(a) ** 2) * (1 - np.abs(b) ** 2) / np.abs(1 - a * b) ** 2
    np.testing.assert_allclose(match_power(ANTENNA, np.full(NU.size, LNA)), expected, rtol=1e-12)
    np.testing.assert_allclose(match_power(ANTENNA, ANTENNA.conj()), 1.0)


def test_the_noise_of_an_amplifier_is_that_of_its_parameters_as_reflections() -> None:
    """T_min + 4 T_0 r_n |s - o|^2 / ((1 - |s|^2) |1 + o|^2), r_n over 50 ohm."""
    s, o = reflect(ANTENNA), reflect(LNA)
    expected = 60.0 + 4 * T_0 * (8.0 / 50.0) * np.abs(s - o) ** 2 / ((1 - np.abs(s) ** 2) * np.abs(1 + o) ** 2)
    best = np.full(NU.size, LNA)
    np.testing.assert_allclose(match_noise(ANTENNA, 60.0, 8.0, best), expected, rtol=1e-12)
    np.testing.assert_allclose(match_noise(best, 60.0, 8.0, best), 60.0)


@pytest.mark.shared
def test_two_measured_antennas_of_a_station_take_shares_that_differ_by_percents(shared: Path) -> None:
    """2-5 % at one station of the LWA, 10-17 % and more at another (DiLullo et al. 2023, arXiv 2303.14904)."""
    rows = (shared / "data/other/lwa_antennas.csv").read_text().splitlines()
    names = rows[1].split(",")
    values = np.array([row.split(",") for row in rows[2:]], dtype=float)
    s11 = {name[:-3]: values[:, k] + 1j * values[:, k + 1] for k, name in enumerate(names) if name.endswith(" re")}
    inside = (values[:, 0] >= 30) & (values[:, 0] <= 80)

    def differ(station: str, dipole: str) -> float:
        one, other = (
            match_power(50 * (1 + s) / (1 - s), np.full(s.size, 100.0 + 0j))[inside]
            for name, s in s11.items()
            if name.startswith(station) and f" {dipole} " in name
        )
        return float(np.mean(np.abs(one / other - 1.0)))

    assert all(0.02 < differ("LWA1_", dipole) < 0.05 for dipole in "AB")
    assert all(differ("LWASV_", dipole) > 0.10 for dipole in "AB")


@pytest.mark.long
def test_an_antenna_with_its_impedance_and_the_noise_parameters_of_its_amplifier_is_fitted(tmp_path: Path) -> None:
    table = (NU * u.MHz, ANTENNA * u.ohm)
    match, noise = lbacal.mismatch(table, LNA), lbacal.lna_noise(table, 60 * u.K, 8.0, LNA)
    np.testing.assert_allclose(match(NU), match_power(ANTENNA, np.full(NU.size, LNA)), rtol=1e-9)
    front = [lbacal.Stage("load", match, noise=noise, error=10.0, name="match"), lbacal.Stage("lna", 20 * u.dB)]
    chain = lbacal.Chain([*front, lbacal.Stage("cable"), lbacal.Stage("adc", noise="free")])
    antenna = lbacal.Antenna("short-dipole", {"X": 45.0}, gain=2.0, gain_source="a table")
    instrument = lbacal.Instrument("mine", lbacal.Site(52.9, 6.9), antenna, chain, NU * u.MHz)
    spectra = lbacal.simulate(instrument, events=200)
    found = lbacal.fit(spectra, instrument)
    assert {curve.status for curve in found.report.curves} == {"converged"}
    pull = (found.table["c"] - spectra.truth["c"]) / np.hypot(found.table["c_sigma_stat"], found.table["c_sigma_sys"])
    assert np.max(np.abs(pull)) < 3.0, "the spectra hide this C"
    instrument.save(tmp_path / "mine.json")
    again = lbacal.fit(spectra, tmp_path / "mine.json")
    np.testing.assert_allclose(again.table["c"].value, found.table["c"].value)


def test_a_short_dipole_has_the_gain_of_its_effective_area() -> None:
    """Half its length, 20 (k L)^2 / 4 ohm of a linear current (Balanis 2016, eq. 4-37), and 3/2 of lambda^2 / 4 pi."""
    length, wavelength = 0.5, 299.792458 / NU
    resistance = 20.0 * np.pi**2 * (length / wavelength) ** 2
    area = 1.5 * wavelength**2 / (4 * np.pi)
    found = lbacal.effective_length((NU * u.MHz, np.full(NU.size, length / 2) * u.m), (NU * u.MHz, resistance * u.ohm))
    np.testing.assert_allclose(found(NU), area * 50.0 / 376.730313668, rtol=2e-3)


def write_s1p(path: Path) -> None:
    nu = np.arange(20.0, 91.0)
    s11 = reflect(20.0 + 0.8 * nu + 1j * (4.0 * nu - 220.0))
    rows = [f"{one:g} {s.real:.9f} {s.imag:.9f}" for one, s in zip(nu, s11, strict=True)]
    path.write_text("\n".join(["# MHz S RI R 50", *rows]) + "\n")


@pytest.mark.long
def test_an_error_of_s11_is_a_term_of_the_budget_that_planted_errors_make(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page's own example; and spectra of an antenna whose S11 is off, fitted with the one on record."""
    page = (repository / "docs/how-to/describe-your-chain.md").read_text().split("## S11")[1]
    monkeypatch.chdir(tmp_path)
    write_s1p(tmp_path / "antenna.s1p")
    (tmp_path / "page.py").write_text(page.split("```python\n")[1].split("```")[0])
    names = runpy.run_path("page.py")
    mine, instrument = names["mine"], names["instrument"]
    assert {curve.status for curve in names["found"].report.curves} == {"converged"}
    terms = {term.name: term for term in lbacal.budget(names["spectra"], instrument).terms}
    np.testing.assert_allclose(terms["length, 3 %"].vectors["X"][0], np.log(1.03), atol=0.003)
    instrument.save("mine.json")
    again = {term.name: term for term in lbacal.budget(names["spectra"], "mine.json").terms}
    np.testing.assert_allclose(again["S11, 5 %"].vectors["X"], terms["S11, 5 %"].vectors["X"], rtol=1e-9)
    found, others = names["found"].table, [lbacal.fit(names["spectra"], mine(off)).table for off in (0.05, 0.05j)]
    for dipole, vectors in terms["S11, 5 %"].vectors.items():
        rows = found["dipole"] == dipole
        changes = np.array([np.log(other["c"] / found["c"])[rows].value for other in others])
        np.testing.assert_allclose(vectors.T @ vectors, changes.T @ changes, atol=1e-5)
    spectra = lbacal.simulate(mine(0.1))
    wrong, right = (lbacal.fit(spectra, one).table for one in (mine(), mine(0.1)))
    truth, rows = spectra.truth["c"], wrong["dipole"] == "X"
    error = right["c_sigma_stat"] / right["c"]
    assert np.max(np.abs(np.log(right["c"] / truth) / error)[rows].value) < 4.0
    assert np.max(np.abs(np.log(wrong["c"] / right["c"]) / error)[rows].value) > 4.0


def test_alternatives_of_another_shape_are_refused() -> None:
    content = json.loads((files("lbacal_core") / "data/instruments/lofar-superterp.json").read_text())
    with pytest.raises(BadInputError, match="alternatives: expected lists of objects with some of antenna_gain"):
        parse_instrument({**content, "alternatives": {"gain": [{"name": "another"}]}}, "mine.json")
    with pytest.raises(BadInputError, match=r"mine.json: alternatives.gain, row 0: antenna_gain"):
        parse_instrument({**content, "alternatives": {"gain": [{"antenna_gain": "1"}]}}, "mine.json")


def test_an_active_antenna_is_refused() -> None:
    with pytest.raises(BadInputError, match="impedance of antenna: expected an impedance in ohm"):
        lbacal.mismatch(-10.0)(NU)
