"""Due refits that read only the events that came since: the fit that is kept is continued by them.

Where C then differs too little from what a scope is told, nothing is written but that the events were examined. The few
paths of a station of which that cannot be said are fitted from their own spectra. The whole window is read where more
than these changed: flags, late spectra of events that were there, other inputs, models with causes, promotions since.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lbacal_core.calibration.continued import Continued, continue_fit
from lbacal_core.curves.kept_lines import KeptLines
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import MODEL_VERSION, hash_content
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from service.storage.database import Stores
from service.storage.examined import Examined
from service.storage.kept_fits import KeptFit, KeptPiece, Told
from service.storage.versions import Version
from service.usecases.fits import Made, Wanted
from service.usecases.windows import SECOND_US

SMALLEST_SHIFT = 0.25
"""Due work that moves C by less than this, in standard deviations and in every channel, is no news."""
LARGEST_REST = 0.5
"""Share of the paths of a station from which on the window is read whole."""


TellKey = tuple[Scope, Instant, Instant]
"""Who is told something, from when until when."""


@dataclass(frozen=True)
class Content:
    """What a window holds: the count of its usable spectra, the last flag set in it, and its newest event."""

    spectra: int
    flag: int
    event: int


@dataclass(frozen=True)
class Later:
    """A kept fit, and the spectra that came since."""

    fit: KeptFit
    spectra: Spectra


@dataclass(frozen=True)
class Outcome:
    """What later events confirm, and the paths of which only a fit from spectra can tell: none where it is a mean."""

    examined: Sequence[Examined]
    rest: Sequence[Scope]


@dataclass(frozen=True)
class Examination:
    """Continues kept fits."""

    instrument: Instrument
    sky_power: Callable[[], SkyPower]
    is_own_sky: bool
    resistance_ohm: float
    clock: Callable[[], Instant]

    def read_content(self, stores: Stores, wanted: Wanted) -> Content:
        """What the window of a fit holds now."""
        window = wanted.window
        return Content(*stores.spectra.content(window), stores.spectra.newest_event(window))

    def read_later(self, stores: Stores, wanted: Wanted, content: Content) -> Later | None:
        """The kept fit of a window with the spectra of later events; None where more than these changed."""
        if not wanted.model.is_plain:
            return None
        fit = stores.kept_fits.get(wanted.scope, wanted.of, wanted.since, wanted.until)
        if fit is None or (fit.inputs, fit.flag) != (self._name_inputs(wanted), content.flag):
            return None
        channels, resistance = self.instrument.frequency_mhz, self.resistance_ohm
        spectra = stores.spectra.load_after(wanted.window, fit.event, channels, resistance)
        is_all = spectra is not None and fit.spectra + len(spectra) == content.spectra
        return Later(fit, spectra) if spectra is not None and is_all else None

    def examine(self, later: Later) -> Outcome | None:
        """Look at later events; None where the whole window is to be read."""
        examined, rest, made, names = list[Examined](), list[Scope](), self.clock(), later.spectra.digest()
        seen = np.zeros(len(later.spectra), dtype=bool)
        for piece in later.fit.pieces:
            rows = _rows_of(piece, later.spectra)
            seen |= rows
            if not np.any(rows):
                continue
            with threadpool_limits(1):
                continued = continue_fit(piece.lines, later.spectra.select(rows), self.instrument, self.sky_power())
            for told in piece.told:
                shift = _find_shift(told, continued)
                if shift is None and not told.curves:
                    return None
                if shift is None or shift >= SMALLEST_SHIFT:
                    rest.append(told.scope)
                    continue
                inputs = hash_content([told.calibration, names])
                examined.append(Examined(told.scope, piece.since, piece.until, inputs, told.calibration, shift, made))
        is_whole = len(later.fit.pieces) == 1 and all(scope.antenna is not None for scope in rest)
        is_few = not rest or (is_whole and len(rest) <= LARGEST_REST * (len(rest) + len(examined)))
        return Outcome(examined, rest) if np.all(seen) and is_few else None

    def is_still_told(self, stores: Stores, fit: KeptFit) -> bool:
        """Whether what is in effect is what was when a fit was kept."""
        for piece in fit.pieces:
            standing = find_standing(stores, [told.scope for told in piece.told], piece.since, piece.until)
            if any(standing.get(one.scope) != (one.calibration if one.is_in_effect else None) for one in piece.told):
                return False
        return True

    def keep(self, stores: Stores, wanted: Wanted, content: Content, made: Made, told: Mapping[TellKey, Told]) -> None:
        """Keep a fit, where the chain alone was fitted."""
        if not made.lines:
            return
        pieces = [
            KeptPiece(since, until, lines, [told[scope, since, until] for scope in _list_scopes(lines)])
            for since, until, lines in made.lines
        ]
        stores.kept_fits.put(
            KeptFit(
                wanted.scope, wanted.of, wanted.since, wanted.until, self._name_inputs(wanted), content.spectra,
                content.flag, content.event, pieces,
            )
        )  # fmt: skip

    def keep_told(self, stores: Stores, fit: KeptFit, told: Mapping[TellKey, Told]) -> None:
        """Keep what some scopes are told since, with the lines as they are."""
        pieces = [
            replace(piece, told=[told.get((one.scope, piece.since, piece.until), one) for one in piece.told])
            for piece in fit.pieces
        ]
        stores.kept_fits.put(replace(fit, pieces=pieces))

    def _name_inputs(self, wanted: Wanted) -> str:
        """The hash of all inputs of a fit but its spectra."""
        ends = wanted.since / SECOND_US, wanted.until / SECOND_US
        instrument = self.instrument.digest_of(*ends, wanted.of.station, wanted.of.antenna)
        cuts = [[one.station, one.antenna, one.date] for one in wanted.cuts]
        return hash_content([instrument, self.sky_power().digest(), self.is_own_sky, MODEL_VERSION, cuts])


def find_standing(stores: Stores, scopes: Sequence[Scope], since: Instant, until: Instant) -> dict[Scope, str]:
    """The versions that are in effect over a whole window, by scope."""
    return {
        scope: promotion.calibration
        for scope, promotion in stores.ledger.decisive(scopes, (since + until) // 2, None).items()
        if promotion.calibration is not None and promotion.covers(since) and promotion.covers(until - 1)
    }


def tell(version: Version, *, is_in_effect: bool) -> Told:
    """What a scope is told after a fit."""
    curves: Mapping[str, tuple[Floats, Floats]] = {
        str(curve.dipole): (curve.c, curve.c_sigma_stat)
        for curve in version.curves
        if curve.c is not None and curve.c_sigma_stat is not None
    }
    return Told(version.scope, version.id, is_in_effect, curves)


def _rows_of(piece: KeptPiece, spectra: Spectra) -> NDArray[np.bool_]:
    """The spectra that belong to a piece of a window: of a mean those of its time, else those of its paths too."""
    rows = (spectra.time_unix >= piece.since / SECOND_US) & (spectra.time_unix < piece.until / SECOND_US)
    if any(one.members is not None for one in piece.lines):
        return np.asarray(rows)
    paths = {owner for one in piece.lines for owner in one.owners}
    keys = zip(spectra.station.tolist(), spectra.antenna.tolist(), spectra.dipole.tolist(), strict=True)
    return np.asarray(rows & np.array([key in paths for key in keys]))


def _list_scopes(lines: Sequence[KeptLines]) -> list[Scope]:
    """The scopes that lines are of, each once."""
    owners = [owner for one in lines for owner in one.owners]
    return list(dict.fromkeys(Scope(s, a, None if a is None else dipole) for s, a, dipole in owners))


def _find_shift(told: Told, continued: Continued) -> float | None:
    """By how much C may differ from what is told, in standard deviations: the largest of any channel that has both.

    None where that is not decided, or where one of them has a curve that the other lacks.
    """
    dipoles = [told.scope.dipole] if told.scope.dipole is not None else _list_dipoles(told, continued)
    owners = {dipole: (told.scope.station, told.scope.antenna, dipole) for dipole in dipoles}
    own = {dipole: continued.curves[owner] for dipole, owner in owners.items() if owner in continued.curves}
    if own.keys() != told.curves.keys() or continued.undecided & set(owners.values()):
        return None
    shifts = [
        np.nanmax(np.abs(own[dipole][0] - c) / np.fmin(own[dipole][1], sigma)) + own[dipole][2]
        for dipole, (c, sigma) in told.curves.items()
    ]
    return float(max(shifts, default=0.0))


def _list_dipoles(told: Told, continued: Continued) -> list[str]:
    """The dipoles of which a mean has curves."""
    parts = told.scope.station, told.scope.antenna
    return sorted({dipole for *own, dipole in (*continued.curves, *continued.undecided) if tuple(own) == parts})
