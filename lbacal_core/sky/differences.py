"""Differences between sky and antenna models at the site of an instrument: nuisance modes with a Gaussian prior.

Other skies and antennas are exchanged for the default ones, at the instrument's own latitude, arms and channels. An
exchange changes the shape of P_sky along LST and its level at each frequency. Both matter: A(nu) multiplies P_sky and
N_LNA alike, so that a level e(nu) of the sky alone looks like a slope of N_LNA. The levels of models differ alike in X
and Y (to 0.002 of 0.15), their shapes do not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from lbacal_core.antenna.names import DEFAULT_ANTENNA, load_antenna
from lbacal_core.antenna.varied import VariedAntenna
from lbacal_core.data.tables import read_content, read_prior
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.linear import fit_least_squares
from lbacal_core.sky.antenna_of import antenna_for_ratios
from lbacal_core.sky.model import DATA_EPOCH, Complexes, precess_multipoles
from lbacal_core.sky.modes import beam_multipoles, combine, sky_power_at
from lbacal_core.sky.names import DEFAULT_SKY, default_sky, load_sky
from lbacal_core.sky.table import read_at

LST_HOURS = np.arange(48) / 2.0
"""P_sky of multipoles to l = 16 is exact between these points."""
LEVEL_DEGREE = 3
"""Degree of the Legendre polynomials in ln nu by which levels differ: between models they leave 0.6 % of power."""
FULL_WAVES, SMALLEST_WAVE = 3, 3e-4
"""Degree of the polynomials above which each has half the size of the one before; and the smallest wave that counts."""
SIMULATED_LBA = "wipl-d"
SMALLEST = 2e-4
"""Modes below this rms in ln P are left out: no station-year can see them."""


@dataclass(frozen=True)
class DifferenceModels:
    """Names of the skies and antennas that are exchanged for the default ones.

    The antenna ``wipl-d`` is the simulated LBA, known here by its difference from the default alone.
    """

    skies: tuple[str, ...] = ("gsm408", "lfsm", "haslam", "maeda")
    antennas: tuple[str, ...] = (SIMULATED_LBA, "inverted-v", "inverted-v-wet")


WIDE_MODELS = DifferenceModels(skies=("lfsm-wide", "haslam-wide"), antennas=())
"""For channels beyond the default sky."""
LOFAR_ANTENNAS = ("hamaker", "hamaker-resonant")
ZENITH_GAIN = read_prior()["zenith_gain"].size
"""How far the gain of another antenna than LOFAR's at zenith is known, at fixed total power."""
FULL_MAPS = DifferenceModels(skies=("gsm408", "lfsm"), antennas=(SIMULATED_LBA,))
"""Models of several maps each, and the simulated LBA: their spread is the covariance of an LST curve's points."""


@dataclass(frozen=True)
class Waves:
    """Changes of ln P_sky, each a wave in time times a spectrum, one standard deviation of its prior each.

    Attributes
    ----------
    profile
        Shape (wave, event).
    spectrum_of
        Number of the spectrum of each, shape (wave,).
    spectra
        Shape (spectrum, ..., freq).
    """

    profile: Floats
    spectrum_of: NDArray[np.int64]
    spectra: Floats

    @property
    def changes(self) -> Floats:
        """Shape (wave, event, freq), for spectra of shape (spectrum, freq)."""
        return np.asarray(self.profile[:, :, None] * self.spectra[self.spectrum_of, None])


@dataclass(frozen=True)
class ModelDifferences:
    """Changes of ln P_sky by exchanges of the sky or antenna model, each one standard deviation of its prior.

    Attributes
    ----------
    shape
        By dipole, shape (mode, lst, freq), on `LST_HOURS`: the change along LST, its mean over LST taken out; principal
        axes of all exchanges, strongest first.
    level
        By dipole, shape (exchange, freq): this mean.
    isotropic
        By dipole, shape (lst, freq): isotropic brightness added, as much as the extragalactic level (Lawson et al.
        1987), because models differ in whether a map contains it.
    frequency_mhz
        Shape (freq,).
    """

    shape: Mapping[str, Floats]
    level: Mapping[str, Floats]
    isotropic: Mapping[str, Floats]
    frequency_mhz: Floats

    def changes_at(self, dipole: str, lst_hours: Floats) -> Floats:
        """Changes along LST at sidereal hours, shape (event,), of events: shape (mode, event, freq)."""
        return read_at(self.shape[dipole], lst_hours)

    def level_modes(self) -> Floats:
        """Legendre polynomials in ln nu, each of the size that real models have, shape (degree, freq)."""
        polynomials = self.smooth_spectra()
        levels = np.mean(list(self.level.values()), axis=0)
        size = np.sqrt(np.sum(fit_least_squares(polynomials.T, levels.T) ** 2, axis=1))
        return np.asarray(polynomials * size[:, None])

    def smooth_spectra(self) -> Floats:
        """Legendre polynomials in ln nu, shape (degree, freq)."""
        x = _unit_range(np.log(self.frequency_mhz))
        return np.asarray(np.polynomial.legendre.legvander(x, min(LEVEL_DEGREE, x.size - 1)).T)

    def list_modes(self, dipole: str) -> Floats:
        """Every change of ln P_sky of a dipole that is free, on `LST_HOURS`, shape (mode, lst, freq).

        Level, isotropic brightness, exchanges of models along LST, waves that no model has: what
        `discovery.station.model_modes` frees at the events of a station. And what a level has beside its polynomials.
        """
        smooth = self.smooth_spectra()
        rest = self.level[dipole] - fit_least_squares(smooth.T, self.level[dipole].T).T @ smooth
        levels = np.concatenate([self.level_modes(), rest])[:, None] * np.ones((LST_HOURS.size, 1))
        waves = [one.changes for one in waves_at(self.frequency_mhz, LST_HOURS)]
        return np.concatenate([levels, self.isotropic[dipole] * smooth[:, None], self.shape[dipole], *waves])


def waves_at(frequency_mhz: Floats, lst_hours: Floats, is_search: bool = False) -> tuple[Waves, Waves]:
    """Smooth waves along LST that no model need have: of both polarisations together, and of each by itself.

    Parameters
    ----------
    is_search
        Whether a cause is looked for, whose name must not come by chance from a sky that is more wrong than models are.
    """
    x = _unit_range(np.log(frequency_mhz))
    prior = read_prior()
    widening = prior["widening"].size if is_search else 1.0
    sizes = widening * np.outer(prior["waves"].sizes, 0.5 ** np.maximum(np.arange(x.size) - FULL_WAVES, 0))
    number, degree = np.nonzero(sizes >= SMALLEST_WAVE)
    angle = 2.0 * np.pi / 24.0 * np.outer(np.arange(1, len(sizes) + 1), lst_hours)
    waves = np.stack([np.cos(angle), np.sin(angle)])
    flat_sizes = widening * np.array(prior["flat_waves"].sizes)
    flat = (flat_sizes[:, None] * waves[:, : flat_sizes.size]).reshape(-1, lst_hours.size)
    own = (sizes[number, degree, None] * waves[:, number]).reshape(-1, lst_hours.size)
    polynomials = np.asarray(np.polynomial.legendre.legvander(x, int(degree.max())).T, dtype=float)
    return (
        Waves(flat, np.zeros(len(flat), dtype=np.int64), np.ones((1, x.size))),
        Waves(own, np.tile(degree, 2), polynomials),
    )


def compute_model_differences(instrument: Instrument, models: DifferenceModels | None = None) -> ModelDifferences:
    """Differences between models for the instrument's place, arms and channels.

    Each single exchange is one standard deviation, and what the exchange of sky and antenna together adds to the two
    single ones another.
    """
    own_sky = default_sky(instrument.frequency_mhz)
    models = models or (DifferenceModels() if own_sky == DEFAULT_SKY else WIDE_MODELS)
    default, skies = load_sky(own_sky), [load_sky(name) for name in models.skies]
    low = max(sky.frequency_mhz[0] for sky in (default, *skies))
    high = min(sky.frequency_mhz[-1] for sky in (default, *skies))
    # Beyond the range of all models the difference at its edge holds.
    nu = np.clip(instrument.frequency_mhz, low, high)
    tilts = {instrument.tilt_deg(dipole) for dipole in instrument.dipoles}
    patterns = {tilt: list_patterns(instrument, models, nu, default.lmax, tilt) for tilt in tilts}
    temperatures = {sky.name: precess_multipoles(sky.temperature(nu), DATA_EPOCH) for sky in (default, *skies)}
    added = precess_multipoles(default.changed(extra_isotropic=1.0).temperature(nu), DATA_EPOCH)
    shape, level, isotropic = {}, {}, {}
    for dipole, arm in instrument.dipole_azimuth_deg.items():
        plain, beams = patterns[instrument.tilt_deg(dipole)]

        def log_power(temperature: Complexes, beam: Complexes, arm_deg: float = arm) -> Floats:
            return np.log(sky_power_at(combine(temperature, beam, arm_deg, instrument.latitude_deg, nu), LST_HOURS))

        base = log_power(temperatures[default.name], plain)
        of_antenna = [log_power(temperatures[default.name], beam) - base for beam in beams]
        exchanges = list(of_antenna)
        for sky in skies:
            alone = log_power(temperatures[sky.name], plain) - base
            exchanges.append(alone)
            for beam, own in zip(beams, of_antenna, strict=True):
                exchanges.append(log_power(temperatures[sky.name], beam) - base - alone - own)
        change = np.array(exchanges).reshape(-1, LST_HOURS.size, nu.size)
        level[dipole] = change.mean(axis=1)
        shape[dipole] = _principal_axes(change - level[dipole][:, None])
        isotropic[dipole] = np.exp(log_power(added, plain) - base) - 1.0
    return ModelDifferences(shape, level, isotropic, instrument.frequency_mhz)


def list_patterns(
    instrument: Instrument, models: DifferenceModels, frequency_mhz: Floats, lmax: int, tilt_deg: float
) -> tuple[Complexes, list[Complexes]]:
    """The pattern of the instrument's antenna, and those that it is exchanged for, shape (freq, l, m') each.

    LOFAR's antenna has several models; any other is exchanged for one with more gain at zenith at fixed total power.
    """
    name = antenna_for_ratios(instrument)
    antenna = load_antenna(name)
    if name not in LOFAR_ANTENNAS:
        varied = VariedAntenna(antenna, zenith_gain=ZENITH_GAIN)
        plain, other = (beam_multipoles(one, frequency_mhz, lmax, tilt_deg) for one in (antenna, varied))
        return plain, [other]
    plain = beam_multipoles(load_antenna(DEFAULT_ANTENNA), frequency_mhz, lmax, tilt_deg)
    others = [
        plain + _simulated_difference(frequency_mhz, lmax)
        if other == SIMULATED_LBA
        else beam_multipoles(load_antenna(other), frequency_mhz, lmax, tilt_deg)
        for other in models.antennas
    ]
    return plain, others


def model_difference_modes(
    instrument: Instrument, lst_hours: Floats, models: DifferenceModels | None = None
) -> dict[str, Floats]:
    """Changes of ln P_sky along LST that an exchange of sky or antenna model can make, one prior sigma each.

    Returns
    -------
    For each dipole, shape (mode, lst, freq), strongest mode first.
    """
    differences = compute_model_differences(instrument, models)
    return {dipole: differences.changes_at(dipole, lst_hours) for dipole in differences.shape}


def _unit_range(values: Floats) -> Floats:
    """Values from -1 to 1."""
    return np.asarray(2.0 * (values - values[0]) / max(float(np.ptp(values)), 1e-300) - 1.0)


def _principal_axes(vectors: Floats) -> Floats:
    """The principal axes of vectors that are one standard deviation each, shape (mode, lst, freq)."""
    _, size, axes = np.linalg.svd(vectors.reshape(len(vectors), -1), full_matrices=False)
    is_seen = size > SMALLEST * np.sqrt(axes.shape[1])
    return np.asarray((size[:, None] * axes)[is_seen].reshape(-1, *vectors.shape[1:]))


def _simulated_difference(frequency_mhz: Floats, lmax: int) -> Complexes:
    """Multipoles of D of the simulated LBA less those of the default antenna, shape (freq, l, m')."""
    table = read_content("antenna_difference")
    nodes, rows = np.array(table["frequency_mhz"]), np.array(table["multipoles"]["rows"])
    weight = scipy.interpolate.CubicSpline(nodes, np.array(table["weight"]))(
        np.clip(frequency_mhz, nodes[0], nodes[-1])
    )
    difference = np.zeros((frequency_mhz.size, lmax + 1, lmax + 1), dtype=complex)
    difference[:, rows[:, 0].astype(int), rows[:, 1].astype(int)] = weight @ rows[:, 2:].T
    return difference
