"""Texts quote the figures of the records."""

from __future__ import annotations

import pytest

from proofs.machinery.claims import at_most, claim_rate
from proofs.machinery.quoted import QUOTES
from proofs.machinery.quotes import Quote, figures_of, renew_pages
from proofs.machinery.records import Record, read_records


def alarms(hits: int, n: int) -> list[Record]:
    claim = claim_rate("alarms", "Alarms", at_most(0.01), hits, n)
    return [Record("discovery", "own-sky", "1234567", "2027-01-01T00:00:00Z", "abc", (), "fresh", 1.0, (claim,))]


QUOTE = Quote(
    "page.md", "something was said of {discovery.own_sky.alarms.hits} of\n{discovery.own_sky.alarms.n} data sets"
)


def test_a_phrase_is_renewed_where_its_lines_break_otherwise():
    text = "First. Something else; something\nwas said of 4 of 2000 data sets, and more 7.\n"
    renewed = QUOTE.renewed(text, figures_of(alarms(5, 3000)))
    assert renewed == text.replace("4 of 2000", "5 of 3000")
    assert QUOTE.renewed(renewed, figures_of(alarms(5, 3000))) == renewed


def test_a_phrase_that_is_not_there_or_twice_is_an_error():
    for text in ("nothing", "something was said of 4 of 20 data sets; something was said of 4 of 20 data sets"):
        with pytest.raises(ValueError, match=r"holds [02] times"):
            QUOTE.renewed(text, figures_of(alarms(5, 3000)))


def test_a_page_is_renewed_phrase_by_phrase(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("something was said of 1 of 2 data sets, that is 50.0 %")
    share = Quote("page.md", "that is {discovery.own_sky.alarms.percent:.1f} %")
    (text,) = renew_pages([QUOTE, share], alarms(1, 200), tmp_path).values()
    assert text == "something was said of 1 of 200 data sets, that is 0.5 %"


@pytest.mark.parametrize("page", sorted({quote.page for quote in QUOTES}))
def test_every_page_quotes_what_the_records_say(repository, page):
    ((path, text),) = renew_pages([quote for quote in QUOTES if quote.page == page], read_records(), repository).items()
    assert path.read_text(encoding="utf-8") == text, "run ./dev prove --page"
