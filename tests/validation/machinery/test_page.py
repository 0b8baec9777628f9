"""docs/validation.md is that of the records."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from validation.machinery.claims import at_least, claim_mean, claim_rate
from validation.machinery.page import draw_figures, write_page
from validation.machinery.records import Record, read_records
from validation.machinery.seeds import Block


def record(*claims, seeds: str = "fresh") -> Record:
    return Record("twin", "nuisances", "1234567", "2027-01-01T00:00:00Z", "abc", (), seeds, 1.5, claims)


def test_the_page_is_that_of_the_records(repository: Path) -> None:
    assert (repository / "docs/validation.md").read_text() == write_page(read_records()), "run ./dev prove --page"


def test_the_page_has_about_25_rows() -> None:
    """With a section and a row for each of ninety claims nobody saw what matters."""
    rows = [line for line in write_page(read_records()).splitlines() if line.startswith("| ")][1:]
    assert 20 <= len(rows) <= 32
    assert len(set(rows)) == len(rows)


def test_a_headline_is_a_row_and_what_is_refuted_is_said_below_even_of_details() -> None:
    shown = claim_rate("antenna_spread", "It is found", at_least(0.5), 99, 100)
    refuted = claim_rate("station_mean", "It is named", at_least(0.9), 50, 100)
    detail = claim_mean("antenna_mean", "A detail", at_least(0.0), np.array([1.0, 2.0]))
    page = write_page([record(shown, refuted, detail)])
    assert (
        "| It is found | >= 50 % | 99 % (94.6 to 99.8) | 100 | shown | `./dev prove twin --part nuisances` | 1234567 |"
        in page
    )
    assert "| A detail |" not in page
    assert "- twin-nuisances: **refuted** It is named (asked >= 90 %" in page.partition("## What is not shown")[2]
    assert "It is found" not in page.partition("## What is not shown")[2]


def test_an_undecided_detail_is_no_row_and_is_not_hidden() -> None:
    detail = claim_rate("station_mean", "A detail", at_least(0.9), 9, 10)
    rows, _, below = write_page([record(detail)]).partition("## What is not shown")
    assert "A detail" not in rows
    assert "- twin-nuisances: undecided, asked >= 90 %: `station_mean` 90 %" in below


def test_a_part_may_have_no_row_at_all() -> None:
    """Two kinds of noise are alike: one of them is the row."""
    claim = claim_rate("antenna_spread", "It is found", at_least(0.5), 99, 100)
    assert "It is found" not in write_page([replace(record(claim), part="clean")])


def test_a_claim_of_data_sets_that_had_been_seen_says_so() -> None:
    shown = claim_rate("antenna_spread", "It is found", at_least(0.5), 99, 100).seen_before()
    assert "| **undecided** (seen before) |" in write_page([record(shown, seeds="seen before")])


def test_a_record_of_blocks_apart_is_not_said_to_be_one_run() -> None:
    shown = claim_rate("antenna_spread", "It is found", at_least(0.5), 99, 100)
    blocks = (Block(1_000_000, 60), Block(1_000_100, 40))
    page = write_page([replace(record(shown), blocks=blocks)])
    command = "`./dev prove twin --part nuisances --first 1000000 --count 60`"
    assert f"| {command} (further blocks of seeds, in its record: 1) |" in page


def test_proofs_without_trials_on_record_draw_no_figure(tmp_path: Path) -> None:
    assert draw_figures([record()], tmp_path) == []
