"""A sky model: brightness temperature by direction and frequency, as a few multipole maps and their spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import erfa
import numpy as np
import scipy
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, require_name
from lbacal_core.grids import Floats, require_channels
from lbacal_core.provenance import hash_arrays

# Directions: from ICRS to the equator of date, and from there to the local sky.

DATA_EPOCH = 2015.0
"""Julian year of the equator that P_sky(LST) refers to; see docs/decisions/sidereal-time.md."""


def precession_angles(epoch: float) -> tuple[float, float, float]:
    """Equatorial precession angles zeta_A, z_A, theta_A from J2000.0 to the mean equator of `epoch`, rad.

    IAU 2006 (`erfa.p06e`; Capitaine, Wallace & Chapront 2003, A&A 412, 567, eq. 40); the frame bias between ICRS and
    J2000.0 (0.02 arcsec) is left out.
    """
    z, zeta, theta = erfa.p06e(*erfa.epj2jd(epoch))[9:12]
    return float(zeta), float(z), float(theta)


def precess(right_ascension: Floats, declination: Floats, epoch: float) -> tuple[Floats, Floats]:
    """Right ascension and declination of date from those of J2000.0, rad, any shape."""
    zeta, z, theta = precession_angles(epoch)
    to_date = erfa.rz(-z, erfa.ry(theta, erfa.rz(-zeta, np.eye(3))))
    of_date = erfa.c2s(erfa.rxp(to_date, erfa.s2c(right_ascension, declination)))
    return np.asarray(of_date[0]), np.asarray(of_date[1])


def local_direction(
    lst_hours: Floats, right_ascension: Floats, declination: Floats, latitude_deg: float
) -> tuple[Floats, Floats]:
    """Zenith angle and azimuth (north through east) of directions given for the equator of date.

    Parameters
    ----------
    lst_hours, right_ascension, declination
        Local sidereal time in hours and direction in rad; shapes that broadcast.
    latitude_deg
        Geodetic latitude, degrees.

    Returns
    -------
    Zenith angle and azimuth in [0, 2 pi), rad, of the broadcast shape.
    """
    hour_angle = np.asarray(lst_hours) * (np.pi / 12.0) - right_ascension
    azimuth, altitude = erfa.hd2ae(hour_angle, declination, np.radians(latitude_deg))
    return np.asarray(np.pi / 2 - altitude), np.asarray(azimuth)


# Spherical-harmonic multipoles of a real field, their order in memory, and how they turn.

Complexes = NDArray[np.complex128]

# Multipoles are kept as a dense array (..., l, m) with 0 <= m <= l <= lmax and zeros elsewhere: at lmax 64 that is
# twice the memory of a packed triangle and spares every index formula. A real field has a_{l,-m} = (-1)^m conj a_lm.


@lru_cache(maxsize=8)
def wigner_d(lmax: int, angle: float) -> tuple[NDArray[np.float64], ...]:
    """Wigner small-d matrices d^l_{m'm}(angle) = <l m'| exp(-i angle J_y) |l m> for l = 0 ... lmax.

    Each has shape (2l+1, 2l+1) with m', m rising from -l, from the eigenvectors of J_y (Edmonds 1957, section 4.1):
    slower than a recursion, exact to rounding at any l.
    """
    matrices = []
    for order in range(lmax + 1):
        m = np.arange(-order, order)
        raising = np.sqrt(order * (order + 1.0) - m * (m + 1.0))
        j_y = np.diag(raising, -1) / 2j - np.diag(raising, 1) / 2j
        values, vectors = np.linalg.eigh(j_y)
        matrices.append(((vectors * np.exp(-1j * angle * np.round(values))) @ vectors.conj().T).real)
    return tuple(matrices)


def with_negative_orders(multipoles: Complexes, order: int) -> Complexes:
    """The multipoles of one l with m from -l to l: shape (..., lmax+1, lmax+1) -> (..., 2l+1)."""
    positive = multipoles[..., order, : order + 1]
    sign = (-1.0) ** np.arange(order, 0, -1)
    return np.concatenate([sign * positive[..., :0:-1].conj(), positive], axis=-1)


def precess_multipoles(multipoles: Complexes, epoch: float) -> Complexes:
    """Multipoles on the mean equator of `epoch` from those on the equator of J2000.0 (ICRS).

    The field is carried by R_z(z_A) R_y(-theta_A) R_z(zeta_A) in the sense of `sky.frames.precess`. `healpy.rotate_alm`
    does the same and is the oracle of the test; for the 51 channels of the embedded sky it takes three times as long,
    seconds where other work keeps the processor from its threads, and its import longer than the whole of P_sky.

    Parameters
    ----------
    multipoles
        Shape (..., l, m).
    """
    zeta, z, theta = precession_angles(epoch)
    lmax = multipoles.shape[-1] - 1
    turned = np.zeros_like(multipoles)
    for order, matrix in enumerate(wigner_d(lmax, -theta)):
        m = np.arange(-order, order + 1)
        moved = (with_negative_orders(multipoles, order) * np.exp(-1j * m * zeta)) @ matrix.T
        turned[..., order, : order + 1] = (moved * np.exp(-1j * m * z))[..., order:]
    return turned


T_CMB_K = 2.725


@dataclass(frozen=True)
class SkyModel:
    """T(nu, n) = level(nu) sum_k weight_k(nu) sum_lm multipoles_klm Y_lm(n), plus the CMB where it is not inside.

    The form of the principal-component sky models (de Oliveira-Costa et al. 2008, MNRAS 388, 247, eq. 6).

    Attributes
    ----------
    frequency_mhz
        Shape (node,), MHz, of the tabulated spectra.
    level
        Shape (node,), K; interpolated by a cubic spline in ln level against ln nu.
    weight
        Shape (node, component); interpolated by a cubic spline against ln nu.
    multipoles
        Shape (component, l, m), ICRS, orthonormal spherical harmonics.
    has_cmb, has_isotropic
        Whether the cosmic microwave background and the isotropic extragalactic emission are inside the maps.
    origin
        Where the numbers come from.
    extra_isotropic
        Isotropic brightness added on top, in units of the extragalactic level of Lawson et al. 1987.
    """

    name: str
    frequency_mhz: Floats
    level: Floats
    weight: Floats
    multipoles: Complexes
    has_cmb: bool
    has_isotropic: bool
    origin: str
    extra_isotropic: float = 0.0

    def __post_init__(self) -> None:
        place = f"sky {self.name}"
        require_channels(place, self.frequency_mhz)
        nodes, components = self.weight.shape
        if self.level.shape != (nodes,) or self.frequency_mhz.shape != (nodes,):
            raise BadInputError(f"{place}: level", f"{nodes} numbers, one a node", f"shape {self.level.shape}")
        if self.multipoles.shape[0] != components or self.multipoles.shape[1] != self.multipoles.shape[2]:
            raise BadInputError(
                f"{place}: multipoles", f"shape ({components}, lmax+1, lmax+1)", f"{self.multipoles.shape}"
            )
        if not (np.all(self.level > 0) and np.all(np.isfinite(self.weight)) and np.all(np.isfinite(self.multipoles))):
            raise BadInputError(place, "finite numbers and levels > 0", "others")

    @property
    def lmax(self) -> int:
        """The highest multipole kept."""
        return int(self.multipoles.shape[1]) - 1

    def spectra(self, frequency_mhz: Floats) -> Floats:
        """Spectrum of each component, shape (freq, component), K.

        Raises
        ------
        BadInputError
            Outside the tabulated range, where a spline would invent numbers.
        """
        low, high = self.frequency_mhz[0], self.frequency_mhz[-1]
        outside = (frequency_mhz < low) | (frequency_mhz > high)
        if np.any(outside):
            raise BadInputError(
                f"sky {self.name}: frequency_mhz",
                f"{low:g} to {high:g} MHz (gsm-wide reaches 10 to 408 MHz; any other sky by its file)",
                f"{frequency_mhz[outside][0]:g} MHz",
            )
        nodes, x = np.log(self.frequency_mhz), np.log(frequency_mhz)
        level = np.exp(scipy.interpolate.CubicSpline(nodes, np.log(self.level))(x))
        return np.asarray(level[:, None] * scipy.interpolate.CubicSpline(nodes, self.weight)(x))

    def isotropic_k(self, frequency_mhz: Floats) -> Floats:
        """Isotropic brightness to be added to the maps, shape (freq,), K: the CMB unless it is inside.

        And, unless it is inside, the extragalactic part of Lawson et al. 1987 as in the paper's appendix on the sky.
        """
        cmb = 0.0 if self.has_cmb else T_CMB_K
        levels = self.extra_isotropic + (0.0 if self.has_isotropic else 1.0)
        return np.asarray(cmb + levels * 50.0 * (150.0 / frequency_mhz) ** 2.75)

    def temperature(self, frequency_mhz: Floats) -> Complexes:
        """Multipoles of the brightness temperature, CMB included, shape (freq, l, m), K, ICRS."""
        total = np.tensordot(self.spectra(frequency_mhz), self.multipoles, axes=1)
        total[:, 0, 0] += np.sqrt(4 * np.pi) * self.isotropic_k(frequency_mhz)
        return np.asarray(total)

    def changed(self, scale: float = 1.0, spectral_index: float = 0.0, extra_isotropic: float = 0.0) -> SkyModel:
        """The model times `scale` (nu / 60 MHz)^-spectral_index, with `extra_isotropic` added."""
        if not scale > 0:
            raise BadInputError("scale", "a factor > 0", f"{scale}")
        changes = (("scale", scale, 1.0), ("index", spectral_index, 0.0), ("isotropic", extra_isotropic, 0.0))
        words = [f"{word}={value:g}" for word, value, plain in changes if value != plain]
        return replace(
            self,
            name=f"{self.name}({', '.join(words)})" if words else self.name,
            level=self.level * scale * (self.frequency_mhz / 60.0) ** -spectral_index,
            extra_isotropic=self.extra_isotropic + extra_isotropic,
        )

    def truncated(self, lmax: int) -> SkyModel:
        """The model with multipoles up to `lmax` only."""
        return replace(self, multipoles=self.multipoles[:, : lmax + 1, : lmax + 1])

    def digest(self) -> str:
        """Hash of the numbers, which names the model in provenance."""
        flags = np.array([self.has_cmb, self.has_isotropic, self.extra_isotropic], dtype=float)
        return hash_arrays(self.frequency_mhz, self.level, self.weight, self.multipoles, flags)


# The four brightest sources of the northern sky: an optional layer on top of a sky model.


@dataclass(frozen=True)
class PointSource:
    """A source with log10 S/Jy = sum_i coefficients_i (log10 nu/MHz)^i at `epoch`, fading by `decline` a year.

    Attributes
    ----------
    right_ascension_deg, declination_deg
        ICRS, degrees.
    """

    name: str
    right_ascension_deg: float
    declination_deg: float
    coefficients: tuple[float, ...]
    epoch: float = 1965.0
    decline: float = 0.0

    def flux_jy(self, frequency_mhz: Floats, year: float) -> Floats:
        """Flux density in a year, shape (freq,), Jy."""
        logarithm = np.polynomial.polynomial.polyval(np.log10(frequency_mhz), self.coefficients)
        return np.asarray(10.0**logarithm * (1.0 - self.decline) ** (year - self.epoch))


SOURCES = {
    source.name: source
    for source in (
        # Spectra: Baars et al. 1977 (A&A 61, 99, table 5), valid from 20 MHz for Cas A and Cyg A; those of Tau A
        # and Vir A are extrapolated from above 400 MHz, good to some 10 % at 50 MHz. The decline of Cas A at 38-80
        # MHz is 0.7-0.8 % a year (Helmboldt & Kassim 2009, AJ 138, 838), slower than Baars et al. had it.
        PointSource("cas-a", 350.8664, 58.8117, (5.625, -0.634, -0.023), decline=0.0077),
        PointSource("cyg-a", 299.8682, 40.7339, (4.695, 0.085, -0.178)),
        PointSource("tau-a", 83.6331, 22.0145, (3.915, -0.299)),
        PointSource("vir-a", 187.7059, 12.3911, (5.023, -0.856)),
    )
}


def find_sources(names: Sequence[str]) -> list[PointSource]:
    """Find the sources of some names."""
    for name in names:
        require_name("point source", name, sorted(SOURCES))
    return [SOURCES[name] for name in names]
