"""Causes of an installation: sentences that somebody named, kept in a file beside the catalogue."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lbacal_core.causes.catalogue import CAUSES, DESCRIPTIONS
from lbacal_core.causes.cause import Cause, Conditions, Template
from lbacal_core.causes.grammar import Sentence, columns_of, in_words, parts_of, require_sentence
from lbacal_core.errors import BadInputError
from lbacal_core.foreign import read_json

FORMAT = "lbacal-causes-1"
_NAME = re.compile(r"[a-z][a-z0-9_]{2,40}")


@dataclass(frozen=True)
class NamedSentence(Sentence):
    """A sentence by the name that an installation gave it.

    Attributes
    ----------
    template
        Its place, law and course.
    """

    template: Template = field(default_factory=Template)

    @classmethod
    def of(cls, name: str, parameters: Mapping[str, Any]) -> NamedSentence:
        """The cause of a name, with the parameters of a sentence."""
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise BadInputError(
                "name of a cause", "a lower-case letter, then 2 to 40 lower-case letters, digits or _", repr(name)
            )
        if name in {one.identifier for one in (*DESCRIPTIONS, Sentence())}:
            raise BadInputError("name of a cause", "one that the catalogue does not have", repr(name))
        require_sentence(f"cause {name}", parameters)
        template = Template({part: parameters[part] for part in ("place", "law", "course")})
        return cls(identifier=name, meaning=in_words(template), template=template)

    def templates(self, conditions: Conditions) -> list[Template]:
        """Its own, where the data have the columns that it reads."""
        columns = columns_of(parts_of(self.template)[2])
        return [self.template] if all(conditions.covariate(name) is not None for name in columns) else []

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """Itself: it was named with its numbers."""
        return [template]


def read_own_causes(path: Path | None) -> tuple[Cause, ...]:
    """Read the causes of a file; none where no file is named."""
    if path is None:
        return ()
    place = f"causes {path}"
    try:
        content = read_json(path)
        if content["format"] != FORMAT:
            raise BadInputError(f"{place}: format", FORMAT, repr(content["format"]))
        named = [(one["name"], one) for one in content["causes"]]
    except (ValueError, KeyError, TypeError) as error:
        expected = f'a file as `lbacal causes add` writes it: {{"format": "{FORMAT}", "causes": [...]}}'
        raise BadInputError(place, expected, f"{type(error).__name__}: {error}") from error
    found = [NamedSentence.of(name, parameters) for name, parameters in named]
    twice = {one.identifier for one in found if [name for name, _ in named].count(one.identifier) > 1}
    if twice:
        raise BadInputError(place, "each name once", ", ".join(sorted(twice)))
    return tuple(found)


def find_sentence(report: Mapping[str, Any], number: int | str | None) -> Mapping[str, Any]:
    """The parameters of the sentence that a report has as a finding, or as the likeliest of its structure."""
    if isinstance(number, int):
        findings: Sequence[Mapping[str, Any]] = report.get("findings", [])
        if not 0 <= number < len(findings):
            raise BadInputError(f"report: finding {number}", f"a number below {len(findings)}", str(number))
        parameters: Mapping[str, Any] = findings[number]["parameters"]
        if "course" not in parameters:
            raise BadInputError(f"report: finding {number}", "a sentence", f"{findings[number]['cause']}, catalogued")
        return parameters
    sentences = (report.get("unexplained") or {}).get("sentences")
    if not sentences:
        raise BadInputError("report: unexplained", "structure that a sentence describes", "none")
    said: Mapping[str, Any] = sentences[0]["parameters"]
    return said


def own_causes_text(causes: Sequence[Cause]) -> str:
    """The text of a file with the causes among these that have names of an installation."""
    kept = [{"name": one.identifier, **one.template.parameters} for one in causes if isinstance(one, NamedSentence)]
    return json.dumps({"format": FORMAT, "causes": kept}, indent=1, ensure_ascii=False) + "\n"


def catalogue_with(path: Path | None) -> tuple[Cause, ...]:
    """The causes that an installation looks for: the catalogue, and those of its file."""
    return (*CAUSES, *read_own_causes(path))
