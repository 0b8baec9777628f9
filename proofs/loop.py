"""The loop: a fault begins in year 2, its investigation names it, and with it adopted C of year 3 is right again.

A station records three years, simulated by the twin, which shares no code with the finder. From the second year on one
of five faults is there whose effect recurs within a year. Year 2 is investigated, the finding is adopted, and year 3 is
calibrated with the model and without it. The truth is C as it was planted. The gain in log-likelihood on year 3, with
the size as it was adopted, stands beside what these events should gain and beside the promise of year 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from lbacal_core.adopted import fit_causes
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves import CalibrationCurve
from lbacal_core.discovery.investigate import investigate
from lbacal_core.discovery.payoff import measure_gains, promise_of
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument, load_instrument
from lbacal_core.model import Model
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra
from lbacal_core.twin.campaign import Campaign, simulate_campaign
from lbacal_core.twin.faults.antenna import GainTemperature
from lbacal_core.twin.faults.fault import Fault
from lbacal_core.twin.faults.interference import RfiBroadband
from lbacal_core.twin.faults.sky import DipoleSwap, IonosphericAbsorption, LstOffset
from lbacal_core.twin.settings import YEAR_S, TwinSettings
from proofs.machinery.claims import (
    Claim,
    at_least,
    at_most,
    between,
    claim_mean,
    claim_rate,
    claim_worst,
    confidence_of_each,
    mean_interval,
)
from proofs.machinery.parts import Part, Row
from proofs.twin import CHANNELS, planted_curve

SETTINGS = TwinSettings(stations=("CS002",), antennas=6, events_per_year=500, years=3.0)
FAULTS: dict[str, Fault] = {
    "ionospheric_absorption": IonosphericAbsorption(size=0.5),
    "lst_offset": LstOffset(size=0.5),
    "dipole_swap": DipoleSwap(size=0.3),
    "gain_temperature": GainTemperature(size=0.18),
    "rfi_broadband": RfiBroadband(size=0.1, index=-2.0, hours=(6.0, 18.0)),
}
"""Sizes that move C by three statistical errors or more."""
WARM = (0.29, 0.79)
"""Part of year 3 that is recorded where the gain follows temperature: over a whole year its mean hardly moves C."""
MOVED, RIGHT, SPREAD, PULLS = 3.0, 0.5, (0.85, 1.15), (0.7, 1.3)


@dataclass(frozen=True)
class Years:
    """Three years of a station, with a fault in the last two, and without it."""

    instrument: Instrument
    sky_power: SkyPower
    clean: Campaign
    faulty: Campaign
    settings: TwinSettings

    def year(self, number: int, part: tuple[float, float] = (0.0, 1.0), *, is_clean: bool = False) -> Spectra:
        """The spectra of a year, from 1, or of a part of it."""
        begin, end = (self.settings.start_unix + (number - 1 + edge) * YEAR_S for edge in part)
        spectra = (self.clean if is_clean or number == 1 else self.faulty).spectra
        return spectra.select((spectra.time_unix >= begin) & (spectra.time_unix < end))

    def truth(self, spectra: Spectra, curve: CalibrationCurve) -> Floats:
        """C of a station as it was planted."""
        return planted_curve(Campaign(spectra, self.clean.truth), curve)


@cache
def _inputs() -> tuple[Instrument, SkyPower]:
    instrument = load_instrument("lofar-superterp")
    return instrument, compute_sky_power(instrument)


def simulate_years(settings: TwinSettings, fault: Fault, seed: int) -> Years:
    """Simulate the same three years with a fault and without."""
    instrument, sky_power = _inputs()
    clean, faulty = (
        simulate_campaign(settings, instrument, sky_power, np.random.default_rng([15, seed]), faults)
        for faults in ([], [fault])
    )
    return Years(instrument, sky_power, clean, faulty, settings)


def close_loop(settings: TwinSettings, scale: float, seed: int) -> Row:
    """One fault: found in year 2, adopted, and what that does to year 3; sizes are those of `FAULTS` times a scale."""
    name = list(FAULTS)[seed % len(FAULTS)]
    fault = replace(FAULTS[name], size=scale * FAULTS[name].size)
    years = simulate_years(settings, fault, seed)
    instrument, sky = years.instrument, years.sky_power
    report, _ = investigate(years.year(2), instrument, sky)
    names = [[one["cause"], *one["indistinguishable"]] for one in report["findings"]]
    row: Row = {"fault": name, "size": fault.size, "verdict": report["verdict"], "named": names}
    if not names:
        return row | {"is_named": False}
    model = Model.from_report(report, 0)
    part = WARM if name == "gain_temperature" else (0.0, 1.0)
    spectra = years.year(3, part)
    fitted = fit_causes(spectra, instrument, sky, model, is_own_sky=False)
    curves = {
        "clean": fit_calibration(years.year(3, part, is_clean=True), instrument, sky, "station").curves,
        "without": fit_calibration(spectra, instrument, sky, "station").curves,
        "with": fitted.fit("station").curves,
    }
    (gain,) = measure_gains(years.year(3), instrument, sky, model, is_own_sky=False)
    promise = promise_of(report["findings"][0])
    left, _ = investigate(spectra, instrument, sky, model=model)
    return row | {
        "is_named": name in names[0],
        "adopted": [model.causes[0].size, model.causes[0].sigma],
        "fitted": [fitted.sizes[0].value, fitted.sizes[0].sigma],
        "status": {key: [curve.status for curve in found] for key, found in curves.items()},
        "pull": {key: _pulls(years, spectra, found) for key, found in curves.items()},
        "moved": _largest(curves["without"], curves["clean"]),
        "wrong": _largest(curves["with"], curves["clean"]),
        "gain": [gain.gain, gain.expected, gain.expected_sigma],
        "promise": [promise.gain, promise.sigma],
        "left": left["verdict"],
        "is_plain_in_year_1": model.during(settings.start_unix, settings.start_unix + YEAR_S).is_plain,
    }


def _pulls(years: Years, spectra: Spectra, curves: Sequence[CalibrationCurve]) -> list[list[float]]:
    """Deviation of C from the truth in statistical errors, at three channels of X and of Y; nothing without C."""
    at, pulls = list(CHANNELS.values()), []
    for curve in curves:
        if curve.c is not None and curve.c_sigma_stat is not None:
            pull = (curve.c - years.truth(spectra, curve)) / curve.c_sigma_stat
            pulls.append(np.round(pull[at], 3).tolist())
    return pulls


def _largest(curves: Sequence[CalibrationCurve], clean: Sequence[CalibrationCurve]) -> float:
    """Largest difference of C at the three channels from that of the data without the fault, in its errors."""
    at = list(CHANNELS.values())
    moved = [
        np.abs((one.c - right.c) / right.c_sigma_stat)[at].max()
        for one, right in zip(curves, clean, strict=True)
        if one.c is not None and right.c is not None and right.c_sigma_stat is not None
    ]
    return float(max(moved))


def judge(rows: Sequence[Row]) -> list[Claim]:
    """Whether the fault is named, C is right with it and wrong without, and the gain is that promised."""
    closed = [row for row in rows if row["is_named"]]
    count = len(closed)

    def rate(key: str, claim: str, asked: Any, of: Sequence[Row], test: Any) -> Claim:
        return claim_rate(key, claim, asked, sum(bool(test(row)) for row in of), len(of))

    square = np.mean(np.array([row["pull"]["with"] for row in closed]) ** 2, axis=1)
    confidence = confidence_of_each(len(CHANNELS))
    ends = [mean_interval(one, confidence) for one in square.T]
    roots = [(max(low, 0.0) ** 0.5, high**0.5) for low, high in ends]
    of_gain = np.array([(g - e) / s for g, e, s in (row["gain"] for row in closed)])
    of_promise = np.array([(row["gain"][0] - row["promise"][0]) / row["promise"][1] for row in closed])
    return [
        rate("named", "The fault is named in the investigation of year 2", at_least(0.95), rows,
             lambda r: r["is_named"]),
        rate("moved", "Without it C of year 3 is off by three statistical errors or more", at_least(0.95), closed,
             lambda r: r["moved"] >= MOVED),
        claim_worst("pulls", "R.m.s. of the pulls of C of year 3 with the fault adopted, at 35, 55 and 75 MHz",
                    between(*SPREAD), np.sqrt(square.mean(axis=0)).tolist(), roots, count),
        claim_mean("right", "Largest difference of C of year 3 from that of data without the fault, in its errors",
                   at_most(RIGHT), np.array([row["wrong"] for row in closed])),
        _claim_spread("gain", "R.m.s. of the pulls of the gain on year 3 against what its events should gain", of_gain),
        _claim_spread("promise", "R.m.s. of the pulls of the gain on year 3 against the promise of year 2", of_promise),
        rate("left", "Nothing is left in year 3 beside the adopted cause", at_least(0.95), closed,
             lambda r: r["left"] == "consistent"),
        rate("before", "Year 1 keeps the model that it had", at_least(1.0), closed, lambda r: r["is_plain_in_year_1"]),
    ]  # fmt: skip


def _claim_spread(key: str, claim: str, pulls: Floats) -> Claim:
    low, high = mean_interval(pulls**2)
    root = float(np.sqrt(np.mean(pulls**2)))
    return Claim(key, claim, between(*PULLS), root, (max(low, 0.0) ** 0.5, high**0.5), pulls.size)


def tell(rows: Sequence[Row]) -> list[str]:
    """Fault by fault."""
    lines = [
        "| fault | size | named | adopted | in year 3 | C off without, with | gain | should be | promised | left |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if not row["is_named"]:
            lines.append(f"| {row['fault']} | {row['size']:.3g} | {row['verdict']} {row['named']} | | | | | | | |")
            continue
        (value, sigma), (now, now_sigma), (gain, should, error) = row["adopted"], row["fitted"], row["gain"]
        promised, of_promise = row["promise"]
        lines.append(
            f"| {row['fault']} | {row['size']:.3g} | yes | {value:.4g} ± {sigma:.1g} | {now:.4g} ± {now_sigma:.1g} "
            f"| {row['moved']:.1f}, {row['wrong']:.2f} | {gain:.0f} | {should:.0f} ± {error:.0f} "
            f"| {promised:.0f} ± {of_promise:.0f} | {row['left']} |"
        )
    return lines


PARTS = (Part("core", partial(close_loop, SETTINGS, 1.0), judge, 60, tell),)
