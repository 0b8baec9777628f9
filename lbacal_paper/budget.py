"""The terms of Table 1 of the paper, and those of today's budgets, each by full refits, none quoted.

A term is the change of ln C when one input of the fit is exchanged and everything else stays, the data included.
The refit decides what the noise terms take over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lbacal_core.calibration import budget as uncertainty
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves import covariance
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_prior
from lbacal_core.grids import Floats
from lbacal_core.simulation.prior import PAPER_BUDGET, PATTERN
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.differences import ZENITH_GAIN
from lbacal_core.sky.names import DEFAULT_SKY, MEASURED_SKY, list_skies, load_sky
from lbacal_core.sky.power import compute_sky_power, vary_sky_power
from lbacal_core.sky.sky_terms import PAPER
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_paper.study import SEED, STATION, Study
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

TIED = "measured"
TODAY = ("models", TIED)
"""Where today's budgets take the error of the sky from: the spread of sky models, or absolute measurements."""
EDGE_MHZ = 77.0
"""Above, the pass band falls so steeply that the paper gives electronics a term of its own."""
REALISATIONS = 3
"""Simulated years over which a change of C is averaged where single years scatter by a tenth of it."""
MEASURED = "sky tied to absolute measurements"
"""The change of C, not an uncertainty: the default sky is fainter than what absolutely calibrated experiments see."""
OTHER_SKY = "sky model "
"""Followed by the name of another sky model that ships: the change of C that the exchange makes."""
STATIC_INDEX = 0.1
"""A change of the sky's spectral index, to show what a tilt does."""


@dataclass(frozen=True)
class Budget:
    """Systematic changes of ln C, shape (freq,) for each polarisation, one standard deviation each.

    Attributes
    ----------
    terms
        Those of Table 1, and what else is exchanged to see what it does.
    sky_fraction
        Uncertainty of the sky's power in Table 1.
    today
        What `lbacal budget` says of the mean path of this simulated year, by where the error of the sky comes from.
    """

    frequency_mhz: Floats
    terms: Mapping[str, Mapping[str, Floats]]
    sky_fraction: float
    today: Mapping[str, covariance.Budget]

    def below_edge(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Channels below the edge of the pass band."""
        return np.asarray(self.frequency_mhz <= EDGE_MHZ)

    def largest(self, name: str, *, is_above: bool = False) -> float:
        """The largest |d ln C| of a term below (or above) the edge, both polarisations."""
        chosen = ~self.below_edge() if is_above else self.below_edge()
        return float(max(np.abs(values[chosen]).max() for values in self.terms[name].values()))

    def typical(self, name: str) -> float:
        """The root mean square of a term below the edge."""
        values = np.concatenate([np.abs(one[self.below_edge()]) for one in self.terms[name].values()])
        return float(np.sqrt(np.mean(values**2)))

    def total(self, dipole: str) -> Floats:
        """Table 1's total: sky, antenna and electronics in quadrature, shape (freq,)."""
        parts = [self.terms[name][dipole] for name in ("sky", "antenna", "electronics")]
        return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)))


def compute_budget(study: Study) -> Budget:
    """Refit one station with every exchange of Table 1, and measure the spread of the single antennas."""
    spectra = study.campaign.spectra
    station = spectra.select(np.flatnonzero(spectra.station == STATION))
    instrument, sky_power = study.instrument, study.sky_power

    def log_c(power: SkyPower) -> dict[str, Floats]:
        return _log_c(station, study, power)

    def change(power: SkyPower) -> dict[str, Floats]:
        """Difference to the default."""
        exchanged = log_c(power)
        return {dipole: exchanged[dipole] - base[dipole] for dipole in DIPOLES}

    base = log_c(sky_power)
    systematic = uncertainty.compute_budget(station, study.simulation, PAPER_BUDGET)

    of_sky = [term for term in systematic.terms if term.name in PAPER.values()]
    (pattern,) = [term for term in systematic.terms if term.name == PATTERN]
    zenith = {sign: vary_sky_power(instrument, zenith_gain_fraction=sign * ZENITH_GAIN) for sign in (-1, 1)}
    tilted = load_sky(DEFAULT_SKY).changed(spectral_index=STATIC_INDEX)
    terms = {
        "sky": {p: np.sqrt(np.sum([term.variance(p) for term in of_sky], axis=0)) for p in DIPOLES},
        "antenna": {p: pattern.vectors[p][0] for p in DIPOLES},
        "antenna, bins weighted alike": _without_event_gain(study, zenith[1], zenith[-1]),
        "index of the sky": change(compute_sky_power(instrument, tilted)),
        "electronics": measure_electronics(study),
        MEASURED: change(compute_sky_power(instrument, MEASURED_SKY)),
        **{
            f"{OTHER_SKY}{name}": change(compute_sky_power(instrument, name))
            for name in list_skies()
            if name != DEFAULT_SKY
        },
    }
    fraction = float(np.sqrt(sum(read_prior()[row].size ** 2 for row in PAPER)))
    today = {name: uncertainty.compute_budget(study.campaign.spectra, study.simulation, name) for name in TODAY}
    return Budget(study.frequency_mhz, terms, fraction, today)


def _log_c(spectra: Spectra, study: Study, power: SkyPower) -> dict[str, Floats]:
    report = fit_calibration(spectra, Simulation(study.instrument, power), "station")
    return {str(curve.dipole): np.log(np.asarray(curve.c)) for curve in report.curves if curve.c is not None}


def _without_event_gain(study: Study, higher: SkyPower, lower: SkyPower) -> dict[str, Floats]:
    """Half the difference of ln C between two skies on a station-year whose power scatters by radiometer noise alone.

    Bins of LST that average many events are fitted by the paper as if their channels were independent; the weights of
    such data are those of spectra without a gain common to all channels.
    """
    settings = TwinSettings(stations=(STATION,), event_gain_common=0.0, event_gain_path=0.0)
    changes = []
    for seed in range(SEED, SEED + REALISATIONS):
        campaign = simulate_campaign(settings, study.instrument, study.sky_power, np.random.default_rng(seed))
        up, down = (_log_c(campaign.spectra, study, power) for power in (higher, lower))
        changes.append([0.5 * (up[dipole] - down[dipole]) for dipole in DIPOLES])
    return dict(zip(DIPOLES, np.mean(changes, axis=0), strict=True))


def measure_electronics(study: Study) -> dict[str, Floats]:
    """Standard deviation of ln C between a station's paths, each through its own cable, shape (freq,) a polarisation.

    The statistical error of the single curves is taken out; what is left is what one curve for all antennas misses. The
    mean of each station is taken out too: the simulation ties it to the mix of cables of that station.
    """
    spread = {}
    for dipole in DIPOLES:
        fitted = [one for one in study.paths.curves if one.dipole == dipole and has_every_channel(one)]
        log_c = np.array([np.log(np.asarray(one.c)) + 0.5 * np.log(_loss(study, one)) for one in fitted])
        station = np.array([one.station for one in fitted])
        names = sorted(set(station))
        for name in names:
            log_c[station == name] -= log_c[station == name].mean(axis=0)
        noise = np.array([np.asarray(one.c_sigma_stat) / np.asarray(one.c) for one in fitted])
        spread[dipole] = np.sqrt(
            np.maximum(np.sum(log_c**2, axis=0) / (len(fitted) - len(names)) - np.mean(noise**2, axis=0), 0.0)
        )
    return spread


def has_every_channel(curve: CalibrationCurve) -> bool:
    """Whether a curve has a value in every channel: spreads are those of the same paths everywhere."""
    return curve.c is not None and bool(np.all(curve.has_value))


def spread_with_cables(study: Study, dipole: str) -> Floats:
    """Standard deviation of ln C between single paths with their cables left in, shape (freq,)."""
    fitted = [one for one in study.paths.curves if one.dipole == dipole and has_every_channel(one)]
    log_c = [np.log(np.asarray(one.c)) for one in fitted]
    return np.asarray(np.std(log_c, axis=0, ddof=1))


def _loss(study: Study, curve: object) -> Floats:
    station, antenna = str(getattr(curve, "station", "")), int(getattr(curve, "antenna", 0) or 0)
    first = float(study.campaign.spectra.time_unix[0])
    return np.asarray(study.instrument.cables[study.instrument.cable_of(station, antenna, first)])
