"""Spectra to a running service: one event a request, repeatable."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from typing import Any

import httpx2
import numpy as np

from lbacal_core.errors import LbacalError
from lbacal_core.spectra import Spectra

TRIES = 5
_STORED = (200, 201)
_BUSY = (429, 503)


def send_spectra(spectra: Spectra, url: str, api_key: str | None) -> dict[str, int]:
    """Send spectra to `POST /v1/spectra`, one event a request; what is stored already counts as duplicate.

    Returns
    -------
    Sums of `received`, `stored` and `duplicates`.
    """
    totals = {"received": 0, "stored": 0, "duplicates": 0}
    headers = {"Authorization": f"Bearer {api_key}"} if api_key else {}
    with httpx2.Client(timeout=60.0, headers=headers) as client:
        for event in np.unique(spectra.event_id):
            body = describe_event(spectra.select(spectra.event_id == event))
            try:
                answer = _post(client, f"{url.rstrip('/')}/v1/spectra", body)
            except httpx2.HTTPError as error:
                raise LbacalError(f"{url}: cannot be reached ({error}); start the service or correct --url") from error
            if answer.status_code not in _STORED:
                raise LbacalError(f"{url}: event {event} was refused: {answer.status_code} {_reason(answer)}")
            receipt = answer.json()
            totals = {name: totals[name] + int(receipt[name]) for name in totals}
    return totals


def describe_event(spectra: Spectra) -> dict[str, Any]:
    """Spectra as the JSON of the route; numbers survive it bit by bit, times to a microsecond."""
    rows = []
    for k in range(len(spectra)):
        known = {name: float(values[k]) for name, values in spectra.environment.items() if np.isfinite(values[k])}
        row = {
            "event_id": str(spectra.event_id[k]),
            "time_utc": datetime.fromtimestamp(float(spectra.time_unix[k]), UTC).isoformat(timespec="microseconds"),
            "station": str(spectra.station[k]),
            "antenna": int(spectra.antenna[k]),
            "dipole": str(spectra.dipole[k]),
            "blocks": int(spectra.blocks[k]),
            "power": spectra.power[k].tolist(),
        }
        rows.append(row | ({"env": known} if known else {}))
    return {"frequency_mhz": spectra.frequency_mhz.tolist(), "spectra": rows}


def _post(client: httpx2.Client, address: str, body: dict[str, Any]) -> httpx2.Response:
    """Post a body, waiting as long as a busy service asks."""
    for _ in range(TRIES - 1):
        answer = client.post(address, json=body)
        if answer.status_code not in _BUSY:
            return answer
        pause = answer.headers.get("Retry-After", "1")
        time.sleep(min(float(pause), 60.0) if pause.isdigit() else 1.0)
    return client.post(address, json=body)


def _reason(answer: httpx2.Response) -> str:
    """What a problem report says (RFC 9457), or the plain text of another answer."""
    try:
        problem = answer.json()
    except ValueError:
        return answer.text[:200]
    return str(problem.get("detail") or problem.get("title") or problem)[:400]
