"""The main path on one page: spectra and a simulation go in; calibration curves with their errors come out.

P_sky(LST, nu)      lbacal_core.sky                     the Galaxy, seen by the antenna
P = s P_sky + b     lbacal_core.calibration.lines       a straight line per channel and path
N_LNA, N / G_ant    lbacal_core.calibration.chain_form  where noise enters, by the odds that the data give
b = N_LNA s + ...   lbacal_core.calibration.separable   the chain ties the intercepts together
C = (G_ant / s)^1/2 lbacal_core.instrument.chain        the calibration factor
P / P(causes)       lbacal_core.discovery.calibrate     what the simulation's causes do, their sizes fitted with C
sigma_sys(C)        lbacal_core.calibration.budget      every input that may be wrong, exchanged and fitted again
"""

from __future__ import annotations

from lbacal_core.calibration.budget import add_budget, compute_budget
from lbacal_core.curves.curves import FitReport
from lbacal_core.discovery.calibrate import fit_causes
from lbacal_core.simulation.prior import DEFAULT_SKY_BUDGET
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra


def calibrate(
    spectra: Spectra, simulation: Simulation, scope: str = "antenna", sky_budget: str = DEFAULT_SKY_BUDGET
) -> FitReport:
    """Calibrate antennas with the Galaxy.

    Parameters
    ----------
    spectra
        Background spectra of the window to be calibrated.
    simulation
        The instrument under its sky; the sizes of its causes are fitted together with C.
    scope
        ``antenna``, ``station`` or ``array``: what one curve belongs to.
    sky_budget
        Where the systematic error of the sky is taken from: ``paper``, ``models`` or ``measured``.

    Returns
    -------
    The curves C(nu) with statistical and systematic errors, noise constants and status.
    """
    fitted = fit_causes(spectra, simulation)
    report = fitted.fit(scope)
    return add_budget(report, compute_budget(fitted.spectra, fitted.simulation, sky_budget))
