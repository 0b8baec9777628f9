"""docs/validation.md is that of the records."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from validation.machinery.claims import Asked, Claim, decide, rate_of
from validation.machinery.ledger import Entry, read_ledger
from validation.machinery.page import draw_figures, write_page
from validation.machinery.quotes import Quote, figures_of, read_quotes, renew_pages, renew_tables
from validation.machinery.records import Record, read_history, read_records


def claim(key: str, says: str, found: float, interval: tuple[float, float]) -> Claim:
    return Claim(key, Asked(says, at_least=0.5), found, interval, 100, "%")


SHOWN = claim("antenna_spread", "It is found", 0.99, (0.946, 0.998))


def record(*claims: Claim, part: str = "nuisances") -> Record:
    return Record("twin", part, "1234567", "2027-01-01T00:00:00Z", "abc", 1, (), 1.5, claims)


def page_of(*records: Record) -> str:
    return write_page(records, [], [Entry("twin", "nuisances", 0, 3, "2027-01-01", "1234567")] * 2)


def test_the_page_is_that_of_the_records(repository: Path) -> None:
    page = write_page(read_records(), read_history(), read_ledger())
    assert (repository / "docs/validation.md").read_text() == page, "run ./dev prove --page"


def test_the_page_has_about_25_rows() -> None:
    """With a section and a row for each of ninety claims nobody saw what matters."""
    rows = [line for line in page_of(*read_records()).splitlines() if line.startswith("| ")][1:]
    assert 20 <= len(rows) <= 32
    assert len(set(rows)) == len(rows)


def test_a_headline_is_a_row_and_what_is_refuted_is_said_below_even_of_details() -> None:
    refuted = claim("station_mean", "It is named", 0.3, (0.2, 0.4))
    page = page_of(record(SHOWN, refuted, claim("antenna_mean", "A detail", 0.9, (0.8, 0.95))))
    row = "| It is found | >= 50 % | 99 % (94.6 to 99.8) | 100 (2) | shown | `twin nuisances`† |"
    assert row in page
    assert "| A detail |" not in page
    assert "- twin-nuisances: **refuted** It is named (asked >= 50 %" in page.partition("## What is not shown")[2]
    assert "It is found" not in page.partition("## What is not shown")[2]


def test_what_refuted_claims_of_a_part_begin_with_alike_is_said_once() -> None:
    names = ("A world: one", "A world: two", "Another: three")
    page = page_of(record(*(claim(f"mean_{k}", says, 0.3, (0.2, 0.4)) for k, says in enumerate(names))))
    said = re.findall(r"(?:refuted\*\*|;) ([^(;]+) \(asked", page)
    assert said == ["A world: one", "two", "Another: three"]


def test_an_undecided_detail_is_no_row_and_is_not_hidden() -> None:
    rows, _, below = page_of(record(claim("station_mean", "A detail", 0.5, (0.4, 0.6)))).partition("## What is not")
    assert "A detail" not in rows
    assert "interval): twin-nuisances." in below
    assert "It is found" not in page_of(record(SHOWN, part="clean")), "a part may have no row at all"


def test_proofs_without_trials_on_record_draw_no_figure(tmp_path: Path) -> None:
    assert draw_figures([record()], tmp_path) == []


QUOTES = read_quotes()


def alarms(hits: int, n: int) -> list[Record]:
    claims = decide([rate_of("alarms", hits, n)], {"alarms": Asked("Alarms", at_most=0.01)})
    return [Record("discovery", "own-sky", "1234567", "2027-01-01T00:00:00Z", "abc", 1, (), 1.0, claims)]


QUOTE = Quote(
    "page.md", "something was said of {discovery.own_sky.alarms.hits} of\n{discovery.own_sky.alarms.n} data sets"
)


def test_a_phrase_is_renewed_where_its_lines_break_otherwise():
    text = "First. Something else; something\nwas said of 4 of 2000 data sets, and more 7.\n"
    renewed = QUOTE.renewed(text, figures_of(alarms(5, 3000)))
    assert renewed == text.replace("4 of 2000", "5 of 3000")
    assert QUOTE.renewed(renewed, figures_of(alarms(5, 3000))) == renewed


def test_a_phrase_that_is_not_there_or_twice_or_quotes_what_no_record_holds_is_an_error():
    for text in ("nothing", "something was said of 4 of 20 data sets; something was said of 4 of 20 data sets"):
        with pytest.raises(ValueError, match=r"holds [02] times"):
            QUOTE.renewed(text, figures_of(alarms(5, 3000)))
    quote = Quote("page.md", "{fit.example.bias.n} data sets")
    with pytest.raises(ValueError, match=r"page.md quotes \{fit.example.bias.n\}, which no record holds"):
        quote.renewed("3 data sets", figures_of(alarms(0, 1)))


def test_a_page_is_renewed_phrase_by_phrase(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("something was said of 1 of 2 data sets, that is 50.0 %")
    share = Quote("page.md", "that is {discovery.own_sky.alarms.percent:.1f} %")
    (text,) = renew_pages([QUOTE, share], alarms(1, 200), tmp_path).values()
    assert text == "something was said of 1 of 200 data sets, that is 0.5 %"


def test_a_table_stays_as_it_is_until_every_part_of_it_has_trials():
    text = "Before\n<!-- records: traces_lines.bands -->\n| old |\n<!-- end of records -->\nafter\n"
    assert renew_tables(text, alarms(0, 3)) == text
    rows = tuple({"found": [0.0, 0.0, 0.5, 1.0, 1.0, 1.0], "change": [0.01] * 6} for _ in range(2))
    parts = [Record("traces_lines", name, "1234567", "", "abc", 1, (), 1.0, (), rows) for name in ("wide-1", "wide-12")]
    renewed = renew_tables(text, parts)
    assert "| 12 | 0 %, +1.0 % | 0 %, +1.0 % | 50 %, +1.0 % |" in renewed
    assert renew_tables(renewed, parts) == renewed


@pytest.mark.parametrize("page", sorted({quote.page for quote in QUOTES}))
def test_every_page_quotes_what_the_records_say(repository, page):
    ((path, text),) = renew_pages([quote for quote in QUOTES if quote.page == page], read_records(), repository).items()
    assert path.read_text(encoding="utf-8") == text, "run ./dev prove --page"
