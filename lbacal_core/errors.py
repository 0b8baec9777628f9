"""Failures a user can cause or cure: each states what was found, what was expected and what to do next."""

from __future__ import annotations

LONGEST_FOUND = 120
"""Characters of what was found that a message shows: a file may hold megabytes in the wrong place."""


class LbacalError(Exception):
    """An expected failure, stated in one line. `status` is its HTTP status, `code` its stable short name.

    `detail` is what only whoever runs a command here may read beside it.
    """

    status = 500
    code = "failed"
    detail = ""

    def __init__(self, sentence: str) -> None:
        super().__init__(_on_one_line(sentence))


class BadInputError(LbacalError):
    """Input that does not follow its format: names the place, what was expected and what was found.

    The place is a file, a field and, where there is one, a row: ``spectra.h5: power, row 17``.
    """

    status = 422
    code = "bad_input"

    def __init__(self, place: str, expected: str, found: str) -> None:
        self.place = place
        self.expected = expected
        self.found = _on_one_line(found)
        if len(self.found) > LONGEST_FOUND:
            self.found = f"{self.found[:LONGEST_FOUND]}..."
        super().__init__(f"{place}: expected {expected}, found {self.found}")


class UnreadableFileError(LbacalError):
    """A file that is missing, empty, truncated or of another kind."""

    status = 400
    code = "unreadable_file"


class UnknownNameError(LbacalError):
    """A name that nothing answers to; the message lists the names that exist."""

    status = 404
    code = "unknown_name"

    def __init__(self, kind: str, name: str, known: list[str]) -> None:
        super().__init__(f"unknown {kind} {name!r}; known: {', '.join(known)}, or the path of a file")


class MissingExtraError(LbacalError):
    """A part of the package that is not installed where it is needed."""

    code = "missing_extra"

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs the extra {extra}: pip install 'lbacal[{extra}]'")


def _on_one_line(text: str) -> str:
    words = " ".join(text.split())
    # Bytes from a file could steer the terminal that shows them.
    return words if words.isprintable() else "".join(c if c.isprintable() else "?" for c in words)
