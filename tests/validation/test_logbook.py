"""The logbook of real faults: sourced, and said by what it claims."""

import pytest

from lbacal_core.causes.catalogue import DESCRIPTIONS
from lbacal_core.causes.grammar import COURSES, LAWS, require_sentence
from validation.logbook import PAGE, SAID_BY, describe_logbook, read_logbook, who_says


def test_the_page_is_that_of_the_file():
    assert PAGE.read_text() == describe_logbook(), "run python -m validation.logbook"


def test_twenty_faults_have_date_instrument_and_source():
    faults = read_logbook()
    assert len(faults) >= 20
    for fault in faults:
        assert {"when", "instrument", "seen", "was", "source", "by"} <= fault.keys()
        assert fault["source"].startswith(("https://", "http://"))
        assert fault["by"] in SAID_BY


@pytest.mark.parametrize("fault", read_logbook(), ids=lambda one: f"{one['when']} {one['instrument']}")
def test_who_is_said_to_say_it_can(fault):
    if fault["by"] == "catalogue":
        assert fault["cause"] in {one.identifier for one in DESCRIPTIONS}
    elif fault["by"] == "grammar":
        require_sentence("logbook", fault)
        assert fault["law"][0] in LAWS
        assert fault["course"][0] in COURSES
    elif fault["by"] in ("nobody", "input"):
        assert len(fault["why"].split()) > 5
    assert who_says(fault) or fault["by"] == "audit"
