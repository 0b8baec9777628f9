from __future__ import annotations

from lbacal_core.paper.everything import WITHOUT_DATA, redo_paper


def test_the_whole_paper_is_redone_without_any_data_beside_the_package() -> None:
    steps: list[str] = []
    redone = redo_paper(steps.append, antennas=4)
    assert len(steps) >= 5
    assert redone.notes == [WITHOUT_DATA]
    assert sum(claim["ours"] is not None for claim in redone.claims) >= 20
    assert [figure.number for figure in redone.figures] == list(range(1, len(redone.figures) + 1))
