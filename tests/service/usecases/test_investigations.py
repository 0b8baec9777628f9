from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from lbacal_core.calibration.fit import MIN_EVENTS
from lbacal_core.curves.validity import Scope
from lbacal_core.spectra.spectra import Spectra
from service.factory import Factory
from service.page.render import format_day
from service.scheduler import look_for_due_work
from service.storage.spectra import Window
from service.usecases.investigations import KIND
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


def test_another_judge_makes_an_investigation_due_again(nightly: Factory) -> None:
    with like(nightly, nightly_investigations=True, judge="compete") as other, nightly.database.read() as stores:
        (one, *_), (again, *_) = (list(use.investigations.due(stores)) for use in (nightly, other))
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
