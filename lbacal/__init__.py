"""The public face: the calibration in effect, and what a pipeline needs to send spectra and ask for fits.

>>> import lbacal
>>> lbacal.effective("CS002", antenna=17, dipole="X", at="2014-05-01")  # doctest: +SKIP

To calibrate, with the extra `fit` (docs/tutorials):

>>> instrument = lbacal.Instrument.load("lofar-superterp")  # doctest: +SKIP
>>> lbacal.fit("spectra.h5", instrument).plot()  # doctest: +SKIP

The server is `LBACAL_URL`, the key `LBACAL_API_KEY`, and `LBACAL_CACHE` the folder that answers while no server does.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from lbacal.client import CachedAnswerWarning, Client, effective, ingest, refit
from lbacal.transport import RefusedError, UnreachableError
from lbacal.voltages import calibrate_trace, carry_to_antenna
from lbacal_core.errors import MissingExtraError

_MODULES = {
    "analysis.instrument": ("Antenna", "Instrument", "Site"),
    "chain": ("Chain", "Stage", "effective_length", "lna_noise", "mismatch"),
    "analysis.audit": ("Audit", "audit"),
    "analysis.budget": ("ErrorBudget", "budget"),
    "analysis.data": ("import_data", "read", "simulate"),
    "analysis.fit": ("Calibration", "fit"),
    "analysis.investigate": ("Finding", "Investigation", "investigate"),
    "analysis.life": ("Life", "life"),
    "analysis.lst_curve": ("LstComparison", "lst_curve"),
    "analysis.predict": ("Prediction", "draw_together", "draw_traces", "predict"),
}
ANALYSIS = {name: module for module, names in _MODULES.items() for name in names}
"""What needs the extra `fit`, by its name, with the module that is imported when it is asked for."""
FIT = ("healpy", "jinja2", "matplotlib", "scipy", "threadpoolctl")  # what this extra installs, as it is imported


def __getattr__(name: str) -> Any:
    """Import the part that fits when it is first used."""
    if name not in ANALYSIS:
        raise AttributeError(f"module 'lbacal' has no attribute {name!r}")
    if not all(find_spec(module) for module in FIT):
        raise MissingExtraError(f"lbacal.{name}", "fit")
    return getattr(import_module(f"lbacal.{ANALYSIS[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *ANALYSIS])


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
