from __future__ import annotations

import pytest
from fastapi.testclient import TestClient

from lbacal.instants import parse_instant
from lbacal_core.curves.validity import Promotion
from service.app import make_app
from service.factory import Factory
from service.storage.versions import Version

PAGES = ("/", "/jobs", "/drift", "/alarms", "/models", "/stations/CS001")


@pytest.mark.parametrize("path", PAGES)
def test_a_page_of_an_empty_service_is_whole(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert answer.text.rstrip().endswith("</html>")
    assert "two small stations" in answer.text


def test_a_version_has_a_page_and_a_month_leads_to_it(
    factory: Factory, client: TestClient, stored: dict[str, Version]
) -> None:
    version, month = stored["path"], "/stations/CS001/0/X/2014-06"
    assert client.get(month).status_code == 404
    with factory.database.write() as stores:
        since, until = (parse_instant("", f"{year}-01-01") for year in (2014, 2015))
        promotion = Promotion(0, version.scope, since, until, version.id, 0, "somebody", "it is <good>")
        stores.ledger.append([promotion], factory.clock)
    led = client.get(month, follow_redirects=False)
    assert (led.status_code, led.headers["location"]) == (303, f"/calibrations/{version.id}")
    page = client.get(led.headers["location"]).text
    assert "it is &lt;good&gt;" in page
    assert "CS001 antenna 0 X" in page
    assert client.get("/stations/CS001/0/X/2015-06").status_code == 404


@pytest.mark.parametrize(("path", "status"), [("/calibrations/none", 404), ("/stations/CS999", 422), ("/cuts", 404)])
def test_what_is_not_there_is_a_page_for_whoever_looks(client: TestClient, path: str, status: int) -> None:
    seen = client.get(path, headers={"Accept": "text/html"})
    assert (seen.status_code, seen.headers["content-type"]) == (status, "text/html; charset=utf-8")
    assert seen.text.rstrip().endswith("</html>")


def test_the_pages_are_closed_where_reads_are(factory: Factory) -> None:
    closed = Factory(factory.settings.model_copy(update={"open_reads": False}), factory.clock)
    with TestClient(make_app(closed)) as stranger:
        assert {stranger.get(path, headers={"Accept": "*/*"}).status_code for path in PAGES} == {401}
