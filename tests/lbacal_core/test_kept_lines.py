from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from lbacal_core.curves.kept_lines import KeptLines, MemberLines, read_lines, write_lines


def draw(rng: np.random.Generator, members: MemberLines | None) -> KeptLines:
    root = rng.standard_normal((2, 8, 8))
    return KeptLines(
        owners=[("CS002", 3, "X"), (None, None, "X")], events=np.array([400, 12]), has_c=np.array([True, False]),
        slope=rng.random((2, 4)), intercept=rng.random((2, 4)), information=root @ root.transpose(0, 2, 1),
        radiometer=rng.random((2, 4)), constant=rng.random((2, 3, 4)), behind=rng.random((2, 3, 4)),
        scatter=rng.random(2), typical_blocks=100.0, variance_unit=1.5, members=members,
    )  # fmt: skip


@pytest.mark.parametrize("is_mean", [False, True])
def test_lines_are_read_as_they_were_written_but_for_the_rounding_of_the_information(is_mean: bool) -> None:
    rng = np.random.default_rng(1)
    members = MemberLines(
        np.array(["CS002", "CS003"]), np.array([3, 4]), rng.random((2, 4)), rng.random((2, 4)), rng.random(2),
        rng.random(2),
    )  # fmt: skip
    written = draw(rng, members if is_mean else None)
    (read,) = read_lines(write_lines([written]))
    assert (read.owners, read.typical_blocks, read.variance_unit) == (written.owners, 100.0, 1.5)
    for one in fields(KeptLines):
        if isinstance(getattr(written, one.name), np.ndarray):
            tolerance = 1e-6 if one.name == "information" else 0
            np.testing.assert_allclose(getattr(read, one.name), getattr(written, one.name), rtol=tolerance)
    assert (read.members is None) == (not is_mean)
    if read.members is not None:
        for name, values in vars(members).items():
            np.testing.assert_array_equal(getattr(read.members, name), values)
