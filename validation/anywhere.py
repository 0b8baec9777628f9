"""Instruments drawn anywhere: the truth is inside the errors whatever the arms, the channels, the site and the chain.

One to three arms, 8-200 uneven channels between 10 and 400 MHz, any latitude at which a sky sets; a flat or a shaped
receiver, or a list of stages with a ground, an amplifier at the antenna whose noise is known or free, a filter and an
amplifier behind the cable. The same P_sky is simulated and fitted with: what is tested is the chain, in the part
`chains`, and what an investigation says of it, in the part `investigations`, with a step of one antenna's gain, a clock
that is off, or nothing planted. How well such an effect could be seen at best differs from instrument to instrument by
a factor of thirty: names are asked for by its ideal SNR, from the twin's truth alone.

An ideal detector knows the template d = P(with) / P(without) - 1 of every path, event and channel, and the noise. It
leaves free what a fit leaves free, N: A(nu) in each channel of a path, and the amounts of a path's noise in front of
the receiver, in it and in the converter. With the covariance V of the noise, its generalised least squares have

    SNR^2 = d' V^-1 d - (N' V^-1 d)' (N' V^-1 N)^-1 (N' V^-1 d).

In an event of the twin's plain campaigns every channel has radiometer noise, every path a gain of its own, and all
paths a common one. V^-1 is then diagonal but for the sums over the channels of a path (Woodbury). No code is shared
with what searches; `validation.hidden.ideal` is the same for the three constants and the nuisances of LOFAR.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CONVERGED, CalibrationCurve
from lbacal_core.discovery.report import investigate
from lbacal_core.grids import Floats
from lbacal_core.instrument.antennas import AntennaRecord, GainProvenance
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.stages import Stage, gain_behind
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_twin.campaign import DrawnStation, draw_stations, expected_power, simulate_campaign
from lbacal_twin.faults.fault import Fault, Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.faults.sky import LstOffset
from lbacal_twin.settings import Truth, TwinSettings
from validation.hidden.detection import fit_detection
from validation.machinery.claims import Found, One, exactly, mean_of, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

SETTINGS = TwinSettings(events_per_year=250)
MATCHED_M2 = 4800.0
"""G_ant of an antenna that receives T behind a sky of T, m^2 MHz^2: 0.053 lambda^2 into 50 ohm."""


def draw_instrument(rng: np.random.Generator) -> Instrument:
    low = float(rng.uniform(10.0, 200.0))
    high = min(float(rng.uniform(1.5, 4.0)) * low, 400.0)
    nu = np.sort(rng.uniform(low, high, int(rng.integers(8, 201))))
    flat = np.ones(nu.size)
    shaped = np.exp(-((nu / high) ** 6) * rng.uniform(0.3, 2.0))
    plain = Instrument(
        name="somewhere",
        # within 18 degrees of a pole no sky sets
        latitude_deg=float(np.degrees(np.arcsin(rng.uniform(-0.95, 0.95)))),
        longitude_deg=float(rng.uniform(-180.0, 180.0)),
        height_m=1000.0,
        frequency_mhz=nu,
        dipole_azimuth_deg={letter: float(rng.uniform(10.0, 180.0)) for letter in "ABC"[: rng.integers(1, 4)]},
        antenna_gain=flat,
        receiver_gain=shaped if rng.random() < 0.5 else flat,
        cables={"long": 0.5 * flat},
        antennas=tuple(AntennaRecord("S1", number, "long") for number in range(int(rng.integers(1, 4)))),
        antenna="quarter-wave",
    )
    return plain if rng.random() < 0.5 else _with_stages(plain, shaped, rng)


def _with_stages(plain: Instrument, shaped: np.ndarray, rng: np.random.Generator) -> Instrument:
    """The instrument with a chain of four to seven stages, and a G_ant in m^2."""
    flat = np.ones(plain.frequency_mhz.size)
    temperature = 10.0 ** float(rng.uniform(1.3, 2.3))
    is_known = rng.random() < 0.5
    known: dict[str, Any] = {"noise_k": temperature * flat, "error_k": 0.1 * temperature}
    stages = [Stage("lna", "lna", 300.0 * flat, **(known if is_known else {"is_free": True})), Stage("coax", "cable")]
    if rng.random() < 0.5:
        stages.insert(0, Stage("ground", "ground", noise_k=290.0 * flat, solid_angle_sr=float(rng.uniform(0.02, 0.3))))
    if rng.random() < 0.5:
        stages.append(Stage("filter", "filter", shaped, is_free=rng.random() < 0.5))
    if rng.random() < 0.5:
        stages.append(Stage("amp", "amplifier", 1000.0 * flat, is_free=rng.random() < 0.5))
    stages.append(Stage("adc", "adc", is_free=True))
    return replace(
        plain,
        stages=tuple(stages),
        receiver_gain=gain_behind(stages, flat.size),
        antenna_gain=MATCHED_M2 / plain.frequency_mhz**2,
        gain_provenance=GainProvenance("absolute", "drawn"),
    )


ANTENNAS, MOST_CHANNELS, STEP, DATE, LATE_H = 4, 40, 0.1, "2014-07-01", 0.5
"""Antennas, of which one has a step; channels at most; size and date of the step, and by how much a clock is off."""
PLANTED = ("nothing", "gain_step", "nothing", "lst_offset")
WHAT = ("gain_step", "lst_offset")
NAMING_SNR = 10.0
"""Ideal SNR from which an effect must be named: that at which the other proofs of discovery ask for it."""


def draw_faulty(rng: np.random.Generator, kind: str) -> tuple[Instrument, list[Fault]]:
    """A drawn instrument of four antennas and at most 40 channels, and what is wrong with one of them or with all."""
    drawn = draw_instrument(rng)
    while drawn.frequency_mhz.size > MOST_CHANNELS:
        drawn = draw_instrument(rng)
    instrument = replace(drawn, antennas=tuple(AntennaRecord("S1", number, "long") for number in range(ANTENNAS)))
    faults: dict[str, Fault] = {
        "gain_step": GainStep(size=STEP, where=Where(antennas=(int(rng.integers(ANTENNAS)),)), date=DATE),
        "lst_offset": LstOffset(size=LATE_H),
    }
    return instrument, [faults[kind]] if kind in faults else []


def investigate_drawn(seed: int) -> Row:
    """A drawn instrument with something planted, or nothing, and what an investigation says of it."""
    rng = np.random.default_rng([18, seed])
    kind = PLANTED[seed % len(PLANTED)]
    instrument, faults = draw_faulty(rng, kind)
    sky = compute_sky_power(instrument)
    again = np.random.default_rng([18, seed])
    draw_faulty(again, kind)
    ((station,), _) = draw_stations(SETTINGS, instrument, sky, again)
    spectra = simulate_campaign(SETTINGS, instrument, sky, rng, faults).spectra
    report, _ = investigate(spectra, Simulation(instrument, sky))
    findings = report["findings"]
    hits = [one for one in findings if kind in (one["cause"], *one["indistinguishable"]) and _is_there(one, faults)]
    sizes = [one["size"] for one in hits if one["cause"] == kind]
    curves = fit_calibration(spectra, Simulation(instrument, sky), "station").curves
    return {
        "kind": kind,
        "arms": len(instrument.dipoles),
        "channels": instrument.frequency_mhz.size,
        "chain": _chain_of(instrument),
        "merged": any(curve.merged is not None for curve in curves),
        "snr": round(ideal_snr(station, faults, SETTINGS), 2) if faults else 0.0,
        "verdict": report["verdict"],
        "said": [f"{one['cause']} {one['size']['value']:.3g}" for one in findings],
        "named": bool(hits),
        "others": len(findings) - len(hits) + (report["unexplained"] is not None),
        "pulls": [round((abs(size["value"]) - faults[0].size) / size["sigma"], 3) for size in sizes[:1]],
    }


def _is_there(finding: Mapping[str, Any], faults: Sequence[Fault]) -> bool:
    """Whether a finding names the antennas of a fault, where it is one of single antennas."""
    antennas = [number for fault in faults for number in fault.where.antennas]
    return not antennas or finding["where"]["antennas"] == antennas


def calibrate_drawn(seed: int) -> Row:
    """A drawn instrument, a year of it, and how far its curves and noise constants are from the truth."""
    rng = np.random.default_rng([17, seed])
    instrument = draw_instrument(rng)
    sky = compute_sky_power(instrument)
    campaign = simulate_campaign(SETTINGS, instrument, sky, rng)
    curves = fit_calibration(campaign.spectra, Simulation(instrument, sky)).curves
    found = [curve for curve in curves if curve.status == CONVERGED]
    return {
        "arms": len(instrument.dipoles),
        "channels": instrument.frequency_mhz.size,
        "chain": _chain_of(instrument),
        "curves": len(curves),
        "statuses": [curve.status for curve in curves],
        "pulls": [round(_pull_of(curve, campaign.truth), 3) for curve in found],
        "constants": [round(pull, 3) for curve in found for pull in _pulls_of_constants(curve, campaign.truth)],
        "merged": sum(curve.merged is not None for curve in found),
    }


def _chain_of(instrument: Instrument) -> str:
    return "stages" if instrument.stages else "flat" if np.ptp(instrument.receiver_gain) == 0 else "shaped"


def _pull_of(curve: CalibrationCurve, truth: Truth) -> float:
    """The median channel of C less the truth, in standard deviations; channels of a curve move together."""
    planted = truth.curve(str(curve.dipole), curve.station, curve.antenna)
    if curve.c is None or curve.c_sigma_stat is None:
        return np.nan
    return float(np.nanmedian((curve.c - planted) / curve.c_sigma_stat))


def _pulls_of_constants(curve: CalibrationCurve, truth: Truth) -> list[float]:
    """Noise constants that the data tell apart, less what was planted, in standard deviations."""
    (station,) = truth.stations
    names = ("n_lna", "n_rcu", "n_adc")
    planted = station.constants or {name: getattr(station, name) for name in names}
    merged = () if curve.merged is None else curve.merged.constants
    return [
        float((one.value - planted[name]) / one.sigma) for name, one in curve.parameters.items() if name not in merged
    ]


def judge(rows: Sequence[Row]) -> list[Found]:
    statuses = [status for row in rows for status in row["statuses"]]
    claims = [rate_of("answered", statuses.count(CONVERGED), len(statuses))]
    for chain in ("flat", "shaped", "stages"):
        for key in ("pulls", "constants"):
            share = [np.mean(np.abs(row[key]) < 2.0) for row in rows if row["chain"] == chain and row[key]]
            if len(share) > 1:
                claims.append(mean_of(f"{chain}_{key}", np.array(share), "%"))
    apart = [row for row in rows if row["chain"] == "flat" and row["merged"] < len(row["pulls"])]
    flat = sum(row["chain"] == "flat" for row in rows)
    return [*claims, exactly("flat_merged", float(len(apart)), n=flat)]


def judge_investigations(rows: Sequence[Row]) -> list[Found]:
    clean = [row for row in rows if row["kind"] == "nothing"]
    claims = [rate_of("false", sum(row["others"] > 0 for row in clean), len(clean))]
    for kind in WHAT:
        of_kind = [row for row in rows if row["kind"] == kind]
        strong = [row for row in of_kind if row["snr"] >= NAMING_SNR]
        claims.append(rate_of(f"{kind}_named", sum(row["named"] for row in strong), len(strong)))
        for is_merged in (False, True):
            pulls = [pull for row in of_kind for pull in row["pulls"] if row["merged"] is is_merged]
            key = f"{kind}_{'merged' if is_merged else 'size'}"
            if pulls:
                claims.append(rate_of(key, int(np.sum(np.abs(pulls) < 2.0)), len(pulls)))
        claims += _measure(kind, of_kind)
    return claims


def _measure(kind: str, of_kind: Sequence[Row]) -> list[Found]:
    """What nobody gave a limit: names at any SNR, other names, and the SNR of detection."""
    n, others = len(of_kind), sum(row["others"] > 0 for row in of_kind)
    claims = [
        rate_of(f"{kind}_at_any_snr", sum(row["named"] for row in of_kind), n),
        rate_of(f"{kind}_others", others, n),
    ]
    found = np.array([row["named"] for row in of_kind], dtype=float)
    if n and 0.0 < found.mean() < 1.0:
        curve = fit_detection(np.array([row["snr"] for row in of_kind]), found)
        claims.append(One(f"{kind}_snr_50", curve.snr_at(0.5), partial(curve.bounds, 0.5), n))
    return claims


SMALLEST = 1e-10
"""Share of the largest eigenvalue of N' V^-1 N below which free vectors are combinations of others."""


def ideal_snr(drawn: DrawnStation, faults: Sequence[Fault], settings: TwinSettings) -> float:
    """SNR of faults in a plain campaign of one station."""
    stages, scene = drawn.stages, drawn.scene
    power = expected_power(stages, scene, ())
    shape = (power.shape[0] * power.shape[1], *power.shape[2:])

    def of_paths(values: Floats) -> Floats:
        """Values that broadcast against (antenna, dipole, event, freq), relative to the power, (path, event, freq)."""
        return np.broadcast_to(values / power, power.shape).reshape(shape)

    template = of_paths(expected_power(stages, scene, faults) - power)
    slope = stages.gain * stages.antenna * stages.cable * stages.receiver
    noise = (stages.lna_noise * slope, stages.rcu_noise * stages.receiver, stages.adc_noise)
    constants = np.stack([of_paths(one) for one in noise], axis=1)
    response = of_paths((stages.sky + stages.lna_noise) * slope)
    paths, events, channels = shape
    free = np.zeros((paths, channels + len(noise) + 1, events, channels))
    free[:, np.arange(channels), :, np.arange(channels)] = np.moveaxis(response, 2, 0)
    free[:, channels:-1] = constants
    free[:, -1] = template
    # all inner products at once: of vectors of one path channel by channel, of all through the sums over channels
    gains = settings.event_gain_path**2 * np.eye(paths) + settings.event_gain_common**2
    precision = settings.radiometer**-2
    shared = precision**2 * np.linalg.inv(np.linalg.inv(gains) + channels * precision * np.eye(paths))
    sums = free.sum(axis=3)
    product = -np.einsum("pie,pq,qje->piqj", sums, shared, sums, optimize=True)
    at = np.arange(paths)
    product[at, :, at] += precision * np.einsum("pief,pjef->pij", free, free, optimize=True)
    # the template is one vector of all paths
    of_free = product[:, :-1, :, :-1].reshape(paths * (channels + len(noise)), -1)
    onto = product[:, :-1, :, -1].sum(axis=2).ravel()
    size = np.sqrt(np.maximum(np.diag(of_free), SMALLEST**2))
    solved = np.linalg.pinv(of_free / np.outer(size, size), rcond=SMALLEST, hermitian=True) @ (onto / size)
    return float(np.sqrt(max(product[:, -1, :, -1].sum() - solved @ (onto / size), 0.0)))


PARTS = (
    Part("chains", calibrate_drawn, judge, 60, by("chain", "arms"), ("stages_pulls",)),
    Part("investigations", investigate_drawn, judge_investigations, 200, by("kind", "chain"), ("gain_step_size",)),
)
