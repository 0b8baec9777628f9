"""Failures a user can cause or cure: each states what was found, what was expected and what to do next."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

LONGEST_FOUND = 120
"""Characters of what was found that a message shows: a file may hold megabytes in the wrong place."""


class LbacalError(Exception):
    """An expected failure, stated in one line. `status` is its HTTP status, `code` its stable short name.

    `detail` is what only whoever runs a command here may read beside it.
    """

    status = 500
    code = "failed"
    detail = ""

    def __init_subclass__(cls, status: int | None = None, code: str | None = None) -> None:
        cls.status, cls.code = status or cls.status, code or cls.code

    def __init__(self, sentence: str) -> None:
        super().__init__(_on_one_line(sentence))

    def __reduce__(self) -> tuple[Any, ...]:
        return _make_again, (type(self), self.args, vars(self))


def _make_again(kind: type[LbacalError], args: tuple[Any, ...], more: dict[str, Any]) -> LbacalError:
    """Make an error that another process raised: classes are made from other words than their sentence."""
    made = kind.__new__(kind, *args)
    vars(made).update(more)
    return made


class BadInputError(LbacalError, status=422, code="bad_input"):
    """Input that does not follow its format: names the place, what was expected and what was found.

    The place is a file, a field and, where there is one, a row: ``spectra.h5: power, row 17``.
    """

    def __init__(self, place: str, expected: str, found: str) -> None:
        self.place = place
        self.expected = expected
        self.found = _on_one_line(found)
        if len(self.found) > LONGEST_FOUND:
            self.found = f"{self.found[:LONGEST_FOUND]}..."
        super().__init__(f"{place}: expected {expected}, found {self.found}")


class UnreadableFileError(LbacalError, status=400, code="unreadable_file"):
    """A file that is missing, empty, truncated or of another kind."""


@contextmanager
def reading(sentence: str, *failures: type[Exception]) -> Iterator[None]:
    """Say in a sentence, with the reason, that a file cannot be read; `failures` are what a library then raises."""
    try:
        yield
    except failures as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UnreadableFileError(f"{sentence} ({reason[:LONGEST_FOUND]})") from error


class UnknownNameError(LbacalError, status=404, code="unknown_name"):
    """A name that nothing answers to; the message offers the one that may be meant, and lists those that exist."""

    def __init__(self, kind: str, name: str, known: list[str]) -> None:
        near = near_name(name, known)
        meant = f"is {near} meant? " if near else ""
        no_file, of_file = (", and no such file", ", or the path of a file") if kind in KINDS_IN_FILES else ("", "")
        super().__init__(f"unknown {kind} {name!r}{no_file}; {meant}known: {', '.join(known)}{of_file}")


KINDS_IN_FILES = ("instrument", "sky model", "antenna model")


def near_name(name: str, known: Collection[str]) -> str | None:
    """The one of some names that is most like another, whatever its case; None where none is."""
    plain = {one.lower(): one for one in known}
    held = [one for one in plain if name and name.lower() in one]
    found = held or get_close_matches(name.lower(), plain, n=1)
    return plain[found[0]] if found else None


def offer_name(name: Any, known: Collection[str]) -> str:
    """Quote a name that was found, with the one of some names that may be meant: ``'cs002' (is CS002 meant?)``."""
    near = near_name(str(name), known)
    return f"{name!r} (is {near} meant?)" if near else repr(name)


def require_name(place: str, name: Any, known: Collection[str]) -> None:
    """Refuse a name that is not among some."""
    if name not in known:
        raise BadInputError(place, f"one of {', '.join(known)}", offer_name(name, known))


ALIKE = 0.8
"""Likeness (difflib) from which an unknown field is a misspelt one: `cabels` has 0.83 to `cables`, and `antenna_type`,
somebody else's, 0.70 to `antennas`."""


def refuse_misspelt(place: str, given: Collection[str], known: Collection[str]) -> None:
    """Refuse a field whose name is nearly one that is not given; others are somebody else's and left alone."""
    absent = [name for name in known if name not in given]
    for field in sorted({*given} - {*known}):
        for meant in get_close_matches(field.lower(), absent, 1, ALIKE):
            raise BadInputError(f"{place}: {meant}", f"the field {meant!r} or none", repr(field))


def require_parts(place: str, kind: str, wanted: Sequence[str], given: Container[str]) -> None:
    """Refuse what lacks some parts of a kind, such as ``columns``, and name them."""
    missing = [name for name in wanted if name not in given]
    if missing:
        raise BadInputError(place, f"the {kind} {', '.join(wanted)}", f"no {', '.join(missing)}")


def require_antenna(place: str, antenna: int, station: str, known: Collection[int]) -> None:
    """Refuse a number that none of the antennas of a station has."""
    if antenna not in known:
        first, last = min(known), max(known)
        is_whole = len(known) == last - first + 1
        there = f"{first} to {last}" if is_whole else ", ".join(map(str, sorted(known)))
        raise BadInputError(place, f"an antenna of {station} ({there})", str(antenna))


def require_kind(place: str, value: Any, kind: Any, expected: str) -> None:
    """Refuse a value of another type."""
    if not isinstance(value, kind):
        is_plain = value is None or isinstance(value, str | int | float)
        raise BadInputError(place, expected, repr(value) if is_plain else type(value).__name__)


class MissingExtraError(LbacalError, code="missing_extra"):
    """A part of the package that is not installed where it is needed."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs the extra {extra}: pip install 'lbacal[{extra}]'")


@contextmanager
def needing(what: str, extra: str) -> Iterator[None]:
    """Name the extra that installs a module which cannot be imported."""
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(what, extra) from error


def _on_one_line(text: str) -> str:
    words = " ".join(text.split())
    # Bytes from a file could steer the terminal that shows them.
    return words if words.isprintable() else "".join(c if c.isprintable() else "?" for c in words)


# How values are written to people, the same in alarms, on pages and by commands: a path, a chance, a share.
#
# Keys that a program reads back are written elsewhere: that of a scope is `lbacal_core.curves.validity.Scope.key`.

SMALLEST_CHANCE = 1e-300
"""A smaller probability is a rounding error of double precision: it is told as smaller than this one."""


def name_path(station: str | None, antenna: int | None = None, dipole: str | None = None) -> str:
    """Name a path, a station, one of its polarisations, or the array: ``CS002 antenna 17 X``."""
    parts = [station or "array"]
    parts += [] if antenna is None else [f"antenna {antenna}"]
    parts += [dipole] if dipole else []
    return " ".join(parts)


def write_chance(p_value: float) -> str:
    """Write a p-value with what it is: ``p = 3.1e-05``."""
    return f"p < {SMALLEST_CHANCE:.0e}" if p_value < SMALLEST_CHANCE else f"p = {p_value:.1e}"


def write_count(count: int, one: str, several: str = "") -> str:
    """Write how many there are of what: ``1 job``, ``3 jobs``."""
    return f"1 {one}" if count == 1 else f"{count} {several or one + 's'}"


def write_percent(fraction: float, digits: int = 2) -> str:
    """Write a change with its sign: ``+1.25 %``."""
    return f"{100.0 * fraction:+.{digits}f} %"


def write_change(fraction: float, sigma: float) -> str:
    """Write a change and its error: ``+1.25 ± 0.20 %``."""
    return f"{100.0 * fraction:+.2f} ± {100.0 * sigma:.2f} %"
