"""Calibration curves C(nu), the report of a fit, and their files (docs/formats/fit-report.md)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.curves.covariance import Budget, CurveCovariance, parse_covariance
from lbacal_core.curves.kept_lines import KeptLines
from lbacal_core.curves.reference_chain import ReferenceChain
from lbacal_core.errors import name_path
from lbacal_core.grids import Floats
from lbacal_core.provenance import Provenance, as_json, hash_arrays, with_arrays

# Spectra whose power is anomalous, as they are named to people: in reports, on pages and by the gate.

MOST_NAMED = 100
"""A summary names this many spectra and counts the others."""


@dataclass(frozen=True)
class Anomaly:
    """One spectrum that is off, by which factor, and what became of it.

    Attributes
    ----------
    factor
        Recorded power over the path's usual power at that LST.
    frequency_mhz
        The channel that is off, where it is not the whole band.
    kept
        Why it is fitted nevertheless; None where it is left out.
    """

    event_id: str
    station: str
    antenna: int
    dipole: str
    factor: float
    frequency_mhz: float | None = None
    kept: str | None = None

    @property
    def path(self) -> str:
        """The path as scopes are written: ``CS002/17/X``."""
        return f"{self.station}/{self.antenna}/{self.dipole}"

    @property
    def reason(self) -> str:
        """The anomaly in words."""
        where = "" if self.frequency_mhz is None else f" at {self.frequency_mhz:g} MHz"
        return f"power {self.factor:.3g} times the usual{where}" + (f"; fitted: {self.kept}" if self.kept else "")

    @property
    def departure(self) -> float:
        """The size of the logarithm of the factor."""
        return abs(math.log(self.factor))

    def as_dict(self) -> dict[str, Any]:
        """Describe the anomaly as JSON values, its fields and the `reason` in words."""
        return {**vars(self), "reason": self.reason}


@dataclass(frozen=True)
class Anomalies:
    """How many anomalous spectra were left out of a fit and how many were fitted, and the worst of both."""

    left_out: int
    fitted: int
    worst: Sequence[Anomaly]

    @classmethod
    def of(cls, found: Iterable[Anomaly]) -> Anomalies:
        """Summarise what was found."""
        ranked = sorted(found, key=lambda one: (-one.departure, one.event_id, one.path))
        fitted = sum(one.kept is not None for one in ranked)
        return cls(len(ranked) - fitted, fitted, tuple(ranked[:MOST_NAMED]))

    def as_dict(self) -> dict[str, Any]:
        """Describe the anomalies as JSON values: `left_out`, `fitted` and `worst`."""
        return {"left_out": self.left_out, "fitted": self.fitted, "worst": [one.as_dict() for one in self.worst]}

    def name_worst(self, count: int) -> str:
        """The worst few in words; empty where there are none."""
        return ", ".join(f"{one.event_id} of {one.path} ({one.reason})" for one in self.worst[:count])


NONE = Anomalies(0, 0, ())


def parse_anomalies(content: Mapping[str, Any]) -> Anomalies:
    """Make a summary from its JSON values."""
    worst = [Anomaly(**{name: one[name] for name in Anomaly.__dataclass_fields__}) for one in content["worst"]]
    return Anomalies(content["left_out"], content["fitted"], tuple(worst))


# The sky through an antenna against its model, where the laboratory knows the receiver: data calibrated in kelvin.
#
# The recorded power is then the temperature behind the antenna, k_B T = P_sky G_ant + noise: C is known, C^2 = k_B per
# MHz, within the error of the laboratory, and the slope tests the product of sky model and G_ant.

WATT_PER_MHZ = 1.380649e-17
"""Noise power of 1 K, W/MHz: k_B, which the SI fixes."""


@dataclass(frozen=True)
class SkyOverModel:
    """How bright the sky is that a path records, over the model's.

    Attributes
    ----------
    ratio
        Measured over modelled P_sky G_ant, shape (freq,); NaN where C is not determined.
    sigma_stat
        Standard deviation by the noise of the data, shape (freq,).
    sigma_laboratory
        That by the receiver's calibration, which moves all channels together.
    mean, mean_sigma_stat
        Mean over the channels and its error by the noise.
    c, c_sigma
        C by the laboratory, V per root kelvin, and its error.
    """

    ratio: Floats
    sigma_stat: Floats
    sigma_laboratory: float
    mean: float
    mean_sigma_stat: float
    c: float
    c_sigma: float

    @classmethod
    def of(cls, c: Floats, covariance: Floats, error: float) -> SkyOverModel:
        """The level from a C that was fitted with the model's sky.

        Parameters
        ----------
        c
            Fitted, shape (freq,), NaN where not determined.
        covariance
            Statistical covariance of ln C, shape (freq, freq).
        error
            Error of the receiver's calibration, a fraction of the power.
        """
        known = WATT_PER_MHZ**0.5
        ratio, at = known**2 / c**2, np.isfinite(c)
        # ln s = -2 ln C + const
        of_ratio = 4.0 * covariance * np.outer(ratio, ratio)
        sigma = np.sqrt(np.diag(of_ratio))
        weight = np.where(at, np.where(at, sigma, 1.0) ** -2.0, 0.0)
        weight /= weight.sum()
        some = np.ix_(at, at)
        return cls(
            ratio=ratio,
            sigma_stat=np.where(at, sigma, np.nan),
            sigma_laboratory=error,
            mean=float(weight[at] @ ratio[at]),
            mean_sigma_stat=float(np.sqrt(weight[at] @ of_ratio[some] @ weight[at])),
            c=known,
            c_sigma=known * error / 2.0,
        )

    def __str__(self) -> str:
        """Describe it for a user."""
        return (
            f"the sky through this antenna is {self.mean:.3f} +- {self.mean_sigma_stat:.3f} (noise) +- "
            f"{self.sigma_laboratory * self.mean:.3f} (laboratory) of the model"
        )


CONVERGED = "converged"
MISFIT = "misfit"
NOT_CONVERGED = "not_converged"
TOO_FEW_EVENTS = "too_few_events"
TOO_FEW_LST_BINS = "too_few_lst_bins"
NOT_IDENTIFIABLE = "not_identifiable"
STATUSES = (CONVERGED, MISFIT, NOT_IDENTIFIABLE, NOT_CONVERGED, TOO_FEW_LST_BINS, TOO_FEW_EVENTS)
"""Every way a fit ends, from best to worst."""
WITH_VALUES = (CONVERGED, MISFIT)
"""A misfit converged, but noise and the freedom of sky and pattern cannot explain the data: C and errors are given."""

OK = "ok"
UNCERTAIN = "uncertain"
INTERFERENCE = "interference"
OUTSIDE = "outside"
FLAGS = (OK, UNCERTAIN, INTERFERENCE, OUTSIDE)
"""What a channel of a curve may be; `outside` has no value: it is outside the band in which the data determine C."""


@dataclass(frozen=True)
class Parameter:
    """A fitted number and its standard deviation, in the same unit."""

    value: float
    sigma: float


@dataclass(frozen=True)
class MergedConstants:
    """Noise constants that the data do not tell apart.

    Attributes
    ----------
    constants
        Their names in `CalibrationCurve.parameters`, where each has an error as large as what they add together.
    value, sigma
        What they add together to the recorded power, mean over the channels, ADC^2/Ohm/MHz.
    reason
        One sentence.
    """

    constants: tuple[str, ...]
    value: float
    sigma: float
    reason: str


@dataclass(frozen=True)
class Repeated:
    """How several windows of a path with the same hardware repeat.

    Attributes
    ----------
    windows
        How many one chain was fitted to; 1 where they do not repeat, and each is fitted by itself.
    chi2_per_dof
        The lines of all windows against one chain with a gain for each.
    """

    windows: int
    chi2_per_dof: float


@dataclass(frozen=True)
class CalibrationCurve:
    """The calibration C(nu) of one path, one station or the whole array, or why there is none.

    Attributes
    ----------
    station, antenna, dipole
        What it belongs to: `antenna` is None for a station, `station` too for the array.
    status
        One of `STATUSES`; `c` and its errors are None unless it is `converged` or `misfit`.
    events
        Number of events used.
    c, c_sigma_stat, c_sigma_sys
        Shape (freq,), V per ADC unit (relative where P_sky or G_ant are relative); one standard deviation. NaN in a
        channel whose flag is `outside`.
    chi2_per_dof, chi2_per_dof_profiled
        The chain test with noise alone, and with the sky free within what is known of it (`calibration.chain_test`).
    lst_coverage
        Fraction of the 96 LST bins of 15 minutes that hold an event.
    parameters
        `n_lna` (unit of P_sky), `n_rcu` and `n_adc` (power at the output, ADC^2/Ohm/MHz).
    flag
        One of `FLAGS` for each channel; None where there is no curve, or in one older than flags (all are good).
    antenna_gain
        G_ant that the chain was fitted with, shape (freq,); None where nobody kept it.
    covariance
        Covariance of ln C along frequency; None where nobody kept it.
    merged
        Noise constants that the data do not tell apart; None where there are none.
    sky_over_model
        The sky over its model, where the data are calibrated in kelvin; None elsewhere.
    repeated
        The windows that were fitted together; None where there was one.
    span_unix
        Its first and last event, s UTC; None where nobody kept them.
    """

    station: str | None
    antenna: int | None
    dipole: str | None
    status: str
    events: int
    frequency_mhz: Floats
    c: Floats | None
    c_sigma_stat: Floats | None
    c_sigma_sys: Floats | None
    chi2_per_dof: float | None
    lst_coverage: float
    parameters: Mapping[str, Parameter]
    flag: Sequence[str] | None = None
    antenna_gain: Floats | None = None
    chi2_per_dof_profiled: float | None = None
    covariance: CurveCovariance | None = None
    merged: MergedConstants | None = None
    sky_over_model: SkyOverModel | None = None
    repeated: Repeated | None = None
    span_unix: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.status not in STATUSES:
            raise ValueError(f"status {self.status!r} is not one of {STATUSES}")
        if (self.status in WITH_VALUES) != (self.c is not None):
            raise ValueError("a curve has values exactly when its status is converged or misfit")
        if self.flag is not None and (len(self.flag) != self.frequency_mhz.size or not {*self.flag} <= {*FLAGS}):
            raise ValueError(
                f"flags {self.flag!r} are not one of {FLAGS} for each of {self.frequency_mhz.size} channels"
            )
        if self.antenna_gain is not None and self.antenna_gain.shape != self.frequency_mhz.shape:
            raise ValueError(f"G_ant of {self.antenna_gain.shape} values for {self.frequency_mhz.size} channels")
        for values in (self.c, self.c_sigma_stat, self.c_sigma_sys):
            if values is not None and values.shape != self.frequency_mhz.shape:
                raise ValueError(f"{values.shape} values for {self.frequency_mhz.size} channels")
            if values is not None and not np.array_equal(np.isfinite(values) & (values > 0), self.has_value):
                raise ValueError("C and its errors are finite and positive, exactly where no flag is outside")

    @property
    def flags(self) -> NDArray[np.str_]:
        """The flag of each channel, shape (freq,)."""
        return np.array([OK] * self.frequency_mhz.size if self.flag is None else self.flag)

    @property
    def has_value(self) -> NDArray[np.bool_]:
        """Whether C is known, shape (freq,)."""
        return np.asarray(self.flags != OUTSIDE)

    @property
    def typical_error(self) -> float:
        """Median over the channels of the whole error as a fraction of C; NaN without a C."""
        if self.c is None or self.c_sigma_stat is None:
            return math.nan
        sys = np.zeros_like(self.c) if self.c_sigma_sys is None else self.c_sigma_sys
        return float(np.nanmedian(np.hypot(self.c_sigma_stat, sys) / self.c))

    def filled(self, values: Floats) -> Floats:
        """Values of all channels, shape (freq,); of one without a value, between or beside those that have one."""
        at = self.has_value
        return np.asarray(np.interp(self.frequency_mhz, self.frequency_mhz[at], values[at]))

    @property
    def name(self) -> str:
        """The path, station or array in words: ``CS002 antenna 17 X``."""
        return name_path(self.station, self.antenna, self.dipole)

    @property
    def owner(self) -> tuple[str | None, int | None]:
        """Station and antenna that it belongs to, with all their dipoles; None: all stations, or antennas."""
        return self.station, self.antenna

    @property
    def path(self) -> tuple[str | None, int | None, str]:
        """The path or mean that was fitted: station and antenna (None where it is a mean), and dipole."""
        return self.station, self.antenna, str(self.dipole)

    @property
    def antenna_gain_sha256(self) -> str | None:
        """Hash of G_ant, None where it is unknown: curves with the same one were fitted with the same antenna gain."""
        return None if self.antenna_gain is None else hash_arrays(self.frequency_mhz, self.antenna_gain)

    @property
    def c_over_h(self) -> Floats | None:
        """C/|H_zenith|, shape (freq,), V/m per ADC unit, None without C or G_ant: field along the arm, from the zenith.

        |H_zenith|^2 = G_ant, because G_ant D = |J_theta|^2 + |J_phi|^2 and D = 1 at zenith. With C^2 = G_ant / s it is
        s^-1/2: whatever is wrong with G_ant is not in it.
        """
        if self.c is None or self.antenna_gain is None:
            return None
        return np.asarray(self.c / np.sqrt(self.antenna_gain))

    def as_not_converged(self) -> CalibrationCurve:
        """Return the same curve without values."""
        return replace(
            self, status=NOT_CONVERGED, c=None, c_sigma_stat=None, c_sigma_sys=None, chi2_per_dof=None, parameters={},
            flag=None, chi2_per_dof_profiled=None, covariance=None, sky_over_model=None, repeated=None,
        )  # fmt: skip

    def as_misfit(self) -> CalibrationCurve:
        """The same curve as a misfit: no channel of it is good."""
        return replace(self, status=MISFIT, flag=tuple(np.where(self.flags == OK, UNCERTAIN, self.flags).tolist()))

    def as_dict(self) -> dict[str, Any]:
        """The curve as JSON values; never NaN. What nobody kept is absent: with it a version keeps its hash."""
        content = {name: as_json(one) for name, one in vars(self).items() if one is not None or name in _NULLABLE}
        if self.flag is None:
            content.pop("chi2_per_dof_profiled")
        if self.antenna_gain is not None:
            content |= {"antenna_gain_sha256": self.antenna_gain_sha256, "c_over_h": as_json(self.c_over_h)}
        return content


_NUMBERS = ("frequency_mhz", "c", "c_sigma_stat", "c_sigma_sys", "antenna_gain")
_NULLABLE = ("station", "antenna", "dipole", *_NUMBERS[1:4], "chi2_per_dof", "chi2_per_dof_profiled")
"""Fields that are null where they do not apply; others are then absent."""


_PARSE: Mapping[str, Callable[[Any], Any]] = {
    **dict.fromkeys(_NUMBERS, partial(np.array, dtype=float)),
    **dict.fromkeys(("flag", "span_unix"), tuple),
    "parameters": lambda every: {name: Parameter(one["value"], one["sigma"]) for name, one in every.items()},
    "covariance": parse_covariance,
    "merged": lambda one: MergedConstants(**one | {"constants": tuple(one["constants"])}),
    "sky_over_model": lambda one: SkyOverModel(**with_arrays(one)),
    "repeated": lambda one: Repeated(**one),
}
"""How the fields of a curve that are not JSON values are made of them."""


def parse_curve(content: Mapping[str, Any]) -> CalibrationCurve:
    """Make a curve from its JSON values."""
    told = [one.name for one in fields(CalibrationCurve) if one.name in content or one.default is MISSING]
    given = {name: content[name] for name in told}
    made = {name: _PARSE[name](one) for name, one in given.items() if name in _PARSE and one is not None}
    return CalibrationCurve(**given | made)


@dataclass(frozen=True)
class FitReport:
    """The curves of one fit and where they came from.

    Attributes
    ----------
    chains
        What each curve belongs to, in the order of `curves`; None where there is no curve. Empty where nobody knows.
    anomalies
        Spectra with anomalous power, left out of the fit or not.
    budgets
        The systematic terms that the curves share, by hash.
    causes
        The adopted causes of the model with their sizes, as JSON values; empty for a model without any.
    lines
        With which later events can continue the fit, and other windows be fitted together with it.
    """

    curves: Sequence[CalibrationCurve]
    provenance: Provenance
    chains: Sequence[ReferenceChain | None] = ()
    anomalies: Sequence[Anomaly] = ()
    budgets: Mapping[str, Budget] = field(default_factory=dict)
    causes: Sequence[Mapping[str, Any]] = ()
    lines: Sequence[KeptLines] = ()

    @property
    def status(self) -> str:
        """The worst status of any curve."""
        return max((curve.status for curve in self.curves), key=STATUSES.index)

    def as_dict(self) -> dict[str, Any]:
        """Describe the content of fit.json (docs/formats/fit-report.md)."""
        return {
            "status": self.status,
            "curves": [{**curve.as_dict(), "reference": chain} for curve, chain in self._with_reference()],
            "budgets": {digest: budget.as_dict() for digest, budget in self.budgets.items()},
            "anomalies": Anomalies.of(self.anomalies).as_dict(),
            **({"causes": list(self.causes)} if self.causes else {}),
            "provenance": self.provenance.as_dict(),
        }

    def _with_reference(self) -> Iterator[tuple[CalibrationCurve, dict[str, Any] | None]]:
        """Each curve, and of a mean of paths its reference chain as JSON values."""
        for curve, chain in zip(self.curves, self.chains or [None] * len(self.curves), strict=True):
            yield curve, None if chain is None or curve.antenna is not None else chain.as_dict()


# The errors of a curve, each fully correlated along frequency, independent of each other.

SMALLEST_OWN = 1e-3
"""Share of a channel's variance that it has for itself, below which it is left out."""


def statistical_errors(curve: CalibrationCurve) -> list[Floats]:
    """The errors of ln C that come from the noise of the data, shape (freq,) each."""
    covariance = curve.covariance
    if covariance is None:
        return _whole_error(curve, curve.c_sigma_stat)
    has_own = covariance.diagonal > SMALLEST_OWN * np.sum(covariance.factor**2, axis=0)
    alone = np.diag(np.sqrt(covariance.diagonal))[has_own]
    return [*covariance.factor, *np.where(curve.has_value, alone, np.nan)]


def systematic_errors(curve: CalibrationCurve, budget: Budget | None = None) -> list[Floats]:
    """The errors of ln C that come from the models of the simulation, shape (freq,) each."""
    if curve.covariance is None or budget is None:
        return _whole_error(curve, curve.c_sigma_sys)
    return [*curve.covariance.own, *budget.vectors(str(curve.dipole))]


def _whole_error(curve: CalibrationCurve, sigma: Floats | None) -> list[Floats]:
    return [] if sigma is None or curve.c is None else [np.asarray(sigma / curve.c)]
