"""The calibrations of a tag on this machine: what `effective` answers with when no server does.

A tag freezes the ledger, and between two edges (an interval begins or ends, an antenna gets another cable) the answer
for a station is the same. So the folder holds, for each station and each stretch between edges, the server's own answer
as a file under its SHA-256, and for each tag the SHA-256 of the list of them. A file is hashed whenever it is read.
"""

from __future__ import annotations

import hashlib
import json
import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from lbacal.files import written_beside
from lbacal.instants import format_instant, parse_instant, read_clock
from lbacal.tables import write_format
from lbacal.transport import RefusedError
from lbacal_core.curves.covariance import name_budgets
from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError, LbacalError, offer_name, require_antenna, require_name

FORMAT = "lbacal-cache-1"
ARRAY = ""
"""The name under which the reference chain of the array stands among the stations."""
_TAG = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_DIGEST = re.compile(r"[0-9a-f]{64}")
NOT_FOUND = 404


class CacheError(LbacalError, status=500, code="cache"):
    """The cache cannot answer: the tag is not there, or a file is damaged."""


class Source(Protocol):
    """A client of a server."""

    @property
    def url(self) -> str:
        """The address of the server."""

    def get(self, path: str, **params: Any) -> Any:
        """The JSON at a path of the API."""

    def list(self, path: str, name: str, **params: Any) -> list[Any]:
        """All items of a list of the API."""

    def fetch(self, path: str, **params: Any) -> bytes:
        """The bytes at a path of the API."""


@dataclass(frozen=True)
class Question:
    """A query of `effective`, as far as a cache can answer it."""

    at: Instant
    station: str | None
    antenna: int | None
    dipole: str | None
    scope: str | None

    @property
    def name(self) -> str:
        """The path, station or array that is meant."""
        parts = (self.station or "the array", self.antenna, self.dipole)
        return " ".join(str(part) for part in parts if part is not None)


@dataclass(frozen=True)
class Snapshot:
    """The list of what a tag holds, or of the part of it that was asked for.

    Attributes
    ----------
    stations
        By name: the antennas, and for each edge in order its instant and the SHA-256 of the answer from there on (None:
        nothing is in effect).
    only, since, until
        The stations of that part, all and the array where it is empty, and its first instant and its end.
    """

    tag: str
    as_of: str
    url: str
    synced_at: str
    stations: Mapping[str, Mapping[str, Any]]
    only: Sequence[str] = ()
    since: str | None = None
    until: str | None = None

    def holds(self, asked: Question) -> bool:
        """Whether a question is about the part that is held."""
        since, until = (None if end is None else parse_instant("part", end) for end in (self.since, self.until))
        is_then = (since is None or asked.at >= since) and (until is None or asked.at < until)
        return is_then and (not self.only or asked.station in self.only)

    @property
    def part(self) -> str:
        """The part in words; empty for everything."""
        ends = [f"{word} {end[:19]}Z" for word, end in (("from", self.since), ("until", self.until)) if end is not None]
        return " ".join([", ".join(self.only), *ends]).strip()

    @property
    def files(self) -> set[str]:
        """The SHA-256 of all answers."""
        held = (digest for station in self.stations.values() for _, digest in station["edges"])
        return {digest for digest in held if digest is not None}


class Cache:
    """A folder of answers, `LBACAL_CACHE`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def sync(
        self,
        client: Source,
        tag: str,
        on_step: Callable[[int, int], None] | None = None,
        *,
        only: Sequence[str] = (),
        since: Instant | None = None,
        until: Instant | None = None,
    ) -> tuple[Snapshot, int]:
        """Fetch what a tag holds and is not here and whole; return the list and the number of answers fetched.

        With stations or instants only the answers of that part, which is then what the cache holds of the tag.
        """
        tags = {one["name"]: one for one in client.list("/v1/tags", "tags")}
        found = tags.get(require_tag(tag))
        if found is None:
            raise BadInputError("tag", "a tag of the server; `lbacal tag` lists and makes them", offer_name(tag, tags))
        as_of = found["as_of"]
        held = self._held_before(tag, as_of)
        stations = client.get("/v1/calibrations/edges", as_of=as_of)["stations"]
        for name in only:
            require_name("station", name, [one["station"] for one in stations if one["station"]])
        stations = [_during(one, since, until) for one in stations if not only or one["station"] in only]
        total, fetched, done = sum(len(station["edges"]) for station in stations), 0, 0
        listed: dict[str, dict[str, Any]] = {}
        for station in stations:
            name = station["station"] or ARRAY
            edges: list[tuple[str, str | None]] = []
            for edge in station["edges"]:
                digest = held.get((name, edge), ...)
                if digest is ... or (digest is not None and not self._is_whole(digest)):
                    digest = self._fetch(client, name, edge, as_of)
                    fetched += 1
                edges.append((edge, digest))
                done += 1
                if on_step:
                    on_step(done, total)
            dipoles = station.get("dipoles", ["X", "Y"])  # a server from before instruments had other letters
            listed[name] = {"antennas": station["antennas"], "dipoles": dipoles, "edges": edges}
        ends = (None if end is None else format_instant(end) for end in (since, until))
        snapshot = Snapshot(tag, as_of, client.url, format_instant(read_clock()), listed, tuple(only), *ends)
        content = json.dumps({"format": FORMAT, **vars(snapshot)}, sort_keys=True).encode()
        self._write(self._folder / "tags" / f"{tag}.json", json.dumps({"list": self._keep(content)}).encode())
        return snapshot, fetched

    def snapshot(self, tag: str | None) -> Snapshot:
        """The list of a tag; without a name that of the tag synced last."""
        if tag is not None:
            return self._read_snapshot(require_tag(tag))
        names = self._names()
        if not names:
            raise CacheError(f"the cache {self._folder} holds no tag: run `lbacal sync TAG` while a server answers")
        return max((self._read_snapshot(name) for name in names), key=lambda snapshot: snapshot.synced_at)

    def _names(self) -> list[str]:
        return sorted(path.stem for path in (self._folder / "tags").glob("*.json"))

    def find(self, tag: str, asked: Question) -> Snapshot | None:
        """The list of a tag that was synced with what is asked for; None where it was not."""
        if not (self._folder / "tags" / f"{require_tag(tag)}.json").is_file():
            return None
        snapshot = self._read_snapshot(tag)
        return snapshot if snapshot.holds(asked) else None

    def answer(self, snapshot: Snapshot, asked: Question, kind: str = "json") -> bytes:
        """The answer of the server to a query as of the tag, in one of its formats."""
        if not snapshot.holds(asked):
            what = f"{asked.name} at {format_instant(asked.at)}"
            raise CacheError(
                f"the cache holds of {snapshot.tag} {snapshot.part} alone, not {what}: "
                f"run `lbacal sync {snapshot.tag}` while a server answers"
            )
        content = self._gather(snapshot, asked)
        if kind == "json":
            return json.dumps(content, allow_nan=False, separators=(",", ":"), ensure_ascii=False).encode()
        return write_format(kind, content)

    def _gather(self, snapshot: Snapshot, asked: Question) -> dict[str, Any]:
        curves: list[dict[str, Any]] = []
        missing: list[dict[str, Any]] = []
        budgets: dict[str, Any] = {}
        try:
            names = _select_stations(snapshot, asked)
        except LbacalError as error:  # as a server says it
            raise RefusedError(error.status, error.code, str(error)) from error
        for name in names:
            station = snapshot.stations[name]
            digest = _at(station["edges"], asked.at)
            if digest is not None:
                content = json.loads(self._read(digest, snapshot.tag))
                curves += content["curves"]
                missing += content["missing"]
                budgets |= content.get("budgets", {})
            else:
                missing += [
                    {"station": name or None, "antenna": antenna, "dipole": dipole}
                    for antenna in station["antennas"] or [None]
                    for dipole in (station.get("dipoles", ["X", "Y"]) if name else [None])
                ]
        curves, missing = (
            [one for one in listed
             if asked.antenna in (None, one["antenna"]) and asked.dipole in (None, one["dipole"])]
            for listed in (curves, missing)
        )  # fmt: skip
        if not curves:
            sentence = f"no calibration is in effect for {asked.name} at {format_instant(asked.at)} in {snapshot.tag}"
            raise RefusedError(NOT_FOUND, "not_in_effect", f"{sentence}; a server knows the nearest (gap=hold)")
        return {
            "at": format_instant(asked.at),
            "as_of": snapshot.as_of,
            "curves": curves,
            "budgets": {name: budgets[name] for name in name_budgets(curves) if name in budgets},
            "missing": missing,
        }

    def _held_before(self, tag: str, as_of: str) -> dict[tuple[str, str], str | None]:
        try:
            before = self._read_snapshot(tag)
        except LbacalError:
            return {}
        if before.as_of != as_of:
            return {}
        return {(name, edge): digest for name, one in before.stations.items() for edge, digest in one["edges"]}

    def _fetch(self, client: Source, name: str, edge: str, as_of: str) -> str | None:
        asked = {"station": name} if name else {"scope": "array"}
        try:
            return self._keep(client.fetch("/v1/calibrations/effective", at=edge, as_of=as_of, **asked))
        except RefusedError as error:
            if error.status == NOT_FOUND:
                return None
            raise

    def _read_snapshot(self, tag: str) -> Snapshot:
        path = self._folder / "tags" / f"{tag}.json"
        try:
            digest = json.loads(path.read_bytes())["list"]
            content = json.loads(self._read(digest, tag))
        except FileNotFoundError:
            wanted = offer_name(tag, self._names())
            raise CacheError(
                f"the cache {self._folder} does not hold the tag {wanted}: run `lbacal sync {tag}`"
            ) from None
        except (ValueError, KeyError, TypeError) as error:
            raise _damaged(path, tag) from error
        if content.pop("format", None) != FORMAT:
            raise _damaged(path, tag)
        return Snapshot(**content)

    def _path(self, digest: str) -> Path:
        if not _DIGEST.fullmatch(digest):
            raise ValueError(f"{digest!r} is no SHA-256")
        return self._folder / "files" / digest[:2] / digest

    def _read(self, digest: str, tag: str) -> bytes:
        """The content of a file, if it still is what its name says."""
        path = self._path(digest)
        try:
            content = path.read_bytes()
        except OSError as error:
            raise _damaged(path, tag) from error
        if hashlib.sha256(content).hexdigest() != digest:
            raise _damaged(path, tag)
        return content

    def _is_whole(self, digest: str) -> bool:
        try:
            self._read(digest, "")
        except CacheError:
            return False
        return True

    def _keep(self, content: bytes) -> str:
        digest = hashlib.sha256(content).hexdigest()
        self._write(self._path(digest), content)
        return digest

    def _write(self, path: Path, content: bytes) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_beside(path) as beside:
            beside.write_bytes(content)


def require_tag(tag: str) -> str:
    """The name of a tag, or an error that says which names there are."""
    if not _TAG.fullmatch(tag):
        raise BadInputError("tag", "letters, digits, '.', '_' and '-'", repr(tag[:40]))
    return tag


def _select_stations(snapshot: Snapshot, asked: Question) -> Sequence[str]:
    stations = [name for name in snapshot.stations if name != ARRAY]
    if asked.scope == "array":
        return [ARRAY]
    letters = sorted({letter for name in stations for letter in snapshot.stations[name].get("dipoles", ["X", "Y"])})
    if asked.dipole is not None:
        require_name("dipole", asked.dipole, letters)
    if asked.antenna is not None and asked.station is None:
        raise BadInputError("antenna", "a station beside it", f"antenna {asked.antenna} alone")
    if asked.station is None:
        return stations
    require_name("station", asked.station, stations)
    if asked.antenna is not None:
        require_antenna("antenna", asked.antenna, asked.station, snapshot.stations[asked.station]["antennas"])
    return [asked.station]


def _during(station: Mapping[str, Any], since: Instant | None, until: Instant | None) -> dict[str, Any]:
    """A station with the edges between which some of a window lies."""
    begins = [parse_instant("edge", edge) for edge in station["edges"]]
    first = 0 if since is None else max(bisect_right(begins, since) - 1, 0)
    last = len(begins) if until is None else bisect_left(begins, until)
    return {**station, "edges": station["edges"][first:last]}


def _at(edges: Sequence[tuple[str, str | None]], at: Instant) -> str | None:
    k = bisect_right([parse_instant("edge", edge) for edge, _ in edges], at)
    return edges[k - 1][1] if k > 0 else None


def _damaged(path: Path, tag: str) -> CacheError:
    return CacheError(f"{path} is damaged or missing: run `lbacal sync {tag}` while a server answers")
