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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, require_name
from lbacal_core.foreign import parse_name, parse_number, parse_numbers
from lbacal_core.grids import Floats, interpolate
from lbacal_core.instrument.matching import Impedance, match_power, read_impedance, require_passive
from lbacal_core.instrument.touchstone import PORTS, read_touchstone

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

    def on_channels(self, kept: NDArray[np.bool_]) -> Stage:
        """The stage with some of its channels, by a mask of shape (freq,)."""
        gain, noise_k = (None if one is None else one[kept] for one in (self.gain, self.noise_k))
        return replace(self, gain=gain, noise_k=noise_k)

    def require_whole(self, place: str) -> None:
        """Refuse a stage of an unknown kind, without the gain that its kind has, or with an error of nothing."""
        require_name(f"{place}: kind", self.kind, KINDS)
        for values, field in ((self.gain, "gain"), (self.noise_k, "noise temperature")):
            if values is not None:
                _require_positive(values, f"{place}: {field}")
        if self.error_k < 0 or (self.error_k > 0 and self.noise_k is None):
            raise BadInputError(place, "an error >= 0 of a known noise temperature", "another")
        if not 0 < self.solid_angle_sr <= 4 * np.pi:
            raise BadInputError(f"{place}: solid_angle_sr", "0 to 4 pi sr, the sphere", f"{self.solid_angle_sr:g}")
        if self.kind == "cable" and self.gain is not None and self.gain.max() > 1.0:
            raise BadInputError(f"{place}: gain", "a power factor <= 1 of a cable (dB <= 0)", f"{self.gain.max():g}")
        if self.kind in ("lna", "filter", "amplifier") and self.gain is None:
            raise BadInputError(place, "a gain", "none")
        if self.kind not in (*IN_LINE, "antenna") and self.gain is not None:
            raise BadInputError(place, f"no gain of what the antenna sees ({self.kind})", "one")

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


# Stages from an instrument file: gains as numbers, decibels, tables and Touchstone files; noise temperatures.

FIELDS = (
    "name", "kind", "gain", "gain_db", "noise_temperature_k", "noise_temperature_error_k", "solid_angle_sr",
)  # fmt: skip


def parse_stages(content: Any, frequency_mhz: Floats, place: str, folder: Path | None) -> tuple[Stage, ...]:
    """The stages of an instrument file on its channels.

    Parameters
    ----------
    content
        The list, as docs/formats/instrument.md describes it.
    folder
        Where the Touchstone files are that it names; None where there are none to be read.
    """
    if not isinstance(content, list) or not content:
        found = "an empty one" if isinstance(content, list) else type(content).__name__
        raise BadInputError(place, "a list of one stage or more", found)
    stages = tuple(_parse_stage(one, frequency_mhz, f"{place}, row {k}", folder) for k, one in enumerate(content))
    require_chain(stages, place)
    return stages


def _parse_stage(content: Any, frequency_mhz: Floats, place: str, folder: Path | None) -> Stage:
    if not isinstance(content, dict) or not {"name", "kind"} <= set(content):
        raise BadInputError(place, "a stage with name and kind", repr(content))
    unknown = sorted(set(content) - set(FIELDS))
    if unknown:
        raise BadInputError(place, f"the fields {', '.join(FIELDS)}", unknown[0])
    noise = content.get("noise_temperature_k")
    error = parse_number(content.get("noise_temperature_error_k", 0.0), f"{place}: noise_temperature_error_k")
    angle = parse_number(content.get("solid_angle_sr", 1.0), f"{place}: solid_angle_sr")
    noise_k = None
    if noise not in (None, FREE):
        where = f"{place}: noise_temperature_k"
        if isinstance(noise, str):
            raise BadInputError(where, f"{FREE!r}, or kelvin as a number, a list or a table", repr(noise))
        noise_k = _require_positive(_on_channels(noise, "noise_temperature_k", frequency_mhz, where), where)
    stage = Stage(
        name=parse_name(content["name"], f"{place}: name"),
        kind=content["kind"],
        gain=_gain(content, frequency_mhz, place, folder),
        noise_k=noise_k,
        is_free=noise == FREE,
        error_k=error,
        solid_angle_sr=angle,
    )
    stage.require_whole(place)
    return stage


def _gain(content: Mapping[str, Any], frequency_mhz: Floats, place: str, folder: Path | None) -> Floats | None:
    """Linear power gain of a stage on the channels, None where it gives none."""
    if "gain" in content and "gain_db" in content:
        raise BadInputError(place, "gain or gain_db", "both")
    given = content.get("gain", content.get("gain_db"))
    if isinstance(given, dict):
        return _gain_of_table(given, frequency_mhz, f"{place}: gain", folder)
    if "gain_db" in content:
        return np.asarray(10.0 ** (_on_channels(given, "gain_db", frequency_mhz, f"{place}: gain_db") / 10.0))
    if given is None:
        return None
    if isinstance(given, str):
        if folder is None:
            raise BadInputError(f"{place}: gain", "a number or a table (no folder to look for files in)", given)
        if Path(given).suffix.lower() not in PORTS:
            expected = (
                f'a number, {{"frequency_mhz": [...], "gain_db": [...]}} or a Touchstone file ({", ".join(PORTS)})'
            )
            raise BadInputError(f"{place}: gain of stage {content['name']!r}", expected, repr(given))
        return read_touchstone_gain(folder / given, frequency_mhz)
    return _require_positive(_on_channels(given, "gain", frequency_mhz, f"{place}: gain"), f"{place}: gain")


def _gain_of_table(given: Mapping[str, Any], frequency_mhz: Floats, place: str, folder: Path | None) -> Floats:
    """What a load takes of an antenna's power, or a table of gains or decibels."""
    if set(given) == {"antenna", "load"}:
        return _match(given, frequency_mhz, place, folder)
    if "gain_db" in given:
        return np.asarray(10.0 ** (_on_channels(given, "gain_db", frequency_mhz, place) / 10.0))
    gain = _require_positive(parse_numbers(given.get("gain"), f"{place}.gain"), place)
    nu = parse_numbers(given.get("frequency_mhz"), f"{place}.frequency_mhz")
    return interpolate_gain(nu, gain, frequency_mhz, place)


def interpolate_gain(nu: Floats, gain: Floats, frequency_mhz: Floats, place: str) -> Floats:
    """Gains of a table on the channels, shape (freq,), between its rows linear in dB."""
    return np.exp(interpolate(nu, np.log(gain), frequency_mhz, place))


def _on_channels(given: Any, name: str, frequency_mhz: Floats, place: str) -> Floats:
    """A number, a number a channel, or a table with them under a name, interpolated linearly; shape (freq,)."""
    if isinstance(given, dict):
        nu = parse_numbers(given.get("frequency_mhz"), f"{place}.frequency_mhz")
        return interpolate(nu, parse_numbers(given.get(name), place), frequency_mhz, place)
    if isinstance(given, list):
        values = parse_numbers(given, place)
        if values.shape != frequency_mhz.shape:
            raise BadInputError(
                place, f"one number, {frequency_mhz.size} or a table with frequency_mhz", f"{values.size}"
            )
        return values
    return np.full(frequency_mhz.size, parse_number(given, place))


def _require_positive(values: Floats, place: str) -> Floats:
    if not np.all(values > 0):
        raise BadInputError(place, "numbers > 0", f"{values[~(values > 0)][0]}")
    return values


def read_touchstone_gain(path: Path, frequency_mhz: Floats) -> Floats:
    """The gain of a Touchstone file on the channels, between its rows linear in dB; shape (freq,).

    That is |S21|^2 where it has two ports, between their reference impedances: mismatches between stages are not in it.
    A file of one port is an antenna, and 1 - |S11|^2 the share of its power that the reference impedance takes.
    """
    nu, s, _ = read_touchstone(path)
    is_antenna = s.shape[-1] == 1
    share = 1.0 - np.abs(s[:, 0, 0]) ** 2 if is_antenna else np.abs(s[:, 1, 0]) ** 2
    gain = _require_positive(share, f"{path}: {'1 - |S11|^2' if is_antenna else 'S21'}")
    return interpolate_gain(nu, gain, frequency_mhz, str(path))


def _match(given: Mapping[str, Any], frequency_mhz: Floats, place: str, folder: Path | None) -> Floats:
    """What a load takes of the power of an antenna, both Touchstone files or ohm."""

    def impedance(name: str) -> Impedance:
        one, where = given[name], f"{place}.{name}"
        if isinstance(one, str) and folder is not None:
            return read_impedance(folder / one, frequency_mhz)
        return require_passive(np.full(frequency_mhz.size, parse_number(one, where), dtype=complex), where)

    return match_power(impedance("antenna"), impedance("load"))
