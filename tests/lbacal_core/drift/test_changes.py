from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.drift.follow import History, follow
from lbacal_core.drift.report import list_changes
from validation.drift_world import DAY, START, YEAR, World, draw_history

WORLD = World(years=2.0, stations=1, antennas=12, events_per_year=500, yearly=0.03)


def _history(seed: int) -> History:
    return draw_history(WORLD, np.random.default_rng(seed))


def test_paths_that_step_together_are_one_change_with_its_members() -> None:
    history = _history(1)
    after = np.flatnonzero(history.time_unix >= START + 0.9 * YEAR)
    for path in (2, 3, 8):
        history.ln_c[path, after, 0] += 0.04
    changes = list_changes(history, follow(history))
    assert len(changes) == 1
    assert {(m.antenna, m.dipole) for m in changes[0].members} == {(1, "X"), (1, "Y"), (4, "X")}
    assert changes[0].date_unix == pytest.approx(START + 0.9 * YEAR, abs=5 * DAY)
    assert changes[0].size[0] == pytest.approx(0.04, abs=4 * changes[0].size_sigma[0])


def test_steps_at_two_dates_are_two_changes() -> None:
    history = _history(2)
    for path, year in ((2, 0.7), (9, 1.3)):
        history.ln_c[path, np.flatnonzero(history.time_unix >= START + year * YEAR), 0] += 0.04
    changes = list_changes(history, follow(history))
    assert sorted(len(change.members) for change in changes) == [1, 1]


def test_a_known_change_says_so_and_has_no_error_of_its_date() -> None:
    history = _history(3)
    known = np.full((24, 1), np.inf)
    known[5] = START + 1.1 * YEAR
    told = History(history.station, history.antenna, history.dipole, history.time_unix, history.ln_c, known)
    changes = list_changes(told, follow(told))
    assert [(change.is_known, change.date_sigma_s) for change in changes] == [(True, 0.0)]
    assert changes[0].date_unix == pytest.approx(START + 1.1 * YEAR)
