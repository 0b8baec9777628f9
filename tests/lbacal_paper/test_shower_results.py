from __future__ import annotations

from lbacal_paper.shower_results import find_about_showers
from lbacal_paper.shower_study import ShowerStudy
from lbacal_paper.statements import AGREE, BY_CONSTRUCTION, UNDECIDED, judge, load_statements


def test_results_on_showers_name_what_is_missing(showers: ShowerStudy) -> None:
    found = find_about_showers(showers)
    for name in ("source-off-diagonal", "source-ratio", "source-difference"):
        assert found[name].ours is None
        assert "VSQ 1000" in found[name].how
    assert "nuradiomc" in found["coreas-straight"].how
    statements = {one.identifier: one for one in load_statements()}
    expected = {
        "background-subtraction": BY_CONSTRUCTION, "galaxy-on-diagonal": UNDECIDED, "source-far-field": AGREE,
        "signals-per-event": BY_CONSTRUCTION,
    }  # fmt: skip
    assert {name: judge(statements[name], found[name]) for name in expected} == expected
