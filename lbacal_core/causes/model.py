"""The model as a value: the signal chain, and the causes that were adopted into it.

A model without causes is the chain alone. Its canonical text is what is hashed, kept and compared: sizes and parameters
with 6 significant digits, instants to the second, causes in the order of the catalogue. A size that is free is fitted
again with every calibration; the text keeps the size as it was adopted, and no fitted value changes it.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from typing import Any

import numpy as np

from lbacal_core.causes.axes import ResidualTerm
from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Cause, Template
from lbacal_core.causes.grammar import Sentence, is_of_dates, require_sentence
from lbacal_core.errors import BadInputError
from lbacal_core.foreign import write_instant
from lbacal_core.provenance import canonical_json, hash_content

FORMAT = "lbacal-model-1"
DIGITS = 6
"""Significant digits of the sizes and parameters of an adopted cause."""
ACTING: Mapping[str, Cause] = {cause.identifier: cause for cause in (*CAUSES, Sentence(), ResidualTerm())}
"""What can be adopted: causes that act from event to event, in the order in which they act, sentences, smooth terms."""
UNEXPLAINED = "unexplained"
"""The structure without a name of a report, where the number of a finding is meant."""
INSTANT, IN_WORDS = "date_unix", "date"
"""The parameter that is an instant, and its name in a text."""


def follows_date(cause: str, parameters: Mapping[str, Any]) -> bool:
    """Whether a cause acts along the date: it steps, drifts, or follows the season."""
    if "course" in parameters:
        return is_of_dates(parameters["course"])
    return cause == "gain_drift" or INSTANT in parameters or parameters.get("follows") == "season"


@dataclass(frozen=True)
class AdoptedCause:
    """A cause that is part of the model of one station.

    Attributes
    ----------
    cause
        Identifier in the catalogue.
    station
        Name of the station.
    target
        The affected paths as a report names them: ``station``, ``antenna 17``, ``antenna 17 X``, ``cable 80``, ``group
        board 3``.
    size, sigma
        As adopted, in the unit of the cause.
    parameters
        Those of its template, by name.
    is_free
        Whether the size is fitted again with every calibration; otherwise it stays at its value with its sigma.
    since_unix, until_unix
        When it acts, s UTC, half open; None where an end is open.
    """

    cause: str
    station: str
    target: str
    size: float
    sigma: float
    parameters: Mapping[str, Any] = field(default_factory=dict)
    is_free: bool = True
    since_unix: int | None = None
    until_unix: int | None = None

    def __post_init__(self) -> None:
        if self.cause not in ACTING:
            expected = "a cause that acts from event to event: what is constant is in A(nu), and C is right without it"
            raise BadInputError("adopted cause", expected, repr(self.cause))
        place = f"adopted cause {self.cause}"
        if self.cause == Sentence.identifier:
            require_sentence(place, self.parameters)
        for name in ("station", "target"):
            if not isinstance(getattr(self, name), str) or not getattr(self, name):
                raise BadInputError(f"{place}: {name}", "a name", repr(getattr(self, name)))
        object.__setattr__(self, "size", _rounded(f"{place}: size", self.size))
        object.__setattr__(self, "sigma", _rounded(f"{place}: sigma", self.sigma))
        if self.sigma <= 0:
            raise BadInputError(f"{place}: sigma", "a standard deviation > 0", repr(self.sigma))
        kept = {name: value for name, value in sorted(self.parameters.items()) if name != IN_WORDS}
        rounded = {name: _plain(f"{place}: {name}", name, value) for name, value in kept.items()}
        object.__setattr__(self, "parameters", rounded)
        if self.since_unix is not None and self.until_unix is not None and self.until_unix <= self.since_unix:
            raise BadInputError(f"{place}: until", "an instant after since", write_instant(self.until_unix))

    @property
    def in_catalogue(self) -> Cause:
        """The cause as the catalogue has it."""
        return ACTING[self.cause]

    @property
    def sentence(self) -> str:
        """What is adopted, in one sentence."""
        whom = f"station {self.station}" + ("" if self.target == "station" else f", {self.target}")
        size = f"{self.size:.3g} ± {self.sigma:.2g} ({self.in_catalogue.unit})"
        ends = [
            f"{word} {write_instant(at)}" for word, at in (("from", self.since_unix), ("until", self.until_unix)) if at
        ]
        kept = "" if self.is_free else ", size not fitted again"
        what = self.in_catalogue.say(Template(self.parameters))
        return f"In {whom}, {what}: {size}{''.join(f', {one}' for one in ends)}{kept}."

    def acts_between(self, since_unix: float, until_unix: float) -> bool:
        """Whether its interval touches another, half open."""
        begins_before = self.since_unix is None or self.since_unix < until_unix
        return begins_before and (self.until_unix is None or self.until_unix > since_unix)

    def as_dict(self) -> dict[str, Any]:
        """The content of its text: these fields, `is_free` as `size_is`, the ends as `since` and `until`, ISO 8601."""
        named = {IN_WORDS if name == INSTANT else name: value for name, value in self.parameters.items()}
        if INSTANT in self.parameters:
            named[IN_WORDS] = write_instant(self.parameters[INSTANT])
        return {
            "cause": self.cause,
            "station": self.station,
            "target": self.target,
            "parameters": named,
            "size": self.size,
            "sigma": self.sigma,
            "size_is": "free" if self.is_free else "fixed",
            "since": None if self.since_unix is None else write_instant(self.since_unix),
            "until": None if self.until_unix is None else write_instant(self.until_unix),
        }


def _parse_cause(content: Mapping[str, Any]) -> AdoptedCause:
    parameters = dict(content["parameters"])
    if IN_WORDS in parameters:
        parameters[INSTANT] = _parse_instant(parameters.pop(IN_WORDS))
    return AdoptedCause(
        cause=content["cause"],
        station=content["station"],
        target=content["target"],
        size=content["size"],
        sigma=content["sigma"],
        parameters=parameters,
        is_free={"free": True, "fixed": False}[content["size_is"]],
        since_unix=None if content["since"] is None else _parse_instant(content["since"]),
        until_unix=None if content["until"] is None else _parse_instant(content["until"]),
    )


@dataclass(frozen=True)
class Model:
    """The chain and the adopted causes, in the order of the catalogue whatever the order of their adoption."""

    causes: tuple[AdoptedCause, ...] = ()

    def __post_init__(self) -> None:
        order = list(ACTING)
        ranked = sorted(self.causes, key=lambda one: (order.index(one.cause), canonical_json(one.as_dict())))
        object.__setattr__(self, "causes", tuple(ranked))
        seen: set[str] = set()
        for one in ranked:
            what = canonical_json([one.cause, one.station, one.target, one.as_dict()["parameters"]])
            if what in seen:
                raise BadInputError(f"model: {one.cause} in {one.target} of {one.station}", "one size", "two")
            seen.add(what)

    @property
    def covariates(self) -> set[str]:
        """The covariates that its causes follow."""
        return {name for one in self.causes for name in one.in_catalogue.covariates(Template(one.parameters))}

    @property
    def is_plain(self) -> bool:
        """Whether it is the chain alone."""
        return not self.causes

    def to_text(self) -> str:
        """The canonical text."""
        return canonical_json(self._content)

    @property
    def _content(self) -> dict[str, Any]:
        return {"format": FORMAT, "causes": [one.as_dict() for one in self.causes]}

    @cached_property
    def id(self) -> str:
        """SHA-256 (hex) of the text."""
        return hash_content(self._content)

    @cached_property
    def by_id(self) -> dict[str, AdoptedCause]:
        """Its causes, each by the id of the model that has it alone."""
        return {Model((one,)).id: one for one in self.causes}

    @classmethod
    def from_dicts(cls, causes: Iterable[Mapping[str, Any]]) -> Model:
        """A model of causes as `AdoptedCause.as_dict` gives them."""
        return cls(tuple(_parse_cause(one) for one in causes))

    @classmethod
    def from_text(cls, text: str) -> Model:
        """Read a text as `to_text` writes it."""
        try:
            content = json.loads(text)
            if content["format"] != FORMAT:
                raise BadInputError("model: format", FORMAT, repr(content["format"]))
            return cls.from_dicts(content["causes"])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BadInputError("model", f"the fields of {FORMAT}", f"{type(error).__name__}: {error}") from error

    @classmethod
    def from_report(cls, report: Mapping[str, Any], number: int | str | None = None) -> Model:
        """The model with which a report was made, extended by one of its findings, or by all of them.

        Parameters
        ----------
        report
            The report of an investigation as JSON values.
        number
            Number of the finding, from 0; ``unexplained`` for the structure without a name; None for all findings.
        """
        made_with = report.get("model")
        before = cls() if made_with is None else cls.from_text(made_with)
        if number is None and not before.is_plain and not report.get("findings"):
            return before
        return before.adopt(report, number)

    def adopt(self, report: Mapping[str, Any], number: int | str | None = None, since_unix: int | None = None) -> Model:
        """The same model extended by a finding of a report, or by all of them, as `from_report`.

        They act from `since_unix` on, s UTC; None for the first event of the report.
        """
        if number == UNEXPLAINED:
            return Model((*self.causes, _adopt_structure(report.get("unexplained"), since_unix)))
        findings: Sequence[Mapping[str, Any]] = report.get("findings", [])
        if not findings:
            told = f"none: its verdict is {report.get('verdict')!r}"
            told += "; give unexplained in place of a number" if report.get(UNEXPLAINED) else ""
            raise BadInputError("report", "a finding to adopt", told)
        if number is not None and (isinstance(number, str) or not 0 <= number < len(findings)):
            raise BadInputError(f"report: finding {number}", f"a number from 0 to {len(findings) - 1}", str(number))
        taken = range(len(findings)) if number is None else [int(number)]
        return Model((*self.causes, *(_adopt_finding(findings[k], f"finding {k}", since_unix) for k in taken)))

    def require_one_c(self, place: str) -> None:
        """Refuse causes along the date: C changes with them, and a fit gives one C for the whole window."""
        for one in self.causes:
            if follows_date(one.cause, one.parameters):
                at = f" on {write_instant(one.parameters[INSTANT])[:10]}" if INSTANT in one.parameters else ""
                expected = (
                    "a cause that does not follow the date: with one that does, one C would stand for a time in which "
                    "C changes; it is a change: put it in force by `lbacal changes` in the service, where windows are "
                    "cut at a step and C follows a drift; from files fit before and after it (--until, --since), and "
                    "adopt other findings one by one (R.json#n)"
                )
                raise BadInputError(place, expected, f"{one.cause}{at} in {one.target} of {one.station}")

    def without(self, number: int) -> Model:
        """The model without one of its causes."""
        return Model(tuple(one for k, one in enumerate(self.causes) if k != number))

    def during(self, since_unix: float, until_unix: float) -> Model:
        """The causes that act in an interval, s UTC, half open."""
        return Model(tuple(one for one in self.causes if one.acts_between(since_unix, until_unix)))

    def of_stations(self, names: Collection[str]) -> Model:
        """The causes of some stations."""
        return Model(tuple(one for one in self.causes if one.station in names))


PLAIN = Model()
"""The chain alone."""


def _adopt_finding(finding: Mapping[str, Any], place: str, since_unix: int | None) -> AdoptedCause:
    try:
        cause, size, where = finding["cause"], finding["size"], finding["where"]
        if "station" not in where:
            raise BadInputError(place, "a finding of spectra, which names a station", "one of an LST curve")
        if finding["evidence"].get("of_record"):
            expected = "a cause that a model can have; put the record right instead, and investigate again"
            raise BadInputError(place, expected, f"{cause} of the record")
        if size["sigma"] is None:
            raise BadInputError(place, "a size with an error", f"{cause} at {size['value']}")
        begin = _parse_instant(where["dates"][0]) if since_unix is None else since_unix
        target, parameters = finding["evidence"]["target"], finding["parameters"]
        cause = Sentence.identifier if "course" in parameters else cause
    except (KeyError, TypeError, IndexError) as error:
        raise BadInputError(place, "the fields of a finding", f"{type(error).__name__}: {error}") from error
    return AdoptedCause(
        cause, where["station"], target, size["value"], size["sigma"], parameters, is_free=True, since_unix=begin
    )


def _adopt_structure(structure: Mapping[str, Any] | None, since_unix: int | None) -> AdoptedCause:
    """The likeliest sentence of a structure, or its smooth term where no sentence describes it.

    The size of the smooth term is shrunk: of its gain in chi^2 the number of its terms is noise.
    """
    place = "report: unexplained"
    if structure is None:
        raise BadInputError(place, "structure to adopt", "none")
    if structure.get("sentences"):
        one, where = structure["sentences"][0], structure["where"]
        begin = _parse_instant(where["dates"][0]) if since_unix is None else since_unix
        size, sigma = one["size"]["value"], one["size"]["sigma"]
        return AdoptedCause(
            one["cause"], where["station"], one["target"], size, sigma, one["parameters"], since_unix=begin
        )
    term, gain = structure.get("term"), structure["gain"]
    if term is None:
        found = f"structure along {structure['where'].get('axis')} in {structure['where'].get('target')}"
        raise BadInputError(place, "a smooth term along an axis that recurs, in the mean of a station", found)
    where, chi2 = structure["where"], float(gain["chi2"])
    begin = _parse_instant(where["dates"][0]) if since_unix is None else since_unix
    size, sigma = 1.0 - gain["terms"] / chi2, chi2**-0.5
    return AdoptedCause(ResidualTerm.identifier, where["station"], "station", size, sigma, term, since_unix=begin)


def _rounded(place: str, value: object) -> float:
    """A number with 6 significant digits."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not np.isfinite(value):
        raise BadInputError(place, "a finite number", repr(value))
    return float(f"{float(value):.{DIGITS}g}") or 0.0


def _plain(place: str, name: str, value: object) -> Any:
    """The value of a parameter as a text keeps it: an instant to the second, whole numbers without a point."""
    if name == INSTANT:
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise BadInputError(place, "an instant, s UTC", repr(value))
        return int(np.floor(float(value)))
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(place, "", one) for key, one in sorted(value.items())}
    if isinstance(value, Sequence):
        return [_plain(place, "", one) for one in value]
    number = _rounded(place, value)
    return int(number) if number.is_integer() else number


def _parse_instant(text: str) -> int:
    return int(datetime.strptime(text, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC).timestamp())
