"""What is kept of a fit comes back as it was."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from lbacal_core.curves.kept_lines import KeptLines, MemberLines, join_members, read_lines, write_lines

PATHS, CHANNELS, MEMBERS = 2, 3, 4


def make_lines(rng: np.random.Generator) -> KeptLines:
    """The lines of two paths."""
    half = rng.normal(size=(PATHS, 2 * CHANNELS, 2 * CHANNELS)).astype(np.float32)
    slope, intercept, radiometer, loss = rng.normal(size=(4, PATHS, CHANNELS))
    constant, behind = rng.normal(size=(2, PATHS, 2, CHANNELS))
    return KeptLines(
        owners=[("CS002", 0, "X"), ("CS002", 1, "X")], events=np.array([40, 50]), has_c=np.array([True, False]),
        is_good=np.array([False, True]), slope=slope, intercept=intercept, information=half + half.transpose(0, 2, 1),
        radiometer=radiometer, constant=constant, behind=behind, scatter=rng.normal(size=PATHS), loss=loss,
        spectra=np.array(["ab", "cd"]), typical_blocks=100.0, variance_unit=1.5, form="in front",
    )  # fmt: skip


def make_members(rng: np.random.Generator) -> MemberLines:
    slope, intercept = rng.normal(size=(2, MEMBERS, CHANNELS))
    level, scatter = rng.normal(size=(2, MEMBERS))
    return MemberLines(np.array(["CS002"] * MEMBERS), np.arange(MEMBERS), slope, intercept, level, scatter)


def require_equal(one: Any, other: Any) -> None:
    for field in fields(one):
        left, right = getattr(one, field.name), getattr(other, field.name)
        if isinstance(left, MemberLines):
            require_equal(left, right)
        else:
            np.testing.assert_array_equal(left, right, err_msg=field.name)


def test_lines_of_paths_and_of_a_mean_are_read_as_they_were_written() -> None:
    rng = np.random.default_rng(1)
    own = make_lines(rng)
    mean = replace(own, owners=[(None, None, "X"), (None, None, "Y")], members=make_members(rng), form="published")
    for before, after in zip((own, mean), read_lines(write_lines([own, mean])), strict=True):
        require_equal(before, after)


def test_members_are_joined_in_their_order() -> None:
    parts = [make_members(np.random.default_rng(seed)) for seed in (1, 2)]
    joined = join_members(parts)
    np.testing.assert_array_equal(joined.slope, np.concatenate([one.slope for one in parts]))
    assert joined.antennas.tolist() == [0, 1, 2, 3, 0, 1, 2, 3]


def test_lines_are_lent_of_the_good_owners_alone() -> None:
    assert make_lines(np.random.default_rng(1)).lend({("CS002", 0, "X")}).is_good.tolist() == [True, False]
