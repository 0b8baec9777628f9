from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lbacal_core.curves.validity import Promotion, Scope, answer_path, timeline
from lbacal_core.errors import BadInputError

PATH = Scope("CS001", 0, "X")
SCOPES = (PATH, Scope("CS001"), Scope(), Scope("CS001", 0, "Y"), Scope("CS002"))


@st.composite
def ledgers(draw: st.DrawFn) -> list[Promotion]:
    lines = draw(
        st.lists(
            st.tuples(
                st.sampled_from(SCOPES), st.integers(0, 9), st.one_of(st.none(), st.integers(1, 9)),
                st.sampled_from([None, "a", "b", "c"]), st.integers(0, 6),
            ),
            max_size=12,
        )
    )  # fmt: skip
    return [
        Promotion(k, scope, start, None if length is None else start + length, version, at)
        for k, (scope, start, length, version, at) in enumerate(lines)
    ]


@given(ledgers(), st.integers(-1, 20))
def test_the_timeline_agrees_with_asking_at_each_instant(ledger: list[Promotion], instant: int) -> None:
    stretches = timeline(ledger, PATH)
    assert stretches[0].start is None
    assert stretches[-1].end is None
    assert all(a.end == b.start and a.promotion != b.promotion for a, b in pairwise(stretches))
    holding = [s for s in stretches if (s.start is None or s.start <= instant) and (s.end is None or instant < s.end)]
    assert len(holding) == 1
    assert holding[0].promotion == answer_path(ledger, PATH, instant)


def test_the_narrowest_scope_with_a_version_answers() -> None:
    ledger = [
        Promotion(1, Scope(), 0, None, "array", 1),
        Promotion(2, Scope("CS001"), 10, 20, "station", 2),
        Promotion(3, PATH, 12, 14, "path", 3),
        Promotion(4, PATH, 13, 14, None, 4),
    ]
    answers = [answer_path(ledger, PATH, t) for t in (-1, 0, 10, 12, 13, 14, 20)]
    assert [a and a.calibration for a in answers] == [None, "array", "station", "path", "station", "station", "array"]


@pytest.mark.parametrize("parts", [(None, 1, "X"), ("CS001", 1, None), ("CS001", None, "X"), ("CS001", 1, "?")])
def test_a_scope_is_the_array_a_station_or_one_path(parts: tuple[str | None, int | None, str | None]) -> None:
    with pytest.raises(BadInputError):
        Scope(*parts)


def test_an_interval_of_validity_is_not_empty() -> None:
    with pytest.raises(BadInputError, match="valid_to"):
        Promotion(1, Scope(), 5, 5, "a", 1)
