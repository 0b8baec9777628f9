"""What extends a model: the findings of an investigation, of its report, or one of them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from lbacal_core.errors import BadInputError, UnreadableFileError, reading, require_kind

if TYPE_CHECKING:
    from lbacal_core.calibration.left_open import OpenTerm
    from lbacal_core.causes.model import Model


class Reported(Protocol):
    """An investigation by its report, or by a number one of its findings."""

    @property
    def report(self) -> Mapping[str, Any]:
        """The report as JSON values."""

    @property
    def number(self) -> int | None:
        """The number of the finding; None for all of them."""


Extended = str | Path | Reported | None
"""What extends a model: an investigation, a finding, or a report such as ``R.json#0``."""
HELP = (
    "Extend the model by the findings of a report (JSON), or by one of them: R.json#0 is the first, "
    "R.json#unexplained the structure without a name."
)
ADOPTING = ("--with", "with_")
"""What a command and a verb call the option that adopts findings."""


def report_path(text: str) -> Path:
    """The file of a value such as ``R.json#1``."""
    return Path(_split(text)[0])


def read_model(given: Extended, option: str = "--with") -> Model:
    """The model that a value such as ``R.json`` or ``R.json#1`` names; the chain alone without one."""
    from lbacal_core.causes.model import PLAIN, Model

    if given is None:
        return PLAIN
    content, number = read_report(given, option)
    try:
        return Model.from_report(content, number)
    except BadInputError as error:
        place = f"{option} {given}: " if isinstance(given, str | Path) else ""
        raise BadInputError(f"{place}{error.place}", error.expected, error.found) from error


def read_open_terms(given: Extended, option: str = "--with") -> list[OpenTerm]:
    """Read the terms that a report leaves open beside the findings that are adopted: n of ``R.json#n``.

    ``R.json`` adopts all of them with an option of `ADOPTING`, and none with another.
    """
    from lbacal_core.calibration.left_open import list_open_terms

    if given is None:
        return []
    try:
        content, number = read_report(given, option, field="findings")
        every = range(len(content["findings"])) if option in ADOPTING else ()
        return list_open_terms(content, every if number is None else [number])
    except (UnreadableFileError, KeyError, TypeError) as error:
        raise BadInputError(f"{option} {given}", "a report of lbacal investigate", "another file") from error


def read_report(
    given: str | Path | Reported, option: str, field: str = "verdict"
) -> tuple[Mapping[str, Any], int | str | None]:
    """A report, or the content of its file, and the number of a finding behind # (``unexplained``; None for none)."""
    if hasattr(given, "report") and hasattr(given, "number"):
        return given.report, given.number
    require_kind(option, given, str | Path, "an investigation, a finding, or a report such as 'R.json#0'")
    name, number = _split(str(given))
    with reading(f"{option} {name}: no report of an investigation can be read", OSError, ValueError):
        content = json.loads(Path(name).read_text(encoding="utf-8"))
    if not isinstance(content, dict) or field not in content:
        raise BadInputError(f"{option} {name}", "a report of lbacal investigate", "another JSON file")
    return content, number


def _split(text: str) -> tuple[str, int | str | None]:
    name, hash_sign, number = text.rpartition("#")
    if not hash_sign or Path(text).is_file():
        return text, None
    if number == "unexplained":
        return name, number
    if not number.isdecimal():
        raise BadInputError(f"--with {text}", "the number of a finding after #, from 0", repr(number))
    return name, int(number)
