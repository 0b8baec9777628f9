"""docs/validation.md is that of the records."""

from __future__ import annotations

from pathlib import Path

from validation.machinery.claims import Asked, Claim
from validation.machinery.ledger import Entry, read_ledger
from validation.machinery.page import draw_figures, write_page
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
    row = "| It is found | >= 50 % | 99 % (94.6 to 99.8) | 100 | shown | `twin nuisances` | 2 | 1234567 | no |"
    assert row in page
    assert "| A detail |" not in page
    assert "- twin-nuisances: **refuted** It is named (asked >= 50 %" in page.partition("## What is not shown")[2]
    assert "It is found" not in page.partition("## What is not shown")[2]


def test_an_undecided_detail_is_no_row_and_is_not_hidden() -> None:
    rows, _, below = page_of(record(claim("station_mean", "A detail", 0.5, (0.4, 0.6)))).partition("## What is not")
    assert "A detail" not in rows
    assert "- twin-nuisances: undecided, asked >= 50 %: `station_mean` 50 %" in below


def test_a_part_may_have_no_row_at_all() -> None:
    """Two kinds of noise are alike: one of them is the row."""
    assert "It is found" not in page_of(record(SHOWN, part="clean"))


def test_proofs_without_trials_on_record_draw_no_figure(tmp_path: Path) -> None:
    assert draw_figures([record()], tmp_path) == []
