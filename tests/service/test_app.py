from __future__ import annotations

import subprocess
import sys
from collections import Counter

import pytest
import schemathesis
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, Phase, given, settings, strategies
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from service.app import GZIP_FROM, make_app
from service.factory import Factory
from service.page.render import load_assets
from service.storage.versions import Version

EXAMPLES = 5
"""Requests to each route, made up from its schema: 90 to 100 in all."""
CONFORMANCE = [
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
]


def test_a_large_answer_is_compressed_for_those_who_accept_that(client: TestClient) -> None:
    large = next(asset for asset in load_assets().values() if len(asset.content) > GZIP_FROM)
    small = min(load_assets().values(), key=lambda asset: len(asset.content))
    packed, plain = client.get(large.url), client.get(large.url, headers={"Accept-Encoding": "identity"})
    assert (packed.headers.get("content-encoding"), plain.headers.get("content-encoding")) == ("gzip", None)
    assert packed.content == plain.content == large.content
    assert 2 * int(packed.headers["content-length"]) < int(plain.headers["content-length"])
    assert "accept-encoding" in plain.headers["vary"].lower()
    assert "content-encoding" not in client.get(small.url).headers


@pytest.mark.long
@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
@pytest.mark.parametrize("scope", ["admin", "read"])
def test_every_route_answers_what_its_schema_allows_as_its_schema_says(
    factory: Factory, stored: dict[str, Version], scope: str
) -> None:
    _, key = factory.keys.create((scope,))
    known = {"version_id": stored["path"].id, "first": stored["path"].id, "second": stored["other"].id}
    statuses: Counter[int] = Counter()
    for found in schemathesis.openapi.from_asgi("/openapi.json", make_app(factory)).get_all_operations():
        operation = found.ok()

        @settings(
            max_examples=EXAMPLES,
            deadline=None,
            derandomize=True,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(case=operation.as_strategy(), is_known=strategies.booleans())
        def ask(case: schemathesis.Case, is_known: bool) -> None:
            if is_known:
                case.path_parameters.update({name: known[name] for name in case.path_parameters if name in known})
            answer = case.call(headers={"Authorization": f"Bearer {key}"})
            case.validate_response(answer, checks=CONFORMANCE)
            # nobody works here, and readiness says so
            assert answer.status_code < 500 or (case.path, answer.status_code) == ("/readyz", 503)
            statuses[answer.status_code] += 1

        ask()
    assert statuses[200] > 0
    assert (statuses[403] > 0) == (scope == "read")
    assert statuses[401] == 0


def test_an_api_that_answers_loads_nothing_of_what_computes() -> None:
    code = "import sys, service.app; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "service.usecases.calibrations" in loaded
    computing = {"scipy.stats", "healpy", "lbacal_core.discovery", "lbacal_core.audit", "lbacal_core.calibration.fit"}
    assert loaded & computing == set()
