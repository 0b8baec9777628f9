"""A measured LST curve: band power against local sidereal time, and its file (docs/formats/lst-curve.md)."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from lbacal_core.data.lofar import DIPOLES, SUPERTERP
from lbacal_core.data.tables import SHIPPED, read_table
from lbacal_core.errors import BadInputError, UnreadableFileError, require_parts
from lbacal_core.foreign import parse_cell, read_text
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.linear import fit_least_squares
from lbacal_core.provenance import Provenance, hash_arrays
from lbacal_core.sky.power import vary_sky_power
from lbacal_core.sky.table import SkyPower, harmonics_at

COLUMNS = ("lst_h", "x_db", "y_db", "error_db")
CENTRE_LINE = "# lst: centre"
FEWEST_POINTS = 4
"""Per dipole: fewer cannot be compared with anything after a noise share and an offset are fitted."""


@dataclass(frozen=True)
class LstCurve:
    """Band power of both dipoles, averaged over antennas, relative to LST 0.

    Attributes
    ----------
    lst_hours
        Shape (point,), hours, the middle of each bin.
    variation_db
        For each polarisation, shape (point,), dB; NaN where there is no point.
    error_db
        Shape (point,), dB, one standard deviation as drawn or stated; NaN where there is no point at all.
    bin_hours
        Width of a bin.
    is_centre_stated
        Whether a comment in the file declares its LST to be bin centres; otherwise they were read as left edges, and
        half a bin is a systematic uncertainty.
    """

    lst_hours: Floats
    variation_db: Mapping[str, Floats]
    error_db: Floats
    bin_hours: float
    is_centre_stated: bool
    origin: str = "LST curve"

    def __post_init__(self) -> None:
        for dipole in DIPOLES:
            found = int(np.isfinite(self.variation_db[dipole]).sum())
            if found < FEWEST_POINTS:
                column = f"{dipole.lower()}_db"
                raise BadInputError(f"{self.origin}: {column}", f"at least {FEWEST_POINTS} points", f"{found}")

    def has_point(self, dipole: str) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Where the dipole was measured, shape (point,)."""
        return np.isfinite(self.variation_db[dipole])

    def digest(self) -> str:
        """Hash of the numbers, which names this curve in provenance."""
        return hash_arrays(self.lst_hours, *(self.variation_db[dipole] for dipole in DIPOLES), self.error_db)


def measured_curve() -> Path:
    """The shipped LST variation of the LOFAR low band, as a file that `read_lst_curve` reads."""
    return Path(str(SHIPPED / "measured_lst_variation.csv"))


def read_lst_curve(path: Path) -> LstCurve:
    """Read an LST curve, naming the line of whatever is wrong."""
    place = path.name
    numbered = [(k, line) for k, line in enumerate(read_text(path).splitlines(), start=1) if line.strip()]
    is_centre_stated = any(line.strip().lower() == CENTRE_LINE for _, line in numbered)
    numbered = [(k, line) for k, line in numbered if not line.lstrip().startswith("#")]
    if not numbered:
        raise UnreadableFileError(f"{path}: expected the columns {', '.join(COLUMNS)}, found an empty file")
    header = [name.strip() for name in next(csv.reader([numbered[0][1]]))]
    require_parts(place, "columns", COLUMNS, header)
    rows = [_parse_row(header, line, f"{place}: line {k}") for k, line in numbered[1:]]
    if not rows:
        raise BadInputError(place, "at least one row below the header", "none")
    table = dict(zip(COLUMNS, np.array(rows).T, strict=True))
    lst = table["lst_h"]
    order = np.argsort(lst, kind="stable")
    twice = order[1:][np.diff(lst[order]) == 0]
    if twice.size:
        raise BadInputError(
            f"{place}: line {numbered[1 + int(twice[0])][0]}", "one row an LST", f"{lst[twice[0]]:g} twice"
        )
    bin_hours = float(np.median(np.diff(lst[order]))) if lst.size > 1 else 0.0
    return LstCurve(
        lst_hours=lst if is_centre_stated else (lst + bin_hours / 2) % 24.0,
        variation_db={"X": table["x_db"], "Y": table["y_db"]},
        error_db=table["error_db"],
        bin_hours=bin_hours,
        is_centre_stated=is_centre_stated,
        origin=place,
    )


def _parse_row(header: list[str], line: str, place: str) -> list[float]:
    cells = next(csv.reader([line]))
    if len(cells) != len(header):
        raise BadInputError(place, f"{len(header)} cells as in the header", f"{len(cells)}")
    row = dict(zip(header, cells, strict=True))
    values = {name: parse_cell(row[name], f"{place}: {name}") for name in COLUMNS}
    if not 0 <= values["lst_h"] < 24:
        raise BadInputError(f"{place}: lst_h", "hours from 0 to 24", row["lst_h"].strip() or "an empty cell")
    if not (math.isnan(values["x_db"]) and math.isnan(values["y_db"])) and not values["error_db"] > 0:
        raise BadInputError(f"{place}: error_db", "dB > 0 beside a point", row["error_db"].strip() or "an empty cell")
    return [values[name] for name in COLUMNS]


# The noise of the points of an LST curve, from their scatter about a smooth curve: smaller than drawn bars may be.

SMOOTH_HARMONICS = 6
"""Harmonics of the smooth curve whose residuals estimate the noise of the points: the sky has fewer (|m| <= 4)."""
FEWEST_FREE = 5
"""Degrees of freedom below which a point noise is not worth stating (32 % uncertain)."""
LARGEST_CORRELATION = 0.99
"""Beyond, the difference of the dipoles would count as nearly free of noise because of a few points."""


@dataclass(frozen=True)
class PointNoise:
    """Noise of the points of both dipoles.

    The mean of an LST bin is over the same events for both dipoles, whose common gain fluctuates: what they share
    leaves their difference more precise than either.

    Attributes
    ----------
    sigma_db
        By dipole, dB.
    correlation
        Between the dipoles at one LST.
    free
        Degrees of freedom from which the level is known.
    """

    sigma_db: dict[str, float]
    correlation: float
    free: int

    def covariance(self, curve: LstCurve) -> Floats:
        """Covariance of the points, X then Y, those that exist; dB^2, shape (point, point)."""
        place = [np.flatnonzero(curve.has_point(dipole)) for dipole in DIPOLES]
        sigma = np.concatenate([np.full(at.size, self.sigma_db[d]) for d, at in zip(DIPOLES, place, strict=True)])
        index = np.concatenate(place)
        shared = np.where(index[:, None] == index[None, :], self.correlation, 0.0)
        np.fill_diagonal(shared, 1.0)
        return np.asarray(sigma[:, None] * shared * sigma[None, :])


def estimate_noise(curve: LstCurve, harmonics: int = SMOOTH_HARMONICS) -> PointNoise:
    """Estimate the noise of both dipoles and what they share."""
    left, free = zip(*(_about_smooth(curve, dipole, harmonics) for dipole in DIPOLES), strict=True)
    if min(free) < FEWEST_FREE:
        needed = f"{1 + 2 * harmonics + FEWEST_FREE} points or more a dipole to estimate their noise"
        raise BadInputError(curve.origin, needed, f"{min(free) + 1 + 2 * harmonics}")
    x, y = (one[np.isfinite(left).all(axis=0)] for one in left)
    correlation = float(x @ y / np.sqrt((x @ x) * (y @ y)))
    limited = float(np.clip(correlation, -LARGEST_CORRELATION, LARGEST_CORRELATION))
    return PointNoise(dict(zip(DIPOLES, map(_scatter, left, free), strict=True)), limited, sum(free))


def estimate_point_noise(curve: LstCurve, dipole: str) -> float | None:
    """Scatter of the points of one dipole about a smooth curve, dB; None with too few points."""
    left, free = _about_smooth(curve, dipole, SMOOTH_HARMONICS)
    return None if free < FEWEST_FREE else _scatter(left, free)


def _about_smooth(curve: LstCurve, dipole: str, harmonics: int) -> tuple[Floats, int]:
    """Measured minus the Fourier series that fits best, shape (point,), NaN without a point; and degrees of freedom."""
    has_point = curve.has_point(dipole)
    design = harmonics_at(curve.lst_hours[has_point], harmonics)
    measured = curve.variation_db[dipole][has_point]
    left = np.full(curve.lst_hours.shape, np.nan)
    left[has_point] = measured - design @ fit_least_squares(design, measured)
    return left, len(design) - design.shape[1]


def _scatter(left: Floats, free: int) -> float:
    return float(np.sqrt(np.nansum(left**2) / free))


# Measured LST curve against simulated sky power, with nothing fitted but a noise share and an offset a dipole.

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
        """Root mean square of the residuals, dB."""
        return float(np.sqrt(np.nanmean(self.residual_db**2)))

    def as_dict(self) -> dict[str, Any]:
        """Describe the comparison as JSON values."""
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
        """Find the comparison of one dipole, ``X`` or ``Y``, with one of `WEIGHTS`, and with or without noise."""
        wanted = (dipole, has_noise, weights)
        return next(one for one in self.dipoles if (one.dipole, one.has_noise, one.weights) == wanted)

    def as_dict(self) -> dict[str, Any]:
        """Describe the content of the report as JSON values."""
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
            inputs={"lst_curve": curve.digest(), "sky_power": sky_power.digest(), "instrument": instrument.digest()},
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
    """Total power in dB over its mean over LST, same shape, where a constant share of that mean is noise."""
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
    """The published noise of an instrument as a prior; None for any but the Superterp.

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
