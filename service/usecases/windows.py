"""Versions of windows that hardware changes cut: one too small for a fit borrows from its neighbour, and says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lbacal_core.calibration.fit import SHARE_OF_MISFITS
from lbacal_core.curves import CONVERGED, MISFIT, TOO_FEW_EVENTS, TOO_FEW_LST_BINS
from lbacal_core.drift.borrow import Borrowed, borrow_curve
from lbacal_core.instrument import Instrument
from lbacal_core.reference_chain import CableTable, ReferenceChain
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra
from lbacal_core.spectra_blocks import split_into_blocks
from lbacal_core.validity import Instant, Scope
from service.storage.versions import Version
from service.wire.instants import format_instant

SECOND_US = 1_000_000
TOO_SMALL = (TOO_FEW_EVENTS, TOO_FEW_LST_BINS)


def lend_to_small(
    versions: Sequence[Version], pieces: Sequence[tuple[Instant, Spectra]], instrument: Instrument, sky_power: SkyPower
) -> list[Version]:
    """Give versions of paths whose window is too small for a fit the curve of a neighbour window, with a free gain.

    Parameters
    ----------
    pieces
        Where each piece begins, and its spectra without what adopted causes do.
    """
    return [_lend(version, versions, pieces, instrument, sky_power) for version in versions]


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
    versions: Sequence[Version],
    pieces: Sequence[tuple[Instant, Spectra]],
    instrument: Instrument,
    sky_power: SkyPower,
) -> Version:
    neighbours = [
        other
        for other in versions
        if other.scope == version.scope and other.curves[0].c is not None and _touch(version, other)
    ]
    if version.scope.antenna is None or version.status not in TOO_SMALL or not neighbours:
        return version
    neighbour = max(neighbours, key=lambda other: other.events)
    station, antenna, dipole = version.scope.parts
    spectra = next(of_piece for since, of_piece in pieces if since == version.since and _holds(of_piece, version.scope))
    own = (spectra.station == station) & (spectra.antenna == antenna) & (spectra.dipole == dipole)
    before, now = (
        instrument.cable_of(str(station), int(str(antenna)), (one.since + one.until) / 2 / SECOND_US)
        for one in (neighbour, version)
    )
    block = split_into_blocks(spectra.select(own))[0]
    borrowed = borrow_curve(neighbour.curves[0], block, instrument, sky_power, (before, now))
    if borrowed is None:
        return version
    chain = ReferenceChain(
        ((str(station), int(str(antenna))),), instrument.cables[now], CableTable.of(instrument), None
    )
    return replace(
        version,
        curves=(borrowed.curve,),
        chains={str(dipole): chain},
        inputs={**version.inputs, "borrowed_from": neighbour.id},
        reason=f"{version.reason}; {_explain(borrowed, neighbour)}",
    )


def _holds(spectra: Spectra, path: Scope) -> bool:
    """Whether there are spectra of a path's antenna."""
    return bool(((spectra.station == path.station) & (spectra.antenna == path.antenna)).any())


def _touch(one: Version, other: Version) -> bool:
    return one.until == other.since or other.until == one.since


def _explain(borrowed: Borrowed, neighbour: Version) -> str:
    since, until = (format_instant(end)[:10] for end in neighbour.window)
    return (
        f"too few events for a fit: C is that of {since} to {until} (version {neighbour.id[:10]}) through its own "
        f"cable, times a gain of {borrowed.gain:.4f} ± {borrowed.sigma:.4f} from {borrowed.events} events"
    )
