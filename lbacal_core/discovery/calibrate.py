"""Calibration with a model that has adopted causes: their sizes are fitted with the chain, and C follows from both.

The sizes of a station are fitted jointly with the chains of all its paths (`discovery.adopted`). What the causes do is
divided out of the recorded power, and C is fitted to the rest. With D = d ln C / d size, by a refit with each size
moved by its standard deviation, and the covariance V of the sizes, the covariance of ln C is

    that at fixed sizes + D V D^T,

which is the covariance of the joint fit. D V D^T is common to all curves of the station.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lbacal_core.calibration.chain_form import FORM_OF_CHAIN, PUBLISHED_FORM, ChainForm, compare_forms
from lbacal_core.calibration.chain_test import LIKELY_MISTAKE
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.windows import leave_out_changed, set_apart
from lbacal_core.calibration.years import Beside
from lbacal_core.causes.cause import Template
from lbacal_core.causes.grammar import numbers_of
from lbacal_core.causes.model import Model
from lbacal_core.curves.covariance import compress_covariance
from lbacal_core.curves.curves import CalibrationCurve, FitReport
from lbacal_core.discovery.adopted import (
    FittedSize,
    Promise,
    describe_size,
    fit_adopted,
    gather_adopted,
    list_hypotheses,
)
from lbacal_core.discovery.baseline import leave_out_deaf
from lbacal_core.discovery.hypothesis import Hypothesis
from lbacal_core.discovery.refit import power_ratio
from lbacal_core.discovery.station import Station, model_modes
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms
from lbacal_core.linear import root_of
from lbacal_core.simulation.prior import OTHER_ANTENNA
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import Recorded
from lbacal_core.spectra.spectra import Rows, Spectra


@dataclass(frozen=True)
class _OfStation:
    """The sizes of one station, and where its spectra stand.

    Attributes
    ----------
    station
        With all its paths, those that a search leaves out too, and without their power.
    terms
        Its chains with the causes.
    sizes, covariance
        The causes with their sizes, and the covariance of these, shape (size, size).
    rows, path, event
        Rows of the spectra on the station's grid, and their places there, shape (row,).
    """

    station: Station
    terms: ChainTerms
    sizes: Sequence[FittedSize]
    covariance: Floats
    rows: NDArray[np.int64]
    path: NDArray[np.int64]
    event: NDArray[np.int64]

    def ratio(self, moved: Floats) -> Floats:
        """Power with the causes over power without, the sizes moved by some amounts, shape (row, freq)."""
        sizes = [size.value + float(by) for size, by in zip(self.sizes, moved, strict=True)]
        hypotheses = [replace(one, size=size) for one, size in zip(self._hypotheses, sizes, strict=True)]
        grid = power_ratio(self.station, self.terms, hypotheses)
        return np.asarray(grid[self.path, self.event])

    @cached_property
    def _hypotheses(self) -> list[Hypothesis]:
        """The causes of the sizes, in their order, on the station's grid."""
        acting = Model(tuple(size.adopted for size in self.sizes))
        return [one for _, one in list_hypotheses(acting, self.station)]

    @cached_property
    def is_known(self) -> NDArray[np.bool_]:
        """Whether every covariate of the causes that act on a row is known, shape (row,)."""
        known = np.ones(self.rows.size, dtype=bool)
        for one in self._hypotheses:
            on_events = one.cause.known_events(self.station.conditions, one.template)
            known &= on_events[self.event] | ~one.target.is_member[self.path]
        return known


@dataclass(frozen=True)
class FittedCauses:
    """Spectra with the sizes of the adopted causes in them.

    Attributes
    ----------
    recorded
        The spectra as they were recorded.
    simulation
        With the form of the chain that they prefer, which `form` gives the odds of.
    unchanged
        The power of spectra without what is known to have changed in single antennas, shape (row, freq); None where
        nothing did.
    """

    recorded: Recorded
    simulation: Simulation
    form: ChainForm
    stations: Sequence[_OfStation]
    unchanged: Callable[[Spectra], Floats] | None = None

    @property
    def model(self) -> Model:
        """The adopted causes."""
        return self.simulation.causes

    @property
    def sizes(self) -> list[FittedSize]:
        """The sizes of all stations; only causes that act in these spectra."""
        return [size for one in self.stations for size in one.sizes]

    @property
    def events_left_out(self) -> int:
        """How many events of stations lack a covariate of a cause: some of their spectra are left out."""
        return sum(np.unique(one.event[~one.is_known]).size for one in self.stations)

    @cached_property
    def spectra(self) -> Recorded:
        """The spectra with what the causes do divided out; without those of which a covariate is not known."""
        return self._divide_out(None)

    def _divide_out(self, moved: tuple[int, int] | None) -> Recorded:
        """The same with one size, by number of station and of size, moved by its standard deviation."""
        if not self.stations and self.unchanged is None:
            return self.recorded
        return self.recorded.change(partial(self._divide, moved=moved))

    def _divide(self, recorded: Spectra, moved: tuple[int, int] | None) -> Spectra:
        power = recorded.power.copy() if self.unchanged is None else self.unchanged(recorded)
        is_kept, here = np.ones(len(recorded), dtype=bool), recorded.key_codes["station"][0]
        for number, one in enumerate(self.stations):
            if one.station.name not in here:
                continue
            by = np.zeros(len(one.sizes))
            if moved is not None and moved[0] == number:
                by[moved[1]] = one.sizes[moved[1]].sigma
            power[one.rows] /= one.ratio(by)
            is_kept[one.rows] = one.is_known
        divided = replace(recorded, power=power)
        return divided if np.all(is_kept) else divided.select(is_kept)

    def keep(self, where: Callable[[Spectra], Rows]) -> FittedCauses:
        """Some of the spectra, such as those of one path, with the sizes fitted to all."""
        stations = []
        for one in self.stations:
            rows = where(self.recorded.read(one.station.name))
            kept = rows[one.rows]
            if np.any(kept):
                at = (np.cumsum(rows) - 1)[one.rows[kept]].astype(np.int64)
                stations.append(replace(one, rows=at, path=one.path[kept], event=one.event[kept]))
        recorded = self.recorded.change(lambda own: own.select(where(own)))
        return replace(self, recorded=recorded, stations=stations)

    def fit(self, scope: str, beside: Sequence[Beside] = ()) -> FitReport:
        """Calibrate with the model; parameters as in `fit_calibration`, which it is where no cause acts.

        The error of the sizes is in the statistical error of C, and common to all curves of a station.
        """
        report = fit_calibration(self.spectra, self.simulation, scope, beside)
        provenance = report.provenance.with_note(FORM_OF_CHAIN, str(self.form))
        mistakes = provenance.notes.get(LIKELY_MISTAKE, OTHER_ANTENNA).split("; ")
        if not all(one.startswith(OTHER_ANTENNA) for one in mistakes):
            from lbacal_core.audit.record import name_mistake  # what few fits need, no fit has to import

            provenance = provenance.with_note(LIKELY_MISTAKE, name_mistake(self.spectra, self.simulation))
        report = replace(report, provenance=provenance)
        if self.model.is_plain:
            return report
        curves = list(report.curves)
        for number, one in enumerate(self.stations):
            plain = self.simulation.at_its_word()
            changes = [
                fit_calibration(self._divide_out((number, k)), plain, scope, beside).curves
                for k in range(len(one.sizes))
            ]
            if changes:
                curves = self._add_errors(curves, list(report.curves), changes, one)
        provenance = replace(
            report.provenance,
            inputs={**report.provenance.inputs, "spectra": self.recorded.digest(), "model": self.model.id},
            settings={**report.provenance.settings, "model": self.model.to_text()},
            notes={**report.provenance.notes, "model": self._note},
        )
        return replace(
            report, curves=tuple(curves), provenance=provenance, causes=tuple(map(describe_size, self.sizes))
        )

    def _add_errors(
        self,
        curves: Sequence[CalibrationCurve],
        central: Sequence[CalibrationCurve],
        changes: Sequence[Sequence[CalibrationCurve]],
        station: _OfStation,
    ) -> list[CalibrationCurve]:
        """Curves with the error of a station's sizes, from the fits with each size moved by its standard deviation."""
        sigma = np.array([size.sigma for size in station.sizes])
        # Rows of the root are independent, each one standard deviation.
        root = root_of(station.covariance / np.outer(sigma, sigma)).T
        found = []
        for k, (curve, before) in enumerate(zip(curves, central, strict=True)):
            moved = [change[k] for change in changes]
            if curve.c is None or before.c is None:
                found.append(curve)
            elif any(one.c is None for one in moved):
                found.append(curve.as_not_converged())
            else:
                by_size = np.array(
                    [np.log(one.filled(one.c) / before.filled(before.c)) for one in moved if one.c is not None]
                )
                found.append(curve if not np.any(by_size) else _with_common(curve, root @ by_size))
        return found

    @property
    def _note(self) -> str:
        """The model in one line, with the sizes in these data."""
        fitted = [
            f"{s.adopted.cause} in {s.adopted.target} of {s.adopted.station} {s.value:.4g} ± {s.sigma:.2g}"
            + f" here, adopted with {s.adopted.size:.4g} ± {s.adopted.sigma:.2g}" * s.is_fitted
            for s in self.sizes
        ]
        idle = len(self.model.causes) - len(fitted)
        left_out = int(sum((~one.is_known).sum() for one in self.stations))
        words = [f"{len(self.model.causes)} adopted cause{'s' * (len(self.model.causes) > 1)}", *fitted]
        words += [f"{idle} without effect in these spectra"] if idle else []
        words += [f"{left_out} spectra left out, a covariate is not known"] if left_out else []
        return "; ".join(words)


def _with_common(curve: CalibrationCurve, common: Floats) -> CalibrationCurve:
    """A curve with vectors of ln C, shape (vector, freq), one standard deviation each, in its statistical error."""
    if curve.c is None or curve.covariance is None:
        return curve
    known = np.where(curve.has_value, common, np.nan)
    own = curve.covariance.factor.T @ curve.covariance.factor + np.diag(curve.covariance.diagonal)
    total = own + known.T @ known
    factor, diagonal = compress_covariance(total)
    return replace(
        curve,
        c_sigma_stat=curve.c * np.sqrt(np.diag(total)),
        covariance=replace(curve.covariance, factor=factor, diagonal=diagonal, common=known),
    )


def promise_of_structure(structure: Mapping[str, Any]) -> Promise:
    """The gain that structure without a name promises for as many events again, adopted as its sentence or its term.

    Its gain in chi^2 is G, of which d, the number of its terms, is noise: the term is adopted at s = 1 - d/G. Its true
    signal is (G - d)^1/2 standard deviations, along a term that is G^1/2 long, so that as many events gain
    s (G - d) - s^2 G / 2 = (G - d)^2 / 2G, with the error s G^1/2. A sentence is adopted at s = 1; its d counts the
    size and the numbers of its law and course.
    """
    if structure.get("sentences"):
        one = structure["sentences"][0]
        found, terms = float(one["gain"]["chi2"]), 1 + numbers_of(Template(one["parameters"]))
        return Promise(0.5 * found - terms, found**0.5)
    gain = structure["gain"]
    found = float(gain["chi2"])
    share = 1.0 - gain["terms"] / found
    return Promise(0.5 * share**2 * found, share * found**0.5)


def fit_causes(spectra: Recorded, simulation: Simulation) -> FittedCauses:
    """Choose the form of the chain, and fit the sizes of causes, each to all paths of its target in the spectra.

    Parameters
    ----------
    spectra
        All spectra of the stations in a window: `FittedCauses.select` takes some of them afterwards. An antenna whose
        hardware changed in it is fitted as several (`calibration.windows.set_apart`).
    simulation
        Where its sky is its own, the differences between sky and antenna models are profiled out.
    """
    found = list[_OfStation]()
    # The products are small: threads of the linear algebra would wait for each other.
    with threadpool_limits(1):
        steady = leave_out_changed(spectra, simulation.instrument) if len(spectra) else None
        form = PUBLISHED_FORM if steady is None else compare_forms(steady, simulation)
        simulation = simulation.with_form(form.name)
        for name in sorted({one.station for one in simulation.causes.causes}):
            apart, parts = set_apart(spectra.read(name), simulation.instrument)
            for station in gather_adopted(
                apart, name, replace(simulation, instrument=parts, given=simulation.sky_power)
            ):
                known = simulation.differences
                modes = None if known is None else model_modes(station, known)
                fitted = fit_adopted(leave_out_deaf(station)[0], simulation.causes, modes)
                if fitted.sizes:
                    light = replace(station, power=np.broadcast_to(1.0, station.power.shape))
                    of_fit = light, fitted.model.baseline.terms, fitted.sizes, fitted.covariance
                    found.append(_OfStation(*of_fit, *station.find_places(apart)))
    return FittedCauses(spectra, simulation, form, found)
