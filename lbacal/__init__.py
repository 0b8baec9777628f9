"""The public face: the calibration in effect, and what a pipeline needs to send spectra and ask for fits.

>>> import lbacal
>>> lbacal.effective("CS002", antenna=17, dipole="X", at="2014-05-01")  # doctest: +SKIP

The server is `LBACAL_URL`, the key `LBACAL_API_KEY`, and `LBACAL_CACHE` the folder that answers while no server does.
"""

from lbacal.antenna import carry_to_antenna
from lbacal.client import CachedAnswerWarning, Client, effective, ingest, refit
from lbacal.transport import RefusedError, UnreachableError
from lbacal.voltages import calibrate_trace

__all__ = [
    "CachedAnswerWarning",
    "Client",
    "RefusedError",
    "UnreachableError",
    "calibrate_trace",
    "carry_to_antenna",
    "effective",
    "ingest",
    "refit",
]
