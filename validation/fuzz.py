"""Requests, documents and files that nobody would send: no 500, no status that is not documented, nobody waits long.

A trial of `routes` asks every route of the OpenAPI document with the keys of an admin and of a reader and with none, of
`readers` changes valid documents and gives them to whoever reads them, and of `files` sends changed HDF5 files to the
processes that read those of strangers. `bombs` are bodies made to fill memory or to take for ever, at a real server.
"""

from __future__ import annotations

import gzip
import io
import json
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import h5py
import numpy as np
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings, strategies
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from lbacal.cache import Cache
from lbacal.instants import parse_at, parse_instant
from lbacal_core.errors import LbacalError
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.lstcurve.curve import read_lst_curve
from lbacal_core.sky.table import read_sky_power
from lbacal_core.spectra.spectra import Spectra, write_spectra
from service.wire.answers import choose_format
from service.wire.bodies import FlagBody, PromotionBody, RefitBody, SpectraBody, parse_body
from service.wire.hdf5_body import FileReader
from validation.fuzzing import NASTY, change_bytes, change_hdf5, write_json
from validation.machinery.claims import Found, exactly, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by
from validation.running.postgres import open_databases
from validation.running.processes import Process, get, make_key, post, run_service

EXAMPLES = 16
"""Requests to each route and way of asking in a trial."""
DOCUMENTS, FILES = 4000, 400
"""Cases of a trial."""
LARGEST_CHUNK = 1 << 20
PATIENCE_S = 30.0
"""Nobody waits longer: the process that reads a file ends after 20 s."""
DATABASES = "sqlite", "postgresql"
Key = dict[str, str]
CHECKS = [status_code_conformance, content_type_conformance, response_schema_conformance]
ROW = {
    "event_id": "e", "time_utc": "2014-03-01", "station": "CS002", "antenna": 0, "dipole": "X", "blocks": 100,
    "power": [1.0] * 51, "env": {"rain_mm_h": 0.5},
}  # fmt: skip
SPECTRA = {"frequency_mhz": [float(mhz) for mhz in range(30, 81)], "spectra": [ROW]}
PROMOTION = {"calibration": None, "station": "CS002", "valid_from": "2014-01-01", "valid_to": None, "reason": "fuzz"}
REFIT = {"scope": "station", "station": "CS002", "since": "2014-01-01", "until": "2015-01-01", "reason": "fuzz"}


def ask_routes(number: int) -> Row:
    """Ask every route of a server, over HTTP, on SQLite and PostgreSQL in turn; no key may stand in its log."""
    failures: list[str] = []
    statuses: Counter[int] = Counter()
    with _server(DATABASES[number % 2], log_level="debug") as (address, keys, server):
        for path, body in (("spectra", SPECTRA), ("refits", REFIT), ("promotions", PROMOTION)):
            post(f"{address}/v1/{path}", json=body, headers=keys[0]).raise_for_status()
        operations: Any = schemathesis.openapi.from_url(f"{address}/openapi.json").get_all_operations()
        for found in operations:
            operation = found.ok()
            _ask_nasty(operation, address, keys[0], statuses, failures)
            for k, one in enumerate((*keys, None)):
                _ask_route(operation, one, number * 1000 + k, statuses, failures)
        log = server.log.read_text(encoding="utf-8", errors="replace")
        failures += ["a key stands in the log" for key in keys if key["Authorization"].split()[1] in log]
    return _row(sum(statuses.values()), failures, statuses=statuses)


def _ask_nasty(operation: Any, address: str, key: Key, statuses: Counter[int], failures: list[str]) -> None:
    """Give every parameter of a reading route each text that nobody would send, the others left out."""
    if operation.method.lower() != "get":
        return
    texts = [text for text in NASTY if isinstance(text, str) and (text.isprintable() or text == "\x00")]
    of_query, of_path = ([one.name for one in places] for places in (operation.query, operation.path_parameters))
    for name in (*of_query, *of_path):
        for text in texts:
            path = operation.path
            for other in of_path:
                path = path.replace(f"{{{other}}}", quote(text, safe="") if other == name else "1")
            asked = {name: text} if name in of_query else {}
            answer = get(f"{address}{path}", params=asked, headers=key, timeout=PATIENCE_S)
            statuses[answer.status_code] += 1
            if answer.status_code >= 500 and operation.path != "/readyz":
                failures.append(f"GET {operation.path}, {name}={text!r}: {answer.status_code}")


def _ask_route(operation: Any, key: Key | None, number: int, statuses: Counter[int], failures: list[str]) -> None:
    known = {"number": 1, "event_id": "e"}
    more = {} if key is None else {"headers": key}

    @seed(number)
    @settings(
        max_examples=EXAMPLES, deadline=None, database=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(case=operation.as_strategy(), is_known=strategies.booleans())
    def ask(case: Any, is_known: bool) -> None:
        if is_known:
            case.path_parameters.update({name: known[name] for name in case.path_parameters if name in known})
        if key is None:
            case.headers.pop("Authorization", None)  # made up, as the document allows
        began = time.monotonic()
        answer = case.call(**more)
        statuses[answer.status_code] += 1
        name = f"{case.method} {case.path}"
        if answer.status_code >= 500 and (case.path, answer.status_code) != ("/readyz", 503):
            failures.append(f"{name}: {answer.status_code}")
        if time.monotonic() - began > PATIENCE_S:
            failures.append(f"{name}: {time.monotonic() - began:.0f} s")
        try:
            case.validate_response(answer, checks=CHECKS)
        except Exception as error:  # noqa: BLE001 - whatever it finds is a failure of the route
            failures.append(f"{name}: {str(error)[:200]}")

    ask()


def read_documents(number: int) -> Row:
    rng = np.random.default_rng([31, number])
    failures: list[str] = []
    read: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="lbacal-fuzz-") as folder:
        readers = _make_readers(Path(folder))
        names = sorted(readers)
        for _ in range(DOCUMENTS):
            name = names[int(rng.integers(len(names)))]
            make, reader = readers[name]
            content = make(rng)
            read[name] += 1
            _try_reader(name, partial(reader, content), failures)
    return _row(sum(read.values()), failures, read=read)


def _try_reader(name: str, read: Callable[[], object], failures: list[str]) -> None:
    began = time.monotonic()
    try:
        read()
    except LbacalError as error:
        if "\n" in str(error):
            failures.append(f"{name}: more than one line")
    except Exception as error:  # noqa: BLE001 - whatever else a reader raises is a failure
        failures.append(f"{name}: {type(error).__name__} {str(error)[:200]}")
    if time.monotonic() - began > PATIENCE_S:
        failures.append(f"{name}: {time.monotonic() - began:.0f} s")


Maker = Callable[[np.random.Generator], Any]
Readers = dict[str, tuple[Maker, Callable[[Any], object]]]


def _make_readers(folder: Path) -> Readers:
    """What makes changed documents of each kind, and what reads them."""
    instrument = load_instrument("lofar-superterp").as_dict()
    instrument["antennas"] = instrument["antennas"][:2]
    sky = {
        "frequency_mhz": [30.0, 55.0, 80.0], "lst_hours": [0.0, 6.0, 12.0, 18.0],
        "X": [[1.0, 2.0, 3.0]] * 4, "Y": [[1.0, 2.0, 3.0]] * 4,
    }  # fmt: skip
    curve = b"# comment\nlst_h,x_db,y_db,error_db\n" + b"".join(b"%d,0.%d,0.1,0.05\n" % (k, k) for k in range(24))
    tag = {"list": "0" * 64}
    texts = [b"2014-05-01T12:30:00.5Z", b"56778.25", b"text/csv;q=0.5, */*", b"9999-12-31T23:59:59-14:00"]

    def by_file(read: Callable[[Path], object]) -> Callable[[bytes], object]:
        def reader(content: bytes) -> object:
            (folder / "document").write_bytes(content)
            return read(folder / "document")

        return reader

    def read_cache(content: bytes) -> object:
        (folder / "tags").mkdir(exist_ok=True)
        (folder / "tags" / "t.json").write_bytes(content)
        return Cache(folder).snapshot("t")

    def text(rng: np.random.Generator) -> str:
        return change_bytes(rng, texts[int(rng.integers(len(texts)))]).decode("latin-1")

    bodies: dict[type, Any] = {
        SpectraBody: SPECTRA, PromotionBody: PROMOTION, RefitBody: REFIT, FlagBody: {"flag": "x", "reason": "y"},
    }  # fmt: skip
    return {
        "instrument": (partial(_changed, instrument), by_file(lambda path: load_instrument(str(path)))),
        "sky power": (partial(_changed, sky), by_file(read_sky_power)),
        "LST curve": (lambda rng: change_bytes(rng, curve), by_file(read_lst_curve)),
        "cached tag": (partial(_changed, tag), read_cache),
        "instant": (text, lambda content: parse_instant("at", content)),
        "date": (text, lambda content: parse_at(None, content)),
        "accept": (text, lambda content: choose_format(None, content)),
        **{kind.__name__: (partial(_changed, body), partial(parse_body, kind)) for kind, body in bodies.items()},
    }


def _changed(document: Any, rng: np.random.Generator) -> bytes:
    return write_json(rng, document)


def read_files(number: int) -> Row:
    rng = np.random.default_rng([32, number])
    content = _write_file()
    reader, failures, outcomes = FileReader(), [], Counter[str]()
    for _ in range(FILES):
        changed = change_hdf5(rng, content)
        began = time.monotonic()
        try:
            reader.read(changed)
            outcomes["read"] += 1
        except LbacalError as error:
            outcomes[error.code] += 1
            if error.status >= 500:
                failures.append(f"file: {error}")
            if "root:" in str(error):
                failures.append("file: another file was read")
        except Exception as error:  # noqa: BLE001 - whatever else comes out is a failure
            failures.append(f"file: {type(error).__name__} {str(error)[:200]}")
        if time.monotonic() - began > PATIENCE_S:
            failures.append(f"file: {time.monotonic() - began:.0f} s")
    return _row(FILES, failures, outcomes=outcomes)


def _write_file() -> bytes:
    rows = 6
    file = io.BytesIO()
    spectra = Spectra(
        frequency_mhz=np.array([30.0, 45.0, 60.0, 80.0]), power=np.arange(1.0, 4 * rows + 1).reshape(rows, 4),
        event_id=np.array([f"e{k}" for k in range(rows)]), time_unix=1.4e9 + np.arange(float(rows)),
        station=np.full(rows, "CS001"), antenna=np.zeros(rows, dtype=np.int64), dipole=np.full(rows, "X"),
        blocks=np.full(rows, 100), environment={"temperature_c": np.arange(float(rows))},
    )  # fmt: skip
    write_spectra(spectra, file)
    return file.getvalue()


def _bomb_file(chunk: int, size: int) -> bytes:
    """A spectra file whose power is gigabytes of nothing, compressed."""
    stream = io.BytesIO(_write_file())
    with h5py.File(stream, "a") as file:
        del file["power"]
        power = file.create_dataset("power", (size // 4, 4), "f8", chunks=(chunk, 4), compression="gzip")
        packed = zlib.compress(b"\0" * 32 * chunk, 9) if chunk <= LARGEST_CHUNK else b""
        for start in range(0, size // 4 if packed else 0, chunk):
            power.id.write_direct_chunk((start, 0), packed)
    return stream.getvalue()


BOMBS: dict[str, tuple[str, str, Callable[[], bytes]]] = {
    "a million open brackets": ("spectra", "json", lambda: b"[" * 1_000_000),
    "a million objects inside each other": ("spectra", "json", lambda: b'{"a":' * 1_000_000),
    "300,000 empty spectra": (
        "spectra", "json", lambda: b'{"frequency_mhz":[],"spectra":[' + b",".join([b"{}"] * 300_000) + b"]}",
    ),
    "five million nulls": (
        "spectra", "json",
        lambda: json.dumps(SPECTRA | {"spectra": [ROW | {"power": [None] * 5_000_000}]}).encode(),
    ),
    "4,000 rows, each with its own covariate": (
        "spectra", "json",
        lambda: json.dumps(
            SPECTRA | {"spectra": [ROW | {"event_id": f"e{k}", "env": {f"n{k}": 1.0}} for k in range(4000)]}
        ).encode(),
    ),
    "an event with 50,000 covariates": (
        "spectra", "json",
        lambda: json.dumps(SPECTRA | {"spectra": [ROW | {"env": {f"n{k}": 1.0 for k in range(50_000)}}]}).encode(),
    ),
    "a number of 10 million digits": (
        "spectra", "json", lambda: b'{"frequency_mhz":[' + b"1" * 10_000_000 + b'],"spectra":[]}',
    ),
    "60 MB of blanks": ("spectra", "json", lambda: b" " * 60_000_000),
    "one text of 60 MB": ("spectra", "json", lambda: b'"' + b"a" * 60_000_000 + b'"'),
    "65 MB": ("spectra", "json", lambda: b" " * 65_000_000),
    "a compressed body": ("spectra", "json", lambda: gzip.compress(b" " * 10_000_000)),
    "a reason of 60 kB": ("refits", "json", lambda: json.dumps(REFIT | {"reason": "x" * 60_000}).encode()),
    "3.6 MB that become 2.3 GB": ("spectra", "x-hdf5", lambda: _bomb_file(1 << 16, 1 << 28)),
    "chunks of 2 GB": ("spectra", "x-hdf5", lambda: _bomb_file(1 << 26, 1 << 30)),
    "a hundred thousand chunks": ("spectra", "x-hdf5", lambda: _bomb_file(4, 400_000)),
    "no file at all": ("spectra", "x-hdf5", lambda: b"\x89HDF\r\n\x1a\n" + b"\xff" * 1_000_000),
}  # fmt: skip


def send_bomb(number: int) -> Row:
    """Send one of the bodies of `BOMBS` to a server, twice, and look at its memory."""
    name = sorted(BOMBS)[number]
    route, kind, make = BOMBS[name]
    content, failures = make(), []
    with _server() as (address, keys, process):
        headers = {**keys[0], "Content-Type": f"application/{kind}"}
        slowest, statuses = 0.0, Counter[int]()
        for _ in range(2):
            began = time.monotonic()
            answer = post(f"{address}/v1/{route}", content=content, headers=headers, timeout=120)
            slowest = max(slowest, time.monotonic() - began)
            statuses[answer.status_code] += 1
        if get(f"{address}/v1/jobs", timeout=10).status_code != 200:
            failures.append("the next request is not answered")
        memory = _peak_mb(process.number)
    failures += [f"{status}" for status in statuses if status not in (400, 413, 422)]
    failures += [f"{slowest:.0f} s"] * (slowest > PATIENCE_S)
    row = _row(2, failures, statuses=statuses)
    return {**row, "bomb": name, "bytes": len(content), "slowest_s": round(slowest, 2), "memory_mb": memory}


@contextmanager
def _server(database: str = "sqlite", *, log_level: str = "error") -> Iterator[tuple[str, list[Key], Process]]:
    """The address of a server, the headers of an admin and of a reader, and its process."""
    with (
        tempfile.TemporaryDirectory(prefix="lbacal-fuzz-") as folder,
        open_databases(database, "fuzz") as (url,),
        run_service(url, Path(folder), log_level=log_level, max_rate="1e9") as service,
    ):
        keys = [{"Authorization": f"Bearer {key}"} for key in (service.key, make_key(url, "read"))]
        yield service.address, keys, service.processes[0]


def _peak_mb(number: int) -> float:
    lines = Path(f"/proc/{number}/status").read_text(encoding="utf-8").splitlines()
    return round(int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024)


def _row(cases: int, failures: Sequence[str], **counts: Counter[Any]) -> Row:
    told = {name: {str(k): n for k, n in sorted(count.items())} for name, count in counts.items()}
    return {"cases": cases, "failed": len(failures), "failures": sorted(set(failures))[:20], **told}


def judge(rows: Sequence[Row]) -> list[Found]:
    return [rate_of("failed", sum(row["failed"] for row in rows), sum(row["cases"] for row in rows))]


def judge_bombs(rows: Sequence[Row]) -> list[Found]:
    failed, memory = sum(row["failed"] for row in rows), max(row["memory_mb"] for row in rows)
    return [exactly("failed", failed, "", len(rows)), exactly("memory", memory, "MB", len(rows))]


PARTS = (
    Part("routes", ask_routes, judge, 24, headlines=("failed",)),
    Part("readers", read_documents, judge, 20),
    Part("files", read_files, judge, 12),
    Part("bombs", send_bomb, judge_bombs, len(BOMBS), by("bomb"), has_chance=False, is_parallel=False),
)
