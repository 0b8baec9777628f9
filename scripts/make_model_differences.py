"""Make lbacal_core/data/model_differences.json: the modes in which models of sky and antenna differ.

    .venv/bin/python scripts/make_model_differences.py ../shared/data

Alternatives to the default (embedded Global Sky Model, Hamaker element beam): the Global Sky Model at nside 64
locked to 408 MHz, the Low Frequency Sky Model (Dowell et al. 2017, MNRAS 469, 4537), both from the PyPI source
package lsl, and the simulated response of the LBA (WIPL-D). Of ln P_sky(LST, nu) against the default, each single
exchange is one vector, and what a double exchange adds to the two single ones another. Each vector counts as one
standard deviation away; the modes are the principal axes of that covariance. The mean over LST is taken out, because
A(nu) of the chain absorbs it; its size is kept as `level`.

Only these few numbers ship, not the maps nor the simulated antenna.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from lbacal_core.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power

TARGET = Path(__file__).parent.parent / "lbacal_core" / "data" / "model_differences.json"
NODE_STEP = 5
ORDERS = 8
SMALLEST = 2e-4
"""Modes below this rms in ln P are left out: no station-year can see them."""


def log_powers(data: Path) -> dict[str, dict[tuple[str, str], np.ndarray]]:
    """Logarithm of P_sky (lst, freq) of every sky x antenna combination, by dipole."""
    instrument = load_instrument("lofar-superterp")
    skies = {"gsm": "gsm", "gsm64": str(data / "sky/gsm-408locked.npz"), "lfsm": str(data / "sky/lfsm-5.1deg.npz")}
    antennas = {"hamaker": "hamaker", "wipl": str(data / "antenna/lba_vout.npz")}
    powers = {(s, a): compute_sky_power(instrument, skies[s], antennas[a]).power for s in skies for a in antennas}
    return {dipole: {key: np.log(power[dipole]) for key, power in powers.items()} for dipole in "XY"}


def differences(logs: dict[tuple[str, str], np.ndarray]) -> np.ndarray:
    """One vector per single exchange and per interaction, shape (vector, lst, freq)."""
    base = logs["gsm", "hamaker"]
    antenna = logs["gsm", "wipl"] - base
    rows = [antenna]
    for sky in ("gsm64", "lfsm"):
        alone = logs[sky, "hamaker"] - base
        rows += [alone, logs[sky, "wipl"] - base - alone - antenna]
    return np.array(rows)


def main(folder: str) -> None:
    instrument = load_instrument("lofar-superterp")
    nodes = instrument.frequency_mhz[::NODE_STEP]
    content: dict[str, object] = {
        "origin": "made by scripts/make_model_differences.py, which names the models",
        "latitude_deg": instrument.latitude_deg,
        "dipole_azimuth_deg": dict(instrument.dipole_azimuth_deg),
        "frequency_mhz": nodes.tolist(),
    }
    for dipole, logs in log_powers(Path(folder)).items():
        vectors = differences(logs)
        level = vectors.mean(axis=1)
        shape = (vectors - level[:, None]).reshape(vectors.shape[0], -1)
        _, size, axes = np.linalg.svd(shape, full_matrices=False)
        rms = size / np.sqrt(shape.shape[1])
        print(dipole, "rms of modes in ln P:", rms.round(6))
        modes = (size[:, None] * axes).reshape(vectors.shape)[rms > SMALLEST]
        terms = np.fft.rfft(modes, axis=1)[:, 1 : ORDERS + 1, ::NODE_STEP] / modes.shape[1]
        content[dipole] = {
            "real": [[[round(float(v), 6) for v in row] for row in mode] for mode in terms.real],
            "imaginary": [[[round(float(v), 6) for v in row] for row in mode] for mode in terms.imag],
            "level": [round(float(v), 4) for v in np.sqrt((level**2).sum(axis=0))[::NODE_STEP]],
        }
    TARGET.write_text(json.dumps(content).replace("]], [[", "]],\n[[").replace("], [", "],\n[") + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
