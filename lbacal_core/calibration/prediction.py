"""What a path should record at an instant, how well that is known, and how single events scatter about it.

The expectation is P = s (P_sky(t) + N) with all noise N referred to the start of the chain, s = G_ant / C^2
(eq. full_chain of Mulrey et al. 2019). A fit knows the mean recorded power far better than C: what the sky is given too
much, the electronics get too little. With the mean P_sky over the sidereal day as the pivot,

    d ln P = -2 d ln C s (P_sky(t) - mean P_sky) / P

for every error of C that the noise of the data makes. A sky that is wrong by dP_sky(t) moves s and N of the fit as far
as dP_sky is a straight line in P_sky; what is left, dP_sky less that line, is wrong in P. A gain that one path has
beside its reference chain moves all that is in front of it: d ln P = -2 d ln C s (P_sky + N_front) / P. An error of
the size of an adopted cause moves what the cause does at the instant.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.one_event import compare_paths
from lbacal_core.calibration.singles import MIN_EVENTS
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import CONVERGED, CalibrationCurve, Parameter, statistical_errors, systematic_errors
from lbacal_core.data.tables import read_prior
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, guess_widths
from lbacal_core.instrument.chain import ChainTerms
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.matching import RESISTANCE_OHM, power_per_kelvin_sr
from lbacal_core.provenance import as_json
from lbacal_core.simulation.simulation import Simulation, noise_at_input, noise_of, terms_of
from lbacal_core.sky.antenna_of import antenna_of
from lbacal_core.sky.sources import point_source_power, response_towards
from lbacal_core.sky.table import read_at
from lbacal_core.spectra.blocks import iterate_blocks
from lbacal_core.spectra.spectra import Spectra
from lbacal_core.traces.trace import BLOCK_SAMPLES

BLOCK_US = BLOCK_SAMPLES / 200.0
"""Duration of a block at 200 MHz, microseconds."""
RINGS, SPOKES = 48, 64
"""Directions over which a pattern is integrated; the patterns that ship vary by less than six waves over the sky."""
SMALLEST_SHARE = 1e-9
"""Share of the power from which it is said that causes add noise, or take it."""
FEWEST_TO_COMPARE = 2
NOT_SHARED = "paths share the gain of an event; the little of the sky's own noise that they share is not in it"


@dataclass(frozen=True)
class EventNoise:
    """How the recorded power of single events scatters, as a fraction of the expectation.

    Attributes
    ----------
    shared
        What an event shares along frequency, shape (vector, freq): one standard deviation each, independent.
    own
        Variance of each channel by itself, shape (freq,).
    source
        Where they come from, in words.
    common
        Share of the variance along the first shared vector, the gain of an event, that all paths of the station have in
        common.
    """

    shared: Floats
    own: Floats
    source: str
    common: float = 0.0

    @classmethod
    def expected(cls, frequency_mhz: Floats, blocks: int = 100) -> EventNoise:
        """The published gain of an event, and the radiometer equation: variance 1 / (width x duration)."""
        own, gain, common = (
            1.0 / (guess_widths(frequency_mhz) * blocks * BLOCK_US),
            *(read_prior()[name].size for name in ("path_gain", "event_gain")),
        )
        said = f"gain of an event {gain:.0%} as published for LOFAR; radiometer equation for {blocks} blocks"
        return cls(np.full((1, frequency_mhz.size), gain), own, said, (common / gain) ** 2)

    @classmethod
    def measured(
        cls, curve: CalibrationCurve, spectra: Spectra, simulation: Simulation, others: Sequence[CalibrationCurve] = ()
    ) -> EventNoise | None:
        """The noise of the events that a path's curve was fitted to; None for fewer than a fit needs.

        Parameters
        ----------
        others
            Curves of other paths, by which is known what those of the station and dipole have in common.
        """
        beside = [
            one for one in others if one.antenna not in (None, curve.antenna) and one.path[::2] == curve.path[::2]
        ]
        for block in iterate_blocks(spectra):
            if (block.station, block.dipole) != (curve.station, curve.dipole):
                continue
            found = {
                int(block.antennas[row]): (row, ratio) for row, _, ratio in compare_paths(block, [curve], simulation)
            }
            row, ratio = found.get(int(str(curve.antenna)), (-1, np.zeros((0, 0))))
            if len(ratio) < MIN_EVENTS:
                return None
            at = curve.has_value
            shared, own = _split(np.cov(ratio[:, at], rowvar=False), len(ratio))
            noise = cls(shared, own, f"measured in {len(ratio)} events of this path")
            known = [one for one in compare_paths(block, beside, simulation) if np.all(one[1].has_value[at])]
            events = [(block.is_present[row], ratio[:, at]), *((block.is_present[k], r[:, at]) for k, _, r in known)]
            return replace(noise, common=noise._share_with_others(events))
        return None

    def _share_with_others(self, events: Sequence[tuple[NDArray[np.bool_], Floats]]) -> float:
        """Mean correlation of the gains of events in one path, the first, with those in others.

        Parameters
        ----------
        events
            Which events a path has, shape (event,), and measured over predicted power in them.
        """
        if not len(self.shared) or len(events) < FEWEST_TO_COMPARE:
            return 0.0
        weight = self.shared[0] / np.sum(self.shared[0] ** 2)
        gain = np.full((len(events), events[0][0].size), np.nan)
        for row, (is_present, ratio) in zip(gain, events, strict=True):
            row[is_present] = (ratio - ratio.mean(axis=0)) @ weight
        both = np.isfinite(gain) & np.isfinite(gain[0])
        # the noise of channels is another in every path: it is in the variances alone
        variance = np.nanvar(gain, axis=1) - np.sum(weight**2 * self.own)
        across = np.sum(np.where(both, gain * gain[0], 0.0), axis=1)[1:] / np.maximum(both.sum(axis=1)[1:], 1)
        is_known = variance[1:] > 0
        if not np.any(is_known) or not variance[0] > 0:
            return 0.0
        correlation = across[is_known] / np.sqrt(variance[1:][is_known] * variance[0])
        return float(np.clip(correlation.mean(), 0.0, 1.0))

    def covariance(self) -> Floats:
        """Relative covariance, shape (freq, freq)."""
        return np.asarray(self.shared.T @ self.shared + np.diag(self.own))

    def draw(self, count: int, rng: np.random.Generator, of_station: Floats | None = None) -> Floats:
        """Factors of mean 1 on the expected power of single events, shape (event, freq).

        The average of n independent samples of noise power follows a gamma distribution of shape n.

        Parameters
        ----------
        of_station
            Standard normal numbers that the paths of a station have in common, shape (event,); None for a path alone.
        """
        own, gain = np.maximum(self.own, 1e-12), self.draw_gains(count, rng, of_station)
        return np.asarray(gain * rng.standard_gamma(1.0 / own, (count, own.size)) * own)

    def draw_gains(self, count: int, rng: np.random.Generator, of_station: Floats | None = None) -> Floats:
        """Draw factors of mean 1 that channels of an event share, as `draw`, (event, freq); a trace has the rest."""
        amount = rng.standard_normal((count, len(self.shared)))
        if of_station is not None and len(self.shared):
            amount[:, 0] = self.common**0.5 * of_station + (1.0 - self.common) ** 0.5 * amount[:, 0]
        return np.asarray(1.0 + amount @ self.shared)


def _split(covariance: Floats, events: int) -> tuple[Floats, Floats]:
    """A covariance as what channels share, shape (vector, freq), and what each has by itself, shape (freq,).

    An axis is kept where its variance is beyond the largest that independent noise of so many events makes,
    (1 + (channels / events)^1/2)^2 times the typical one (Marchenko & Pastur 1967, Math. USSR Sb. 1, 457).
    """
    size, axes = np.linalg.eigh(covariance)
    typical = float(np.median(size))
    kept = size > typical * (1.0 + (size.size / events) ** 0.5) ** 2
    shared = np.sqrt(size[kept] - typical)[:, None] * axes[:, kept].T
    shared *= np.where(shared.sum(axis=1) < 0, -1.0, 1.0)[:, None]  # more power is more gain in every path
    return shared[::-1], np.maximum(np.diag(covariance) - np.sum(shared**2, axis=0), 0.0)


@dataclass(frozen=True)
class Acting:
    """The chain of a path at an instant with its adopted causes (`discovery.forward`).

    Attributes
    ----------
    terms
        The chain with them, shape (freq,) each.
    moved
        The same with one size after the other moved by its standard deviation.
    notes
        What acts, and what was not known of the instant, a sentence each.
    """

    terms: ChainTerms
    moved: Sequence[ChainTerms] = ()
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Prediction:
    """The expectation of one path at one instant, on the channels in which C is known.

    Attributes
    ----------
    power
        Shape (freq,): ADC^2/Ohm/MHz; W/MHz in front of the converter where there is no calibration.
    errors
        Independent errors of ln power, one standard deviation each, shape (error, freq).
    contributions
        What the power is made of, each referred to the start of the chain in the unit of P_sky, shape (freq,).
    per_kelvin
        P_sky of an isotropic sky of 1 K, shape (freq,); None where the antenna model is not known.
    sefd_error
        Standard deviation of ln SEFD, shape (freq,).
    notes
        What is not in it, a sentence each.
    """

    name: Mapping[str, Any]
    lst_hours: float
    frequency_mhz: Floats
    power: Floats
    errors: Floats
    contributions: Mapping[str, Floats]
    per_kelvin: Floats | None
    sefd_error: Floats
    noise: EventNoise
    is_calibrated: bool
    notes: Sequence[str]

    def covariance(self) -> Floats:
        """Covariance of the expected power, shape (freq, freq): how well it is known, without the noise of an event."""
        return np.asarray(self.errors.T @ self.errors * np.outer(self.power, self.power))

    @property
    def sefd_jy(self) -> Floats:
        """Flux of an unpolarised source at the zenith (D = 1) that doubles the power of this dipole, shape (freq,), Jy.

        All noise and sky referred to the start of the chain, over what 1 Jy adds to P_sky (`point_source_power`).
        """
        one = np.ones(self.power.size)
        return np.asarray(np.sum(list(self.contributions.values()), axis=0) / point_source_power(one, one))

    def describe_adc(self) -> dict[str, Any]:
        """Root mean square of the samples by the power in the channels: sum of power x width x R_r (Parseval).

        `rms` and its `sigma` relative to it; `band_mhz` is the first and the last channel.
        """
        part = self.power * guess_widths(self.frequency_mhz) * RESISTANCE_OHM
        rms = float(part.sum()) ** 0.5
        moved = np.concatenate([self.errors @ part, self.noise.shared @ part, np.sqrt(self.noise.own) * part])
        band = self.frequency_mhz[[0, -1]].tolist()
        return {"rms": rms, "sigma": float(np.linalg.norm(moved) / (2.0 * rms)), "band_mhz": band}

    def as_dict(self) -> dict[str, Any]:
        """The content of `GET /v1/predictions`, but for the instant."""
        total = np.sum(list(self.contributions.values()), axis=0)
        kelvin = self.per_kelvin
        return {
            **self.name,
            "lst_h": self.lst_hours,
            "frequency_mhz": self.frequency_mhz.tolist(),
            "power": self.power.tolist(),
            "power_unit": "ADC^2/Ohm/MHz" if self.is_calibrated else "W/MHz",
            "covariance": self.covariance().tolist(),
            "contributions": {
                name: {"kelvin": None if kelvin is None else (p / kelvin).tolist(), "fraction": (p / total).tolist()}
                for name, p in self.contributions.items()
            },
            "adc": self.describe_adc() if self.is_calibrated else None,
            "sefd_jy": self.sefd_jy.tolist(),
            "sefd_sigma": (self.sefd_jy * self.sefd_error).tolist(),
            "noise": as_json(self.noise),
            "notes": [*self.notes, NOT_SHARED],
        }


def predict_path(
    curve: CalibrationCurve,
    simulation: Simulation,
    time_unix: float,
    noise: EventNoise | None = None,
    budget: Budget | None = None,
    acting: Acting | None = None,
    *,
    is_own: bool = True,
    is_calibrated: bool = True,
) -> Prediction:
    """Predict the record of a path at an instant; with adopted causes use `discovery.forward.predict`.

    Parameters
    ----------
    noise
        How its events scatter; as published, averaged over 100 blocks, unless given.
    budget
        The systematic terms that the curve's covariance names.
    acting
        What adopted causes make of its chain then; None where there are none.
    is_own
        Whether the curve was fitted to the path itself, and is not that of its station or of the array.
    is_calibrated
        Whether it was fitted at all. A curve of `curve_alone` was not: its power is W/MHz at the converter's input,
        whose error is that of the sky and of the sizes of adopted causes.
    """
    if curve.c is None or curve.dipole is None:
        raise BadInputError(curve.name, "a curve of one polarisation that converged", curve.status)
    at, instrument, table = curve.has_value, simulation.instrument, simulation.sky_power.of_station(curve.station)
    lst = simulation.sidereal_time(curve.station, np.array([time_unix]))
    plain = terms_of(curve, instrument, table.at(curve.dipole, lst)[0])
    acting = Acting(plain) if acting is None else acting
    chain, of_chain, notes = acting.terms, noise_of(curve, instrument), [*acting.notes]
    power, sky = chain.power()[at], chain.sky[at]
    total = power / chain.front[at]
    contributions = {"sky": sky, **{name: one[at] for name, one in noise_at_input(curve, instrument).items()}}
    behind = [name.removeprefix("n_") for name in of_chain.names[len(of_chain.front) :]]
    contributions |= {name: contributions[name] * (plain.front / chain.front)[at] for name in behind}
    if not is_calibrated:
        contributions = {"sky": sky, "known_noise": plain.n_lna[at]}
        is_known = np.append(simulation.noise.precision > 0, np.zeros(len(simulation.noise.behind), dtype=bool))
        free = ", ".join(np.array(simulation.noise.names)[~is_known])
        notes += [f"noise that only data determine is not in it: {free}"] if free else []
    rest = total - np.sum(list(contributions.values()), axis=0)
    if np.any(np.abs(rest) > SMALLEST_SHARE * total):
        contributions["causes"] = rest
    # what an error of ln C moves: the sky about its mean, or all that one gain in front multiplies
    about, in_front = sky - table.power[curve.dipole].mean(axis=0)[at], (chain.sky + chain.n_lna)[at]
    by_noise = [error[at] * about for error in statistical_errors(curve)]
    own: Sequence[Floats] = [] if curve.covariance is None else [*np.nan_to_num(curve.covariance.own[:, at])]
    by_gain = [error * (about if is_own else in_front) for error in own]
    by_sky = [-0.5 * error[at] for error in _sky_errors(curve, simulation, lst, is_fitted=is_calibrated)]
    by_size = [(one.power()[at] / power, one.front[at] / chain.front[at]) for one in acting.moved]
    # SEFD goes with C^2/G_ant, in which the antenna gain cancels
    of_gain = None if budget is None else replace(budget, terms=[one for one in budget.terms if not one.is_of_gain])
    of_c = [2.0 * error[at] for error in (*statistical_errors(curve), *systematic_errors(curve, of_gain))]
    of_c = of_c if is_calibrated else [2.0 * one / total for one in by_sky]
    of_power = [*(-2.0 * one / total for one in (*by_noise, *by_gain, *by_sky)), *(np.log(p) for p, _ in by_size)]
    of_sefd = [*of_c, *(np.log(p / s) for p, s in by_size)]
    kelvin = _per_kelvin(simulation, curve.dipole)
    return Prediction(
        name={"station": curve.station, "antenna": curve.antenna, "dipole": curve.dipole},
        lst_hours=float(lst[0]),
        frequency_mhz=curve.frequency_mhz[at],
        power=power,
        errors=np.reshape(of_power, (-1, sky.size)),
        contributions=contributions,
        per_kelvin=None if kelvin is None else kelvin[at],
        sefd_error=np.linalg.norm(np.reshape(of_sefd, (-1, sky.size)), axis=0),
        noise=noise or EventNoise.expected(curve.frequency_mhz[at]),
        is_calibrated=is_calibrated,
        notes=notes,
    )


def curve_alone(simulation: Simulation, station: str, antenna: int, dipole: str, time_unix: float) -> CalibrationCurve:
    """The curve of a path that nobody has calibrated: A(nu) S = 1, and only the noise that the instrument states."""
    instrument, noise = simulation.instrument, simulation.noise
    instrument.require_dipoles(np.array([dipole]), "prediction")
    loss = instrument.cables[instrument.cable_of(station, antenna, time_unix)]
    stated = np.append(np.where(noise.precision > 0, noise.mean, 0.0), np.zeros(len(noise.behind)))
    return CalibrationCurve(
        station, antenna, dipole, CONVERGED, 0, instrument.frequency_mhz, (loss * instrument.receiver_gain) ** -0.5,
        None, None, None, 0.0, {name: Parameter(float(n), 0.0) for name, n in zip(noise.names, stated, strict=True)},
    )  # fmt: skip


def _sky_errors(
    curve: CalibrationCurve, simulation: Simulation, lst_hours: Floats, *, is_fitted: bool
) -> Iterator[Floats]:
    """For each term of the sky dP_sky(t), or what of it is no straight line in P_sky, which a fit takes up.

    Shape (freq,), in the unit of P_sky.
    """
    dipole, table = str(curve.dipole), simulation.sky_power.of_station(curve.station)

    def list_errors() -> list[tuple[Floats, float]]:
        found = []
        for term in simulation.changes():
            sky = table.at(dipole, term.lst_hours)
            wrong, about = sky * term.d_ln_p[dipole], sky - sky.mean(axis=0)
            line = np.sum(about * wrong, axis=0) / np.maximum(np.sum(about**2, axis=0), np.finfo(float).tiny)
            taken = wrong.mean(axis=0) + line * about if is_fitted else 0.0
            found.append((wrong - taken, float(term.lst_hours[0])))
        return found

    for error, first in simulation.made.get(("sky errors", curve.station, dipole, is_fitted), list_errors):
        yield read_at(error, lst_hours - first)[0]


def _per_kelvin(simulation: Simulation, dipole: str) -> Floats | None:
    def integrate() -> Floats | None:
        try:
            return power_per_kelvin(simulation.instrument, dipole)
        except BadInputError:  # nobody says how the antenna sees: P_sky was given
            return None

    found: Floats | None = simulation.made.get(("per kelvin", dipole), integrate)
    return found


def power_per_kelvin(instrument: Instrument, dipole: str) -> Floats:
    """P_sky of an isotropic sky of 1 K, shape (freq,): eq. total_sky_power_eq with the integral of D over the sky."""
    x, weight = np.polynomial.legendre.leggauss(RINGS)
    zenith, azimuth = np.arccos((x + 1.0) / 2.0), 2.0 * np.pi * np.arange(SPOKES) / SPOKES
    towards = np.meshgrid(zenith, azimuth, indexing="ij")
    response = response_towards(instrument, dipole, *towards, antenna_of(instrument))
    return np.asarray(power_per_kelvin_sr(instrument.frequency_mhz) * (np.pi * weight @ response.mean(axis=1)))
