from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lbacal_core.errors import LbacalError
from lbacal_core.spectra.spectra import Spectra, write_spectra
from service.errors import MalformedBodyError, UnavailableError
from service.wire.hdf5_body import FileReader, _parse_answer
from service.wire.hdf5_child import GOOD, REFUSED, read_file, write_example

ROWS = 6


@pytest.fixture(scope="module")
def reader() -> FileReader:
    return FileReader()


@pytest.fixture
def spectra() -> Spectra:
    return Spectra(
        frequency_mhz=np.array([30.0, 45.0, 60.0, 80.0]), power=np.arange(1.0, 4 * ROWS + 1).reshape(ROWS, 4),
        event_id=np.array([f"e{k}" for k in range(ROWS)]), time_unix=1.4e9 + np.arange(float(ROWS)),
        station=np.full(ROWS, "CS001"), antenna=np.zeros(ROWS, dtype=np.int64), dipole=np.full(ROWS, "X"),
        blocks=np.full(ROWS, 100), environment={"temperature_c": np.array([1.0, 2.0, np.nan, 4.0, 5.0, 6.0])},
    )  # fmt: skip


@pytest.fixture
def file(spectra: Spectra, tmp_path: Path) -> Path:
    write_spectra(spectra, tmp_path / "s.h5")
    return tmp_path / "s.h5"


def test_what_was_written_is_read(reader: FileReader, spectra: Spectra, file: Path) -> None:
    found = reader.read(file.read_bytes())
    for name in ("frequency_mhz", "power", "event_id", "time_unix", "station", "antenna", "dipole", "blocks"):
        assert np.array_equal(getattr(found, name), getattr(spectra, name)), name
    assert np.array_equal(found.environment["temperature_c"], spectra.environment["temperature_c"], equal_nan=True)
    assert found.resistance_ohm == 50.0


def test_texts_of_one_length_are_read(reader: FileReader, spectra: Spectra, file: Path) -> None:
    """What the library loads at its first use cannot be loaded any more when the file is there."""
    with h5py.File(file, "a") as opened:
        for name in ("event_id", "station", "dipole"):
            values = opened[name][()].astype("S")
            del opened[name]
            opened[name] = values
    assert reader.read(file.read_bytes()).event_id.tolist() == spectra.event_id.tolist()


def replace(name: str, make: Callable[[h5py.File], object]) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        made = make(file)
        if name not in file:
            file[name] = made

    return change


def store_power(**how: Any) -> Callable[[h5py.File], None]:
    return replace("power", lambda file: file.create_dataset("power", **how))


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout(shape=(ROWS, 4), dtype="f8")
    layout[:] = h5py.VirtualSource("/etc/hostname", "power", shape=(ROWS, 4))
    file.create_virtual_dataset("power", layout)


def many(file: h5py.File) -> None:
    rows, channels = 100_000, 400
    for name in ("event_id", "time_unix", "station", "antenna", "dipole", "blocks", "env/temperature_c"):
        value = file[name][0]
        del file[name]
        file.create_dataset(name, data=np.full(rows, value), compression="gzip")
    replace("frequency_mhz", lambda _: np.arange(1.0, channels + 1))(file)
    del file["power"]
    file.create_dataset("power", data=np.ones((rows, channels)), compression="gzip")


MEAN: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "a link to a file of the server": (
        replace("power", lambda _: h5py.ExternalLink("/etc/hostname", "/")),
        "found a link",
    ),
    "a link inside the file": (replace("power", lambda _: h5py.SoftLink("/blocks")), "found a link"),
    "a virtual dataset": (replace("power", virtual), "found external or virtual storage"),
    "bytes of a file of the server": (
        store_power(shape=(ROWS, 4), dtype="f8", external=[("/etc/hostname", 0, 8 * ROWS * 4)]),
        "found external or virtual storage",
    ),
    "another filter": (store_power(data=np.ones((ROWS, 4)), compression="lzf"), "no filter, gzip or shuffle"),
    "320 MB in 400 kB": (many, "power: expected at most 67108864 bytes, found 320000000"),
    "data never written": (store_power(shape=(ROWS, 4), dtype="f8"), "too few to hold them"),
    "an unknown dataset": (replace("more", lambda _: np.ones(3)), "unknown more"),
    "the same spectrum twice": (replace("event_id", lambda _: ["e0"] * ROWS), "one spectrum per event"),
    "negative power": (replace("power", lambda _: -np.ones((ROWS, 4))), "row 0: expected finite power > 0, found -1.0"),
}


@pytest.mark.long
@pytest.mark.parametrize(("change", "sentence"), MEAN.values(), ids=MEAN.keys())
def test_a_mean_file_is_refused_in_one_sentence(
    reader: FileReader, file: Path, change: Callable[[h5py.File], None], sentence: str
) -> None:
    with h5py.File(file, "a") as opened:
        change(opened)
    with pytest.raises(LbacalError, match=sentence) as caught:
        reader.read(file.read_bytes())
    assert caught.value.status in (400, 422)


def test_a_hundred_broken_files_do_no_harm(reader: FileReader, spectra: Spectra, file: Path) -> None:
    good = file.read_bytes()
    rng = np.random.default_rng(14)
    refused = 0
    for _ in range(100):
        content = bytearray(good)
        for place in rng.integers(0, len(good), size=rng.integers(1, 30)):
            content[place] = rng.integers(256)
        try:
            reader.read(bytes(content[: rng.integers(1, len(good))] if rng.random() < 0.2 else content))
        except LbacalError as error:
            assert error.status in (400, 422)  # noqa: PT017 - some of them are good files still
            refused += 1
    assert refused > 20
    assert np.array_equal(reader.read(good).power, spectra.power)


@pytest.mark.parametrize("content", [b"", b"x", b"\x89HDF\r\n\x1a\n" + bytes(100), b"{}"])
def test_what_is_no_file_is_malformed(reader: FileReader, content: bytes) -> None:
    with pytest.raises(LbacalError, match="expected a spectra file") as caught:
        reader.read(content)
    assert caught.value.status == 400


def test_a_process_that_dies_of_its_file_is_a_malformed_body(
    reader: FileReader, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader.read(file.read_bytes())

    def connect_to_the_dead() -> socket.socket:
        ours, theirs = socket.socketpair()
        theirs.close()
        return ours

    monkeypatch.setattr(reader, "_connect", connect_to_the_dead)
    with pytest.raises(MalformedBodyError, match="20 s or 1 GB"):
        reader.read(b"x")


def test_a_reader_whose_process_was_killed_says_so_and_reads_the_next_file(spectra: Spectra, file: Path) -> None:
    reader = FileReader()
    content = file.read_bytes()
    reader.read(content)
    assert reader._parent is not None
    os.kill(reader._parent.pid, signal.SIGSTOP)
    os.kill(reader._parent.pid, signal.SIGKILL)
    try:
        found = reader.read(content)
    except UnavailableError:
        found = reader.read(content)
    assert np.array_equal(found.power, spectra.power)


def test_the_processes_end_with_the_server_whatever_ends_it(file: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from service.wire.hdf5_body import FileReader; "
        f"reader = FileReader(); reader.read(Path({str(file)!r}).read_bytes()); "
        "print(reader._parent.pid, flush=True); os.kill(os.getpid(), 9)"
    )
    killed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert killed.returncode == -signal.SIGKILL
    parent = Path(f"/proc/{killed.stdout.strip()}")
    for _ in range(100):
        if not parent.exists() or "State:\tZ" in (parent / "status").read_text():
            return
        time.sleep(0.1)
    pytest.fail("the processes that read files outlive their server")


def confined(code: str, deadline_s: int = 20) -> subprocess.CompletedProcess[str]:
    start = f"from service.wire.hdf5_child import confine; confine({deadline_s}); "
    return subprocess.run([sys.executable, "-c", start + code], capture_output=True, text=True, check=False, timeout=60)


def test_the_columns_of_a_file_come_back_as_arrays_without_objects() -> None:
    columns = _parse_answer(read_file(write_example("e")))
    assert columns["power"].tolist() == [[1.0]]
    assert columns["event_id"].tolist() == ["e"]
    assert columns["environment"]["temperature_c"].tolist() == [1.0]


@pytest.mark.parametrize("letters", ["|O", "<f4,<f4", "V8", "(", "<M8[s]"])
def test_an_answer_of_another_type_than_numbers_and_texts_is_refused(letters: str) -> None:
    with pytest.raises(ValueError, match="neither numbers nor texts"):
        _parse_answer(GOOD + json.dumps([("power", letters, [1])]).encode() + b"\n" + bytes(64))


def test_what_is_no_file_is_a_sentence() -> None:
    status, sentence = json.loads(read_file(b"x" * 5000).removeprefix(REFUSED))
    assert (status, sentence[:40]) == (400, "body: expected a spectra file (HDF5), fo")


def test_a_confined_process_ends_at_its_deadline_whatever_it_does() -> None:
    # The alarm counts seconds of the clock, the limit those of the processor: on an idle machine either may come first.
    ended = confined("import itertools; sum(itertools.repeat(0))", deadline_s=1).returncode
    assert ended in (-signal.SIGALRM, -signal.SIGXCPU, -signal.SIGKILL)


def test_a_confined_process_gets_a_gigabyte() -> None:
    done = confined("b'x' * (1 << 30)")
    assert done.returncode == 1
    assert "MemoryError" in done.stderr


@pytest.mark.parametrize("what", ["open('/etc/hostname')", "__import__('socket').socket()", "open('x', 'w')"])
def test_a_process_that_has_its_file_opens_nothing(what: str) -> None:
    answer = (
        "from service.wire.hdf5_child import answer_one, warm_up; import socket; warm_up(); "
        "here, there = socket.socketpair(); here.sendall((1).to_bytes(8, 'little') + b'x'); answer_one(there); "
        "print(here.recv(99)); "
    )
    done = confined(answer + what)
    assert (done.returncode, done.stdout[:8]) == (1, "b'-[400,")
    assert "Too many open files" in done.stderr


def test_the_processes_did_not_end_while_a_fork_of_the_server_held_their_connection(file: Path) -> None:
    """A pool that was forked while a reader lived kept its processes waiting, and whoever let go of the reader too."""
    readers = [FileReader()]
    readers[0].read(file.read_bytes())
    held, release = os.pipe()
    fork = os.fork()
    if fork == 0:
        os.close(release)
        os.read(held, 1)
        os._exit(0)
    ending = threading.Thread(target=readers.clear, daemon=True)
    ending.start()
    ending.join(20.0)
    is_over = not ending.is_alive()
    os.close(held)
    os.close(release)
    os.waitpid(fork, 0)
    assert is_over
