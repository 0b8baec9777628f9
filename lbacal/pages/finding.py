"""A finding and the station around it, from the values of a report alone: figures and words, wherever it is shown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lbacal.pages.chart import BAND, BARS, BLUE, IMAGE, INK, LINE, OF_DIPOLE, POINTS, RED, Chart, Series
from lbacal.pages.curves import FREQUENCY, PERCENT
from lbacal.pages.svg import draw_svg
from lbacal_core.grids import Floats

MOST_SCORES = 12
STEP_OF_GAIN = "gain_step"
LEAST_LIKELY = 0.05
"""Likelihood beside a finding below which the data do tell a rival from it: 1 to 20, as between its rivals."""


def draw_finding(finding: Mapping[str, Any]) -> dict[str, Chart]:
    """The figures of a finding by their names; none where the report was made before it carried them.

    They are `course`, `law`, ``before 0``, ``after 0``, … (maps, a pair an axis) and `change`, or `against` where
    antennas were compared.
    """
    picture, cause = finding["evidence"].get("picture"), finding["cause"]
    if picture is None:
        return {}
    if "against" in picture:
        return {"against": _draw_against(picture["against"], cause)}
    charts = _draw_course_and_law(picture, cause)
    if "law" not in charts:
        return charts
    charts |= _draw_maps(picture["maps"], f"residuals of {finding['evidence']['target']}")
    change, mhz = picture["change_of_c"], picture["law"]["frequency_mhz"]
    low, middle, high = (_percent(change[name]) for name in ("low", "median", "high"))
    series = [Series(BAND, mhz, low=low, high=high, name="68 % of its paths", colour=RED)]
    series.append(_hover(Series(LINE, mhz, middle, name="median", colour=RED), "MHz", "%"))
    return charts | {"change": Chart(f"change of C by {cause}", FREQUENCY, "change of C (%)", series)}


def draw_sentence(sentence: Mapping[str, Any]) -> dict[str, Chart]:
    """The figures `course` and `law` of a sentence; none where the report was made before it carried them."""
    return _draw_course_and_law(sentence["picture"], "the sentence") if "picture" in sentence else {}


def _draw_course_and_law(picture: Mapping[str, Any], name: str) -> dict[str, Chart]:
    charts = {"course": _draw_course(picture["course"], name, "mean relative power (%)")}
    if "law" in picture:  # an error of the record has no template
        mhz, label = picture["law"]["frequency_mhz"], "relative power (%)"
        charts["law"] = Chart(f"{name} along frequency", FREQUENCY, label, _compare(mhz, picture["law"], name))
    return charts


def tell_finding(finding: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Describe a finding by heads, each with a text."""
    size, gain, evidence = finding["size"], finding["gain"], finding["evidence"]
    error = "" if size["sigma"] is None else f" ± {size['sigma']:.2g}"
    yield "size", f"{size['value']:.4g}{error} {size['unit']}"
    yield "significance", f"{finding['significance_sigma']:.1f} sigma after the look-elsewhere correction"
    if not evidence.get("is_converged", True):
        yield "caution", "the fit of all causes together has not converged"
    fell = gain["chi2_before"] - gain["chi2_after"]
    yield "chi²", f"{gain['chi2_before']:.0f} without it, {gain['chi2_after']:.0f} with it ({fell:.0f} gained)"
    if gain["held_out_log_likelihood_gain"] is not None:
        told = f"ln L {gain['held_out_log_likelihood_gain']:+.1f} on {gain['held_out_events']} events, in four folds"
        yield "gain on unseen events", told
    yield "these data cannot tell it from", ", ".join(tell_similar(finding)) or "nothing else in the catalogue"
    if rivals := tell_rivals(finding):
        yield "rivals, with their odds to it", rivals
    if sentences := evidence.get("sentences"):
        yield "sentences that are nearly as likely", " ".join(sentences)
    change = finding["calibration_change"]
    middle, most = (PERCENT * change[name] for name in ("median_fraction", "max_fraction"))
    words = "against a fit of the window without it"
    if most:  # by a record that is wrong there may be no C to change
        yield "C of its paths changes", f"by {middle:.2f} % in the median, {most:.2f} % at most, {words}"
    if finding["cause"] == STEP_OF_GAIN and size["value"] > -1:
        after = (1.0 + size["value"]) ** -0.5 - 1.0
        yield "C behind the date", f"{PERCENT * after:+.2f} % against C before it; one C for the window lies between"
    if evidence.get("note"):
        yield "note", evidence["note"]
    yield "how to confirm it", evidence["confirm"]


def tell_similar(finding: Mapping[str, Any]) -> Iterator[str]:
    """Rivals with their likelihood beside that of the finding, 1/20 or more, or the correlation of their signatures."""
    rivals = {one["cause"]: one["weight"] for one in finding.get("left_open", ())[1:]}
    correlations = finding["evidence"].get("correlations", {})
    for name in dict.fromkeys((*finding["indistinguishable"], *rivals)):
        if name not in rivals:
            yield f"{name} (r = {correlations[name]:.2f})" if name in correlations else name
        elif rivals[name] >= LEAST_LIKELY:
            yield f"{name} ({rivals[name]:.2g} : 1 beside it)"


def tell_rivals(finding: Mapping[str, Any]) -> str:
    """Name what was fitted in the place of a finding, with its odds to it; empty where nothing was."""
    rivals = finding["evidence"].get("rivals", ())
    return ", ".join(f"{one['cause']} ({one['target']}) {one['odds']:.1g} : 1" for one in rivals)


def draw_station(station: Mapping[str, Any], scores: Sequence[Mapping[str, Any]] = ()) -> dict[str, Chart]:
    """Draw structure without a cause, the mean over all paths before and after, and the scores of the causes.

    The figures are `structure`, `spectrum`, `amounts`, the maps ``before 0``, ``after 0``, … and `scores`, as far as
    there is something to draw.
    """
    picture = station.get("picture") or {"maps": []}
    charts: dict[str, Chart] = {}
    if "structure" in picture:
        structure = picture["structure"]
        charts["structure"] = _draw_course(
            structure["course"], "smooth along it", "relative power, in its channels (%)"
        )
        spectrum = Series(LINE, structure["spectrum"]["frequency_mhz"], structure["spectrum"]["rms_1"], colour=RED)
        charts["spectrum"] = Chart("spectrum of the structure", FREQUENCY, "spectrum (rms 1)", [spectrum])
        if structure["amounts"]["paths"]:
            charts["amounts"] = _draw_amounts(structure["amounts"])
    charts |= _draw_maps(picture["maps"], "residuals of the mean over all paths")
    return charts | ({"scores": draw_scores(scores)} if scores else {})


def draw_scores(scores: Sequence[Mapping[str, Any]]) -> Chart:
    """The best scores of the causes, the largest first."""
    ranked = sorted(scores, key=lambda one: -abs(one["score_sigma"]))[:MOST_SCORES]
    titles = [
        f"{one['cause']}, {one['target']}: {one['score_sigma']:.1f} sigma, p = {one['p_value']:.2g}" for one in ranked
    ]
    bars = Series(BARS, [abs(one["score_sigma"]) for one in ranked], range(len(ranked)), colour=BLUE, titles=titles)
    rows = [f"{one['cause']}, {one['target']}" for one in ranked]
    label = "best score (standard deviations)"
    return Chart("scores of the causes", label, "", [bars], rows=rows, height=70 + 18 * len(rows))


def _draw_course(course: Mapping[str, Any], name: str, y_label: str) -> Chart:
    return Chart(f"{name} along {course['label']}", course["label"], y_label, _compare(course["at"], course, name))


def _compare(at: Sequence[float], values: Mapping[str, Any], name: str) -> list[Series]:
    observed, sigma, expected = (_percent(values[part]) for part in ("observed", "sigma", "expected"))
    points = Series(POINTS, at, observed, observed - sigma, observed + sigma, "measured / model without it - 1")
    return [_hover(points, "", "%"), Series(LINE, at, expected, name=name, colour=RED)]


def _draw_against(against: Mapping[str, Any], cause: str) -> Chart:
    mhz = against["frequency_mhz"]
    observed, sigma = _percent(against["observed"]), _percent(against["sigma"])
    points = Series(POINTS, mhz, observed, observed - sigma, observed + sigma, against["label"])
    shape = Series(LINE, against["fine_mhz"], _percent(against["fine"]), name=cause, colour=RED)
    return Chart(against["label"], FREQUENCY, "gain in front of the receiver (%)", [_hover(points, "MHz", "%"), shape])


def _draw_amounts(amounts: Mapping[str, Any]) -> Chart:
    series = []
    for dipole in sorted({path[1] for path in amounts["paths"]}):
        antenna, _, value, sigma = zip(*(path for path in amounts["paths"] if path[1] == dipole), strict=True)
        low, high = np.subtract(value, sigma), np.add(value, sigma)
        series.append(Series(POINTS, antenna, value, low, high, dipole, OF_DIPOLE.get(dipole, INK)))
    return Chart("amount of the structure in each path", "antenna", f"amount, of that in {amounts['in']}", series)


def _draw_maps(maps: Sequence[Mapping[str, Any]], of: str) -> dict[str, Chart]:
    """Residual maps before and after, on one scale of colours; one, where nothing was added to the model."""
    charts = {}
    for k, one in enumerate(maps):
        pair = {name: PERCENT * np.array(one[name], dtype=float) for name in ("before", "after")}
        limit = float(np.nanpercentile(np.abs(np.stack(list(pair.values()))), 99)) or 1.0
        is_same = np.array_equal(pair["before"], pair["after"], equal_nan=True)  # nothing was added to the model
        for name, values in [("before", pair["before"])] if is_same else pair.items():
            extent = one["frequency_mhz"], (one["from"], one["to"])
            image = Series(IMAGE, *extent, name="%", image=values, limit=limit)
            title = f"{of}{'' if is_same else f' {name}'}: {np.sqrt(np.nanmean(values**2)):.2f} % rms"
            charts[f"{name} {k}"] = Chart(title, FREQUENCY, one["label"], [image], y_limits=extent[1])
    return charts


def _percent(values: Sequence[float | None]) -> Floats:
    return PERCENT * np.array(values, dtype=float)


def _hover(series: Series, x_unit: str, y_unit: str) -> Series:
    """With a title at each value."""
    titles = [f"{x:.6g} {x_unit}: {y:.4g} {y_unit}" for x, y in zip(series.x, series.y, strict=True)]
    return replace(series, titles=titles)


FILTERS: Mapping[str, Any] = {
    "svg": draw_svg, "facts": tell_finding, "finding_figures": draw_finding, "sentence_figures": draw_sentence,
    "station_figures": draw_station,
}  # fmt: skip
"""What `templates/findings.html` needs."""
