"""The signal chain as a list of stages; `chain.noise` finds the noise constants that follow from it.

Each stage multiplies the power by a gain and adds noise at its input. What no table knows about the gains, A(nu), and
with it the cable of an antenna, stands between two parts of the list:

- in front: what is seen by the antenna (`antenna`, `ground`, `ice`), and every stage before the `cable`; where no cable
  is listed, up to the `lna`. A(nu) multiplies this noise as it does the sky, so it is referred to P_sky:
  k_B T / (G_ant g_1 ... ) for a temperature T at the input of a stage;
- behind: every other stage. Its noise is amplified by the tables from its input on.

Noise of a stage is free (the data determine it), known, with an error or without, or absent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats

SEEN = ("antenna", "ground", "ice")
"""Kinds that the antenna sees or is: `antenna` adds the same to P_sky at each frequency, the others are warm bodies."""
IN_LINE = ("load", "lna", "cable", "filter", "amplifier", "adc")
"""Kinds that the signal passes, in any order but for the first and the last."""
KINDS = SEEN + IN_LINE
FREE = "free"


@dataclass(frozen=True)
class Stage:
    """One stage of a chain.

    Attributes
    ----------
    name
        Its noise constant is ``n_`` and this name.
    kind
        One of `KINDS`.
    gain
        Linear power, shape (freq,); None for what has none, and for a cable that every antenna has its own of.
    noise_k
        Noise temperature at its input, shape (freq,), K; for `ground` and `ice` that of the body. Where it is free,
        None.
    is_free
        Whether the data determine the noise.
    error_k
        One standard deviation of the mean of `noise_k`, which moves as a whole; 0 where it is taken at its word.
    solid_angle_sr
        Integral of D, which is 1 at zenith, over the body that `ground` or `ice` is.
    """

    name: str
    kind: str
    gain: Floats | None = None
    noise_k: Floats | None = None
    is_free: bool = False
    error_k: float = 0.0
    solid_angle_sr: float = 1.0

    @property
    def has_noise(self) -> bool:
        """Whether it adds anything."""
        return self.is_free or self.noise_k is not None

    def as_dict(self) -> dict[str, Any]:
        """The stage as JSON values, its tables on the channels of the instrument."""
        content: dict[str, Any] = {"name": self.name, "kind": self.kind}
        if self.gain is not None:
            content["gain"] = self.gain.tolist()
        if self.has_noise:
            content["noise_temperature_k"] = FREE if self.noise_k is None else self.noise_k.tolist()
        if self.error_k:
            content["noise_temperature_error_k"] = self.error_k
        if self.solid_angle_sr != 1.0:
            content["solid_angle_sr"] = self.solid_angle_sr
        return content


def require_chain(stages: Sequence[Stage], place: str) -> None:
    """Refuse a list that is no chain."""
    names = [stage.name for stage in stages]
    if len(set(names)) < len(names):
        raise BadInputError(place, "a name for each stage", f"{max(names, key=names.count)!r} twice")
    kinds = [stage.kind for stage in stages]
    in_line = [kind for kind in kinds if kind in IN_LINE]
    if kinds != [kind for kind in kinds if kind in SEEN] + in_line:
        raise BadInputError(place, f"{', '.join(SEEN)} before what the signal passes", ", ".join(kinds))
    if "adc" in kinds[:-1]:
        raise BadInputError(place, "the adc as the last stage", ", ".join(kinds))
    for kind in ("antenna", "lna", "cable"):
        if kinds.count(kind) > 1:
            raise BadInputError(place, f"one {kind}", f"{kinds.count(kind)}")
    cables = [stage for stage in stages if stage.kind == "cable"]
    if any(stage.has_noise for stage in cables):
        raise BadInputError(place, "no noise temperature of the cable", "one")
    if not any(stage.is_free or stage.error_k for stage in stages):
        raise BadInputError(place, "one stage at least whose noise_temperature_k is free, or has an error", "none")


def split_stages(stages: Sequence[Stage]) -> tuple[list[Stage], list[Stage]]:
    """Stages in front of A(nu) and behind it, the cable in neither."""
    kinds = [stage.kind for stage in stages]
    if "cable" in kinds:
        at = kinds.index("cable")
        return list(stages[:at]), list(stages[at + 1 :])
    at = 1 + max([k for k, kind in enumerate(kinds) if kind in (*SEEN, "lna")], default=-1)
    return list(stages[:at]), list(stages[at:])


def gain_behind(stages: Sequence[Stage], channels: int) -> Floats:
    """G_RCU: the product of the gains behind A(nu), shape (freq,)."""
    return multiply_gains(split_stages(stages)[1], channels)


def multiply_gains(stages: Sequence[Stage], channels: int) -> Floats:
    """The product of gains, shape (freq,); that of the antenna, and of what it sees, is not among them."""
    gains = [stage.gain for stage in stages if stage.gain is not None and stage.kind not in SEEN]
    return np.asarray(np.prod([np.ones(channels), *gains], axis=0))


def fill_fields(content: Mapping[str, Any], stages: Sequence[Stage], channels: int) -> dict[str, Any]:
    """The content of an instrument file with the fields that follow from its stages, where it does not give them.

    These are `antenna_gain`, `receiver_gain`, and, where the cable is the same for all antennas, `cables` and its name
    with each antenna.
    """
    filled = {"receiver_gain": gain_behind(stages, channels).tolist(), **content}
    of_antenna = [stage.gain for stage in stages if stage.kind == "antenna" and stage.gain is not None]
    if of_antenna:
        filled.setdefault("antenna_gain", of_antenna[0].tolist())
    cables = [stage for stage in stages if stage.kind == "cable"]
    if cables and cables[0].gain is None:
        return filled
    name = cables[0].name if cables else "none"
    gain = cables[0].gain if cables and cables[0].gain is not None else np.ones(channels)
    filled.setdefault("cables", {name: gain.tolist()})
    antennas = filled.get("antennas")
    if isinstance(antennas, list):
        filled["antennas"] = [{"cable": name, **row} if isinstance(row, dict) else row for row in antennas]
    return filled
