"""The report of an investigation as JSON values and sentences (docs/formats/investigation-report.md)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from lbacal_core.audit.record import OF_RECORD, RecordError, put_right
from lbacal_core.calibration.chain_form import FORM_OF_CHAIN, compare_forms
from lbacal_core.causes.axes import describe_term
from lbacal_core.causes.cause import Description as CauseTexts
from lbacal_core.causes.grammar import PLACES, as_equation, axis_of, in_words, law_of, parts_of, size_at_mhz
from lbacal_core.discovery.adopted import describe_size, fit_adopted
from lbacal_core.discovery.antennas import AntennaScore
from lbacal_core.discovery.describe import Described, Description
from lbacal_core.discovery.findings import Finding, change_of_c
from lbacal_core.discovery.hypothesis import Hypothesis, Target, sigma_of
from lbacal_core.discovery.pictures import (
    picture_antenna,
    picture_finding,
    picture_hypothesis,
    picture_record,
    picture_station,
)
from lbacal_core.discovery.policy import JUDGE, Policy
from lbacal_core.discovery.residual_structure import ResidualStructure, say_axis
from lbacal_core.discovery.scan import Score
from lbacal_core.discovery.search import StationReport, put_into_words, search_station
from lbacal_core.discovery.station import Station, gather_stations, model_modes
from lbacal_core.foreign import write_instant
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument.chain import BEHIND, PUBLISHED
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra

VERDICTS = CONSISTENT, EXPLAINED, UNEXPLAINED = "consistent", "explained", "unexplained"
BY_RATIO = "acts by ratio: P_sky times own(with)/own(without), from the package's own sky and antenna model"
OPEN_NOISE = "the data hardly tell the noise in front of the receiver from that behind it, on which the size depends"
PUT_RIGHT = "of the record: put it right, no model can adopt it; all else in this report is of the record put right"
IN_A = "It is in A(nu), and C is right without it."
GROWS = 0.8
"""Correlation of the amounts of antennas with their numbers from which it is said."""
NOISY = 1.1
"""Noise of a path over the typical one beyond which the report names the path."""


@dataclass(frozen=True)
class StationContent:
    """What one station adds to a report, as JSON values.

    Attributes
    ----------
    findings
        In the order in which the search lists them.
    station, noise, scores, adopted
        Its entries in the fields `stations`, `noise`, `scores` and `adopted`.
    """

    findings: Sequence[dict[str, Any]]
    station: dict[str, Any]
    noise: dict[str, Any]
    scores: list[dict[str, Any]]
    adopted: list[dict[str, Any]]


def describe_station(report: StationReport) -> StationContent:
    """What a station adds to the report."""
    findings = [_finding(finding, report) for finding in report.findings]
    findings += [_antenna_finding(score, report) for score in report.antennas]
    findings += [_record_finding(one, report) for one in report.record]
    station = {
        "station": report.station.name,
        "verdict": _verdict(report),
        "findings": [],  # their numbers, once those of all stations are in one order
        "unexplained": _left(report),
        "unidentifiable": [{"cause": cause, "why": why} for cause, why in sorted(report.unidentifiable.items())],
        "deaf": report.deaf,
        "paths": len(report.station.antenna),
        "events": len(report.station.event_id),
        "dates": [write_instant(float(pick(report.station.conditions.time_unix))) for pick in (np.min, np.max)],
        "picture": picture_station(report),
    }
    adopted = [describe_size(size) for size in report.adopted]
    return StationContent(findings, station, _noise(report), _scores(report), adopted)


def join(described: Sequence[StationContent], provenance: Provenance) -> dict[str, Any]:
    """The report of all stations as JSON values; the fields of the whole are the union of those of the stations.

    docs/formats/investigation-report.md names them.
    """
    found = [(finding, one.station["station"]) for one in described for finding in one.findings]
    found.sort(key=lambda pair: -pair[0]["significance_sigma"])
    stations: list[dict[str, Any]] = [
        {**one.station, "findings": [k for k, (_, name) in enumerate(found) if name == one.station["station"]]}
        for one in described
    ]
    left = [station["unexplained"] for station in stations if station["unexplained"] is not None]
    several = len(stations) > 1
    return {
        "verdict": max((station["verdict"] for station in stations), key=VERDICTS.index, default=CONSISTENT),
        "findings": [finding for finding, _ in found],
        "unexplained": min(left, key=lambda one: float(one["p_value"]), default=None),
        "unidentifiable": [
            {**reason, "station": station["station"]} if several else reason
            for station in stations
            for reason in station["unidentifiable"]
        ],
        "stations": stations,
        "noise": {one.station["station"]: one.noise for one in described},
        "scores": {one.station["station"]: one.scores for one in described},
        "provenance": {**provenance.as_dict(), "judge": JUDGE},
    }


def _verdict(report: StationReport) -> str:
    if report.structure is not None or report.departure is not None:
        return UNEXPLAINED
    return EXPLAINED if report.findings or report.antennas or report.record else CONSISTENT


def _noise(report: StationReport) -> dict[str, Any]:
    station, levels = report.station, report.last.linear.residuals.levels
    channels, polarisations = levels.vectors.shape[1], len(report.last.linear.residuals.polarisations)
    of_path, of_station = levels.of_all(levels.mean_path_shared), levels.of_all(levels.common_sum) / polarisations
    return {
        "radiometer_per_mhz": levels.path_channel,
        "path_event_gain": float(np.sqrt(np.trace(of_path) / channels)),
        "station_event_gain": float(np.sqrt(np.trace(of_station) / channels)),
        "path_vectors": _vectors(levels.vectors, of_path),
        "station_vectors": _vectors(levels.vectors, of_station),
        "taken": report.taken,
        "common_per_mhz": levels.common_channel.tolist(),
        "noisy_paths": [
            {"antenna": int(a), "dipole": str(d), "scale": float(s)}
            for a, d, s in zip(station.antenna, station.dipole, levels.path_scale, strict=True)
            if s > NOISY
        ],
    }


def _vectors(vectors: Floats, covariance: Floats) -> list[dict[str, Any]]:
    """What events share along frequency, strongest first: rms over frequency, and one standard deviation in each."""
    values, turned = np.linalg.eigh(covariance)
    along = (vectors.T @ turned * np.sqrt(np.maximum(values, 0.0))).T[::-1]
    return [{"level": float(np.sqrt(np.mean(one**2))), "by_channel": one.tolist()} for one in along]


def _scores(report: StationReport) -> list[dict[str, Any]]:
    scores: list[Score | AntennaScore] = [*report.scores, *report.antenna_scores]
    return [
        {
            "cause": score.cause.identifier,
            "target": score.target.label,
            "parameters": plain_parameters(score.parameters),
            "score_sigma": float(score.z),
            "size": float(score.size),
            "p_value": float(score.p_value),
        }
        for score in scores
    ]


def _finding(finding: Finding, report: StationReport) -> dict[str, Any]:
    one, cause, score = finding.hypothesis, finding.hypothesis.cause, finding.score
    return tell_finding(
        cause,
        indistinguishable=finding.indistinguishable,
        size=finding.size,
        parameters=one.template.parameters,
        chance=(score.significance, score.p_value),
        where=_where(report, one.target, one.template.parameters),
        gain=tell_gain(finding.chi2_before, finding.chi2_after, finding.dof, finding.held_out_gain, score.events),
        change=finding.calibration_change,
        sentence=_sentence(report, one.target, cause, finding.size, one.template.parameters)
        + (f" {OPEN_NOISE[0].upper()}{OPEN_NOISE[1:]}." if finding.over_noise else ""),
        evidence={
            "score_sigma": float(score.z),
            "trials": float(score.trials),
            "events": score.events,
            "target": one.target.label,
            "sigma_for_this_template": one.sigma,
            "is_converged": report.last.is_converged,
            "correlations": dict(finding.indistinguishable),
            "note": BY_RATIO if cause.acts_by_ratio else "",
            "rivals": [rival.as_dict() for rival in finding.rivals],
            "sentences": [_tell_sentence(one, report) for one in finding.sentences],
            **_of_noise(finding),
            "picture": picture_finding(report, finding),
        },
    )


def _of_noise(finding: Finding) -> dict[str, Any]:
    """What the size depends on where the noise constants are hardly told apart."""
    if finding.over_noise is None:
        return {}
    one = finding.hypothesis
    return {"noise": OPEN_NOISE, "with_fitted_noise": {"value": one.size, "sigma": one.uncertainty}}


def _antenna_finding(score: AntennaScore, report: StationReport) -> dict[str, Any]:
    return tell_finding(
        score.cause,
        indistinguishable=score.similar,
        size=(score.size, score.sigma),
        parameters=score.parameters,
        chance=(sigma_of(score.p_value), score.p_value),
        where=_where(report, score.target, score.parameters),
        gain=tell_gain(score.chi2_before, score.chi2_after, score.dof),
        change=np.zeros(1),  # the slopes of its paths have it, whatever its name
        sentence=_sentence(report, score.target, score.cause, (score.size, score.sigma), score.parameters),
        evidence={
            "score_sigma": score.z,
            "trials": score.trials,
            "target": score.target.label,
            "correlations": dict(score.similar),
            "note": f"{score.cause.note(score.parameters, score.size)} {IN_A}".strip(),
            "picture": picture_antenna(report, score),
        },
    )


def _record_finding(error: RecordError, report: StationReport) -> dict[str, Any]:
    """What is wrong with the record; its gain is that of the record put right, all else of the model being fitted."""
    station, before, after = report.station, report.as_recorded or report.first, report.first
    line = error.line
    is_member = np.isin(station.antenna, line.antennas) if line.antennas else station.antenna >= 0
    is_member &= station.dipole == line.dipole if line.dipole else True
    target = Target("antenna" if error.line.antennas else "station", error.label, is_member)
    odds = error.line.log_odds or 0.0
    chi2_after, dof = after.linear.chi_squared()
    chi2_before, _ = before.linear.with_levels(after.linear.residuals.levels).chi_squared()
    return tell_finding(
        error.cause,
        indistinguishable=[],
        size=error.size,
        parameters=dict(zip(("summer_time_h", "else_h"), line.seasons_h or (), strict=False)),
        chance=((2.0 * odds) ** 0.5, float(np.exp(-odds))),
        where=_where(report, target, {}, (line.since_unix, line.until_unix)),
        gain=tell_gain(chi2_before, chi2_after, dof),
        change=change_of_c(before, after, target),
        sentence=error.sentence,
        evidence={
            "score_sigma": (2.0 * odds) ** 0.5,
            "trials": 1.0,
            "target": error.label,
            "correlations": {},
            "note": PUT_RIGHT,
            "of_record": True,
            "picture": picture_record(report, error),
        },
    )


def tell_finding(
    cause: CauseTexts,
    *,
    indistinguishable: Sequence[tuple[str, float]],
    size: tuple[float, float | None],
    parameters: Mapping[str, Any],
    chance: tuple[float, float],
    where: dict[str, Any],
    gain: dict[str, Any],
    change: Floats,
    sentence: str,
    evidence: dict[str, Any],
) -> dict[str, Any]:
    """The fields of a finding, in spectra and in LST curves (docs/formats/investigation-report.md).

    Parameters
    ----------
    chance
        Significance in standard deviations and p-value, after the look-elsewhere correction.
    change
        Relative change of C, any shape.
    """
    every = np.abs(change)
    return {
        "cause": cause.identifier,
        "indistinguishable": [name for name, _ in indistinguishable],
        "size": {"value": size[0], "sigma": size[1], "unit": cause.unit},
        "parameters": plain_parameters(parameters),
        "significance_sigma": chance[0],
        "p_value": chance[1],
        "where": where,
        "gain": gain,
        "calibration_change": {"max_fraction": float(every.max()), "median_fraction": float(np.median(every))},
        "sentence": sentence,
        "evidence": {"confirm": cause.confirm, **evidence},
    }


def tell_gain(
    before: float, after: float, dof: int, held_out: float | None = None, events: int | None = None
) -> dict[str, Any]:
    """The gain of a finding in chi^2, `before` and `after`, and in log-likelihood on `events` held out.

    Both of these are null where nothing was held out.
    """
    return {
        "chi2_before": before,
        "chi2_after": after,
        "dof": dof,
        "residual_variance_explained": (before - after) / before,
        "held_out_log_likelihood_gain": held_out,
        "held_out_events": events,
    }


def _where(
    report: StationReport,
    target: Target,
    parameters: Mapping[str, Any],
    during_unix: tuple[float | None, float | None] = (None, None),
) -> dict[str, Any]:
    """Where the cause acts; null along an axis to which it is not confined."""
    since, until = during_unix
    station = report.station
    frequency, times = station.conditions.frequency_mhz, station.conditions.time_unix
    band = [float(frequency[0]), float(frequency[-1])]
    if "width_mhz" in parameters:
        half = max(0.5 * parameters["width_mhz"], 0.5 * float(np.median(np.diff(frequency))))
        band = [parameters["frequency_mhz"] - half, parameters["frequency_mhz"] + half]
    hours = parameters.get("utc_h", [0, 24])
    return {
        "station": station.name,
        "frequency_mhz": band,
        "lst_h": None,
        "utc_h": None if list(hours) == [0, 24] else [float(hour) for hour in hours],
        "dates": [
            write_instant(parameters.get("date_unix", since or float(times.min()))),
            write_instant(until or float(times.max())),
        ],
        "antennas": sorted({int(a) for a in station.antenna[target.is_member]}),
        "dipoles": sorted({str(d) for d in station.dipole[target.is_member]}),
    }


def _sentence(
    report: StationReport, target: Target, cause: CauseTexts, size: tuple[float, float], parameters: Mapping[str, Any]
) -> str:
    whom = f"station {report.station.name}" + ("" if target.scope == "station" else f", {target.label}")
    words = "".join(f", {one}" for one in parameter_words(parameters))
    return f"In {whom}, {cause.meaning}: {size[0]:.3g} ± {size[1]:.2g} ({cause.unit}){words}."


WORDS = {
    "source": "{}",
    "follows": "following {}",
    "wetness": "as a {} of rain",
    "phase_deg": "phase {:.0f} deg",
    "model": "by a model of the {} of the gain",
    "delay_h": "{:g} h late",
    "memory_h": "with a memory of {:g} h or more",
    "exponent": "exponent {:g}",
    "spectral_index": "spectral index {:g}",
    "frequency_mhz": "at {:g} MHz",
    "width_mhz": "{:g} MHz wide",
    "delay_us": "delay {:g} µs",
    "or_delay_us": "or {:g} µs",
    "date": "from {} on",
}
"""How a sentence names the parameters of a template."""


def parameter_words(parameters: Mapping[str, Any]) -> list[str]:
    """The parameters of a template in words."""
    values = plain_parameters(parameters)
    words = [text.format(values[name]) for name, text in WORDS.items() if name in values]
    if list(values.get("utc_h", [0, 24])) != [0, 24]:
        words.append("from {:g} to {:g} h UTC".format(*values["utc_h"]))
    return words


def _unexplained(structure: ResidualStructure, report: StationReport) -> dict[str, Any]:
    station, rest = report.station, report.rest
    times = station.conditions.time_unix
    axis, target, low, high = _place_of(structure, report)
    return {
        "p_value": structure.p_value,
        "where": {
            "station": station.name,
            "axis": axis,
            "target": target,
            "frequency_mhz": [low, high],
            "dates": [write_instant(float(times.min())), write_instant(float(times.max()))],
        },
        "description": f"{say_axis(axis)} in {_place(structure, target, station.name)} that no cause "
        f"of the catalogue explains, strongest at {low:.0f}-{high:.0f} MHz",
        "gain": {
            "chi2": structure.gain,
            "terms": structure.dof,
            "held_out_log_likelihood_gain": structure.held_out_gain,
        },
        "paths": {path: {"value": value, "sigma": sigma} for path, (value, sigma) in structure.amounts.items()} or None,
        "term": _term(structure, report),
        **_said(report.description, report),
        "similar_to": [_finding(finding, report) for finding in report.similar],
        **({} if rest is None or rest.structure is None else {"in_others": _unexplained(rest.structure, rest)}),
    }


def _left(report: StationReport) -> dict[str, Any] | None:
    """What no cause explains: structure, and an antenna whose gain departs from the others along frequency."""
    structure = None if report.structure is None else _unexplained(report.structure, report)
    score = report.departure
    if score is None or score.law is None:
        return structure
    law, station = score.law, report.station
    whom, rise = score.target.label, f"{law.departure[-1] - law.departure[0]:+.2g} from end to end of the band"
    words = f"the gain has another {'slope' if law.degree == 1 else 'course'} along frequency than in the others"
    departure = {
        "p_value": score.p_value,
        "where": _where(report, score.target, {}) | {"axis": "frequency", "target": whom},
        "description": f"{whom} of {station.name} departs at all times from the others of its cable along frequency, "
        "by a smooth law that no cause of the catalogue explains",
        "gain": {
            "chi2": score.chi2_before - law.chi2, "terms": law.degree, "held_out_log_likelihood_gain": None,
        },
        "paths": None,
        "term": None,
        "sentences": [],
        "in_words": f"In station {station.name}, {whom}, {words} of its cable: by {rise}, {np.ptp(law.departure):.2g} "
        f"in all (ln of the power). {IN_A}",
        "remains": None,
        "would_decide": None,
        "amounts": None,
        "similar_to": [],
    }  # fmt: skip
    return departure if structure is None else {"in_others": departure} | structure


def _place_of(structure: ResidualStructure, report: StationReport) -> tuple[str, str, float, float]:
    """Axis, target, first and last frequency of structure: of the sentence that describes it, or where it is seen.

    The axis is that along which it is most significant, unless it is seen in single events.
    """
    conditions, axis = report.station.conditions, structure.axis_name
    target, share = structure.target, structure.channel_share
    if report.description.sentences:
        one = report.description.sentences[0].hypothesis
        _, law, course = parts_of(one.template)
        target, share = one.target.label, np.abs(law_of(conditions, law)).max(axis=(0, 1))
        axis = axis_of(course) if structure.axis is None else axis
    strong = conditions.frequency_mhz[share > 0.5 * share.max()]
    return axis, target, float(strong.min()), float(strong.max())


def _said(description: Description, report: StationReport) -> dict[str, Any]:
    """The structure as sentences of place, law and course: the likeliest, its rivals, and what would decide."""
    sentences = [_sentence_of(one, report, description.sentences[0]) for one in description.sentences]
    found: dict[str, Any] = {"sentences": sentences, "in_words": None, "remains": None, "would_decide": None}
    if not sentences:
        return found
    places = list(dict.fromkeys(one["parameters"]["place"] for one in sentences))
    words = sentences[0]["sentence"]
    if len(sentences) > 1:
        others = "; ".join(f"{in_words(one.hypothesis.template)}" for one in description.sentences[1:])
        words += f" The data hardly tell this from: {others}."
        shared = [
            part
            for part in ("place", "law", "course")
            if len({str(one["parameters"][part][0]) for one in sentences}) == 1
        ]
        words += f" Known: {' and '.join(shared) or 'none of place, law and course'}."
    if (growth := description.grows_with_number) is not None and abs(growth) > GROWS:
        words += f" Antennas show it by an amount that grows with their number (correlation {growth:.2f})."
    if description.remains is not None:
        words += f" Beside it {description.remains.in_words} remains."
        found["remains"] = {"axis": description.remains.axis_name, "p_value": description.remains.p_value}
    if (decider := description.decider) is not None:
        more = "no more events tell the first two apart:"
        if decider.events is not None:
            more = f"{max(decider.events, 1.0):.0f} more events {decider.where} would tell the first two apart, each "
            more += f"worth {decider.times:.1f} of a typical one; or"
        found["would_decide"] = f"{more} {' or '.join(PLACES[one].confirm for one in places[:2])}"
    amounts = {str(number): {"value": size, "sigma": sigma} for number, (size, sigma) in description.amounts.items()}
    return {**found, "in_words": words, "amounts": amounts or None}


def _sentence_of(one: Described, report: StationReport, first: Described) -> dict[str, Any]:
    """A sentence with its equation, size and odds; as a cause it is adopted as any other."""
    hypothesis, cause = one.hypothesis, one.hypothesis.cause
    size, place = hypothesis.size, hypothesis.template.parameters["place"]
    return {
        "sentence": _tell_sentence(hypothesis, report),
        "equation": as_equation(hypothesis.template),
        "cause": cause.identifier,
        "parameters": plain_parameters(hypothesis.template.parameters),
        "target": hypothesis.target.label,
        "size": {
            "value": size,
            "sigma": hypothesis.uncertainty,
            "unit": cause.unit,
            "at_mhz": size_at_mhz(report.station.conditions, hypothesis.template),
        },
        "log_odds": one.log_odds,
        "odds_to_first": float(np.exp(one.log_odds - first.log_odds)),
        "gain": {"chi2": one.gain, "held_out_log_likelihood_gain": one.held_out_gain},
        "confirm": PLACES[place].confirm,
        "picture": picture_hypothesis(report, hypothesis),
    }


def _tell_sentence(one: Hypothesis, report: StationReport) -> str:
    """A sentence with whom it concerns and with its size."""
    whom = f"station {report.station.name}" + ("" if one.target.scope == "station" else f", {one.target.label}")
    words, at_mhz = in_words(one.template), size_at_mhz(report.station.conditions, one.template)
    at = "" if at_mhz is None or f"(size at {at_mhz:g} MHz)" in words else f" at {at_mhz:g} MHz"
    return f"In {whom}, {words}: {one.size:.3g} ± {one.uncertainty:.2g}{at}."


def _place(structure: ResidualStructure, target: str, station: str) -> str:
    """Where structure is, in words."""
    if structure.amounts:
        paths = f"{len(structure.amounts)} paths of {station} together"
        return f"{paths}, each by its own amount and most in {target},"
    return f"{target} of {station}"


def _term(structure: ResidualStructure, report: StationReport) -> dict[str, Any] | None:
    """The smooth term that describes the structure, where it can be adopted."""
    if structure.axis is None or structure.coefficients is None:
        return None
    polarisations = report.last.linear.residuals.polarisations.tolist()
    coefficients = dict(zip(polarisations, structure.coefficients, strict=True))
    return describe_term(report.station.conditions, structure.axis.name, coefficients)


def plain_parameters(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters as JSON values, an instant `date_unix` also in words as `date`."""
    values = {key: value.item() if isinstance(value, np.generic) else value for key, value in parameters.items()}
    if "date_unix" in values:
        values["date"] = f"{datetime.fromtimestamp(values['date_unix'], UTC):%Y-%m-%dT%H:%MZ}"
    return values


# The entry of an investigation: search station by station for what the simulation of the spectra gets wrong.


@dataclass(frozen=True)
class Search:
    """The search of the stations of an investigation, each by itself, in whatever process.

    Attributes
    ----------
    simulation
        In the form of the chain that the spectra of all stations leave open.
    stations
        How many there are: they share the false-alarm rate.
    seed
        Seed of the simulated trials factors.
    provenance
        That of the whole report.
    """

    simulation: Simulation
    stations: int
    seed: int
    provenance: Provenance

    def run(self, station: Station, own: Spectra, progress: Callable[[str], None] = lambda _: None) -> StationReport:
        """Search one station; `own` are its spectra as they were recorded."""
        simulation = self.simulation
        search = partial(
            search_station, stations=self.stations, seed=self.seed, policy=Policy(), progress=progress,
            model=simulation.causes, catalogue=simulation.catalogue,
        )  # fmt: skip
        known = simulation.differences
        # The products are small: threads of the linear algebra would wait for each other.
        with threadpool_limits(1):
            report = search(station, modes=None if known is None else model_modes(station, known))
            is_open = report.structure is not None or not report.findings or _names_record(report)
            if simulation.is_own_sky and (is_open or _steps_together(report)):
                progress(f"{station.name}: asking whether its record is wrong")
                report = _search_put_right(own, report, simulation, search) or report
            if report.structure is not None:
                progress(f"{station.name}: describing structure that no cause explains")
            return put_into_words(report, self.seed)

    def join(self, described: Sequence[StationContent]) -> dict[str, Any]:
        """The report of all stations as JSON values (docs/formats/investigation-report.md)."""
        content, model = join(described, self.provenance), self.simulation.causes
        if model.is_plain:
            return content
        return {**content, "model": model.to_text(), "adopted": [size for one in described for size in one.adopted]}


def prepare_search(
    spectra: Spectra, simulation: Simulation, seed: int = 0
) -> tuple[Search, Iterator[tuple[Station, Spectra]]]:
    """Prepare the search of every station; parameters as in `investigate`.

    Returns
    -------
    The search, and the arguments of its `run`, station by station.
    """
    name = f"instrument {simulation.instrument.name}"
    require_same_grid(spectra.origin, spectra.frequency_mhz, simulation.instrument.frequency_mhz, name)
    form = compare_forms(spectra, simulation)
    simulation = simulation.with_form(BEHIND if form.is_open(BEHIND) else PUBLISHED)
    model = {} if simulation.causes.is_plain else {"model": simulation.causes.id}
    with threadpool_limits(1):
        stations = gather_stations(spectra, simulation)
    provenance = Provenance(
        inputs={
            "spectra": spectra.digest(),
            "instrument": simulation.instrument.digest(),
            "sky_power": simulation.sky_power.digest(),
            **model,
        },
        settings={
            "policy": Policy().as_dict(), "seed": seed, "own_sky": simulation.is_own_sky, **simulation.own_causes
        },
        notes={
            FORM_OF_CHAIN: str(form), "sky_power": simulation.sky_power.note_for(simulation.instrument),
            **_tell_dead(spectra, stations),
        },
    )  # fmt: skip
    own = (spectra.select(np.flatnonzero(spectra.station == station.name)) for station in stations)
    return Search(simulation, len(stations), seed, provenance), zip(stations, own, strict=True)


def _tell_dead(spectra: Spectra, stations: Sequence[Station]) -> dict[str, str]:
    """A note on the spectra that are left out as dead; none where there are none."""
    sent = Counter(zip(spectra.station.tolist(), spectra.antenna.tolist(), spectra.dipole.tolist(), strict=True))
    paths = (
        (f"{one.name} antenna {antenna} {dipole}", sent[one.name, antenna, dipole] - there)
        for one in stations
        for antenna, dipole, there in zip(
            one.antenna.tolist(), one.dipole.tolist(), one.is_present.sum(axis=1).tolist(), strict=True
        )
    )
    told = [f"{count} of {path}" for path, count in paths if count]
    return {"dead spectra": f"left out with less than a tenth of the usual power: {', '.join(told)}"} if told else {}


def investigate(
    spectra: Spectra, simulation: Simulation, *, seed: int = 0, progress: Callable[[str], None] = lambda _: None
) -> tuple[dict[str, Any], list[StationReport]]:
    """Find what the simulation gets wrong in the spectra of every station.

    Parameters
    ----------
    simulation
        Where its sky is its own, the differences between sky and antenna models are profiled out. Noise behind the
        resonance is free in the baseline where the data leave it open; a slope of N_LNA is a cause. The simulation's
        causes belong to the baseline, with sizes fitted again: what is looked for is what they leave.
    seed
        Seed of the simulated trials factors.
    progress
        Called with a sentence before each step.

    Returns
    -------
    The report as JSON values, and the values of each station from which it was made.
    """
    search, stations = prepare_search(spectra, simulation, seed)
    reports = [search.run(station, own, progress) for station, own in stations]
    return search.join([describe_station(one) for one in reports]), reports


def _names_record(report: StationReport) -> bool:
    """Whether a finding may be an error of the record, which is linear in no size."""
    return any(one.hypothesis.cause.identifier in OF_RECORD for one in report.findings)


def _steps_together(report: StationReport) -> bool:
    """Whether several antennas step, as those do that change places."""
    found = (one.hypothesis for one in report.findings)
    return len({one.target.label for one in found if one.cause.identifier == "gain_step"}) > 1


def _search_put_right(
    spectra: Spectra, recorded: StationReport, simulation: Simulation, search: Callable[..., StationReport]
) -> StationReport | None:
    """The report of one station with its record put right; None where the record is not wrong, or that does not help.

    The record is wrong where the audit says so and nothing is then left: structure that stays is of something else.
    """
    right = put_right(spectra, simulation)
    if right is None or (recorded.structure is None and not right.errors):
        return None
    if recorded.structure is None and recorded.findings and all(one.is_as_cause for one in right.errors):
        return None  # which can be adopted
    known, stations = right.simulation.differences, gather_stations(right.spectra, right.simulation)
    if not stations:  # no path that works has events enough
        return None
    (station,) = stations
    report = search(station, modes=None if known is None else model_modes(station, known))
    if report.structure is not None or (recorded.structure is None and _names_record(report)):
        return None
    searched = list(zip(report.station.antenna.tolist(), report.station.dipole.tolist(), strict=True))
    paths = zip(right.as_recorded.antenna.tolist(), right.as_recorded.dipole.tolist(), strict=True)
    same = np.flatnonzero([path in searched for path in paths])
    (as_recorded,), known = gather_stations(right.as_recorded.select(same), simulation), simulation.differences
    modes = None if known is None else model_modes(as_recorded, known)
    before = fit_adopted(as_recorded, simulation.causes, modes).model
    kept = zip(before.station.antenna.tolist(), before.station.dipole.tolist(), strict=True)
    whole = [one for one in right.left_out if one.since_unix is None and one.until_unix is None]
    ill = [f"antenna {antenna} {one.dipole}" for one in whole for antenna in one.antennas]
    told = before if list(kept) == searched else None  # a path of two antennas may look as if it heard no sky
    return replace(report, record=right.errors, as_recorded=told, deaf=sorted({*report.deaf, *ill}))
