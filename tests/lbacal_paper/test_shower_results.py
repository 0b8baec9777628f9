from __future__ import annotations

from lbacal_paper.shower_results import find_about_showers
from lbacal_paper.shower_study import ShowerStudy
from lbacal_paper.statements import AGREE, judge, load_statements


def test_results_on_showers_name_what_is_missing(showers: ShowerStudy) -> None:
    found = find_about_showers(showers)
    for name in ("source-off-diagonal", "source-ratio", "source-difference"):
        assert found[name].ours is None
        assert "VSQ 1000" in found[name].how
    assert "nuradiomc" in found["coreas-straight"].how
    statements = {one.identifier: one for one in load_statements()}
    for name in ("background-subtraction", "galaxy-on-diagonal", "source-far-field", "signals-per-event"):
        assert judge(statements[name], found[name]) == AGREE, name
