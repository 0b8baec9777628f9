"""Measured LST curve against simulated sky power, with nothing fitted but a noise share and an offset a dipole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from lbacal_core.data.lofar import DIPOLES, SUPERTERP
from lbacal_core.data.tables import read_table
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.lstcurve.curve import LstCurve, estimate_point_noise
from lbacal_core.provenance import Provenance
from lbacal_core.skypower.model import vary_sky_power
from lbacal_core.skypower.table import SkyPower

BAND_MHZ = (30.0, 80.0)
AS_RECORDED = "c^-2 g_ant"
FLAT = "flat"
WEIGHTS = (AS_RECORDED, FLAT)


@dataclass(frozen=True)
class DipoleComparison:
    """One dipole's measured curve beside one simulation.

    Attributes
    ----------
    weights
        How channels are weighted in the band: one of `WEIGHTS`.
    has_noise
        Whether a noise share was fitted; without, it is 0.
    noise_share, noise_share_sigma
        Electronic noise over the total power in the band, averaged over LST, with the drawn bars as errors.
    offset_db
        Fitted: the reference level at LST 0 is itself a measurement.
    residual_db
        Measured minus simulated, shape (point,), NaN where there is no point.
    chi2
        With the drawn bars.
    """

    dipole: str
    weights: str
    has_noise: bool
    noise_share: float
    noise_share_sigma: float | None
    offset_db: float
    residual_db: Floats
    chi2: float

    @property
    def points(self) -> int:
        """How many points were compared."""
        return int(np.isfinite(self.residual_db).sum())

    @property
    def rms_db(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt(np.nanmean(self.residual_db**2)))

    def as_dict(self) -> dict[str, Any]:
        """The comparison as JSON values."""
        return {
            "dipole": self.dipole,
            "weights": self.weights,
            "electronic_noise": self.has_noise,
            "noise_share": {"value": self.noise_share, "sigma": self.noise_share_sigma},
            "offset_db": self.offset_db,
            "points": self.points,
            "chi2": self.chi2,
            "chi2_per_point": self.chi2 / self.points,
            "rms_db": self.rms_db,
            "residual_db": [None if np.isnan(value) else float(value) for value in self.residual_db],
        }


@dataclass(frozen=True)
class Comparison:
    """Every comparison of one measured curve with one simulated sky power."""

    curve: LstCurve
    band_mhz: tuple[float, float]
    dipoles: tuple[DipoleComparison, ...]
    shifted: tuple[DipoleComparison, ...]
    provenance: Provenance

    def of(self, dipole: str, *, has_noise: bool, weights: str = AS_RECORDED) -> DipoleComparison:
        """The comparison of one dipole."""
        wanted = (dipole, has_noise, weights)
        return next(one for one in self.dipoles if (one.dipole, one.has_noise, one.weights) == wanted)

    def as_dict(self) -> dict[str, Any]:
        """The content of the report."""
        return {
            "points": sum(int(self.curve.has_point(dipole).sum()) for dipole in DIPOLES),
            "band_mhz": list(self.band_mhz),
            "lst_hours": self.curve.lst_hours.tolist(),
            "lst_convention": "bin centre, stated" if self.curve.is_centre_stated else "left edge, assumed",
            "point_noise_db": {dipole: estimate_point_noise(self.curve, dipole) for dipole in DIPOLES},
            "published_noise_share": published_noise_share(self.band_mhz),
            "comparisons": [one.as_dict() for one in self.dipoles],
            "half_a_bin_earlier": [
                {key: value for key, value in one.as_dict().items() if key != "residual_db"} for one in self.shifted
            ],
            "provenance": self.provenance.as_dict(),
        }


def compare_lst_curve(
    curve: LstCurve, sky_power: SkyPower, instrument: Instrument, band_mhz: tuple[float, float] = BAND_MHZ
) -> Comparison:
    """Compare a measured LST curve with a simulation, with and without electronic noise, per dipole.

    The band power is the sum over channels of (P_sky + noise) G_ant / C^2 (eq. full_chain), C being the published
    calibration; equal weights are the check that this choice does not decide.
    """
    require_same_grid(sky_power.origin, sky_power.frequency_mhz, instrument.frequency_mhz, instrument.name)
    weights = {name: band_weights(instrument, name, band_mhz) for name in WEIGHTS}
    shift = -curve.bin_hours / 2
    kinds = [(dipole, name, has_noise) for name in WEIGHTS for has_noise in (False, True) for dipole in DIPOLES]
    return Comparison(
        curve,
        band_mhz,
        tuple(
            _compare_dipole(curve, dipole, sky_power, weights[name], name, has_noise, 0.0)
            for dipole, name, has_noise in kinds
        ),
        tuple(
            _compare_dipole(curve, dipole, sky_power, weights[AS_RECORDED], AS_RECORDED, True, shift)
            for dipole in DIPOLES
        ),
        Provenance(
            inputs={
                "lst_curve": curve.digest(),
                "sky_power": sky_power.digest(),
                "instrument": instrument.digest(),
            },
            settings={"band_mhz": list(band_mhz), "sky_power": sky_power.origin},
        ),
    )


def band_weights(instrument: Instrument, name: str, band_mhz: tuple[float, float]) -> Floats:
    """Weight of every channel in the band power, shape (freq,), 0 outside the band, summing to 1.

    As recorded it is G_ant / C^2. C is the published one for LOFAR's Superterp; of any other instrument
    G_ant L_coax G_RCU is known, which is that but for A(nu).
    """
    low, high = band_mhz
    frequency = instrument.frequency_mhz
    is_inside = (frequency >= low) & (frequency <= high)
    if not low < high or not np.any(is_inside):
        channels = f"channels of {instrument.name} ({frequency[0]:g} to {frequency[-1]:g} MHz) between"
        raise BadInputError("band", f"LO below HI and {channels}", f"{low:g} to {high:g}")
    if name == FLAT:
        response = np.ones(frequency.size)
    elif instrument.name == SUPERTERP:
        published = read_table("published_calibration")
        covered = (frequency >= published["mhz"][0]) & (frequency <= published["mhz"][-1])
        if not np.all(covered[is_inside]):
            span = f"{published['mhz'][0]:g} to {published['mhz'][-1]:g} MHz"
            raise BadInputError("band", f"channels of the published C(nu), {span}", f"{low:g} to {high:g} MHz")
        response = instrument.antenna_gain / np.interp(frequency, published["mhz"], published["c"]) ** 2
    else:
        loss = np.mean(list(instrument.cables.values()), axis=0)
        response = instrument.antenna_gain * loss * instrument.receiver_gain
    weights = np.where(is_inside, response, 0.0)
    return np.asarray(weights / weights.sum())


def simulate_band_power(sky_power: SkyPower, dipole: str, lst_hours: Floats, weights: Floats) -> Floats:
    """Sky power of the band over its mean over LST, shape (point,)."""
    mean = float((sky_power.power[dipole] @ weights).mean())
    return np.asarray(sky_power.at(dipole, lst_hours) @ weights / mean)


def in_db(relative_sky: Floats, noise_share: float) -> Floats:
    """Total power in dB when a constant part of it is noise; the mean over LST is the reference."""
    return np.asarray(10.0 * np.log10((1.0 - noise_share) * relative_sky + noise_share))


def _compare_dipole(
    curve: LstCurve, dipole: str, sky_power: SkyPower, weights: Floats, name: str, has_noise: bool, shift_hours: float
) -> DipoleComparison:
    measured = curve.variation_db[dipole]
    relative = simulate_band_power(sky_power, dipole, curve.lst_hours + shift_hours, weights)
    precision = np.where(curve.has_point(dipole), curve.error_db, np.inf) ** -2.0

    def offset_and_residual(share: float) -> tuple[float, Floats]:
        difference = np.where(curve.has_point(dipole), measured, 0.0) - in_db(relative, share)
        offset = float(precision @ difference / precision.sum())
        return offset, difference - offset

    def chi2(share: float) -> float:
        return float(precision @ offset_and_residual(share)[1] ** 2)

    share, sigma = 0.0, None
    if has_noise:
        inner = minimize_scalar(chi2, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-6})
        share = min((float(inner.x), 0.0, 1.0), key=chi2)
        sigma = _share_sigma(relative, share, precision)
    offset, residual = offset_and_residual(share)
    return DipoleComparison(
        dipole=dipole,
        weights=name,
        has_noise=has_noise,
        noise_share=share,
        noise_share_sigma=sigma,
        offset_db=offset,
        residual_db=np.where(curve.has_point(dipole), residual, np.nan),
        chi2=chi2(share),
    )


def _share_sigma(relative: Floats, share: float, precision: Floats) -> float:
    """Fisher error of the noise share after the offset has taken its part."""
    slope = 10.0 / np.log(10.0) * (1.0 - relative) / ((1.0 - share) * relative + share)
    slope = slope - precision @ slope / precision.sum()
    return float((precision @ slope**2) ** -0.5)


def published_noise_share(band_mhz: tuple[float, float]) -> float | None:
    """Noise over total power in the band by the published noise terms and C(nu); None outside their channels.

    The terms are referred to the sky; at the output each is multiplied by G_ant / C^2, and G_ant is proportional to
    C^2 / N_ADC,in because N_ADC is constant at the output: so the weight is 1 / N_ADC,in.
    """
    terms = read_table("noise_terms")
    is_inside = (terms["mhz"] >= band_mhz[0]) & (terms["mhz"] <= band_mhz[1])
    if not np.any(is_inside):
        return None
    noise = (terms["lna"] + terms["rcu"] + terms["adc"]) / terms["adc"]
    sky = terms["sky"] / terms["adc"]
    return float(noise[is_inside].sum() / (noise + sky)[is_inside].sum())


# Electronic noise in an LST curve, over the mean sky power of its band: what is known before the points are fitted.

SKY_SCALE = 0.23
"""Relative error of the simulated sky power to which the published noise is referred (Mulrey et al. 2019, Table 1)."""
LARGEST_RATIO = 99.0
"""Noise over sky of a noise share of 0.99."""


@dataclass(frozen=True)
class NoisePrior:
    """Electronic noise over the mean sky power of the band, the same for both polarisations.

    Attributes
    ----------
    mean, sigma
        `sigma` is infinite where nothing is known but that the noise share lies between 0 and 1.
    stages
        Power of LNA, receiver and digitiser at the output, shape (stage, freq), in any common unit.
    """

    mean: float
    sigma: float
    stages: Floats

    @property
    def is_known(self) -> bool:
        """Whether anything is known of the noise."""
        return bool(np.isfinite(self.sigma))


def noise_prior(instrument: Instrument, band_mhz: tuple[float, float], weights: Floats) -> NoisePrior:
    """What is published of the noise of an instrument; nothing, for any but the Superterp.

    The published noise was fitted against a sky power whose integral has a cosine of the zenith angle too many
    (docs/explanation/what-the-simulation-gets-wrong.md). Against our integral, which is larger, the ratio is smaller by
    the ratio of the two integrals. That cosine is an inference from published code: the standard deviation contains
    the whole change, beside the error of the sky's scale.

    Parameters
    ----------
    weights
        Weight of every channel in the band power, shape (freq,).
    """
    share = published_noise_share(band_mhz)
    lna_alone = np.stack([weights, 0.0 * weights, 0.0 * weights])
    if instrument.name != SUPERTERP or share is None:
        return NoisePrior(0.5, np.inf, lna_alone)
    try:
        own, narrow = (vary_sky_power(instrument, zenith_exponent=exponent) for exponent in (0.0, 1.0))
    except BadInputError:
        return NoisePrior(0.5, np.inf, lna_alone)
    cosine = float(np.mean([np.sum(narrow.power[d] @ weights) / np.sum(own.power[d] @ weights) for d in DIPOLES]))
    mean = cosine * share / (1.0 - share)
    terms = read_table("noise_terms")
    shapes = np.stack([weights, instrument.receiver_gain * (weights > 0), 1.0 * (weights > 0)])
    at_input = [np.interp(instrument.frequency_mhz, terms["mhz"], terms[stage]) for stage in ("lna", "rcu", "adc")]
    levels = (np.stack(at_input) * weights).sum(axis=1) / shapes.sum(axis=1)
    return NoisePrior(mean, mean * float(np.hypot(SKY_SCALE, 1.0 - cosine)), levels[:, None] * shapes)
