"""The command and the listing of frozen numbers; those of fast data sets are compared beside the finder."""

from __future__ import annotations

import pytest

from validation.frozen.__main__ import NUMBERS, main
from validation.frozen.comparison import ABSENT, list_differences, read_numbers, write_numbers
from validation.frozen.listing import CAUSES, DATA_SETS, OTHERS
from validation.frozen.surface import in_first_window


def test_every_data_set_has_a_name_and_numbers_of_its_own():
    assert len(DATA_SETS) == len(CAUSES) + len(OTHERS)
    assert {path.name.removesuffix(".json.gz") for path in NUMBERS.iterdir()} == set(DATA_SETS)
    assert sum(path.stat().st_size for path in NUMBERS.iterdir()) < 1_000_000


def test_a_gap_in_the_temperature_is_of_one_event():
    spectra = DATA_SETS["unknown-temperature"].spectra()
    is_unknown = spectra.environment["temperature_c"] != spectra.environment["temperature_c"]
    assert len(set(spectra.event_id[is_unknown].tolist())) == 1


def test_numbers_differ_beyond_what_another_kernel_of_linear_algebra_moves():
    before = {"a": [1.0, {"z": 5.0}]}
    assert list_differences("d", before, {"a": [1.0 + 9e-5, {"z": 5.0 - 4e-4}]}) == []
    (found,) = list_differences("d", before, {"a": [1.0, {"z": 5.0 - 6e-4}]})
    assert (found.data_set, found.path) == ("d", "a/1/z")
    assert found.relative == pytest.approx(1.2e-4, rel=1e-3)


def test_a_finding_may_move_by_a_thousandth_of_its_standard_deviation():
    def moved(share):
        before, after = ({"size": {"value": value, "sigma": 2.0}, "change": value / 10} for value in (8.0, 8.0 + share))
        return [one.path for one in list_differences("d", before, after)]

    assert moved(0.0019) == []
    assert moved(0.0021) == ["size/value", "change"]
    assert list_differences("d", {"score_sigma": 0.1}, {"score_sigma": 0.1009}) == []
    assert len(list_differences("d", {"score_sigma": 0.1}, {"score_sigma": 0.1011})) == 1


def test_sentences_are_no_numbers():
    before = {"unidentifiable": [{"cause": "gain_step", "why": "no dates"}], "findings": [{"sentence": "It is 0.1."}]}
    after = {"unidentifiable": [{"cause": "gain_step", "why": "the dates are unknown"}], "findings": [{"sentence": ""}]}
    assert list_differences("d", before, after) == []


def test_only_what_rounding_moves_has_a_wider_tolerance():
    def changed(place):
        before, after = ({"report": {place: [{"value": value}]}} for value in (10.0, 10.005))
        return list_differences("d", before, after)

    assert changed("hypotheses") == []
    assert len(changed("findings")) == 1


def test_of_two_windows_that_share_out_the_day_one_is_shown():
    score = {"parameters": {"spectral_index": 0.0, "utc_h": [21, 9]}, "score_sigma": 3.0, "size": 0.1}
    turned = {"parameters": {"spectral_index": 0.0, "utc_h": [9, 21]}, "score_sigma": -3.0, "size": -0.1}
    assert in_first_window(score) == in_first_window(turned) == turned
    steep = {**score, "parameters": {"spectral_index": -2.5, "utc_h": [21, 9]}}
    assert in_first_window(steep) == steep


@pytest.mark.parametrize(
    ("before", "after"),
    [("gain_step", "gain_drift"), (None, 0.0), (1, True), ([], [0.0]), ({}, None), (ABSENT, {"key": 1})],
)
def test_what_is_no_number_differs_unless_it_is_equal(before, after):
    assert list_differences("d", {"a": before}, {"a": before}) == []
    assert len(list_differences("d", {"a": before}, {"a": after})) >= 1


def test_a_key_that_is_gone_or_new_is_a_difference():
    gone, new = list_differences("d", {"old": 1.0, "same": 2.0}, {"new": 1.0, "same": 2.0})
    assert (gone.path, gone.after) == ("old", ABSENT)
    assert (new.path, new.before) == ("new", ABSENT)


def test_numbers_are_stored_in_the_same_bytes(tmp_path):
    numbers = {"b": [1.0 / 3.0, None, "text"], "a": {"n": 3}}
    one, other = tmp_path / "one.json.gz", tmp_path / "other.json.gz"
    write_numbers(one, numbers)
    write_numbers(other, {"a": {"n": 3}, "b": (1.0 / 3.0, None, "text")})
    assert one.read_bytes() == other.read_bytes()
    assert list_differences("d", numbers, read_numbers(one)) == []


def test_the_command_names_a_changed_number_and_fails(monkeypatch, tmp_path, capsys):
    numbers = read_numbers(NUMBERS / "curve-clean.json.gz")
    numbers["report"]["chi2"]["before"]["estimated"] *= 1.001
    write_numbers(tmp_path / "curve-clean.json.gz", numbers)
    monkeypatch.setattr("validation.frozen.__main__.NUMBERS", tmp_path)
    assert main(["--compare", "curve-clean"]) == 1
    assert "curve-clean: report/chi2/before/estimated: " in capsys.readouterr().out
    assert main(["--write", "curve-clean"]) == 0
    assert main(["--compare", "curve-clean"]) == 0
