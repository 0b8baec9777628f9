"""An analytic dipole as other programs tabulate it."""

from dataclasses import dataclass

import numpy as np
import pytest

from lbacal_core.antenna.ideal import ShortDipole

DIPOLE = ShortDipole(height_m=1.5)


@dataclass(frozen=True)
class Tabulated:
    """Responses to a field along increasing zenith angle and phi, which runs counterclockwise seen from above.

    `arm_deg` is where the arm lies, counted as phi is; arrays have the shape (freq, zenith, phi).
    """

    arm_deg: float
    frequency_mhz: np.ndarray
    zenith_deg: np.ndarray
    phi_deg: np.ndarray
    theta: np.ndarray
    phi: np.ndarray

    def require_the_same(self, table) -> None:
        """The pattern of the dipole with its arm at azimuth 0, complex but for one sign."""
        rng = np.random.default_rng(4)
        zenith, azimuth = np.radians(rng.uniform(0.0, 85.0, 200)), rng.uniform(0.0, 2 * np.pi, 200)
        found = np.stack(table.jones(self.frequency_mhz, zenith, azimuth))
        expected = np.stack(DIPOLE.jones(self.frequency_mhz, zenith, azimuth))
        sign = np.sign(np.sum((found * expected.conj()).real))
        # splines on steps of 5 and 10 degrees
        np.testing.assert_allclose(sign * found, expected, atol=2e-3 * np.abs(expected).max())


@pytest.fixture(params=[0.0, 90.0, 33.0], ids=lambda arm: f"arm at {arm:g}")
def tabulated(request):
    frequency_mhz = np.array([40.0, 50.0, 60.0, 70.0])
    zenith_deg, phi_deg = np.arange(0.0, 91.0, 5.0), np.arange(0.0, 360.0, 10.0)
    zenith, phi = np.meshgrid(np.radians(zenith_deg), np.radians(phi_deg), indexing="ij")
    # at the horizon itself a table still has the field just above it
    theta, clockwise = DIPOLE.jones(
        frequency_mhz, np.minimum(zenith, np.pi / 2 - 1e-9), np.radians(request.param) - phi
    )
    return Tabulated(request.param, frequency_mhz, zenith_deg, phi_deg, theta, -clockwise)
