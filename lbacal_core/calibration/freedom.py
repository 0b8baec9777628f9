"""What the package's own sky power may be wrong by: other models of sky and antenna, and smooth departures of both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from lbacal_core.calibration.chain_test import SkyFreedom
from lbacal_core.calibration.mistakes import list_mistakes
from lbacal_core.calibration.other_antennas import list_other_antennas
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.provenance import hash_content
from lbacal_core.skypower.differences import LST_HOURS, DifferenceModels, compute_model_differences
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.variation import vary_sky_power

LEVEL = (0.2, 0.03, 0.02, 0.01)
"""Spread of ln P_sky along the Legendre polynomials in ln nu: 20 % is the scale error of the paper, the others what
models differ by."""
ZENITH_GAIN = 0.1
"""Change of the pattern's gain at zenith with its total fixed (section 4.2 of the paper)."""
SHAPE = (0.01, 0.003)
"""Changes along LST that no model at hand makes, of each of the first harmonics: the same at all frequencies, and along
ln nu. A sky that is off by 3 % r.m.s. along LST is 1.7 standard deviations of each away; mistakes that this could hide
are asked for by name."""
SHAPE_HARMONICS = 3


def free_own_sky(instrument: Instrument, models: DifferenceModels | None = None) -> SkyFreedom:
    """The freedom of `compute_sky_power` for an instrument; by all other models that ship unless named."""
    with threadpool_limits(1):
        return _free_own_sky(instrument, models or DifferenceModels())


def _free_own_sky(instrument: Instrument, models: DifferenceModels) -> SkyFreedom:
    own = compute_sky_power(instrument, lst_hours=LST_HOURS)
    wider = vary_sky_power(instrument, lst_hours=LST_HOURS, zenith_gain_fraction=ZENITH_GAIN)
    differences = compute_model_differences(instrument, models)
    smooth = _smooth_modes(instrument.frequency_mhz, LST_HOURS)
    modes = {}
    for dipole, values in own.power.items():
        levels = differences.level[dipole][:, None, :] * np.ones((LST_HOURS.size, 1))
        pattern = np.log(wider.power[dipole] / values)[None]
        modes[dipole] = np.concatenate([levels, differences.shape[dipole], pattern, smooth])
    made_of = {"own": own.digest(), "level": LEVEL, "zenith_gain": ZENITH_GAIN, "shape": [SHAPE, SHAPE_HARMONICS]}
    mistakes = list_mistakes(instrument, own.power, LST_HOURS)
    others = list_other_antennas(instrument, own.power, LST_HOURS)
    names = {"mistakes": [one.name for one in mistakes], "other_antennas": [one.name for one in others]}
    digest = hash_content({**made_of, "skies": models.skies, "antennas": models.antennas, **names})
    return SkyFreedom(modes, digest, tuple(mistakes), tuple(others))


def _smooth_modes(frequency_mhz: Floats, lst_hours: Floats) -> Floats:
    """Departures of level and shape that are smooth in ln nu and LST, shape (mode, lst, freq)."""
    log = np.log(frequency_mhz)
    x = 2.0 * (log - log[0]) / max(float(np.ptp(log)), 1e-300) - 1.0
    polynomials = np.polynomial.legendre.legvander(x, len(LEVEL) - 1).T
    angle = 2.0 * np.pi / 24.0 * np.outer(np.arange(1, SHAPE_HARMONICS + 1), lst_hours)
    waves: Sequence[Floats] = [*np.cos(angle), *np.sin(angle)]
    levels = [size * np.tile(p, (lst_hours.size, 1)) for size, p in zip(LEVEL, polynomials, strict=True)]
    shapes = [size * np.outer(wave, p) for wave in waves for size, p in zip(SHAPE, polynomials, strict=False)]
    return np.array([*levels, *shapes])
