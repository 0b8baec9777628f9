from __future__ import annotations

from lbacal_core.errors import name_path, write_chance, write_change, write_percent


def test_a_path_a_polarisation_a_station_and_the_array_have_one_name_each() -> None:
    assert name_path("CS002", 17, "X") == "CS002 antenna 17 X"
    assert [name_path("CS002", None, "X"), name_path("CS002", 0), name_path("CS002"), name_path(None)] == [
        "CS002 X", "CS002 antenna 0", "CS002", "array",
    ]  # fmt: skip


def test_a_chance_below_what_double_precision_holds_was_written_as_zero() -> None:
    assert [write_chance(p) for p in (0.0, 1e-310, 2.5e-300, 0.031)] == [
        "p < 1e-300", "p < 1e-300", "p = 2.5e-300", "p = 3.1e-02",
    ]  # fmt: skip


def test_changes_are_told_in_percent_with_their_sign() -> None:
    assert (write_percent(0.0125), write_percent(-0.5, 0), write_change(-0.031, 0.002)) == (
        "+1.25 %", "-50 %", "-3.10 ± 0.20 %",
    )  # fmt: skip
