from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from lbacal_core.calibration.fit import MIN_EVENTS
from lbacal_core.curves.validity import Scope
from lbacal_core.discovery.policy import Policy
from lbacal_core.spectra.spectra import Spectra
from service.factory import Factory
from service.page.render import format_day
from service.scheduler import look_for_due_work
from service.storage.models import Investigation
from service.storage.spectra import Window
from service.usecases.investigations import KIND, STRONGER_SIGMA, tell_news
from tests.service.conftest import like, night, served


@pytest.fixture
def nightly(station: Factory) -> Iterator[Factory]:
    """The service of two years, which also investigates by night."""
    with like(station, nightly_investigations=True) as made:
        yield made


@pytest.mark.long
def test_the_night_investigates_each_year_once_and_again_when_its_spectra_changed(nightly: Factory) -> None:
    jobs = [job for job in night(nightly) if job.kind == KIND]
    assert [(job.state, job.by) for job in jobs] == [("done", "scheduler")] * 2
    assert look_for_due_work(nightly) == []
    first = nightly.investigations.news()[0]
    assert (first.newest.station, format_day(first.newest.since)) == ("CS002", "2015-01-01")
    assert first.before == jobs[0].results[0]["results"][0], "the year before, until the year is investigated again"
    assert "gain_step" in [finding["cause"] for finding in first.newest.report["findings"]]
    assert any("antenna 2 Y" in sentence for sentence in first.new)

    events = nightly.calibrations.database
    with events.read() as stores:
        last = stores.spectra.events(limit=1000)[-1]
    nightly.intake.set_flag(last.event_id, "bad", reason="test", by="test")
    (again,) = [job for job in night(nightly) if job.kind == KIND]
    second = nightly.investigations.news()[0]
    assert second.newest.id == again.results[0]["results"][0]
    assert (second.before, list(second.new), list(second.gone)) == (first.newest.id, [], [])

    with served(nightly, "read") as client:
        (told,) = client.get("/v1/status").json()["investigations"]
        assert (told["id"], told["before"], told["new"]) == (second.newest.id, first.newest.id, [])
        page = client.get("/").text
        assert f'href="/investigations/{second.newest.id}"' in page
        short = client.get(f"/v1/investigations/{second.newest.id[:10]}")
        assert short.json()["id"] == second.newest.id
        assert client.get(f"/v1/investigations/{second.newest.id[:5]}").status_code == 404


def test_a_year_with_too_few_events_for_a_fit_is_not_yet_due(nightly: Factory, campaign: Spectra) -> None:
    """Otherwise the first nights of every January would end in a failed job."""
    names = np.unique(campaign.event_id[campaign.time_unix > np.datetime64("2015-01-01", "s").astype(float)])
    for name in names[MIN_EVENTS - 1 :]:
        nightly.intake.set_flag(str(name), "bad", reason="test", by="test")
    with nightly.database.read() as stores:
        windows = [format_day(part["since"]) for part, _ in nightly.investigations.due(stores)]
        assert windows == ["2014-01-01"]
    nightly.intake.set_flag(str(names[-1]), None, reason="test", by="test")
    with nightly.database.read() as stores:
        assert len(list(nightly.investigations.due(stores))) == 2


def test_another_threshold_makes_an_investigation_due_again(nightly: Factory, monkeypatch) -> None:
    with nightly.database.read() as stores:
        one, *_ = nightly.investigations.due(stores)
        monkeypatch.setattr("service.usecases.investigations.Policy", lambda: Policy(most_findings=4))
        again, *_ = nightly.investigations.due(stores)
    assert one[0] == again[0]
    assert one[1] != again[1]


def test_stored_investigations_never_saw_a_temperature(station: Factory, campaign: Spectra) -> None:
    """Spectra were loaded without covariates: no cause that follows one could be found in the service."""
    window = Window(0, 2**62, Scope("CS002"))
    with station.database.read() as stores:
        spectra = stores.spectra.load(window, station.instrument.frequency_mhz, 50.0, with_covariates=True)
    assert spectra is not None
    assert set(spectra.environment) == set(campaign.environment)
    assert spectra.environment
    place = {str(name): k for k, name in enumerate(campaign.event_id)}
    at = [place[str(name)] for name in spectra.event_id]
    for name, values in spectra.environment.items():
        np.testing.assert_array_equal(values, campaign.environment[name][at])


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
