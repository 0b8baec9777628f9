"""The size of a planted fault in the words of a report: what it does to what can be observed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lbacal_core.grids import Floats
from lbacal_twin.faults.fault import driver
from lbacal_twin.faults.hardware import CableReflection, ResonanceFault, ResonanceShift, circuit_response
from lbacal_twin.faults.sky import RfiLine
from validation.hidden.data_sets import DataSet, Planted

WIDE_MHZ = np.arange(25.0, 110.0, 0.01)
"""Frequencies over which the half-power points of a circuit are sought."""


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
    peak_mhz = float(scene.frequency_mhz[np.argmax(data.instrument.antenna_gain)])
    size = _of_circuit(fault, peak_mhz) if fault.is_circuit else fault.size
    return size * float(strength[strength != 0].mean()) if fault.follows in ("wet", "rain", "soaked") else size


def _of_circuit(fault: ResonanceFault, peak_mhz: float) -> float:
    """What a fault at full strength does to the circuit's half-power points: their middle, MHz, or ln of the width.

    Reports state this of their circuit. In G_ant the same circuit moves the half-power points by half as much or half
    as much again, as the other losses beside the resonance fall.
    """
    shift, widening = fault.change(np.ones((1, 1)))
    built, changed = (np.array(peak_mhz), np.array(1.0)), (peak_mhz + shift[0, 0], 1.0 + widening[0, 0])
    before, after = (_half_power(circuit_response(WIDE_MHZ, *one)) for one in (built, changed))
    at = 0 if isinstance(fault, ResonanceShift) else 1
    return float(after[at] - before[at])


def _half_power(gain: Floats) -> tuple[float, float]:
    """Middle of the half-power points of a gain over `WIDE_MHZ`, MHz, and ln of the width between them."""
    top = int(np.argmax(gain))
    below = float(np.interp(0.5 * gain[top], gain[:top], WIDE_MHZ[:top]))
    above = float(np.interp(-0.5 * gain[top], -gain[top:], WIDE_MHZ[top:]))
    return (above + below) / 2, float(np.log(above - below))
