"""A small instance of `./dev prove answers`."""

from dataclasses import replace

import pytest

from lbacal_core.audit.verdict import WRONG
from lbacal_core.causes.model import Model
from lbacal_core.errors import BadInputError
from validation.answers import Said, ask, judge, make, read
from validation.machinery.claims import One

NOTHING = Said(
    is_misfit=False,
    mistakes=[],
    wrong=[],
    right={"lst_offset"},
    is_healthy=True,
    found=[],
    verdict="consistent",
    axis="",
)


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (NOTHING, []),
        (replace(NOTHING, found=[{"lst_offset"}]), ["right: lst_offset"]),
        (replace(NOTHING, found=[{"lst_offset", "dipole_azimuth"}]), []),
        (replace(NOTHING, mistakes=[{"dipole_swap"}]), ["right: the record, of which the fit names a mistake"]),
        (replace(NOTHING, is_misfit=True), ["misfit, and nothing is found"]),
        (replace(NOTHING, is_misfit=True, verdict="unexplained"), []),
        (
            replace(NOTHING, right=set(), is_healthy=False, wrong=[{"site"}], found=[{"dipole_swap"}]),
            ["other names: audit and investigation"],
        ),
        (replace(NOTHING, right=set(), is_healthy=False, wrong=[{"site"}], found=[{"dipole_swap", "site"}]), []),
    ],
)
def test_what_contradicts_is_told(said: Said, told: list[str]) -> None:
    assert said.contradictions() == told


CLOCK_OF_HOURS = 2
"""World in which it is off by more hours than the catalogue has."""


@pytest.mark.long
def test_a_clock_that_no_search_finds_is_one_answer_of_all_three(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("validation.answers.EVENTS", 150)
    monkeypatch.setattr("validation.answers.TEN", (0, 1, 2, 6, 7))
    audited, fits, content = ask(*make("clock", CLOCK_OF_HOURS), seed=0)
    said = read(audited, fits, content)
    assert (said.contradictions(), said.verdict, said.is_healthy, said.axis) == ([], "explained", False, "")
    assert ["lst_offset" in one for one in [*said.found, *said.wrong]] == [True, True]
    row = {"trouble": "clock", "contradictions": [], "healthy": True, "is_misfit": False, "verdict": "explained"}
    (contradictory, _) = judge([row, {**row, "contradictions": ["right: lst_offset"]}])
    assert isinstance(contradictory, One)
    assert contradictory.found == 0.5
    # the record put right is a finding like any other
    (finding,) = content["findings"]
    (line,) = [one for one in audited.lines if one.verdict == WRONG]
    assert line.sentence in finding["sentence"]
    assert finding["size"]["value"] == pytest.approx(line.value)
    assert finding["gain"]["chi2_before"] - finding["gain"]["chi2_after"] > 1000.0
    assert set(finding["where"]["antennas"]) <= {0, 1, 2, 6, 7}  # who has events enough
    with pytest.raises(BadInputError, match="put the record right instead, and investigate again, found lst_offset"):
        Model.from_report(content)
