"""Every sky and antenna model against each other, and against what has been published: a comparison, not a tuning."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from lbacal_core.antenna.lofar import load_hamaker
from lbacal_core.data.constants import IMPEDANCE_OF_FREE_SPACE
from lbacal_core.data.tables import read_columns
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.instrument.matching import RESISTANCE_OHM
from lbacal_core.lstcurve.curve import (
    AS_RECORDED,
    LstCurve,
    band_weights,
    compare_lst_curve,
    measured_curve,
    read_lst_curve,
)
from lbacal_core.sky.modes import sky_power_at, sky_power_modes
from lbacal_core.sky.names import load_sky
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower
from validation.machinery.claims import Found, exactly, worst_of
from validation.machinery.parts import SHARED, Part, Row
from validation.pixels import sum_over_pixels

DATA = SHARED / "data"
MAPS = (DATA / "sky/gsm-408locked.npz", DATA / "sky/lfsm-5.1deg.npz")
WIPL = DATA / "antenna/lba_vout.npz"
TABLES = DATA / "published_sky_power.csv"
BAND_MHZ = (30.0, 80.0)
DRAWN_BAR_DB = 0.11
LETTERS = {"as named": {"X": 45.0, "Y": 135.0}, "exchanged": {"X": 135.0, "Y": 45.0}}


def compare_with_plain_sum(instrument: Instrument, sky_name: str, nside: int) -> float:
    """Largest relative difference of the Fourier series from the plain sum, at LSTs off any grid."""
    frequency_mhz = instrument.frequency_mhz[::25]
    lst = np.array([0.123, 5.71, 11.37, 17.9, 20.55])
    sky, antenna = load_sky(sky_name), load_hamaker()
    arm = instrument.dipole_azimuth_deg["X"]
    series = sky_power_at(sky_power_modes(sky, antenna, arm, instrument.latitude_deg, frequency_mhz), lst)
    plain = sum_over_pixels(sky, antenna, arm, instrument.latitude_deg, lst, frequency_mhz, nside)
    return float(np.abs(series / plain - 1).max())


def everybeam_difference() -> float:
    """Largest difference of a Jones term from EveryBeam's, over the 20 stored matrices."""
    stored = Path(__file__).parents[1] / "tests/lbacal_core/antenna/everybeam_values.json"
    worst = 0.0
    for nu, zenith, angle, *values in json.loads(stored.read_text())["rows"]:
        matrix = (np.array(values[::2]) + 1j * np.array(values[1::2])).reshape(2, 2)
        for row, arm in zip(matrix, (0.0, np.pi / 2), strict=True):
            ours = load_hamaker().jones(np.array([nu]), np.array(zenith), np.array(angle - arm))
            worst = max(worst, float(np.abs(np.array(ours)[:, 0] - row).max()))
    return worst


def shape_difference(one: SkyPower, other: SkyPower) -> tuple[float, float]:
    """Largest and rms relative difference in LST shape (a factor per channel apart), both dipoles."""
    ratio = np.array([one.power[dipole] / other.power[dipole] for dipole in "XY"])
    shape = ratio / ratio.mean(axis=1, keepdims=True) - 1
    return float(np.abs(shape).max()), float(np.sqrt(np.mean(shape**2)))


def fourier_series_curve(path: Path) -> LstCurve:
    """The published Fourier series of the LST variation as a curve: X polarization_1, Y polarization_0."""
    rows = [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")]
    lst = np.arange(48) / 2 + 0.25
    x = 2 * np.pi * lst / 24
    basis = np.array([np.full(48, 0.5), np.sin(x), np.cos(x), np.sin(2 * x), np.cos(2 * x)])
    power = {letter: np.array([float(row[k]) for row in rows[1:]]) @ basis for letter, k in (("X", 1), ("Y", 2))}
    decibel = {letter: 10 * np.log10(values / values[0]) for letter, values in power.items()}
    return LstCurve(lst, decibel, np.full(48, DRAWN_BAR_DB), 0.5, is_centre_stated=True, origin=path.name)


def published_tables(path: Path, instrument: Instrument) -> tuple[LstCurve, dict[str, Floats], Floats]:
    """The published sky-power tables: band curve, tables (lst, freq) and their LSTs."""
    read = read_columns(path)
    lst = np.unique(read["lst_h"])
    tables = {letter: read[letter].reshape(-1, lst.size).T for letter in ("X", "Y", "bare")}
    weights = band_weights(instrument, AS_RECORDED, BAND_MHZ) / instrument.antenna_gain
    decibel = {letter: 10 * np.log10(tables[letter] @ weights) for letter in "XY"}
    curve = LstCurve(lst, decibel, np.full(lst.size, DRAWN_BAR_DB), 1.0, is_centre_stated=True, origin=path.name)
    return curve, tables, lst


def tables_shape_rms(sky_power: SkyPower, tables: dict[str, Floats], lst: Floats) -> float:
    """Rms of ln(published / ours) per channel after one factor a channel, both dipoles."""
    left = []
    for letter in "XY":
        ratio = np.log(tables[letter] / sky_power.at(letter, lst))
        left.append(ratio - ratio.mean(axis=0))
    return float(np.std(left))


def best_lst_shift(
    curve: LstCurve, power: SkyPower, instrument: Instrument, dipole: str, has_noise: bool
) -> tuple[float, float]:
    """Hours by which the simulation has to be late to fit best, and chi2 per point there."""
    tried = []
    for shift in np.arange(-2.0, 2.01, 0.05):
        moved = {letter: power.at(letter, power.lst_hours - shift) for letter in "XY"}
        one = compare_lst_curve(curve, replace(power, power=moved), instrument, BAND_MHZ)
        best = one.of(dipole, has_noise=has_noise)
        tried.append((best.chi2 / best.points, float(shift)))
    chi2, shift = min(tried)
    return shift, chi2


def bare_level(tables: dict[str, Floats], instrument: Instrument) -> Floats:
    """Published sky without antenna over ours with an isotropic response and Z_0/R_r = 1, shape (freq,)."""
    ours = compute_sky_power(instrument, antenna="isotropic").power["X"].mean(axis=0)
    return np.asarray(tables["bare"].mean(axis=0) / ours * IMPEDANCE_OF_FREE_SPACE / RESISTANCE_OHM)


def shapes(instrument: Instrument) -> dict[str, tuple[float, float]]:
    """Sky, what it is compared with, largest and rms difference in LST shape: the embedded sky and truncated maps."""
    found = {}
    for path in MAPS:
        full = load_sky(str(path))
        power = compute_sky_power(instrument, full)
        found[f"embedded, {path.stem}"] = shape_difference(compute_sky_power(instrument), power)
        for lmax in (8, 10, 16, 24, 32):
            truncated = compute_sky_power(instrument, full.truncated(lmax))
            found[f"{path.stem}, l <= {lmax}"] = shape_difference(truncated, power)
    return found


def compare_published(instrument: Instrument) -> dict[str, Row]:
    """Every sky x antenna x letters against the published curves: chi2 per point with bars of 0.11 dB.

    The bars are drawn for the measured curve and assumed for the others. After the best offset a dipole; where there is
    noise also after the best share of it; for the tables the rms per channel after one factor a channel as well.
    """
    found = {}
    _, tables, lst = published_tables(TABLES, instrument)
    skies, antennas = ["gsm", *map(str, MAPS)], ["hamaker", str(WIPL), "short-dipole"]
    for sky, antenna, words in product(skies, antennas, LETTERS):
        turned = replace(instrument, dipole_azimuth_deg=LETTERS[words])
        power = compute_sky_power(turned, sky, antenna)
        row: Row = {"rms_of_tables": round(tables_shape_rms(power, tables, lst), 4)}
        for name, (curve, has_noise) in published_curves(instrument).items():
            compared = compare_lst_curve(curve, power, turned, BAND_MHZ)
            for dipole in "XY":
                one = compared.of(dipole, has_noise=has_noise)
                row[f"{name} {dipole}"] = round(one.chi2 / one.points, 2)
                row[f"{name} {dipole}, noise"] = round(one.noise_share, 2) if has_noise else 0.0
        found[f"{Path(sky).stem}, {Path(antenna).stem}, {words}"] = row
    return found


def find_lst_shifts(instrument: Instrument) -> dict[str, Row]:
    """Hours by which the simulation would have to be late, and chi2 per point there: embedded sky, Hamaker."""
    found = {}
    for words, arms in LETTERS.items():
        turned = replace(instrument, dipole_azimuth_deg=arms)
        power = compute_sky_power(turned)
        found[words] = {
            f"{name} {dipole}": best_lst_shift(curve, power, turned, dipole, has_noise)
            for (name, (curve, has_noise)), dipole in product(published_curves(instrument).items(), "XY")
        }
    return found


def published_curves(instrument: Instrument) -> dict[str, tuple[LstCurve, bool]]:
    """The curves compared with, and whether each contains electronic noise."""
    series = fourier_series_curve(DATA / "lst_fourier_series.csv")
    tables = published_tables(TABLES, instrument)[0]
    return {"measured": (read_lst_curve(measured_curve()), True), "series": (series, True), "tables": (tables, False)}


def compare_all(_case: int) -> Row:
    """Every comparison, in one row."""
    instrument = load_instrument("lofar-superterp")
    level = bare_level(published_tables(TABLES, instrument)[1], instrument)
    return {
        "everybeam": everybeam_difference(),
        "plain_sum_embedded": compare_with_plain_sum(instrument, "gsm", 64),
        "plain_sum_map": compare_with_plain_sum(instrument, str(MAPS[0]), 128),
        "published_level": [round(float(level.min()), 4), round(float(level.max()), 4)],
        "shapes": shapes(instrument),
        "chi2_per_point": compare_published(instrument),
        "lst_shifts": find_lst_shifts(instrument),
    }


def judge(rows: Sequence[Row]) -> list[Found]:
    (row,) = rows
    return [
        exactly("everybeam", row["everybeam"], n=20),
        exactly("plain_sum", row["plain_sum_embedded"], n=15),
        exactly("plain_sum_map", row["plain_sum_map"], n=15),
        worst_of([exactly("published_level", one) for one in row["published_level"]], 51),
        exactly("embedded", row["shapes"][f"embedded, {MAPS[0].stem}"][0], "%"),
        *(exactly(f"l_{lmax}", row["shapes"][f"{MAPS[0].stem}, l <= {lmax}"][0], "%") for lmax in (8, 10, 16)),
    ]


PARTS = (Part("sky_models", compare_all, judge, 1, has_chance=False, needs_shared=True),)
