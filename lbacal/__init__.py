"""The public face: the calibration in effect, and what a pipeline needs to send spectra and ask for fits.

>>> import lbacal
>>> lbacal.effective("CS002", antenna=17, dipole="X", at="2014-05-01")  # doctest: +SKIP

The server is `LBACAL_URL`, the key `LBACAL_API_KEY`.
"""

from lbacal.client import Client, effective, ingest, refit
from lbacal.transport import RefusedError, UnreachableError
from lbacal.voltages import calibrate_trace

__all__ = ["Client", "RefusedError", "UnreachableError", "calibrate_trace", "effective", "ingest", "refit"]
