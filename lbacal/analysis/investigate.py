"""`lbacal.investigate`: what the simulation gets wrong in these data, and the simulation extended by it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import QTable

from lbacal.analysis.data import in_common, spectra_of
from lbacal.analysis.instrument import Described, simulation_of
from lbacal.analysis.result import Result
from lbacal.engine import Engine
from lbacal.pages.chart import Chart
from lbacal.pages.curve import draw_change, draw_curve, draw_curve_page, draw_ranking
from lbacal.pages.finding import draw_finding, draw_scores, tell_rivals, tell_similar
from lbacal.pages.report import draw_investigation, list_origin
from lbacal.units import convert_band
from lbacal.with_model import Extended, read_model
from lbacal_core.audit.audit import audit_quickly
from lbacal_core.data.lofar import SUPERTERP
from lbacal_core.discovery.curve_search import describe_curve, investigate_curve
from lbacal_core.discovery.left_open import investigate_openly
from lbacal_core.discovery.report import CONSISTENT, Search, StationContent
from lbacal_core.discovery.station import Station
from lbacal_core.errors import BadInputError, write_chance
from lbacal_core.lstcurve.curve import BAND_MHZ, LstCurve, read_lst_curve
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra

COLUMNS = ("cause", "station", "size", "sigma", "what is wrong")
TABLE = ("cause", "station", "size", "size_sigma", "unit", "significance_sigma", "sentence")


@dataclass(frozen=True, repr=False, kw_only=True)
class Extension(Result):
    """An extension of a simulation: the report of an investigation, or by its number one of its findings."""

    report: Mapping[str, Any]
    simulation: Simulation
    number: int | None = None

    def extend(self) -> Simulation:
        """The simulation with what was found; sizes are fitted together with C."""
        return self.simulation.with_causes(read_model(self))


@dataclass(frozen=True, repr=False, kw_only=True)
class Finding(Extension):
    """One cause that was found.

    Attributes
    ----------
    content
        The finding as the report has it.
    cause, sentence
        Its name in the catalogue (docs/causes.md), and what is wrong in one sentence.
    significance
        Standard deviations, after the look-elsewhere correction over the whole catalogue.
    gain
        Chi^2 before and after, and the gain in likelihood on held-out events.
    """

    content: Mapping[str, Any]
    cause: str
    sentence: str
    significance: float
    gain: Mapping[str, Any]


@dataclass(frozen=True, repr=False, kw_only=True)
class Investigation(Extension):
    """The result of an investigation: verdict, findings, and structure without a name.

    Attributes
    ----------
    verdict
        `consistent`, `explained` or `unexplained`.
    headline
        The verdict in words: where nothing was found, whether the audit finds something wrong.
    findings
        The causes that were found, the most significant first.
    unexplained
        Structure that no cause explains, as the report has it; None where nothing is left.
    """

    verdict: str
    headline: str
    findings: Sequence[Finding]
    unexplained: Mapping[str, Any] | None


def investigate(
    data: Spectra | LstCurve | str | Path,
    instrument: Described | None = None,
    sky_power: SkyPower | str | Path | None = None,
    with_: Extended = None,
    band: tuple[Any, Any] = BAND_MHZ,
    *,
    dask: str | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Investigation:
    """Find what the simulation gets wrong: name the cause, extend the model, measure the gain.

    Parameters
    ----------
    data
        Spectra or their file; or a band-averaged LST curve, or its file (CSV).
    instrument, sky_power
        As in `lbacal.fit`; lofar-superterp for an LST curve unless given.
    with_
        What the model is extended by beforehand: an `Investigation`, a finding, or ``"R.json#0"``.
    band
        First and last channel of the LST curve, MHz or Quantities; spectra are searched in all channels.
    dask
        Address of a dask scheduler whose workers search one station of spectra each, or ``"local"``.
    tell
        Called with a sentence before each step.

    Examples
    --------
    >>> import lbacal
    >>> spectra = lbacal.simulate("lofar-superterp", events=100, antennas=2)
    >>> found = lbacal.investigate(spectra, "lofar-superterp")
    >>> found.verdict
    'consistent'
    >>> found.findings[0].plot()  # doctest: +SKIP
    >>> lbacal.fit(spectra, "lofar-superterp", with_=found.findings[0])  # doctest: +SKIP
    """
    if isinstance(data, LstCurve) or (isinstance(data, str | Path) and Path(data).suffix.lower() == ".csv"):
        if with_ is not None:
            raise BadInputError("with_", "spectra beside it", "an LST curve")
        curve = data if isinstance(data, LstCurve) else read_lst_curve(Path(data))
        return _investigate_curve(curve, simulation_of(instrument or SUPERTERP, sky_power), convert_band(band))
    if tuple(band) != BAND_MHZ:
        raise BadInputError("band", "an LST curve beside it", "spectra")
    if instrument is None:
        raise BadInputError("instrument", "an instrument beside spectra, or the name of one", "None")
    simulation, causes = simulation_of(instrument, sky_power), read_model(with_, "with_")
    simulation = simulation if causes.is_plain else simulation.with_causes(causes)
    measured = spectra_of(data)
    simulation, without = in_common(measured, simulation)
    audited = audit_quickly(measured, simulation.instrument)
    audited.require_power(measured.origin)
    with Engine(dask) as engine:
        each = None if dask is None else partial(_search_each, engine, tell)
        content = investigate_openly(measured, simulation.smeared(measured), progress=tell, each=each)
    content["provenance"]["notes"] |= {"audit": audited.sentence} | ({"channels": without} if without else {})

    origin = list_origin(measured.origin, simulation, measured.time_unix, content["provenance"])
    headline = content["verdict"]
    if headline == CONSISTENT and audited.report.wrong:
        headline += ", but the audit finds something wrong (below)"
    page = partial(draw_investigation, content, origin, headline)
    return _make(
        measured.origin, content, simulation, page, lambda: map(draw_scores, content["scores"].values()),
        lambda one: draw_finding(one).values(), headline,
    )  # fmt: skip


def _search_each(
    engine: Engine,
    tell: Callable[[str], None],
    function: Callable[..., StationContent],
    search: Search,
    stations: Iterable[tuple[Station, Spectra]],
) -> list[StationContent]:
    """Search stations by an engine; they are told as they are done, and given in their order."""
    found = dict[int, StationContent]()
    for number, described in engine.spread(function, search, stations):
        found[number] = described
        tell(f"{described.station['station']}: searched, {len(found)} of {search.stations} stations")
    return [found[number] for number in sorted(found)]


def _investigate_curve(curve: LstCurve, simulation: Simulation, band_mhz: tuple[float, float]) -> Investigation:
    found = investigate_curve(curve, simulation, band_mhz)
    sky, chain = simulation.sky_power.digest(), simulation.instrument.digest()
    inputs = {"lst_curve": curve.digest(), "sky_power": sky, "instrument": chain}
    settings = {"band_mhz": list(band_mhz), "own_sky": simulation.is_own_sky, "policy": found.policy.as_dict()}
    content = describe_curve(found, Provenance(inputs, settings))
    page = partial(draw_curve_page, content, found, list_origin(curve.origin, simulation, None, content["provenance"]))
    return _make(
        curve.origin, content, simulation, page,
        lambda: [*draw_curve(found), draw_ranking(found), *draw_change(found)], lambda _: draw_change(found),
    )  # fmt: skip


def _make(
    source: str, content: dict[str, Any], simulation: Simulation, page: Callable[[], str],
    charts: Callable[[], Iterable[Chart]], of_finding: Callable[[Mapping[str, Any]], Iterable[Chart]],
    headline: str | None = None,
) -> Investigation:  # fmt: skip
    findings = [
        Finding(
            title=f"{one['cause']} {_size(one)}",
            rows=[("gain", ""), *((k, f"{v:.4g}") for k, v in one["gain"].items() if isinstance(v, float | int))],
            told=list(_tell_finding(one)),
            notes=[one["sentence"]],
            charts=partial(of_finding, one),
            as_dict=partial(dict, one),
            report=content,
            simulation=simulation,
            number=number,
            content=one,
            cause=one["cause"],
            sentence=one["sentence"],
            significance=one["significance_sigma"],
            gain=one["gain"],
        )
        for number, one in enumerate(content["findings"])
    ]
    rows = [
        (one.cause, one.content["where"]["station"] or "", _size(one.content), f"{one.significance:.1f}", one.sentence)
        for one in findings
    ]
    notes = [f"{name}: {note}" for name, note in content["provenance"].get("notes", {}).items()]
    headline = headline or content["verdict"]
    return Investigation(
        title=f"{source}: {headline}",
        rows=[COLUMNS, *rows],
        told=[*_tell(content), *notes],
        notes=notes,
        charts=charts,
        page=page,
        as_dict=lambda: content,
        as_table=partial(_list_findings, findings),
        report=content,
        simulation=simulation,
        verdict=content["verdict"],
        headline=headline,
        findings=findings,
        unexplained=content["unexplained"],
    )


def _list_findings(findings: Sequence[Finding]) -> QTable:
    """A row a finding; the size is in the unit of its cause, and without error where that is not known."""
    rows = []
    for one in findings:
        size, station = one.content["size"], one.content["where"]["station"] or ""
        sigma = np.nan if size["sigma"] is None else size["sigma"]
        rows.append((one.cause, station, size["value"], sigma, size["unit"], one.significance, one.sentence))
    return QTable(rows=rows or None, names=TABLE, dtype=[str, str, float, float, str, float, str])


def _tell(content: Mapping[str, Any]) -> Iterator[str]:
    """Adopted causes with their sizes, the findings, and what no cause explains."""
    for one in content.get("adopted", []):
        value, sigma, whom = one["size"]["value"], one["size"]["sigma"], f"{one['target']} of {one['station']}"
        yield f"  adopted: {one['cause']} in {whom}, here {value:.3g} ± {sigma:.2g}"
    for one in content["findings"]:
        yield from _tell_finding(one)
    for one in content.get("stations", []):
        if one["deaf"]:
            paths = ", ".join(one["deaf"])
            yield f"  left out of {one['station']}, as hardly any of their power is that of the sky: {paths}"
    left = content["unexplained"]
    while left:
        yield f"  {left['description']} ({write_chance(left['p_value'])})"
        if left.get("in_words"):
            yield f"    in words: {left['in_words']}"
        if left.get("would_decide"):
            yield f"    what would decide: {left['would_decide']}"
        yield from (f"    similar to: {one['sentence']}" for one in left["similar_to"])
        left = left.get("in_others")


def _tell_finding(finding: Mapping[str, Any]) -> Iterator[str]:
    yield f"  {finding['significance_sigma']:.1f} sigma: {finding['sentence']}"
    if similar := ", ".join(tell_similar(finding)):
        yield f"    these data cannot tell it from {similar}"
    if not finding["evidence"].get("is_converged", True):
        yield "    caution: the fit of all causes together has not converged"
    if rivals := tell_rivals(finding):
        yield f"    rivals, with their odds to it: {rivals}"
    yield from (f"    nearly as likely: {one}" for one in finding["evidence"].get("sentences", ()))


def _size(finding: Mapping[str, Any]) -> str:
    size = finding["size"]
    error = "" if size["sigma"] is None else f" ± {size['sigma']:.2g}"
    return f"{size['value']:.3g}{error} {size['unit']}"
