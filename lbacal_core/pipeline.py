"""The main path on one page: spectra, sky power and the chain go in; calibration curves with their errors come out.

P_sky(LST, nu)      lbacal_core.skypower                the Galaxy, seen by the antenna
P = s P_sky + b     lbacal_core.calibration.lines       a straight line per channel and path
b = N_LNA s + ...   lbacal_core.calibration.separable   the chain ties the intercepts together
C = (G_ant / s)^1/2 lbacal_core.chain                   the calibration factor
P / P(causes)       lbacal_core.discovery.calibrate     what the model's adopted causes do, their sizes fitted with C
sigma_sys(C)        lbacal_core.uncertainty             every input that may be wrong, exchanged and fitted again
"""

from __future__ import annotations

from lbacal_core.calibration.chain_test import free_own_sky
from lbacal_core.calibration.singles import RememberedSingles
from lbacal_core.causes.model import PLAIN, Model
from lbacal_core.curves.curves import FitReport
from lbacal_core.discovery.calibrate import fit_causes
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import Remembered
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_core.uncertainty.refit import DEFAULT_SKY_BUDGET, add_budget, compute_budget


def calibrate(
    spectra: Spectra,
    instrument: Instrument,
    sky_power: SkyPower | None = None,
    scope: str = "antenna",
    sky_budget: str = DEFAULT_SKY_BUDGET,
    model: Model = PLAIN,
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
    sky_budget
        Where the systematic error of the sky is taken from: ``paper``, ``models`` or ``measured``.
    model
        The chain with its adopted causes, whose sizes are fitted together with C.

    Returns
    -------
    The curves C(nu) with statistical and systematic errors, noise constants and status.
    """
    freedom = None if sky_power is not None else free_own_sky(instrument)
    sky_power = sky_power or compute_sky_power(instrument)
    fitted = fit_causes(spectra, instrument, sky_power, model, is_own_sky=freedom is not None)
    singles = RememberedSingles(Remembered(len(spectra)))
    report = fitted.fit(scope, freedom, singles=singles)
    budget = compute_budget(fitted.spectra, instrument, sky_power, sky_budget, freedom=freedom, singles=singles)
    return add_budget(report, budget)
