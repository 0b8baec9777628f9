"""A cause of an installation: named from a report, looked for beside the catalogue, refused where it cannot be one."""

import json

import pytest

from lbacal_core.causes.catalogue import FORMAT, catalogue_with, read_own_causes
from lbacal_core.errors import BadInputError

WORKSHOP = {"place": "receiver", "law": ["flat"], "course": ["working days"]}


@pytest.fixture
def report(tmp_path):
    path = tmp_path / "R.json"
    said = {"sentences": [{"parameters": WORKSHOP}]}
    path.write_text(json.dumps({"verdict": "unexplained", "findings": [], "unexplained": said}))
    return path


def test_a_sentence_of_a_report_is_named_and_listed(report, tmp_path, lbacal):
    file = tmp_path / "causes.json"
    code, said, _ = lbacal("causes", "add", f"{report}#unexplained", "--name", "workshop", "--file", file)
    assert code == 0
    assert said.startswith("workshop: the noise of the receiver changes, alike at all frequencies, from Monday")
    assert lbacal("causes", "--file", file)[1].startswith("workshop: the noise of the receiver changes")
    (cause,) = read_own_causes(file)
    assert (cause.identifier, catalogue_with(file)[-1]) == ("workshop", cause)
    code, _, why = lbacal("causes", "add", f"{report}#unexplained", "--name", "workshop", "--file", file)
    assert (code, "does not have" in why) == (2, True)
    assert json.loads(file.read_text())["causes"] == [{"name": "workshop", **WORKSHOP}]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["R#unexplained", "--name", "gain_step"], "the catalogue does not have"),
        (["R#unexplained", "--name", "W"], "lower-case letters"),
        (["R#0", "--name", "workshop"], "finding 0"),
        (["R#first", "--name", "workshop"], "number of a finding"),
    ],
)
def test_what_cannot_be_a_cause_is_refused_in_one_sentence(arguments, says, report, tmp_path, lbacal):
    given = [arguments[0].replace("R", str(report), 1), *arguments[1:], "--file", tmp_path / "causes.json"]
    code, _, why = lbacal("causes", "add", *given)
    assert (code, says in why) == (2, True), why
    assert not (tmp_path / "causes.json").exists()


def test_a_file_is_asked_for_where_none_is_named(lbacal):
    code, _, why = lbacal("causes")
    assert (code, "LBACAL_CAUSES" in why) == (2, True)


def test_a_file_that_is_named_and_not_there_is_no_empty_one(lbacal, tmp_path):
    code, _, why = lbacal("causes", "--file", tmp_path / "caues.json")
    assert (code, "caues.json" in why) == (2, True)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("[]", "as `lbacal causes add` writes it"),
        ('{"format": "other", "causes": []}', FORMAT),
        ('{"format": "lbacal-causes-1", "causes": [{"name": "workshop"}]}', "a place of sky"),
        (json.dumps({"format": FORMAT, "causes": [{"name": "workshop", **WORKSHOP}] * 2}), "each name once"),
    ],
)
def test_a_file_of_causes_that_is_none_is_refused(content, says, tmp_path):
    path = tmp_path / "causes.json"
    path.write_text(content)
    with pytest.raises(BadInputError, match=says):
        read_own_causes(path)
