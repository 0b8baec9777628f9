from __future__ import annotations

from lbacal_core.provenance import Remembered


def test_a_value_is_made_once_and_what_was_asked_for_last_stays_longest() -> None:
    made: list[int] = []

    def make(keys: list[int]) -> dict[int, int]:
        made.extend(keys)
        return {key: key**2 for key in keys if key >= 0}

    kept = Remembered[int, int](2)
    assert kept.get_many([3, 1, 3], make) == {3: 9, 1: 1}
    assert kept.get_many([3], make) == {3: 9}
    assert kept.get_many([2, -1], make) == {2: 4}, "what nothing makes is left out"
    assert kept.get_many([3], make) == {3: 9}
    assert made == [3, 1, 2, -1]
    assert kept.get_many([1], make) == {1: 1}
    assert made == [3, 1, 2, -1, 1], "it was asked for longest ago"
