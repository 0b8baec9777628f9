from __future__ import annotations

from typing import Any

from service.storage.models import Investigation
from service.usecases.alarms import STRONGER_SIGMA, tell_news


def finding(cause: str, sigma: float, antennas: tuple[int, ...] = (0, 1)) -> dict[str, Any]:
    sentence = f"{cause} in {list(antennas)}"
    where = {"antennas": list(antennas), "dipoles": ["X", "Y"]}
    return {"cause": cause, "significance_sigma": sigma, "where": where, "sentence": sentence}


def investigation(name: str, *findings: dict[str, Any], axis: str | None = None) -> Investigation:
    rest = None
    if axis is not None:
        rest = {"where": {"axis": axis, "target": "station"}, "description": f"along {axis}", "p_value": 1e-9}
    report = {"verdict": "explained", "findings": list(findings), "unexplained": rest}
    return Investigation(name, "CS001", 0, 1, {}, report, 2, "test", "test")


def test_the_first_investigation_is_all_new() -> None:
    news = tell_news(investigation("b", finding("lst_offset", 9.0)), None)
    assert (news.before, news.new, news.stronger, news.gone) == (None, ["lst_offset in [0, 1]"], [], [])


def test_what_stayed_is_no_news_and_noise_of_a_significance_is_none() -> None:
    before = investigation("a", finding("lst_offset", 9.0), axis="utc")
    news = tell_news(investigation("b", finding("lst_offset", 9.0 + 0.9 * STRONGER_SIGMA), axis="utc"), before)
    assert (news.before, news.new, news.stronger, news.gone) == ("a", [], [], [])


def test_what_came_grew_and_went_is_told() -> None:
    before = investigation("a", finding("lst_offset", 9.0), finding("gain_step", 8.0, (2,)), axis="utc")
    after = investigation("b", finding("lst_offset", 12.0), finding("gain_step", 8.0, (3,)), axis="date")
    news = tell_news(after, before)
    assert news.new == ["gain_step in [3]", "along date (p = 1.0e-09)"]
    assert news.stronger == ["lst_offset in [0, 1] (9.0 -> 12.0 sigma)"]
    assert news.gone == ["gain_step in [2]", "along utc (p = 1.0e-09)"]


def test_a_pattern_of_all_paths_is_no_news_where_another_path_shows_most() -> None:
    before, after = investigation("a", axis="lst"), investigation("b", axis="lst")
    before.report["unexplained"]["where"]["target"] = "antenna 0 X"
    after.report["unexplained"]["where"]["target"] = "antenna 47 Y"
    news = tell_news(after, before)
    assert (news.new, news.gone) == (["along lst (p = 1.0e-09)"], ["along lst (p = 1.0e-09)"])
    for one in (before, after):
        one.report["unexplained"]["paths"] = {"antenna 0 X": {"value": 1.0, "sigma": 0.1}}
    news = tell_news(after, before)
    assert (news.new, news.gone) == ([], [])


def test_a_second_step_of_the_same_path_is_new() -> None:
    before = investigation("a", finding("gain_step", 9.0, (2,)))
    news = tell_news(investigation("b", finding("gain_step", 9.0, (2,)), finding("gain_step", 6.0, (2,))), before)
    assert news.new == ["gain_step in [2]"]
