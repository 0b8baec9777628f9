"""The size of a planted fault in the words of a report: what it does to what can be observed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.grids import Floats
from lbacal_twin.faults.fault import driver
from lbacal_twin.faults.hardware import CableReflection, ResonanceFault, ResonanceShift
from lbacal_twin.faults.sky import RfiLine
from validation.hidden.data_sets import DataSet, Planted


def size_pull(data: DataSet, planted: Planted, finding: Mapping[str, Any]) -> float | None:
    """(Size reported - size planted) / its error; None of a statement, which has none.

    What follows rain is compared by what it does in the mean rain of the data, whatever law is named; a ripple as it
    is seen in channels of 1 MHz, which know its delay modulo 1 us.
    """
    if finding["size"]["sigma"] is None:
        return None
    rain = data.scene.rain_mm_h
    laws = {"flag": (rain > 0).astype(float), "linear": rain, "saturating": np.tanh(rain)}
    named = laws.get(finding["parameters"].get("wetness", ""))
    factor = 1.0 if named is None else float(named[rain > 0].mean())
    if planted.cause == "cable_reflection":
        factor = float(np.sinc(finding["parameters"]["delay_us"]))
    size = finding["size"]
    return float((size["value"] * factor - planted_size(data, planted)) / (size["sigma"] * factor))


def planted_size(data: DataSet, planted: Planted) -> float:
    """The planted size in the unit of the contract's report, of rain and ripples as `size_pull` compares them."""
    fault, scene = planted.fault, data.scene
    if isinstance(fault, RfiLine):
        # The unit is the power recorded in the strongest channel, which has more noise than what reaches the converter.
        before, after = data.detector.power([]), data.detector.power([fault])
        of_path = ((after - before) / before.mean(axis=1, keepdims=True)).max(axis=(1, 2))
        return float(of_path[of_path > 0].mean())
    if isinstance(fault, CableReflection):
        return abs(fault.size * float(np.sinc(fault.delay_us)))
    if not isinstance(fault, ResonanceFault):
        return fault.size
    strength = driver(fault.follows, scene)
    size = _of_gain(data, fault) if fault.is_circuit else fault.size
    return size * float(strength[strength != 0].mean()) if fault.follows in ("wet", "rain", "soaked") else size


def _of_gain(data: DataSet, fault: ResonanceFault) -> float:
    """What a circuit of another size does to the resonance of G_ant: its place in MHz, or ln of its width."""
    stages, scene = data.detector.station.stages, data.scene
    ratio = replace(fault, follows="wet").alter(stages, scene).antenna / stages.antenna
    wet = ratio[..., int(np.argmax(scene.rain_mm_h)), :].reshape(-1, scene.frequency_mhz.size)
    changed = wet[np.argmax(np.abs(wet - 1.0).sum(axis=1))]
    gain = data.instrument.antenna_gain
    before, after = (_resonance(scene.frequency_mhz, curve) for curve in (gain, gain * changed))
    at = 0 if isinstance(fault, ResonanceShift) else 1
    return float(after[at] - before[at])


def _resonance(frequency_mhz: Floats, gain: Floats) -> tuple[float, float]:
    """Middle of the half-power points of a gain, MHz, and ln of the width between them."""
    curve = CubicSpline(frequency_mhz, np.log(gain))
    extremes = curve.derivative().roots(extrapolate=False)
    peak = extremes[np.argmax(curve(extremes))]
    half = CubicSpline(frequency_mhz, np.log(2 * gain) - curve(peak)).roots(extrapolate=False)
    above, below = half[half > peak].min(), half[half < peak].max()
    return float((above + below) / 2), float(np.log(above - below))
