from __future__ import annotations

import json
import signal
import subprocess
import sys

import pytest

from service.wire.hdf5_body import _parse_answer
from service.wire.hdf5_child import GOOD, REFUSED, read_file, write_example


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
    limit = "__import__('resource').setrlimit(__import__('resource').RLIMIT_NOFILE, (0, 0)); "
    done = confined("import socket, resource; " + limit + what)
    assert done.returncode == 1
    assert "Too many open files" in done.stderr
