from __future__ import annotations

from service.usecases.calibrations import LastMade


def test_another_state_is_made_anew_and_the_same_is_not() -> None:
    made: list[str] = []
    last = LastMade[str]()

    def make() -> str:
        made.append("one")
        return f"content {len(made)}"

    told = [last.get(state, make) for state in ("a", "a", "b", "a")]
    assert told == ["content 1", "content 1", "content 2", "content 3"]
