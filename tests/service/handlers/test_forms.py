from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from lbacal.instants import DAY_US, format_instant, parse_instant
from lbacal_core.curves.validity import Scope
from service.app import make_app
from service.factory import Factory
from service.storage.alarms import MISFIT, OPEN, News
from service.storage.drift import Cut

BROWSER = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
DATE = parse_instant("date", "2014-06-01")


@pytest.fixture
def browser(factory: Factory) -> Iterator[TestClient]:
    with TestClient(make_app(factory), raise_server_exceptions=False, headers=BROWSER, follow_redirects=False) as made:
        yield made


@pytest.fixture
def cut(factory: Factory) -> int:
    with factory.database.write() as stores:
        stores.cuts.add([Cut("CS001", 1, DATE, 2 * DAY_US)], DATE)
        return stores.cuts.kept()[0].number


def send(browser: TestClient, address: str, key: str, **fields: str) -> Any:
    return browser.post(address, data={"reason": "snow lay on it", "key": key, **fields})


def test_an_admin_lifts_a_cut_on_the_page_and_restores_it(browser: TestClient, factory: Factory, cut: int) -> None:
    number, key = factory.keys.create(("calibrations:promote",))
    page = browser.get("/drift").text
    assert "2014-06-01 &plusmn; 2.0 d" in page
    assert f'action="/cuts/{cut}/lift"' in page
    lifted = send(browser, f"/cuts/{cut}/lift", key)
    assert (lifted.status_code, lifted.headers["location"]) == (303, "/drift#cuts")
    (kept,) = factory.cuts.list_all(None)
    assert (kept.stands, kept.decision is not None and kept.decision.reason) == (False, "snow lay on it")
    page = browser.get("/drift").text
    assert "snow lay on it" in page
    assert f'action="/cuts/{cut}/restoration"' in page
    assert f'action="/cuts/{cut}/lift"' not in page
    assert send(browser, f"/cuts/{cut}/lift", key).status_code == 409
    assert send(browser, f"/cuts/{cut}/restoration", key).status_code == 303
    assert factory.cuts.list_all(None)[0].stands
    factory.keys.revoke(number)
    assert send(browser, f"/cuts/{cut}/lift", key).status_code == 403


@pytest.mark.parametrize("address", ["/cuts/{}/lift", "/cuts/{}/restoration"])
def test_nothing_changes_without_a_key_that_may(browser: TestClient, factory: Factory, cut: int, address: str) -> None:
    _, reads = factory.keys.create(("read", "refits:run"))
    _, good = factory.keys.create(("admin",))
    browser.cookies.set("lbacal_key", good)
    where = address.format(cut)
    refused = send(browser, where, "wrong")
    assert (refused.status_code, "the key is unknown, expired or revoked" in refused.text) == (403, True)
    assert "<h1>Forbidden</h1>" in refused.text, "a page, and not a log-in that leads nowhere"
    assert [send(browser, where, key).status_code for key in ("", reads)] == [403, 403]
    assert browser.post(where, data={"reason": "x"}).status_code == 403, "the kept key opens reads only"
    assert browser.post(where, json={"reason": "x", "key": good}).status_code == 415
    assert send(browser, where, good, reason=" ").status_code == 422
    assert send(browser, where, good, more="x").status_code == 422
    assert browser.get(where).status_code == 405
    assert factory.cuts.list_all(None)[0].decision is None


def test_a_problem_is_said_to_be_known_until_a_date(browser: TestClient, factory: Factory, clock: Any) -> None:
    _, key = factory.keys.create(("refits:run",))
    with factory.database.write() as stores:
        number = stores.alarms.raise_alarm(News(MISFIT, Scope("CS001"), "", "it misfits"), clock.now)
    address = f"/alarms/{number}/acknowledgement"
    assert f'action="{address}"' in browser.get("/alarms").text
    until = format_instant(clock.now + 40 * DAY_US)[:10]
    assert send(browser, address, key, until="2001-01-01").status_code == 422
    assert send(browser, address, key, until=until).headers["location"] == "/alarms"
    page = browser.get("/alarms").text
    assert f"until {until}: snow lay on it" in page
    clock.now += 41 * DAY_US
    assert [one.number for one in lasting(factory)] == [number], "it is told again"
    assert send(browser, address, key, until="").status_code == 303, "without a date it is for good"
    assert lasting(factory) == []


def lasting(factory: Factory) -> Any:
    return factory.alarms.newest(states=(OPEN,), kind=None, station=None, before=None, limit=10)
