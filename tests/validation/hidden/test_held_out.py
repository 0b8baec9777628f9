from __future__ import annotations

from validation.hidden.held_out import hide_in_halves


def test_what_a_deaf_path_recorded_is_divided_by_nothing() -> None:
    """A compression of this size leaves one path without the sky: the search leaves it out, and the model lacks it."""
    outcome = hide_in_halves(1_356_142)
    assert outcome is not None
    assert outcome.named == ["compression"]
    assert outcome.after < outcome.before
