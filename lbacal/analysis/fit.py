"""`lbacal.fit`: C(nu) from spectra, with its errors; `lbacal fit` is the same from files."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from lbacal.analysis.data import in_common, spectra_of
from lbacal.analysis.instrument import Described, simulation_of
from lbacal.analysis.result import Result
from lbacal.calibration_files import FORMATS, complete_curves, write_calibrations
from lbacal.client import make_table
from lbacal.curve_table import CurveTable
from lbacal.pages.chart import Chart
from lbacal.pages.fit import (
    average_residuals,
    describe_error,
    draw_c,
    draw_fit,
    draw_page,
    explain_chi2,
    tabulate_curves,
)
from lbacal.pages.report import list_origin
from lbacal.with_model import Extended, read_model, read_open_terms
from lbacal_core.audit.audit import audit_quickly
from lbacal_core.audit.record import NOT_NAMED, name_mistake
from lbacal_core.calibration.chain_test import LIKELY_MISTAKE
from lbacal_core.calibration.left_open import widen_by_open_terms
from lbacal_core.calibration.one_event import ErrorOfC, measure_error
from lbacal_core.calibration.paths import LEAST_COVERAGE, is_undetermined
from lbacal_core.calibration.singles import MIN_EVENTS
from lbacal_core.causes.model import Model
from lbacal_core.curves.curves import CONVERGED, MISFIT, Anomalies, CalibrationCurve, FitReport
from lbacal_core.curves.galcal import describe_made_with
from lbacal_core.curves.reference_chain import ReferenceChain
from lbacal_core.discovery.forward import divide_out
from lbacal_core.drift.events import measure_spectra
from lbacal_core.drift.follow import History, follow
from lbacal_core.drift.members import name_members, split_by_size
from lbacal_core.drift.report import describe_followed
from lbacal_core.errors import BadInputError, require_name, write_percent
from lbacal_core.foreign import write_instant
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.pipeline import calibrate
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra

SCOPES = ("antenna", "station", "array")
"""What one curve may belong to."""
UNKNOWN = (
    "its power does not follow P_sky at these sidereal times, or C is uncertain by more than half; an audit tells "
    "which paths are dead, and whether clock, place or letters are wrong; the LST of a sky power file may be"
)
"""Why the data of a path with enough events at enough sidereal times do not determine C."""
UNSTEADY, FEWEST_PATHS = 3.0, 4
"""Scatter from event to event over that of the typical path that is told, where there are so many: gains of working
antennas scatter alike, one with a quarter of its events at twice the power by 35 % where others do by 5."""
NEXT_STEP = "lbacal.investigate(spectra, instrument).save('R.html')"
"""What to do where a curve is a misfit; the command says it in its own words."""


@dataclass(frozen=True, repr=False, kw_only=True)
class Calibration(Result):
    """The result of a fit: a curve C(nu) for each path, station or the array, as `report` has them.

    ``found["S1", 3, "E"]`` is one curve as a table with units, with `mean` and `at`; `table` has all of them, one row a
    curve and channel, with the columns of `lbacal.effective`.

    Attributes
    ----------
    error
        The error of C for one event on one antenna, and for the mean; None where no curve has values.
    """

    report: FitReport
    simulation: Simulation
    spectra: Spectra
    error: ErrorOfC | None

    @property
    def instrument(self) -> Instrument:
        """The instrument that was calibrated."""
        return self.simulation.instrument

    @property
    def converged(self) -> list[CalibrationCurve]:
        """The curves that converged and are no misfit."""
        return [curve for curve in self.report.curves if curve.status == CONVERGED]

    @cached_property
    def with_sizes(self) -> Simulation:
        """The simulation with the adopted causes that act in these spectra, at the sizes found in them."""
        sizes = [(one, one["size"]["value"], one["size"]["sigma"]) for one in self.report.causes]
        return self.simulation.with_causes(
            Model.from_dicts({**one, "size": value, "sigma": sigma} for one, value, sigma in sizes)
        )

    @cached_property
    def without_causes(self) -> Spectra:
        """The spectra with what adopted causes do to paths that have a curve divided out."""
        return divide_out(self.spectra, self.report.curves, self.with_sizes) if self.report.causes else self.spectra

    def __getitem__(self, key: Any) -> CurveTable:
        """C of one curve: (station, antenna, dipole), (station, dipole) or (dipole,) by what was fitted."""
        wanted = key if isinstance(key, tuple) else (key,)
        for curve in self.report.curves:
            is_wanted = tuple(part for part in (*curve.owner, curve.dipole) if part is not None) == wanted
            if is_wanted and curve.c is None:
                raise BadInputError(curve.name, "a curve that converged", curve.status)
        rows: CurveTable = self.table.find_curve(wanted)
        return rows


def fit(
    spectra: Spectra | str | Path,
    instrument: Described,
    sky_power: SkyPower | str | Path | None = None,
    scope: str = "antenna",
    with_: Extended = None,
    *,
    tell: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """Calibrate with the Galaxy: C(nu) of every antenna (``scope="antenna"``), ``station`` or ``array``.

    Parameters
    ----------
    spectra
        From `lbacal.read`, `import_data` or `simulate`, or the name of a spectra file.
    instrument
        An `Instrument`, the name or file of one, or a `Simulation`.
    sky_power
        P_sky(LST, nu), or its file; the instrument's own sky and antenna models unless given.
    with_
        What extends the model: an `Investigation`, one of its findings, or ``"R.json#0"``. Errors grow by what it
        leaves open.
    tell
        Called with a sentence before each step.

    Returns
    -------
    What the quick part of the audit says of the spectra is among the notes; it refuses decibels and volts.

    Examples
    --------
    >>> import lbacal
    >>> spectra = lbacal.simulate("lofar-superterp", events=150, antennas=2)
    >>> found = lbacal.fit(spectra, "lofar-superterp")
    >>> found["CS002", 1, "X"].mean(40, 70).c.unit
    Unit("V")
    >>> found.save("C.fits")  # doctest: +SKIP
    """
    require_name("scope", scope, SCOPES)
    simulation, causes = simulation_of(instrument, sky_power), read_model(with_, "with_")
    simulation = simulation if causes.is_plain else simulation.with_causes(causes)
    simulation.causes.require_one_c("with_")
    measured = spectra_of(spectra)
    simulation, without = in_common(measured, simulation)
    audited = audit_quickly(measured, simulation.instrument)
    audited.require_power(measured.origin)
    tell(f"fit {len(measured)} spectra")
    seen = simulation.smeared(measured)
    report = widen_by_open_terms(calibrate(measured, seen, scope), read_open_terms(with_, "with_"))
    if simulation.is_own_sky and sum(is_undetermined(curve) for curve in report.curves) > len(report.curves) / 2:
        mistake = name_mistake(measured, seen)
        if mistake != NOT_NAMED:
            report = replace(report, provenance=report.provenance.with_note(LIKELY_MISTAKE, mistake))
    report = audited.mark(report)
    if without:
        report = replace(report, provenance=report.provenance.with_note("channels", without))
    tell("error of one event")
    error = measure_error(report, measured, seen)
    sentences = [] if error is None else [describe_error(error)]
    explained = [explain_chi2(report.curves)] if any(curve.c is not None for curve in report.curves) else []
    counted = sum(curve.status == CONVERGED for curve in report.curves)
    content = partial(_content_of, report, simulation)

    def draw() -> list[Chart]:
        return draw_fit(report, average_residuals(measured, report.curves, seen), seen)

    origin = list_origin(measured.origin, simulation, measured.time_unix, report.provenance.as_dict())
    return Calibration(
        title=f"{simulation.instrument.name}: {counted} of {len(report.curves)} curves converged",
        rows=tabulate_curves(report.curves),
        notes=[
            *sentences,
            *explained,
            *_describe_rest(report, simulation, len(measured)),
            *_describe_changes(report, measured, seen),
        ],
        charts=draw,
        main=lambda: draw_c(report.curves),
        columns=len({curve.dipole for curve in report.curves}),
        as_dict=content,
        as_table=lambda: make_table(dict(content())),
        page=lambda: draw_page(report, draw(), origin, sentences),
        more={suffix: partial(_write_curves, content, kind) for suffix, kind in FORMATS.items()},
        fallback=".ecsv",
        report=report,
        simulation=simulation,
        spectra=measured,
        error=error,
    )


def _content_of(report: FitReport, simulation: Simulation) -> Mapping[str, Any]:
    """The curves that have values with covariances and budgets, as a calibration file holds them."""
    made_for = simulation.sky_power.made_for
    made_with = describe_made_with(simulation.instrument, None if made_for is None else made_for.as_dict())
    return complete_curves(report.as_dict() | made_with, Path("fit"))


def _write_curves(content: Callable[[], Mapping[str, Any]], kind: str, path: Path) -> None:
    write_calibrations(content(), path, kind)


def _describe_rest(report: FitReport, simulation: Simulation, spectra: int) -> Iterator[str]:
    """What else there is to know: inputs, anomalous power, misfits, curves without values, and reference chains."""
    for name, note in report.provenance.notes.items():
        yield f"{name}: {note}"
    anomalies = Anomalies.of(report.anomalies)
    if anomalies.worst:
        yield (
            f"anomalous power: {anomalies.left_out} of {spectra} spectra left out, {anomalies.fitted} "
            f"fitted; worst: {anomalies.name_worst(3)}"
        )
    yield from _describe_unsteady(report)
    misfits = [curve for curve in report.curves if curve.status == MISFIT]
    if misfits:
        yield f"{_describe_misfits(misfits, is_own_sky=bool(simulation.is_own_sky))}; next: {NEXT_STEP}"
    for curve in report.curves:
        if curve.c is None:
            events = f"{curve.events} events{f', {MIN_EVENTS} needed' if curve.events < MIN_EVENTS else ''}"
            needed = f", {LEAST_COVERAGE:.2f} needed" if curve.lst_coverage < LEAST_COVERAGE else ""
            reason = f": {UNKNOWN}" if is_undetermined(curve) else ""
            yield f"{curve.name}: {curve.status} ({events}, LST coverage {curve.lst_coverage:.2f}{needed}){reason}"
    reasons = [curve.merged.reason for curve in report.curves if curve.merged is not None]
    for reason in dict.fromkeys(reasons):
        yield f"{reasons.count(reason)} of {len(report.curves)} curves: {reason}"
    levels = [curve.sky_over_model for curve in report.curves if curve.sky_over_model is not None]
    if levels:
        yield f"median of {len(levels)} curves: {sorted(levels, key=lambda one: one.mean)[len(levels) // 2]}"
    for curve, reference in zip(report.curves, report.chains, strict=True):
        if reference is not None and curve.antenna is None:
            yield f"{curve.name}: {_describe_chain(reference)}"


def _describe_unsteady(report: FitReport) -> Iterator[str]:
    """The paths whose gain scatters from event to event far more than the typical path's."""
    names = {(one.station, one.antenna, one.dipole): one.name for one in report.curves if one.antenna is not None}
    every = [one for kept in report.lines for one in zip(kept.owners, kept.scatter.tolist(), strict=True)]
    of = {names[owner]: scatter for owner, scatter in every if owner in names}
    if len(of) < FEWEST_PATHS:
        return
    typical = float(np.median(list(of.values())))
    for name, scatter in of.items():
        if scatter > UNSTEADY * typical:
            yield (
                f"{name}: its power scatters by {100 * scatter:.0f} % from event to event, that of the typical path by "
                f"{100 * typical:.0f} %: it changed, or fails at times, and C is that of the mean"
            )


def _describe_changes(report: FitReport, spectra: Spectra, simulation: Simulation) -> Iterator[str]:
    """The steps and slopes of paths beside their station, where C of the fit is that of the mean."""
    if report.causes:  # which say of their steps themselves
        return
    references = defaultdict[tuple[str | None, str | None], dict[int, CalibrationCurve]](dict)
    for one in report.curves:
        if one.antenna is not None and one.c is not None:
            references[one.station, one.dipole][one.antenna] = one
    if not references:
        return
    modes = measure_spectra(spectra, lambda station, dipole: references[station, dipole], simulation)
    history = History.of(modes, {})
    found = describe_followed(history, follow(history), spectra.frequency_mhz)
    for step in (one for change in found["changes"] for one in split_by_size(change)):
        members = name_members(step["members"], FEWEST_PATHS)
        size, date = write_percent(step["members"][0]["size"], 0), write_instant(step["date_unix"])[:10]
        days = f"{max(step['date_sigma_days'], 1.0):.0f} d"
        yield f"{step['station']} {members}: C steps by about {size} at {date} ± {days}, and C is that of the mean"
    for one in (one for one in found["slopes"] if one["is_found"]):
        size = write_percent(one["slope"], 0)
        yield f"{one['station']} {name_members([one], 1)}: C is not steady: about {size} a year, or steps"


def _describe_chain(chain: ReferenceChain) -> str:
    """What a curve of many paths belongs to, and how far single paths depart from it, in one sentence."""
    if chain.spreads is None:
        known = "too few paths could be fitted by themselves to know how far they depart from it"
    else:
        departures = [
            f"{100 * np.median(one.offset):+.1f} % with a spread of {100 * np.median(one.spread):.1f} % (cable {cable})"
            for cable, one in (chain.spreads.by_cable or {"any": chain.spreads.all_paths}).items()
        ]
        known = f"power gain of single paths against it: {', '.join(departures)}"
    return f"reference chain of {len(chain.members)} paths, nobody's cable; {known}"


def _describe_misfits(misfits: Sequence[CalibrationCurve], *, is_own_sky: bool) -> str:
    """Which curves noise and the sky's prior cannot explain."""
    alone, profiled = (
        [float(getattr(curve, name) or 0.0) for curve in misfits] for name in ("chi2_per_dof", "chi2_per_dof_profiled")
    )
    names = misfits[0].name if len(misfits) == 1 else f"{len(misfits)} curves, {misfits[0].name} to {misfits[-1].name}"
    free = "sky and pattern free within what is known of them" if is_own_sky else "the sky power taken at its word"
    return (
        f"misfit: {names}: chi2/dof {np.median(alone):.1f} with noise alone, {np.median(profiled):.1f} with {free} "
        "(1 expected): units, clock, place, letters or antenna may be wrong"
    )
