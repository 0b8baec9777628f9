"""Spectra to a running service: one event a request, repeatable."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import httpx2
import numpy as np

from lbacal_core.errors import LbacalError
from lbacal_core.spectra import Spectra, write_spectra

TRIES = 5
_STORED = (200, 201)
_BUSY = (429, 503)


def send_spectra(spectra: Spectra, url: str, api_key: str | None) -> dict[str, int]:
    """Send spectra to `POST /v1/spectra` as one file an event; what is stored already counts as duplicate.

    Returns
    -------
    Sums of `received`, `stored` and `duplicates`.
    """
    totals = {"received": 0, "stored": 0, "duplicates": 0}
    headers = {"Content-Type": "application/x-hdf5"} | ({"Authorization": f"Bearer {api_key}"} if api_key else {})
    with tempfile.TemporaryDirectory() as folder, httpx2.Client(timeout=60.0, headers=headers) as client:
        path = Path(folder) / "event.h5"
        for event in np.unique(spectra.event_id):
            write_spectra(spectra.select(spectra.event_id == event), path)
            try:
                answer = _post(client, f"{url.rstrip('/')}/v1/spectra", path.read_bytes())
            except httpx2.HTTPError as error:
                raise LbacalError(f"{url}: cannot be reached ({error}); start the service or correct --url") from error
            if answer.status_code not in _STORED:
                raise LbacalError(f"{url}: event {event} was refused: {answer.status_code} {_reason(answer)}")
            receipt = answer.json()
            totals = {name: totals[name] + int(receipt[name]) for name in totals}
    return totals


def _post(client: httpx2.Client, address: str, body: bytes) -> httpx2.Response:
    """Post a body, waiting as long as a busy service asks."""
    for _ in range(TRIES - 1):
        answer = client.post(address, content=body)
        if answer.status_code not in _BUSY:
            return answer
        pause = answer.headers.get("Retry-After", "1")
        time.sleep(min(float(pause), 60.0) if pause.isdigit() else 1.0)
    return client.post(address, content=body)


def _reason(answer: httpx2.Response) -> str:
    """What a problem report says (RFC 9457), or the plain text of another answer."""
    try:
        problem = answer.json()
    except ValueError:
        return answer.text[:200]
    return str(problem.get("detail") or problem.get("title") or problem)[:400]
