"""Stages from an instrument file: gains as numbers, decibels, tables and Touchstone files; noise temperatures."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.errors import BadInputError, MissingExtraError, UnreadableFileError
from lbacal_core.grids import Floats, require_channels
from lbacal_core.json_values import parse_name, parse_number, parse_numbers
from lbacal_core.stages import FREE, IN_LINE, KINDS, Stage, require_chain

FIELDS = (
    "name", "kind", "gain", "gain_db", "noise_temperature_k", "noise_temperature_error_k", "solid_angle_sr",
)  # fmt: skip
TWO_PORTS = (2, 2)


def parse_stages(content: Any, frequency_mhz: Floats, place: str, folder: Path | None) -> tuple[Stage, ...]:
    """The stages of an instrument file on its channels.

    Parameters
    ----------
    content
        The list, as docs/formats.md describes it.
    folder
        Where the Touchstone files are that it names; None where there are none to be read.
    """
    if not isinstance(content, list) or not content:
        raise BadInputError(place, "a list of stages", type(content).__name__)
    stages = tuple(_parse_stage(one, frequency_mhz, f"{place}, row {k}", folder) for k, one in enumerate(content))
    require_chain(stages, place)
    return stages


def _parse_stage(content: Any, frequency_mhz: Floats, place: str, folder: Path | None) -> Stage:
    if not isinstance(content, dict) or not {"name", "kind"} <= set(content):
        raise BadInputError(place, "a stage with name and kind", repr(content))
    unknown = sorted(set(content) - set(FIELDS))
    if unknown:
        raise BadInputError(place, f"the fields {', '.join(FIELDS)}", unknown[0])
    kind = content["kind"]
    if kind not in KINDS:
        raise BadInputError(f"{place}: kind", f"one of {', '.join(KINDS)}", repr(kind))
    noise = content.get("noise_temperature_k")
    error = parse_number(content.get("noise_temperature_error_k", 0.0), f"{place}: noise_temperature_error_k")
    angle = parse_number(content.get("solid_angle_sr", 1.0), f"{place}: solid_angle_sr")
    noise_k = None if noise in (None, FREE) else _noise(noise, frequency_mhz, f"{place}: noise_temperature_k")
    if error < 0 or (error > 0 and noise_k is None) or angle <= 0:
        raise BadInputError(place, "an error >= 0 of a known noise_temperature_k, and a solid angle > 0", "another")
    gain = _gain(content, frequency_mhz, place, folder)
    if kind in ("lna", "filter", "amplifier") and gain is None:
        raise BadInputError(place, "a gain or gain_db", "none")
    if kind not in (*IN_LINE, "antenna") and gain is not None:
        raise BadInputError(place, f"no gain of what the antenna sees ({kind})", "one")
    return Stage(
        name=parse_name(content["name"], f"{place}: name"),
        kind=kind,
        gain=gain,
        noise_k=noise_k,
        is_free=noise == FREE,
        error_k=error,
        solid_angle_sr=angle,
    )


def _gain(content: Mapping[str, Any], frequency_mhz: Floats, place: str, folder: Path | None) -> Floats | None:
    """Linear power gain of a stage on the channels, None where it gives none."""
    if "gain" in content and "gain_db" in content:
        raise BadInputError(place, "gain or gain_db", "both")
    if "gain_db" in content:
        return np.asarray(10.0 ** (_on_channels(content["gain_db"], frequency_mhz, f"{place}: gain_db") / 10.0))
    given = content.get("gain")
    if given is None:
        return None
    if isinstance(given, str):
        if folder is None:
            raise BadInputError(f"{place}: gain", "a number or a table (no folder to look for files in)", given)
        return read_touchstone_gain(folder / given, frequency_mhz)
    if isinstance(given, dict) and "gain_db" in given:
        table = {"frequency_mhz": given.get("frequency_mhz"), "value": given["gain_db"]}
        return np.asarray(10.0 ** (_on_channels(table, frequency_mhz, f"{place}: gain") / 10.0))
    if isinstance(given, dict):
        table = {"frequency_mhz": given.get("frequency_mhz"), "value": given.get("gain")}
        gains = _require_positive(parse_numbers(table["value"], f"{place}: gain.gain"), f"{place}: gain")
        table["value"] = np.log(gains).tolist()
        return np.exp(_on_channels(table, frequency_mhz, f"{place}: gain"))
    return _require_positive(_on_channels(given, frequency_mhz, f"{place}: gain"), f"{place}: gain")


def _noise(given: Any, frequency_mhz: Floats, place: str) -> Floats:
    if isinstance(given, dict):
        given = {"frequency_mhz": given.get("frequency_mhz"), "value": given.get("noise_temperature_k")}
    return _require_positive(_on_channels(given, frequency_mhz, place), place)


def _on_channels(given: Any, frequency_mhz: Floats, place: str) -> Floats:
    """A number, a number a channel, or a table that is interpolated linearly; shape (freq,)."""
    if isinstance(given, dict):
        nu = parse_numbers(given["frequency_mhz"], f"{place}.frequency_mhz")
        return interpolate(nu, parse_numbers(given["value"], place), frequency_mhz, place)
    if isinstance(given, list):
        values = parse_numbers(given, place)
        if values.shape != frequency_mhz.shape:
            raise BadInputError(
                place, f"one number, {frequency_mhz.size} or a table with frequency_mhz", f"{values.size}"
            )
        return values
    return np.full(frequency_mhz.size, parse_number(given, place))


def interpolate(nu: Floats, values: Floats, frequency_mhz: Floats, place: str) -> Floats:
    """Values of a table on the channels, which it must cover, linear between its rows."""
    require_channels(place, nu)
    if nu.shape != values.shape:
        raise BadInputError(place, f"a value for each of {nu.size} frequencies", f"{values.size}")
    if nu[0] > frequency_mhz[0] or nu[-1] < frequency_mhz[-1]:
        expected = f"a table from {frequency_mhz[0]:g} to {frequency_mhz[-1]:g} MHz"
        raise BadInputError(place, expected, f"{nu[0]:g} to {nu[-1]:g} MHz")
    return np.interp(frequency_mhz, nu, values)


def _require_positive(values: Floats, place: str) -> Floats:
    if not np.all(values > 0):
        raise BadInputError(place, "numbers > 0", f"{values[~(values > 0)][0]}")
    return values


def read_touchstone_gain(path: Path, frequency_mhz: Floats) -> Floats:
    """|S21|^2 of a two-port Touchstone file on the channels, between its rows linear in dB; shape (freq,).

    The gain between the reference impedances of the file: mismatches between stages are not in it.
    """
    try:
        import skrf
    except ImportError as error:
        raise MissingExtraError(f"{path}, a Touchstone file,", "touchstone") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            network = skrf.Network(str(path))
            nu, s = np.asarray(network.f, dtype=float) / 1e6, np.asarray(network.s)
    except (OSError, ValueError, IndexError, KeyError, TypeError, NotImplementedError) as error:
        raise UnreadableFileError(f"{path}: expected a Touchstone file ({error})") from error
    if s.shape[1:] != TWO_PORTS:
        raise BadInputError(str(path), "a Touchstone file of two ports (.s2p)", f"{s.shape[-1]}")
    gain = _require_positive(np.abs(s[:, 1, 0]) ** 2, f"{path}: S21")
    return np.exp(interpolate(nu, np.log(gain), frequency_mhz, str(path)))
