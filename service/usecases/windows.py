"""Versions of windows that changes cut: one too small for a fit borrows from the nearest that has one, and says so."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from lbacal.instants import format_instant
from lbacal_core.calibration.fit import SHARE_OF_MISFITS
from lbacal_core.curves.curves import CONVERGED, MISFIT, TOO_FEW_EVENTS, TOO_FEW_LST_BINS
from lbacal_core.curves.reference_chain import CableTable, ReferenceChain
from lbacal_core.curves.validity import Instant, Scope, timeline
from lbacal_core.drift.windows import Borrowed, borrow_curve
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_core.spectra.spectra import Spectra
from service.storage.database import Database
from service.storage.versions import Version

SECOND_US = 1_000_000
TOO_SMALL = (TOO_FEW_EVENTS, TOO_FEW_LST_BINS)


BORROWED_FROM = "borrowed_from"
FindLenders = Callable[[Collection[Scope]], Sequence[Version]]
"""The versions of other windows from which paths may borrow."""


def lend_to_small(
    versions: Sequence[Version],
    window: tuple[Instant, Instant],
    pieces: Sequence[tuple[Instant, Spectra]],
    simulation: Simulation,
    find_lenders: FindLenders,
) -> list[Version]:
    """Give versions of paths whose piece is too small for a fit the curve of the nearest window, with a free gain.

    Parameters
    ----------
    window
        What was cut: a path whose window it is lacks events, and no change is why.
    pieces
        Where each piece begins, and its spectra without what adopted causes do.
    find_lenders
        Asked where a window is too small, for what stands beside these versions.
    """
    small = [
        one for one in versions if one.scope.antenna is not None and one.status in TOO_SMALL and one.window != window
    ]
    if not small:
        return list(versions)
    lenders = [*versions, *find_lenders({one.scope for one in small})]
    lent = {one.id: _lend(one, lenders, pieces, simulation) for one in small}
    return [lent.get(one.id, one) for one in versions]


def find_in_effect(database: Database, scopes: Collection[Scope]) -> list[Version]:
    """The versions that answer for scopes at any time."""
    with database.read() as stores:
        standing = stores.ledger.standing(scopes)
        stretches = [one for scope in scopes for one in timeline((p for p in standing if p.scope == scope), scope)]
        names = {one.calibration for one in stretches if one.calibration is not None}
        return list(stores.versions.get_many(names).values())


def share_misfits(versions: Sequence[Version]) -> list[Version]:
    """Versions of the pieces of a window with the misfit of their station.

    A fit of a piece judges the paths of the piece alone: an antenna whose window is cut would escape what is wrong with
    clock, sky or pattern of all.
    """
    groups: dict[tuple[str | None, str | None], list[bool]] = {}
    for version in versions:
        for curve in version.curves:
            if curve.c is not None:
                groups.setdefault((curve.station, curve.dipole), []).append(curve.status == MISFIT)
    wrong = {station for (station, _), misfits in groups.items() if np.mean(misfits) >= SHARE_OF_MISFITS}
    return [
        replace(one, curves=tuple(curve.as_misfit() if curve.status == CONVERGED else curve for curve in one.curves))
        if one.scope.station in wrong
        else one
        for one in versions
    ]


def _lend(
    version: Version,
    lenders: Sequence[Version],
    pieces: Sequence[tuple[Instant, Spectra]],
    simulation: Simulation,
) -> Version:
    fitted = [
        other
        for other in lenders
        if other.scope == version.scope and other.status == CONVERGED and BORROWED_FROM not in other.inputs
    ]
    # one that overlaps was made before the window was cut, of what is now two
    apart = {other.id: other for other in fitted if other.until <= version.since or other.since >= version.until}
    if not apart:
        return version
    neighbour = min(apart.values(), key=lambda other: (_find_gap(version, other), -other.events))
    station, antenna, dipole = version.scope.parts
    spectra = next(of_piece for since, of_piece in pieces if since == version.since and _holds(of_piece, version.scope))
    own = (spectra.station == station) & (spectra.antenna == antenna) & (spectra.dipole == dipole)
    before, now = (
        simulation.instrument.cable_of(str(station), int(str(antenna)), (one.since + one.until) / 2 / SECOND_US)
        for one in (neighbour, version)
    )
    block = split_into_blocks(spectra.select(own))[0]
    borrowed = borrow_curve(neighbour.curves[0], block, simulation, (before, now))
    if borrowed is None:
        return version
    chain = ReferenceChain(
        ((str(station), int(str(antenna))),),
        simulation.instrument.cables[now],
        CableTable.of(simulation.instrument),
        None,
    )
    return replace(
        version,
        curves=(borrowed.curve,),
        chains={str(dipole): chain},
        inputs={**version.inputs, BORROWED_FROM: neighbour.id},
        reason=f"{version.reason}; {_explain(borrowed, neighbour)}",
    )


def _holds(spectra: Spectra, path: Scope) -> bool:
    """Whether there are spectra of a path's antenna."""
    return bool(((spectra.station == path.station) & (spectra.antenna == path.antenna)).any())


def _find_gap(one: Version, other: Version) -> Instant:
    """The time between two windows, 0 where they touch."""
    return max(other.since - one.until, one.since - other.until)


def _explain(borrowed: Borrowed, neighbour: Version) -> str:
    since, until = (format_instant(end)[:10] for end in neighbour.window)
    return (
        f"too few events for a fit: C is that of {since} to {until} (version {neighbour.id[:10]}), the nearest window "
        f"with a fit, through its own cable, times a gain of {borrowed.gain:.4f} ± {borrowed.sigma:.4f} from "
        f"{borrowed.events} events"
    )
