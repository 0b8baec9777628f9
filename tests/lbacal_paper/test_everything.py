from __future__ import annotations

import re

from lbacal_paper.everything import WITHOUT_DATA, WITHOUT_SHOWERS, redo_paper


def test_the_whole_paper_is_redone_without_any_data_beside_the_package() -> None:
    steps: list[str] = []
    redone = redo_paper(steps.append, antennas=4)
    assert len(steps) >= 5
    assert redone.notes[:2] == [WITHOUT_DATA, WITHOUT_SHOWERS]
    assert redone.notes[2].startswith("What the measured sky changes in 5.1 and 5.2: with the sky tied to absolute")
    # a hotter sky is a larger C in every channel
    assert all(part.startswith("+") for part in re.findall(r"([+-]\d+) %", redone.notes[2]))
    assert sum(claim["ours"] is not None for claim in redone.claims) >= 20
    assert [figure.number for figure in redone.figures] == list(range(1, 10))
    assert [len(table.rows) > 3 for table in redone.tables] == [True, True, True]
    assert all(len(row) == len(table.header) for table in redone.tables for row in table.rows)
