"""What extends a model: the findings of an investigation, of its report, or one of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

from lbacal_core.errors import BadInputError, UnreadableFileError

if TYPE_CHECKING:
    from lbacal_core.causes.model import Model
    from lbacal_core.uncertainty.left_open import OpenTerm


class Extension(NamedTuple):
    """Causes that a model is extended by, what the investigation that found them leaves open, and what it is called."""

    causes: Model
    left_open: Sequence[OpenTerm]
    place: str


class Extending(Protocol):
    """An investigation, or one of its findings."""

    @property
    def extension(self) -> Extension:
        """What it adds."""

    @property
    def left_open(self) -> Sequence[OpenTerm]:
        """What it leaves open where nothing but itself, if it is one finding, is adopted."""


Extended = str | Path | Extension | Extending | None
"""What a verb takes for `with_`: an investigation, a finding, or a report such as ``R.json#0``."""


def extend_by(given: Extended, place: str = "with_") -> Extension:
    """What extends the model; nothing where nothing is given."""
    if isinstance(given, Extension):
        return given
    if given is None or isinstance(given, str | Path):
        text = None if given is None else str(given)
        return Extension(read_model(text, place), read_open_terms(text, place), f"{place} {text}")
    return given.extension


def list_left_open(given: Extending | str | Path | None, place: str = "left_open") -> Sequence[OpenTerm]:
    """What an investigation leaves open; nothing where none is given."""
    if given is None or isinstance(given, str | Path):
        return read_open_terms(None if given is None else str(given), place)
    return given.left_open


HELP = (
    "Extend the model by the findings of a report (JSON), or by one of them: R.json#0 is the first, "
    "R.json#unexplained the structure without a name."
)


ADOPTING = ("--with", "with_")
"""What a command and a verb call the option that adopts findings."""


def report_path(text: str) -> Path:
    """The file of a value such as ``R.json#1``."""
    return Path(_split(text)[0])


def read_model(text: str | None, option: str = "--with") -> Model:
    """The model that a value such as ``R.json`` or ``R.json#1`` names; the chain alone without one."""
    from lbacal_core.causes.model import PLAIN, Model

    if text is None:
        return PLAIN
    name, number = _split(text)
    try:
        content = json.loads(Path(name).read_text())
    except (OSError, ValueError) as error:
        raise UnreadableFileError(f"{option} {name}: no report of an investigation can be read: {error}") from error
    if not isinstance(content, dict) or "verdict" not in content:
        raise BadInputError(f"{option} {name}", "a report of lbacal investigate", "another JSON file")
    try:
        return Model.from_report(content, number)
    except BadInputError as error:
        raise BadInputError(f"{option} {text}: {error.place}", error.expected, error.found) from error


def read_open_terms(text: str | None, option: str = "--with") -> list[OpenTerm]:
    """What a report leaves open beside the findings that are adopted: n of ``R.json#n``.

    ``R.json`` adopts all of them with an option of `ADOPTING`, and none with another.
    """
    from lbacal_core.uncertainty.left_open import list_open_terms

    if text is None:
        return []
    name, number = _split(text)
    try:
        content = json.loads(Path(name).read_text(encoding="utf-8"))
        every = range(len(content["findings"])) if option in ADOPTING else ()
        return list_open_terms(content, every if number is None else [number])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInputError(f"{option} {text}", "a report of lbacal investigate", "another file") from error


def _split(text: str) -> tuple[str, int | str | None]:
    name, hash_sign, number = text.rpartition("#")
    if not hash_sign or Path(text).is_file():
        return text, None
    if number == "unexplained":
        return name, number
    if not number.isdecimal():
        raise BadInputError(f"--with {text}", "the number of a finding after #, from 0", repr(number))
    return name, int(number)
