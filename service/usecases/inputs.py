"""What a fit is made with besides spectra: the scheduler names it in the part, and only a worker that has it may begin.

Otherwise a worker with another sky file than the scheduler's would make calibrations that nobody asked for.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import MODEL_VERSION, canonical_json, hash_arrays
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.spectra import Spectra

SHOWN = 12
"""Digits of a hash that a sentence shows."""


@dataclass(frozen=True)
class Inputs:
    """Hashes of instrument and sky power, and the model version."""

    instrument: str
    sky_power: str
    model_version: int = MODEL_VERSION

    @property
    def text(self) -> str:
        """As it is stored and compared."""
        return canonical_json(asdict(self))


def name_inputs(instrument: Instrument, sky_power: SkyPower) -> Inputs:
    """The inputs of this process."""
    return Inputs(instrument.digest(), sky_power.digest())


def hash_covariates(spectra: Spectra) -> str:
    """The hash of the covariates of spectra, which their own digest leaves out."""
    names = sorted(spectra.environment)
    return hash_arrays(names, *(spectra.environment[name] for name in names))


def explain_difference(needed: str, found: str) -> str:
    """In which inputs two processes differ, in words."""
    wanted, own = json.loads(needed), json.loads(found)
    return ", ".join(
        f"{name.replace('_', ' ')} {str(wanted[name])[:SHOWN]} (here {str(own.get(name))[:SHOWN]})"
        for name in wanted
        if wanted[name] != own.get(name)
    )
