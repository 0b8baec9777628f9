"""What a file of calibration curves holds beside its rows (docs/formats/galcal.md)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from lbacal_core.curves.covariance import parse_budget, parse_covariance
from lbacal_core.curves.curves import FLAGS, OUTSIDE
from lbacal_core.grids import Floats, name_channels
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import hash_content

FORMAT = "galcal-1"
KEY = "galcal"
"""Where the head stands: a key of ECSV's metadata, an attribute of the HDF5 root, an image HDU of FITS."""
CARRIED = ("instrument", "models", "provenance")
"""Optional parts of a head."""


def name_path(curve: Mapping[str, Any]) -> str:
    """A path in words, as the key of its covariance: ``CS002 17 X``."""
    return " ".join(str(curve[name]) for name in ("station", "antenna", "dipole") if curve[name] not in (None, "", -1))


def make_head(content: Mapping[str, Any]) -> dict[str, Any]:
    """Everything of an answer or of a fit report that is not a row, as JSON values (docs/formats/galcal.md)."""
    return {
        "format": FORMAT,
        "at": content.get("at"),
        "as_of": content.get("as_of"),
        "covariances": {name_path(one): one["covariance"] for one in content["curves"] if one.get("covariance")},
        "budgets": content.get("budgets", {}),
        **{name: content[name] for name in CARRIED if name in content},
    }


def describe_made_with(instrument: Instrument, models: Mapping[str, Any] | None) -> dict[str, Any]:
    """The parts of a head that say where the antennas stand, how their arms point, and what the sky power is made of.

    Parameters
    ----------
    models
        `MadeFor.as_dict` of the sky power; None where it says nothing.
    """
    whole = instrument.as_dict()
    kept = ("name", "latitude_deg", "longitude_deg", "height_m", "dipoles", "sites")
    described = {name: whole[name] for name in kept if name in whole} | {"sha256": instrument.digest()}
    named = {name: value for name, value in (models or {}).items() if name in ("sky", "antenna", "hashes")}
    return {"instrument": described, **({"models": named} if named else {})}


# Whether what a file of calibration curves says agrees with itself (docs/formats/galcal.md).

SHOWN = 80
"""Characters of an error that a sentence shows."""
PER_CHANNEL = ("flag", "c", "c_sigma_stat", "c_sigma_sys", "antenna_gain", "c_over_h")
ROUNDING = 1e-3
"""Relative: numbers of the covariance have six digits, those of budgets six decimals of ln C."""
_numbers = partial(np.array, dtype=float)
"""Those of a channel without one, None, are NaN."""


def find_problems(content: Mapping[str, Any]) -> list[str]:
    """List the contradictions of curves and head with the format, a sentence each; empty where all agrees.

    Parameters
    ----------
    content
        Curves as JSON values, with `budgets`, `at`, `as_of`, and `instrument` where it is known.
    """
    problems = list(_check_instants(content))
    if content.get("format", FORMAT) != FORMAT:
        problems.append(f"format: expected {FORMAT}, found {content['format']!r}")
    names = [name_path(curve) for curve in content["curves"]]
    if not names:
        problems.append("there is no curve")
    problems += [f"{name}: given twice" for name in sorted({name for name in names if names.count(name) > 1})]
    for digest, budget in content.get("budgets", {}).items():
        if hash_content(budget) != digest:
            problems.append(f"budget {digest[:12]}: its content has another hash, {hash_content(budget)[:12]}")
    arms = content.get("instrument", {}).get("dipoles")
    for name, curve in zip(names, content["curves"], strict=True):
        if arms is not None and curve["dipole"] not in (None, *arms):
            problems.append(f"{name}: the instrument has no arm {curve['dipole']}, but {', '.join(arms)}")
        try:
            found = [*_check_path(curve), *_check_curve(curve, content.get("budgets", {}))]
            problems += [f"{name}: {problem}" for problem in found]
        except (KeyError, TypeError, ValueError) as error:
            problems.append(f"{name}: its fields are not those of a curve ({str(error)[:SHOWN]})")
    return problems


def _check_instants(content: Mapping[str, Any]) -> Iterator[str]:
    for name in ("at", "as_of"):
        if content.get(name) and _parse(content[name]) is None:
            yield f"{name}: expected ISO 8601, found {content[name]!r}"
    for curve in content["curves"]:
        valid = curve.get("valid") or {}
        start, end = (_parse(valid.get(name)) for name in ("from", "to"))
        if start is not None and end is not None and start >= end:
            yield f"{name_path(curve)}: valid from {valid['from']}, which is not before {valid['to']}"


def _parse(text: str | None) -> datetime | None:
    try:
        return datetime.fromisoformat(text) if text else None
    except ValueError:
        return None


def _check_path(curve: Mapping[str, Any]) -> Iterator[str]:
    for name, kind, said in (("station", str, "a text"), ("antenna", int, "a whole number"), ("dipole", str, "a text")):
        if not isinstance(curve[name], kind | None):
            yield f"{name}: expected {said} or null, found {curve[name]!r}"


def _check_curve(curve: Mapping[str, Any], budgets: Mapping[str, Any]) -> Iterator[str]:
    frequency = _numbers(curve["frequency_mhz"])
    if not np.all(np.isfinite(frequency)) or np.any(frequency <= 0) or any(b <= a for a, b in pairwise(frequency)):
        yield "frequency_mhz: expected rising numbers > 0"
    short = [name for name in PER_CHANNEL if curve.get(name) and len(curve[name]) != frequency.size]
    yield from (f"{name}: expected {frequency.size} channels, found {len(curve[name])}" for name in short)
    if short:
        return  # what else they say cannot be compared
    unknown = sorted({*curve["flag"]} - {*FLAGS})
    if unknown:
        yield f"flag: expected {', '.join(FLAGS)}, found {', '.join(unknown)}"
    has_value = np.array([flag != OUTSIDE for flag in curve["flag"]])
    c, stat = _numbers(curve["c"]), _numbers(curve["c_sigma_stat"])
    is_sound = has_value
    for name, values in (("c", c), ("c_sigma_stat", stat)):
        wrong = (np.isfinite(values) & (values > 0)) != has_value
        if np.any(wrong):
            where = name_channels(frequency[wrong])
            yield f"{name} at {where}: expected a number > 0 unless the flag is outside, and none if it is"
        is_sound = is_sound & ~wrong
    system = _numbers(curve["c_sigma_sys"]) if curve.get("c_sigma_sys") else None
    if system is not None and not np.all(np.isfinite(system[has_value]) & (system[has_value] > 0)):
        yield "c_sigma_sys: expected a number > 0 in every channel that has a C, or in none"
        system = None
    gain, over = curve.get("antenna_gain"), curve.get("c_over_h")
    if gain and over and not _agree(_numbers(over) * np.sqrt(_numbers(gain)), c, is_sound):
        yield "c_over_h: expected c over the root of antenna_gain"
    if curve.get("covariance"):
        yield from _check_covariance(curve, c, stat, system, budgets, is_sound)


def _check_covariance(
    curve: Mapping[str, Any], c: Floats, stat: Floats, system: Floats | None, budgets: Mapping[str, Any], at: Any
) -> Iterator[str]:
    """Check errors against their covariance in the channels `at`, where both are numbers."""
    given = curve["covariance"]
    rows = [*given["statistical"]["factor"], given["statistical"]["diagonal"], *given["systematic"]["own"]]
    if any(len(row) != c.size for row in rows):
        yield f"covariance: expected {c.size} channels, found {min(map(len, rows))} to {max(map(len, rows))}"
        return
    covariance = parse_covariance(given)
    if not _agree(c * np.sqrt(np.sum(covariance.factor**2, axis=0) + covariance.diagonal), stat, at):
        yield "covariance: expected c_sigma_stat^2 = c^2 (sum factor^2 + diagonal)"
    if covariance.budget is None or system is None:
        return
    if covariance.budget not in budgets:
        yield f"covariance: the file does not hold the budget {covariance.budget[:12]} that it names"
        return
    budget = parse_budget(budgets[covariance.budget])
    if curve["dipole"] not in (None, *{letter for term in budget.terms for letter in term.vectors}):
        yield f"budget {covariance.budget[:12]}: no vectors for the dipole {curve['dipole']}"
    elif curve["dipole"] is not None:
        variance = budget.variance(curve["dipole"]) + np.sum(covariance.own**2, axis=0)
        if not _agree(c * np.sqrt(variance), system, at):
            yield "covariance: expected c_sigma_sys^2 = c^2 (budget + sum own^2)"


def _agree(found: Floats, expected: Floats, at: Any) -> bool:
    return bool(np.allclose(found[at], expected[at], rtol=ROUNDING, atol=0.0))
