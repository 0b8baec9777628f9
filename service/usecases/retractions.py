"""Retractions: most events of a version were flagged since it was made, and C in effect does not follow from them.

What due work put into effect ends by the next daily run, where no fit of the events that are left answers. What a
person put into effect stays, and answers with the reason. Cleared flags bring the same version back.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache

from lbacal_core.curves.validity import Instant, Promotion, Scope, list_deciding
from service.storage.database import Stores
from service.storage.processes import SCHEDULER
from service.storage.spectra import Window
from service.storage.sums import ServedKey
from service.storage.versions import Summary

SHARE = 0.5
"""C of fewer of its events than this is rather that of the others."""


def find_retracted(stores: Stores, versions: Iterable[Summary]) -> dict[str, str]:
    """Say of the versions most of whose events were flagged since how many, by id.

    Since they were made, or since a fit confirmed them last: the events that are left had the same C.
    """
    in_window = cache(lambda since, until: stores.spectra.count_flagged(Window(since, until)))
    found = {}
    for one in versions:
        if in_window(one.since, one.until) > SHARE * one.events:
            confirmed = stores.versions.confirmation(one.id)
            read = one.made if confirmed is None else max(one.made, confirmed.made)
            gone = stores.spectra.count_flagged(Window(one.since, one.until, one.scope), read)
            if gone > SHARE * one.events:
                found[one.id] = f"{min(gone, one.events)} of its {one.events} events were flagged since it was made"
    return found


def withdraw_retracted(
    stores: Stores, scopes: Sequence[Scope], since: Instant, until: Instant, answered: Collection[ServedKey] = ()
) -> Iterator[Promotion]:
    """Withdraw what due work put into effect in a window and what was retracted, but for what a fit answers anew."""
    if not stores.spectra.last_flag(since, until):
        return
    standing = stores.ledger.standing(scopes, since, until)
    deciding = [one for scope in scopes for one in list_deciding(standing, scope, since, until)]
    names = {str(one.calibration) for one in deciding if one.by == SCHEDULER and one.calibration is not None}
    retracted = find_retracted(stores, stores.versions.summaries(names))
    for one in deciding:
        spans = [span for scope, *span in answered if scope == one.scope]
        is_anew = any(first < (one.valid_to or until) and one.valid_from < last for first, last in spans)
        if one.by == SCHEDULER and one.calibration in retracted and not is_anew:
            yield replace(one, calibration=None, reason=retracted[one.calibration])
