from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lbacal_core.errors import BadInputError, LbacalError, UnreadableFileError
from lbacal_core.skypower.table import SkyPower, read_sky_power, write_sky_power

FREQUENCY = np.array([30.0, 50.0, 80.0])
ANYWHERE = np.random.default_rng(1).uniform(-30.0, 60.0, 200)


def make_sky_power(size: int = 24, first: float = 0.125) -> SkyPower:
    rng = np.random.default_rng(size)
    lst = first + 24.0 / size * np.arange(size)
    return SkyPower(FREQUENCY, lst, {dipole: rng.uniform(1, 2, (size, 3)) for dipole in "XY"}, "made up")


@pytest.mark.parametrize("size", [3, 8, 9, 96])
@pytest.mark.parametrize("first", [0.0, 0.125, 7.3])
def test_sky_power_between_instants_is_the_direct_fourier_sum(size: int, first: float) -> None:
    table = make_sky_power(size, first)
    expected = np.zeros((ANYWHERE.size, 3))
    highest = (size - 1) // 2
    for order in range(-highest, highest + 1):
        phase = np.exp(-2j * np.pi * order * table.lst_hours / 24.0)
        term = phase @ table.power["X"] / size
        expected += np.real(np.exp(2j * np.pi * order * ANYWHERE / 24.0)[:, None] * term)
    if size % 2 == 0:  # the fastest wave of an even grid is known only as the cosine that peaks on its instants
        term = (-1.0) ** np.arange(size) @ table.power["X"] / size
        expected += np.cos(np.pi * size * (ANYWHERE - first) / 24.0)[:, None] * term
    np.testing.assert_allclose(table.at("X", ANYWHERE), expected, rtol=1e-12)


@pytest.mark.parametrize("order", [0, 1, 8, 47])
def test_a_single_harmonic_is_exact_between_the_instants(order: int) -> None:
    lst = np.arange(96) * 0.25 + 0.125

    def wave(hours: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        return np.outer(2.0 + np.cos(2 * np.pi * order * (hours - 3.3) / 24.0), [1.0, 2.0, 3.0])

    table = SkyPower(FREQUENCY, lst, {"X": wave(lst), "Y": 2 * wave(lst)})
    np.testing.assert_allclose(table.at("X", ANYWHERE), wave(ANYWHERE), rtol=1e-12)
    np.testing.assert_allclose(table.at("Y", ANYWHERE), 2 * wave(ANYWHERE), rtol=1e-12)


def test_sky_power_at_its_instants_is_the_table_and_repeats_every_sidereal_day() -> None:
    table = make_sky_power()
    for day in (-24.0, 0.0, 48.0):
        np.testing.assert_allclose(table.at("Y", table.lst_hours + day), table.power["Y"], rtol=1e-12)


def test_a_file_returns_what_was_written(tmp_path: Path) -> None:
    write_sky_power(make_sky_power(), tmp_path / "p.json")
    read = read_sky_power(tmp_path / "p.json")
    assert read.digest() == make_sky_power().digest()
    assert read.origin.endswith("p.json")


def test_the_digest_sees_every_number() -> None:
    table = make_sky_power()
    changed = {**table.power, "Y": table.power["Y"] * (1 + 1e-15)}
    assert SkyPower(FREQUENCY, table.lst_hours, changed).digest() != table.digest()
    assert SkyPower(FREQUENCY, table.lst_hours + 1e-9, table.power).digest() != table.digest()


def smooth(lst_hours: np.ndarray[Any, Any], harmonics: int = 5) -> np.ndarray[Any, Any]:
    """A sky of some harmonics, shape (lst, 3)."""
    angle = 2 * np.pi / 24.0 * np.outer(lst_hours, np.arange(1, harmonics + 1))
    swing = np.cos(angle - 1.0) @ (0.3 / np.arange(1.0, harmonics + 1) ** 2)
    return np.outer(2.0 + swing, [1.0, 2.0, 3.0])


@pytest.mark.parametrize("even", [False, True])
def test_uneven_instants_give_the_same_sky_as_even_ones(tmp_path: Path, even: bool) -> None:
    jitter = 0.0 if even else np.random.default_rng(4).uniform(-0.2, 0.2, 24)
    lst = np.arange(24) + 0.5 + jitter
    content = {"frequency_mhz": FREQUENCY.tolist(), "lst_hours": lst.tolist()}
    content |= {"X": smooth(lst).tolist(), "Y": (2 * smooth(lst)).tolist()}
    (tmp_path / "p.json").write_text(json.dumps(content))
    read = read_sky_power(tmp_path / "p.json")
    np.testing.assert_allclose(read.at("X", ANYWHERE), smooth(ANYWHERE), rtol=1e-9)
    np.testing.assert_allclose(read.at("Y", ANYWHERE), 2 * smooth(ANYWHERE), rtol=1e-9)
    if even:
        assert read.fit is None
    else:
        assert read.fit is not None
        assert (read.fit.instants, read.fit.harmonics) == (24, 8)
        assert read.fit.largest < 1e-9
        assert "8 harmonics fitted to 24 uneven instants, residual 0.00% r.m.s." in read.origin


def test_uneven_instants_are_named_by_the_numbers_given(tmp_path: Path) -> None:
    lst = np.arange(24) + np.where(np.arange(24) == 7, 0.1, 0.0)
    digests = set()
    for factor in (1.0, 1.0, 1.0 + 1e-15):
        power = (factor * smooth(lst)).tolist()
        content = {"frequency_mhz": FREQUENCY.tolist(), "lst_hours": lst.tolist(), "X": power, "Y": power}
        (tmp_path / "p.json").write_text(json.dumps(content))
        digests.add(read_sky_power(tmp_path / "p.json").digest())
    assert len(digests) == 2


def put(field: str, value: object) -> Callable[[dict[str, Any]], object]:
    return lambda content: content.__setitem__(field, value)


def put_value(dipole: str, row: int, channel: int, value: object) -> Callable[[dict[str, Any]], object]:
    return lambda content: content[dipole][row].__setitem__(channel, value)


WRONG_CONTENT: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "no dipole": (
        lambda c: [c.pop(letter) for letter in "XY"],
        "expected the fields frequency_mhz, lst_hours and P_sky of each dipole under its letter, found no dipole",
    ),
    "NaN": (put_value("X", 3, 1, float("nan")), "X, row 3, entry 1: expected a finite number, found nan"),
    "infinity": (put_value("Y", 0, 2, float("inf")), "Y, row 0, entry 2: expected a finite number, found inf"),
    "zero": (put_value("X", 23, 0, 0), "X, row 23, channel 0: expected finite power > 0, found 0"),
    "negative": (put_value("Y", 5, 2, -1e-9), "Y, row 5, channel 2: expected finite power > 0, found -1e-09"),
    "text": (put_value("X", 1, 1, "1.0"), "X, row 1, entry 1: expected a finite number, found '1.0'"),
    "null": (put_value("X", 1, 1, None), "X, row 1, entry 1: expected a finite number, found None"),
    "true": (put_value("X", 1, 1, True), "X, row 1, entry 1: expected a finite number, found True"),
    "huge integer": (put_value("X", 1, 1, 10**400), "X, row 1, entry 1: expected a finite number"),
    "short row": (lambda c: c["X"][4].pop(), "X, row 4: expected 3 channels, found 2"),
    "missing row": (lambda c: c["Y"].pop(), r"Y: expected shape \(24, 3\) \(lst, freq\), found \(23, 3\)"),
    "no rows": (put("X", []), r"X: expected shape \(24, 3\)"),
    "rows as object": (put("X", {}), "X: expected a list of rows, one an LST, found dict"),
    "flat": (put("X", [1.0] * 24), "X, row 0: expected a list of numbers, found float"),
    "LST in degrees": (
        lambda c: put("lst_hours", [15 * h for h in c["lst_hours"]])(c),
        r"lst_hours, row 2: expected more than 16.875 h and at most 25.875 h \(LST rise over one day\), found 31.875 h",
    ),
    "LST with a hole": (
        lambda c: [c[name].__delitem__(slice(9, 13)) for name in ("lst_hours", "X", "Y")],
        "determine 8 harmonics of the sidereal day, one in every 1.4 h or so, found 5 h without one after row 8",
    ),
    "LST of the night": (
        lambda c: [c[name].__delitem__(slice(12, 24)) for name in ("lst_hours", "X", "Y")],
        "determine 5 harmonics .* found 13 h without one after the last row",
    ),
    "LST that falls": (
        lambda c: c["lst_hours"].__setitem__(9, 3.0),
        r"lst_hours, row 9: expected more than 8.125 h and at most 24.125 h .* found 3 h",
    ),
    "LST of several days": (
        put("lst_hours", list(np.linspace(0, 48, 24))),
        "lst_hours, row 12: expected more than 22.9565 h and at most 24 h",
    ),
    "uneven LST and a missing row": (
        lambda c: [c["lst_hours"].__setitem__(9, 9.5), c["Y"].pop()],
        r"Y: expected shape \(24, 3\) \(lst, freq\), found \(23, 3\)",
    ),
    "uneven LST and a zero": (
        lambda c: [c["lst_hours"].__setitem__(9, 9.5), put_value("X", 23, 0, 0)(c)],
        "X, row 23, channel 0: expected finite power > 0, found 0",
    ),
    "two instants": (put("lst_hours", [0.0, 12.0]), "lst_hours: expected a list of at least 3 instants"),
    "LST as number": (put("lst_hours", 24), "lst_hours: expected a list of numbers, found int"),
    "falling channels": (put("frequency_mhz", [80, 50, 30]), "frequency_mhz, channel 1: expected more than 80 MHz"),
    "no channels": (
        lambda c: [put("frequency_mhz", [])(c), put("X", [[]] * 24)(c), put("Y", [[]] * 24)(c)],
        "frequency_mhz: expected a list of channels",
    ),
}


@pytest.mark.parametrize("case", WRONG_CONTENT)
def test_wrong_content_is_named_with_field_and_row(tmp_path: Path, case: str) -> None:
    change, sentence = WRONG_CONTENT[case]
    content = make_sky_power().as_dict()
    change(content)
    (tmp_path / "p.json").write_text(json.dumps(content))
    with pytest.raises(BadInputError, match=sentence) as caught:
        read_sky_power(tmp_path / "p.json")
    assert str(caught.value).startswith(str(tmp_path / "p.json"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [[], 3, "text", None, True])
def test_json_of_another_kind_is_refused(tmp_path: Path, content: object) -> None:
    (tmp_path / "p.json").write_text(json.dumps(content))
    with pytest.raises(BadInputError, match="a JSON object with the fields frequency_mhz, lst_hours and P_sky"):
        read_sky_power(tmp_path / "p.json")


def test_every_truncation_is_a_sentence(tmp_path: Path) -> None:
    write_sky_power(make_sky_power(), tmp_path / "p.json")
    content = (tmp_path / "p.json").read_bytes().rstrip()
    for length in range(0, len(content), 37):
        (tmp_path / "p.json").write_bytes(content[:length])
        with pytest.raises(UnreadableFileError, match="expected JSON") as caught:
            read_sky_power(tmp_path / "p.json")
        assert "\n" not in str(caught.value)


def test_changed_characters_give_a_sentence_or_a_table(tmp_path: Path) -> None:
    write_sky_power(make_sky_power(8), tmp_path / "p.json")
    content = np.frombuffer((tmp_path / "p.json").read_bytes(), dtype=np.uint8)
    alphabet = np.frombuffer(b'0123456789.,[]{}"eE- nX\xff\x00', dtype=np.uint8)
    rng = np.random.default_rng(3)
    sentences = []
    for _ in range(300):
        mutant = content.copy()
        mutant[rng.integers(0, mutant.size, 2)] = rng.choice(alphabet, 2)
        (tmp_path / "p.json").write_bytes(mutant.tobytes())
        try:
            read_sky_power(tmp_path / "p.json")
        except LbacalError as error:
            sentences.append(str(error))
    assert 100 < len(sentences) < 300
    assert not [sentence for sentence in sentences if "\n" in sentence]
