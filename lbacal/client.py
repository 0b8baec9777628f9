"""What a pipeline does with the service: ask for the calibration in effect, send spectra, ask for fits."""

from __future__ import annotations

import hashlib
import json
import os
import time
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from inspect import signature
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, Self, TypeVar

import numpy as np

from lbacal import tables
from lbacal.cache import Cache, Question, Snapshot
from lbacal.files import path_of
from lbacal.instants import format_time, parse_instant
from lbacal.selection import parse_selection
from lbacal.transport import STUCK_S, TRIES, Transport, UnreachableError, files_of_events
from lbacal_core.curves.galcal import make_head
from lbacal_core.errors import BadInputError
from lbacal_core.spectra.spectra import Spectra, read_spectra

if TYPE_CHECKING:
    from lbacal.curve_table import CurveTable

DEFAULT_URL = "http://127.0.0.1:8000"
_EFFECTIVE = "/v1/calibrations/effective"
ENDED = ("done", "failed", "cancelled")
POLL_S = 0.5
BUNDLE = 10_000
"""Spectra of a request of `ingest`, in whole events: 4 MB, a tenth of a second of the server."""
ASKED_AT_ONCE = 5
"""Events about which the server is asked whether it has them, in one request."""


class CachedAnswerWarning(UserWarning):
    """No server answers: the calibrations are those of a tag that was synced before."""


def describe_snapshot(snapshot: Snapshot) -> str:
    """Which tag answers, and as of when."""
    part = f" ({snapshot.part} alone)" if snapshot.part else ""
    when = f"as known at {snapshot.as_of}, synced at {snapshot.synced_at[:19]}Z from {snapshot.url}"
    return f"tag {snapshot.tag}{part}, {when}"


def _question(params: Mapping[str, Any]) -> Question:
    about = {name: params[name] for name in ("station", "antenna", "dipole", "scope")}
    return Question(at=parse_instant("at", params["at"]), **about)


class Client:
    """A server and a key; by default those of `LBACAL_URL` and `LBACAL_API_KEY`."""

    def __init__(self, url: str | None = None, api_key: str | None = None, tries: int = TRIES) -> None:
        address = url or os.environ.get("LBACAL_URL") or DEFAULT_URL
        self._transport = Transport(address, api_key or os.environ.get("LBACAL_API_KEY") or None, tries)
        folder = os.environ.get("LBACAL_CACHE")
        self._cache = Cache(Path(folder)) if folder else None
        self.snapshot: Snapshot | None = None
        """The cached tag that answered the last question; None where the server did."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    @property
    def url(self) -> str:
        """The address of the server."""
        return self._transport.url

    def get(self, path: str, **params: Any) -> Any:
        """The JSON at a path of the API."""
        return self._transport.request("GET", path, params=params).json()

    def list(self, path: str, name: str, **params: Any) -> list[Any]:
        """All items of a list that the API gives page by page under a name."""
        page = self.get(path, **params)
        found = page[name]
        while page["next"] is not None:
            page = self.get(path, **params | {"cursor": page["next"]})
            found += page[name]
        return list(found)

    def fetch(self, path: str, **params: Any) -> bytes:
        """The bytes at a path of the API."""
        return self._transport.request("GET", path, params=params).content

    def sync(
        self,
        tag: str,
        on_step: Callable[[int, int], None] | None = None,
        *,
        stations: Sequence[str] = (),
        since: Any = None,
        until: Any = None,
    ) -> tuple[Snapshot, int]:
        """Bring what a tag holds, or a part of it, into `LBACAL_CACHE`; see `Cache.sync`."""
        if self._cache is None:
            raise BadInputError("LBACAL_CACHE", "a folder for the answers of the tag", "nothing")
        part = parse_selection(since, until, None, stations, prefix="")
        return self._cache.sync(self, tag, on_step, only=part.stations, since=part.since, until=part.until)

    def send(self, method: str, path: str, body: dict[str, Any], **params: Any) -> Any:
        """Send a JSON body, without fields that are None unless they are `calibration`; the JSON that comes back."""
        given = {name: value for name, value in body.items() if value is not None or name == "calibration"}
        return self._transport.request(method, path, params=params, body=given).json()

    def effective(
        self, station: str | None = None, antenna: int | None = None, dipole: str | None = None, *,
        at: Any, as_of: Any = None, gap: str | None = None, scope: str | None = None, tag: str | None = None,
        format: str | None = None,  # noqa: A002 (the name that the HTTP route has)
    ) -> Any:  # fmt: skip
        """The calibration in effect at an instant, one row per path and frequency, with units.

        A tag that is in `LBACAL_CACHE` is answered from there, since it is the same for ever; anything else only where
        the server does not answer, and then from the tag that was synced last.

        Parameters
        ----------
        station, antenna, dipole
            A path such as ``("CS002", 17, "X")``; without dipole both, without antenna the whole station, without
            station all stations.
        at, as_of
            When the data were taken, and when the question is asked (None: now): an astropy Time, a date, a datetime
            (naive = UTC) or ISO 8601 text.
        gap
            ``hold`` answers with the nearest in time where nothing is in effect; such rows are ``uncertain``. A cache
            does not know it.
        scope
            ``array``: the reference chain of the array, which is nobody's cable (station empty, antenna -1).
        tag
            Name of an instant at which the ledger was frozen, in place of `as_of`.
        format
            A format in which the server writes it: json, csv, ecsv, fits, hdf5, or nuradio for one path.

        Returns
        -------
        A `CurveTable` with the columns `c`, `c_sigma_stat`, `c_sigma_sys` (V per ADC unit), `frequency_mhz`, `flag` and
        more; with `format` the bytes of such a file. C of every path through its own cable, whichever scope
        answered. `flag` is ``ok``, or ``uncertain`` for the reason in `flag_reason`; `factor` is c over that of the
        stored curve. `meta["source"]` is the address that answered; where no server did and `LBACAL_CACHE` is set, the
        cached tag (with a `CachedAnswerWarning`).

        Examples
        --------
        >>> import lbacal
        >>> lbacal.effective("CS002", antenna=17, dipole="X", at="2014-05-01")  # doctest: +SKIP
        """
        params = {"station": station, "antenna": antenna, "dipole": dipole, "gap": gap, "scope": scope, "tag": tag}
        params |= {"at": format_time(at), "as_of": None if as_of is None else format_time(as_of)}
        body = self._ask(params | {"format": format or "json"})
        if self.snapshot is not None and tag is None:
            warnings.warn(f"{self.url} does not answer: {describe_snapshot(self.snapshot)}", CachedAnswerWarning, 2)
        if format is not None:
            return body
        table = make_table(json.loads(body))
        table.meta["source"] = self.url if self.snapshot is None else f"cache: {describe_snapshot(self.snapshot)}"
        return table

    def _ask(self, params: dict[str, Any]) -> bytes:
        self.snapshot = None
        is_plain = params["as_of"] is None and params["gap"] is None
        if self._cache and params["tag"] is not None and is_plain:
            held = self._cache.find(params["tag"], _question(params))
            if held is not None:
                return self._ask_cache(self._cache, params, held)
        try:
            # with a cache nobody need wait for a server that may come back, or for one that is stuck
            patience: dict[str, Any] = {} if self._cache is None else {"tries": 1, "answer_s": STUCK_S}
            return self._transport.request("GET", _EFFECTIVE, params=params, is_quick=True, **patience).content
        except UnreachableError:
            if self._cache is None or params["gap"] is not None:
                raise
            return self._ask_cache(self._cache, params, self._cache.snapshot(params["tag"]))

    def _ask_cache(self, cache: Cache, params: dict[str, Any], snapshot: Snapshot) -> bytes:
        wanted = params["as_of"]
        if wanted is not None and parse_instant("as_of", wanted) != parse_instant("as_of", snapshot.as_of):
            raise BadInputError("as_of", f"{snapshot.as_of}, the instant of the cached tag {snapshot.tag}", wanted)
        answer = cache.answer(snapshot, _question(params), params["format"])
        self.snapshot = snapshot
        return answer

    def ingest(
        self, spectra: Path | str | Spectra, on_event: Callable[[int, int], None] | None = None
    ) -> dict[str, Any]:
        """Send spectra in bundles of whole events, leaving out those that the server says it has: it can be run again.

        The server acknowledges each bundle as one: it stores all of it or nothing. Where it has `warnings`, they are
        beside the counts, and so is how many `covariates` became known of events that were there.

        Parameters
        ----------
        on_event
            Called with the number of events sent and their total.
        """
        measured = spectra if isinstance(spectra, Spectra) else read_spectra(path_of("ingest", spectra))
        if not len(measured):
            raise BadInputError(measured.origin, "spectra", "none")
        total, warned = Counter(received=0, stored=0, duplicates=0), list[str]()
        events, sent = len(np.unique(measured.event_id)), 0
        bundles = files_of_events(measured, BUNDLE)
        while some := {hashlib.sha256(one[-1]).hexdigest(): one for one in islice(bundles, ASKED_AT_ONCE)}:
            answered = self.get("/v1/spectra/receipts", sha256=",".join(some))
            known, told = set(answered["stored"]), answered.get("warnings", [])
            for digest, (count, rows, file) in some.items():
                receipt = {"received": rows, "stored": 0, "duplicates": rows}
                if digest not in known:
                    receipt = self._transport.request("POST", "/v1/spectra", file=file).json()
                told += receipt.pop("warnings", [])
                total.update(receipt)
                sent += count
                if on_event:
                    on_event(sent, events)
            warned += told
        return {**total, "warnings": warned} if warned else dict(total)

    def refit(
        self, scope: str, since: Any, until: Any, *, reason: str, station: str | None = None,
        antenna: int | None = None, dipole: str | None = None, promote: bool = False, wait: bool = True,
        fit: str = "years",
    ) -> dict[str, Any]:  # fmt: skip
        """Ask for fits over [since, until); with `wait` until they have ended. Returns the job.

        `scope` is ``array``, ``station`` or ``antenna``. With `fit` ``year`` the window is fitted by itself, else one
        chain through the years.
        """
        body = {
            "scope": scope, "since": format_time(since), "until": format_time(until), "station": station,
            "antenna": antenna, "dipole": dipole, "reason": reason, "promote": promote, "fit": fit,
        }  # fmt: skip
        number = self._transport.request("POST", "/v1/refits", body=body).json()["job"]
        return self.wait_for(number) if wait else self.job(number)

    def job(self, number: int) -> dict[str, Any]:
        """Get a job as it is now: `state`, `progress` (0 to 1), `calibrations`, `error` and more."""
        found: dict[str, Any] = self.get(f"/v1/jobs/{number}")
        return found

    def wait_for(self, number: int, on_change: Callable[[dict[str, Any]], object] = lambda _: None) -> dict[str, Any]:
        """Wait for a job until it has ended and return it, failed or done.

        `on_change` gets it whenever its progress is another.
        """
        seen = None
        while (job := self.job(number))["state"] not in ENDED:
            if seen != (seen := (job["state"], job["progress"])):
                on_change(job)
            time.sleep(POLL_S)
        return job


P = ParamSpec("P")
R = TypeVar("R")


def _asking(method: Callable[Concatenate[Client, P], R]) -> Callable[P, R]:
    """A method of a client as a function, which asks the server of `LBACAL_URL`."""

    @wraps(method)
    def ask(*args: P.args, **named: P.kwargs) -> R:
        with Client() as client:
            return method(client, *args, **named)

    own = signature(method)
    vars(ask)["__signature__"] = own.replace(parameters=list(own.parameters.values())[1:])
    return ask


effective, ingest, refit = _asking(Client.effective), _asking(Client.ingest), _asking(Client.refit)


def make_table(answer: dict[str, Any]) -> CurveTable:
    """The rows of an answer to "in effect at" as a table with units; the versions are in its column `calibration`."""
    from lbacal.curve_table import CurveTable

    return CurveTable(tables.make_table(answer), meta={**make_head(answer), "missing": answer.get("missing")})
