"""The sky of section 3.1 and appendix C: how much of it is isotropic, and how far sky models differ."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lbacal_core.grids import Floats
from lbacal_core.sky.model import SkyModel
from lbacal_core.sky.names import DEFAULT_SKY, list_skies, load_sky
from lbacal_paper.statements import Result, not_testable

INDEX_ERROR = 0.2
"""Uncertainty of the index 2.75 of the isotropic component (appendix C)."""
SKY_FILES = ("sky/gsm-408locked.npz", "sky/lfsm-5.1deg.npz")
"""Sky models in the folder of measured data."""


def find_skies(data: Path | None) -> list[SkyModel]:
    """The default sky and every other that is at hand: shipped ones, and files in the folder of measured data."""
    names = [DEFAULT_SKY, *(name for name in list_skies() if name != DEFAULT_SKY)]
    at_hand = [] if data is None else [str(data / name) for name in SKY_FILES if (data / name).is_file()]
    return [load_sky(name) for name in (*names, *at_hand)]


def mean_temperature(sky: SkyModel, frequency_mhz: Floats) -> Floats:
    """Brightness temperature averaged over the whole sky, shape (freq,), K."""
    return np.asarray(sky.temperature(frequency_mhz)[:, 0, 0].real / np.sqrt(4 * np.pi))


def isotropic_temperature(frequency_mhz: Floats, index: float = 2.75) -> Floats:
    """T_Iso of eq. (C.2), shape (freq,), K."""
    return np.asarray(50.0 * (150.0 / frequency_mhz) ** index)


def find_about_sky(skies: Sequence[SkyModel], frequency_mhz: Floats) -> dict[str, Result]:
    """Results on the isotropic component and on the difference of sky models."""
    total = mean_temperature(skies[0], frequency_mhz)
    share = 100.0 * isotropic_temperature(frequency_mhz) / total
    changed = [isotropic_temperature(frequency_mhz, 2.75 + sign * INDEX_ERROR) for sign in (-1, 1)]
    effect = 100.0 * np.abs(changed[1] - changed[0]) / 2.0 / total
    level = 0.12
    return {
        "isotropic-share": Result(
            float(share.max()),
            float(level * share.max()),
            f"50 K (150 MHz/nu)^2.75 over the sky mean of {skies[0].name}, largest at "
            f"{frequency_mhz[share.argmax()]:g} MHz; {share.min():.0f} % at the smallest. Error: seven sky models "
            "spread by 12 % in level (arXiv 2211.03086).",
        ),
        "isotropic-index": Result(
            float(effect.mean()),
            float(np.hypot(level * effect.mean(), effect.std())),
            f"half the change of T_Iso for an index of 2.75 +- {INDEX_ERROR}, over the sky mean of {skies[0].name}, "
            f"averaged over the band, with its scatter over the band in the error; it falls from {effect.max():.1f} % "
            f"to {effect.min():.1f} % with frequency, because the pivot is 150 MHz.",
        ),
        "sky-models": _compare(skies, frequency_mhz),
    }


def _compare(skies: Sequence[SkyModel], frequency_mhz: Floats) -> Result:
    if len(skies) < 2:
        return not_testable("a second sky model is needed (--data with sky/*.npz, or pygdsm); LFmap is not at hand")
    mean = {sky.name: mean_temperature(sky, frequency_mhz) for sky in skies}
    first = mean[skies[0].name].mean()
    ratio = {name: 100.0 * (values.mean() / first - 1.0) for name, values in mean.items()}
    others = {name: value for name, value in ratio.items() if name != skies[0].name}
    words = ", ".join(f"{name} {value:+.1f} %" for name, value in others.items())
    return not_testable(
        "needs LFmap, which the paper compared with one version of the GSM. The models at hand, averaged over the sky "
        f"and the band, differ from {skies[0].name} by: {words}; haslam is 408 MHz scaled with one index"
    )
