"""The catalogue: every cause that is looked for; what acts at the times of a family is an entry here, and no class."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lbacal_core.causes import chain, sky
from lbacal_core.causes.antenna import DipoleSwap, ResonanceShift, ResonanceWidth
from lbacal_core.causes.cable import CableLength, CableReflection
from lbacal_core.causes.cause import OF_HARDWARE, Cause, Conditions, Description, SizeRange, Template
from lbacal_core.causes.grammar import Sentence, columns_of, in_words, parts_of, require_sentence
from lbacal_core.errors import BadInputError
from lbacal_core.foreign import read_json

CAUSES: tuple[Cause, ...] = (
    sky.PointSource(),
    sky.SkyChange(
        "zenith_weighting", "exponent", "the sky integral weighs with a wrong power of cos(zenith)",
        "repeat the integral for a uniform sky, whose value is known for every power of the cosine",
        sizes=SizeRange(-1.5, 1.5),
    ),
    sky.SkyChange(
        "pattern_width", "fraction", "the antenna pattern is too wide or too narrow at fixed total power",
        "measure the pattern with a source on a drone", sizes=SizeRange(-0.35, 0.35),
    ),
    sky.DipoleAzimuth(),
    DipoleSwap(),
    Cause(
        "lst_offset", "h", "the sidereal time of data or simulation is off, or all antennas lean to the east",
        "ask whether lst_h is the edge or the centre of a bin; compare the transit of a bright source in "
        "interferometric data with its right ascension",
        step=0.005, sizes=SizeRange(-3.0, 3.0), does=sky.move_in_time,
    ),
    chain.MissingNoise(),
    Cause(
        "isotropic_level", "fraction of the mean sky power", "the isotropic part of the sky is wrong",
        "compare with an absolute measurement of the sky minimum, or with the noise levels of a laboratory",
        sizes=SizeRange(-0.5, 10.0), does=sky.add_level,
    ),
    sky.SolarEmission(),
    sky.IonosphericAbsorption(),
    ResonanceShift(),
    ResonanceWidth(),
    chain.FilterShift(),
    Cause(
        "lna_noise_slope", "fraction per 25 MHz", "the noise of the LNA has a slope in frequency",
        "measure the noise temperature of an LNA on a dummy load", sizes=SizeRange(-1.0, 1.0),
        does=chain.tilt_lna_noise,
    ),
    chain.TemperatureCause(
        "lna_noise_temperature", "fraction per 10 K", "the noise of the LNA follows temperature",
        "compare nights of equal LST in summer and winter at the lowest frequencies", scopes=OF_HARDWARE,
        sizes=SizeRange(-0.5, 0.5), does=chain.scale_lna_noise,
    ),
    chain.GainTemperature(),
    chain.TemperatureCause(
        "cable_temperature", "fraction per 10 K", "the loss of the cables (in dB) follows temperature",
        "compare short and long cables by day and by night", scopes=("station", "cable", "group", "antenna"),
        sizes=SizeRange(-1.0, 1.0), does=chain.scale_loss,
    ),
    chain.StepCause(
        "gain_step", "fraction", "the gain stepped at a date", "look into the maintenance log of that date",
        sizes=SizeRange(-1.0, 10.0), does=chain.scale_gain,
    ),
    chain.GainDrift(),
    chain.StepCause(
        "adc_noise_step", "fraction", "the noise of the digitiser stepped at a date",
        "look into the maintenance log of that date", sizes=SizeRange(-1.0, 100.0), does=chain.scale_adc_noise,
    ),
    Cause(
        "compression", "fraction", "the gain falls when the total power rises",
        "insert an attenuator and look whether the ratio of strong to weak sky changes", scopes=OF_HARDWARE,
        sizes=SizeRange(0.0, 1.0), does=chain.compress,
    ),
    Cause(
        "adc_jitter", "fraction of the mean power", "clock jitter adds white noise that follows the signal",
        "feed a sine of rising frequency and watch the noise floor", scopes=OF_HARDWARE,
        step=1e-4, sizes=SizeRange(0.0, 1.0), does=chain.add_jitter,
    ),
    sky.RfiLine(),
    sky.RfiBroadband(),
)  # fmt: skip
"""Causes that act from event to event, in the order in which they act: from the sky through beam and arms to the
digitiser."""

ANTENNA_CAUSES = (CableLength(), CableReflection())
"""Causes seen only by comparing antennas."""

DESCRIPTIONS: tuple[Description, ...] = (*CAUSES, *ANTENNA_CAUSES)
"""The whole catalogue."""


# Causes of an installation: sentences that somebody named, kept in a file beside the catalogue.


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
