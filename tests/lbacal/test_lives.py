import pytest

from lbacal.cli.life import print_change
from lbacal.lives import tell_life


def test_what_happened_on_one_day_stands_in_the_order_of_its_time() -> None:
    """It stood in the order of the alphabet."""
    alarm = {"raised_at": "2014-05-01T09:00:00Z", "alarm": 1, "state": "open", "sentence": "CS001 is wrong"}
    change = {
        "at": {"value": "2014-05-01T06:45:00Z"},
        "id": 3,
        "decision": "in_force",
        "ended_at": None,
        "refitted": True,
    }
    version = {"from": None, "to": "2014-05-01T06:45:00Z", "calibration": "ab" * 32}
    found = {"in_effect": [version], "changes": [change], "causes": [], "alarms": [alarm], "investigations": []}
    assert [at for at, _ in tell_life(found)] == ["", "2014-05-01", "2014-05-01"]
    assert [words.split()[0] for _, words in tell_life(found)] == ["version", "change", "alarm"]
    found["changes"] = [{**change, "at": {"value": "2014-05-01T09:00:00.000001Z"}}]
    assert [words.split()[0] for _, words in tell_life(found)] == ["version", "alarm", "change"]


def test_a_withdrawal_is_told_with_who_made_it_and_why() -> None:
    of = {"station": "CS001", "antenna": 0, "dipole": "X", "at": "2020-01-01T00:00:00", "by": "key 1", "reason": "hail"}
    found = {"withdrawals": [of | {"valid_from": "2014-05-01T00:00:00Z", "valid_to": None}]}
    sentence = "CS001 antenna 0 X was withdrawn from 2014-05-01T00:00:00Z to open by key 1: hail"
    assert tell_life(found) == [("2020-01-01", sentence)]


@pytest.mark.parametrize(
    ("paths", "who"), [(["X"], "CS003 antenna 1 X"), (["X", "Y"], "CS003 antenna 1"), ([None], "CS003 antenna 1")]
)
def test_a_change_of_one_dipole_is_told_with_its_letter(
    capsys: pytest.CaptureFixture[str], paths: list[str | None], who: str
) -> None:
    """One entered of a dipole was answered as one of its antenna."""
    print_change(
        {
            "id": 2,
            "station": "CS003",
            "paths": [{"antenna": 1, "dipole": one} for one in paths],
            "kind": "step",
            "in_words": "",
            "at": {"value": "2015-09-03T12:00:00Z", "sigma_days": 0.0},
            "ended_at": None,
            "decision": "in_force",
            "refitted": True,
            "evidence": [],
            "by": "ops",
            "reason": "found by ops",
        }
    )
    assert capsys.readouterr().out.startswith(f"2 {who}, step at 2015-09-03")
