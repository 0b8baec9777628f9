"""The main path on one page: spectra, sky power and the chain go in; calibration curves with their errors come out.

P_sky(LST, nu)      lbacal_core.skypower    the Galaxy, seen by the antenna
P = s P_sky + b     lbacal_core.calibration.lines       a straight line per channel and path
b = N_LNA s + ...   lbacal_core.calibration.separable   the chain ties the intercepts together
C = (G_ant / s)^1/2 lbacal_core.chain       the calibration factor
"""

from __future__ import annotations

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves import FitReport
from lbacal_core.instrument import Instrument
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra


def calibrate(
    spectra: Spectra, instrument: Instrument, sky_power: SkyPower | None = None, scope: str = "antenna"
) -> FitReport:
    """Calibrate antennas with the Galaxy.

    Parameters
    ----------
    spectra
        Background spectra of the window to be calibrated.
    instrument
        The antennas, their dipoles, cables, antenna gain and receiver gain.
    sky_power
        P_sky of both dipoles; without it the package's own sky and antenna model.
    scope
        ``antenna``, ``station`` or ``array``: what one curve belongs to.

    Returns
    -------
    The curves C(nu) with statistical errors, noise constants and status.
    """
    if sky_power is None:
        # Imported here because healpy takes a second to load and is not needed with a sky power file.
        from lbacal_core.skypower.model import compute_sky_power

        sky_power = compute_sky_power(instrument)
    return fit_calibration(spectra, instrument, sky_power, scope)
