"""Cross-correlations of a station's receivers: which of them carry the same letter, and which letter is which arm.

Two dipoles with parallel arms see the same sky, two with perpendicular arms hardly any of it in common: coherence
shows which receivers belong together. Which of the two sets is the arm X follows from the brightest sources, which the
two arms receive with different strengths. No letter on record is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from lbacal_core.antenna.model import AntennaModel, directional_response
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.sidereal import local_sidereal_time, sun_position
from lbacal_core.sky.model import find_sources, local_direction, precess

SUN = "sun"
SHORTEST_WAVELENGTHS = 4.0
"""Baselines below this many wavelengths see the Galaxy, which is no point source."""
UNIX_J2000_S, YEAR_S = 946_728_000.0, 365.25 * 86_400.0


@dataclass(frozen=True)
class StationCorrelations:
    """Correlations of all receivers of a station at one frequency and one instant.

    Antenna i has the receivers 2i and 2i + 1.

    Attributes
    ----------
    matrix
        Shape (receiver, receiver), complex, any unit.
    gains
        Factors that calibrate each receiver, shape (receiver,), complex.
    offsets_m
        Positions of the antennas about the centre, shape (antenna, 3), geocentric axes, m.
    centre_m
        Geocentric position of the centre, shape (3,), m.
    """

    matrix: NDArray[np.complex128]
    gains: NDArray[np.complex128]
    offsets_m: Floats
    centre_m: Floats
    frequency_mhz: float
    time_unix: float

    def __post_init__(self) -> None:
        receivers = 2 * len(self.offsets_m)
        if self.matrix.shape != (receivers, receivers) or self.gains.shape != (receivers,):
            raise BadInputError("correlations", f"{receivers} x {receivers} and as many gains", f"{self.matrix.shape}")

    @property
    def works(self) -> NDArray[np.bool_]:
        """Whether both receivers of an antenna have power, shape (antenna,)."""
        return np.asarray(np.diag(self.matrix).real.reshape(-1, 2).min(axis=1) > 0)

    def same_parity_share(self, reference: NDArray[np.bool_]) -> Floats:
        """Share of each antenna's coherence with reference antennas that is in receivers of its own parity.

        It is 1 where receivers of one parity carry the same letter in an antenna and in the reference, and 0 where the
        letters are exchanged.

        Parameters
        ----------
        reference
            Which antennas are the reference, shape (antenna,).

        Returns
        -------
        Shape (antenna,), NaN for an antenna without power.
        """
        power = np.diag(self.matrix).real
        coherence = np.abs(self.matrix) ** 2 / np.where(power > 0, power, np.inf)[:, None]
        coherence /= np.where(power > 0, power, np.inf)
        count = len(self.offsets_m)
        pairs = coherence.reshape(count, 2, count, 2).transpose(0, 2, 1, 3)
        others = (reference & self.works)[None, :] & ~np.eye(count, dtype=bool)
        same, cross = (np.sum(others * (pairs[..., 0, k] + pairs[..., 1, 1 - k]), axis=1) for k in (0, 1))
        return np.asarray(np.where(self.works, same, np.nan) / np.where(self.works, same + cross, 1.0))

    def direction(self, source: str) -> tuple[float, float]:
        """Zenith angle and azimuth (north through east) of a source of `lbacal_core.sky.model`, or the Sun, rad."""
        longitude, latitude, _ = erfa.gc2gd(1, self.centre_m)
        if source == SUN:
            altitude, azimuth = sun_position(np.array([self.time_unix]), np.degrees(latitude), np.degrees(longitude))
            return float(np.pi / 2 - altitude[0]), float(azimuth[0])
        (one,) = find_sources([source])
        epoch = 2000.0 + (self.time_unix - UNIX_J2000_S) / YEAR_S
        right_ascension, declination = np.radians([[one.right_ascension_deg], [one.declination_deg]])
        place = precess(right_ascension, declination, epoch)
        lst = local_sidereal_time(np.array([self.time_unix]), np.degrees(longitude))
        zenith, azimuth = local_direction(lst, *place, np.degrees(latitude))
        return float(zenith[0]), float(azimuth[0])

    def phases(self, source: str) -> NDArray[np.complex128]:
        """Phase factor of a source at each antenna, shape (antenna,)."""
        zenith, azimuth = self.direction(source)
        longitude, latitude, _ = erfa.gc2gd(1, self.centre_m)
        east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
        up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
        level = np.sin(azimuth) * east + np.cos(azimuth) * np.cross(up, east)
        towards = np.cos(zenith) * up + np.sin(zenith) * level
        wavelength = speed_of_light / (1e6 * self.frequency_mhz)
        return np.asarray(np.exp(2j * np.pi / wavelength * (self.offsets_m @ towards)))

    def fit_sources(self, receivers: NDArray[np.int64], sources: Sequence[str]) -> SourceFit:
        """Powers of sources in the correlations of one receiver of each antenna, by least squares.

        Parameters
        ----------
        receivers
            A receiver of each antenna, shape (antenna,); antennas without power are left out.
        """
        used = np.flatnonzero(self.works)
        i, j = (used[k] for k in np.triu_indices(used.size, 1))
        length = np.linalg.norm(self.offsets_m[i] - self.offsets_m[j], axis=1)
        is_long = length > SHORTEST_WAVELENGTHS * speed_of_light / (1e6 * self.frequency_mhz)
        i, j = i[is_long], j[is_long]
        calibrated = self.matrix * np.outer(self.gains, self.gains.conj())
        visibility = calibrated[receivers[i], receivers[j]]
        phase = np.stack([self.phases(source) for source in sources])
        model = (phase[:, i] * phase[:, j].conj()).T
        design = np.concatenate([model.real, model.imag])
        measured = np.concatenate([visibility.real, visibility.imag])
        powers = np.linalg.lstsq(design, measured, rcond=None)[0]
        left = measured - design @ powers
        explained = 1.0 - float(left @ left) / float(measured @ measured)
        return SourceFit(dict(zip(sources, powers.tolist(), strict=True)), explained, i.size)

    def without(self, antenna: int) -> StationCorrelations:
        """The same without power of one antenna."""
        matrix = self.matrix.copy()
        matrix[2 * antenna : 2 * antenna + 2], matrix[:, 2 * antenna : 2 * antenna + 2] = 0.0, 0.0
        return StationCorrelations(
            matrix, self.gains, self.offsets_m, self.centre_m, self.frequency_mhz, self.time_unix
        )


@dataclass(frozen=True)
class SourceFit:
    """Powers of sources in correlations.

    Attributes
    ----------
    powers
        By source, in the unit of the correlations.
    explained
        Share of the squared correlations that the sources explain.
    """

    powers: Mapping[str, float]
    explained: float
    baselines: int


def arm_ratio(
    station: StationCorrelations, first: NDArray[np.int64], second: NDArray[np.int64], sources: Sequence[str]
) -> tuple[float, float]:
    """(Power of source 1 over source 0 in one set of receivers) over (the same in the other), with its error.

    Fluxes and gains cancel: the ratio depends on the patterns of the arms alone. The error is that of a jackknife over
    the antennas.

    Parameters
    ----------
    first, second
        The receivers of two sets with parallel arms, one an antenna, shape (antenna,).
    sources
        All sources that are fitted, those of the ratio first.
    """

    def ratio(one: StationCorrelations) -> float:
        fits = [one.fit_sources(receivers, sources).powers for receivers in (first, second)]
        relative = [fit[sources[1]] / fit[sources[0]] for fit in fits]
        return relative[0] / relative[1]

    parts = np.array([ratio(station.without(int(antenna))) for antenna in np.flatnonzero(station.works)])
    sigma = np.sqrt((parts.size - 1) * np.mean((parts - parts.mean()) ** 2))
    return ratio(station), float(sigma)


def expected_arm_ratio(
    station: StationCorrelations, model: AntennaModel, azimuth_deg: tuple[float, float], sources: Sequence[str]
) -> float:
    """The ratio of `arm_ratio` by an antenna model, for arms at two azimuths (north through east)."""
    response = np.empty((2, 2))
    for k, source in enumerate(sources[:2]):
        zenith, azimuth = station.direction(source)
        for a, arm in enumerate(azimuth_deg):
            towards = np.array([zenith]), np.array([azimuth - np.radians(arm)])
            response[k, a] = directional_response(model, np.array([station.frequency_mhz]), *towards)[0, 0]
    return float(response[1, 0] / response[0, 0] / (response[1, 1] / response[0, 1]))
