from __future__ import annotations

from fastapi.testclient import TestClient

from service.app import GZIP_FROM
from service.page.assets import load_assets


def test_a_large_answer_is_compressed_for_those_who_accept_that(client: TestClient) -> None:
    large = next(asset for asset in load_assets().values() if len(asset.content) > GZIP_FROM)
    small = min(load_assets().values(), key=lambda asset: len(asset.content))
    packed, plain = client.get(large.url), client.get(large.url, headers={"Accept-Encoding": "identity"})
    assert (packed.headers.get("content-encoding"), plain.headers.get("content-encoding")) == ("gzip", None)
    assert packed.content == plain.content == large.content
    assert 2 * int(packed.headers["content-length"]) < int(plain.headers["content-length"])
    assert "accept-encoding" in plain.headers["vary"].lower()
    assert "content-encoding" not in client.get(small.url).headers
