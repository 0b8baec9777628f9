import csv
import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.sky.table import SkyPower, fewest_harmonics, make_even, most_harmonics, read_sky_power, write_sky_power

FREQUENCY = np.array([30.0, 50.0, 80.0])
ANYWHERE = np.random.default_rng(1).uniform(-30.0, 60.0, 200)


def make_sky_power(size: int = 24, first: float = 0.125) -> SkyPower:
    rng = np.random.default_rng(size)
    lst = first + 24.0 / size * np.arange(size)
    return SkyPower(FREQUENCY, lst, {dipole: rng.uniform(1, 2, (size, 3)) for dipole in "XY"}, "made up")


@pytest.mark.parametrize("size", [3, 8, 9, 96])
@pytest.mark.parametrize("first", [0.0, 0.125, 7.3])
def test_sky_power_between_instants_is_the_direct_fourier_sum(size, first):
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
def test_a_single_harmonic_is_exact_between_the_instants(order):
    lst = np.arange(96) * 0.25 + 0.125

    def wave(hours: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        return np.outer(2.0 + np.cos(2 * np.pi * order * (hours - 3.3) / 24.0), [1.0, 2.0, 3.0])

    table = SkyPower(FREQUENCY, lst, {"X": wave(lst), "Y": 2 * wave(lst)})
    np.testing.assert_allclose(table.at("X", ANYWHERE), wave(ANYWHERE), rtol=1e-12)
    np.testing.assert_allclose(table.at("Y", ANYWHERE), 2 * wave(ANYWHERE), rtol=1e-12)


def test_a_file_returns_what_was_written(tmp_path):
    write_sky_power(make_sky_power(), tmp_path / "p.json")
    read = read_sky_power(tmp_path / "p.json")
    assert read.digest() == make_sky_power().digest()
    assert read.origin.endswith("p.json")


def test_the_digest_sees_every_number():
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
def test_uneven_instants_give_the_same_sky_as_even_ones(tmp_path, even):
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


def test_uneven_instants_are_named_by_the_numbers_given(tmp_path):
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
    "zero": (put_value("X", 23, 0, 0), "X, row 23, channel 0: expected finite power > 0, found 0"),
    "text": (put_value("X", 1, 1, "1.0"), "X, row 1, entry 1: expected a finite number, found '1.0'"),
    "short row": (lambda c: c["X"][4].pop(), "X, row 4: expected 3 channels, found 2"),
    "misspelt antenna": (
        lambda c: c.__setitem__("antena", "hamaker"),
        "antenna: expected the field 'antenna' or none, found 'antena'",
    ),
    "missing row": (lambda c: c["Y"].pop(), r"Y: expected shape \(24, 3\) \(lst, freq\), found \(23, 3\)"),
    "rows as object": (put("X", {}), "X: expected a list of rows, one an LST, found dict"),
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
    "LST of several days": (
        put("lst_hours", list(np.linspace(0, 48, 24))),
        "lst_hours, row 12: expected more than 22.9565 h and at most 24 h",
    ),
    "uneven LST and a missing row": (
        lambda c: [c["lst_hours"].__setitem__(9, 9.5), c["Y"].pop()],
        r"Y: expected shape \(24, 3\) \(lst, freq\), found \(23, 3\)",
    ),
    "two instants": (put("lst_hours", [0.0, 12.0]), "lst_hours: expected a list of at least 3 instants"),
    "falling channels": (put("frequency_mhz", [80, 50, 30]), "frequency_mhz, channel 1: expected more than 80 MHz"),
}


@pytest.mark.parametrize("case", WRONG_CONTENT)
def test_wrong_content_is_named_with_field_and_row(tmp_path, case):
    change, sentence = WRONG_CONTENT[case]
    content = make_sky_power().as_dict()
    change(content)
    (tmp_path / "p.json").write_text(json.dumps(content))
    with pytest.raises(BadInputError, match=sentence) as caught:
        read_sky_power(tmp_path / "p.json")
    assert str(caught.value).startswith(str(tmp_path / "p.json"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [[], 3, "text", None, True])
def test_json_of_another_kind_is_refused(tmp_path, content):
    (tmp_path / "p.json").write_text(json.dumps(content))
    with pytest.raises(BadInputError, match="a JSON object with the fields frequency_mhz, lst_hours and P_sky"):
        read_sky_power(tmp_path / "p.json")


@pytest.mark.parametrize(
    ("instants", "fewest", "most"),
    [(3, 1, 1), (12, 5, 5), (17, 8, 8), (24, 8, 8), (32, 8, 8), (48, 8, 12), (96, 8, 24)],
)
def test_a_series_has_8_harmonics_or_one_for_four_instants(instants, fewest, most):
    assert (fewest_harmonics(instants), most_harmonics(instants)) == (fewest, most)


@pytest.mark.parametrize("instants", [17, 24, 96, 300])
def test_the_series_of_a_grid_at_random_is_that_of_the_sky(instants):
    rng = np.random.default_rng(instants)
    step = 24.0 / instants
    lst = np.sort(step * (np.arange(instants) + rng.uniform(-0.3, 0.3, instants)))
    harmonics = most_harmonics(instants)
    even, power, fit = make_even("made up", lst, {"X": smooth(lst, harmonics)})
    np.testing.assert_allclose(power["X"], smooth(even, harmonics), rtol=1e-8)
    assert fit.largest < 1e-8


def test_what_the_harmonics_do_not_hold_is_the_residual():
    lst = np.sort(np.random.default_rng(1).uniform(0, 24, 96))
    noise = 1 + 0.01 * np.random.default_rng(2).standard_normal((96, 3))
    # instants at random leave holes, and fewer than 24 harmonics are determined
    _, _, fit = make_even("at random", lst, {"X": smooth(lst, 4) * noise})
    assert 8 <= fit.harmonics < 24
    assert fit.rms == pytest.approx(0.01 * (1 - (2 * fit.harmonics + 1) / 96) ** 0.5, rel=0.2)
    # 96 instants, 49 coefficients: the residual keeps (96 - 49) / 96 of the variance
    even = np.arange(96) / 4 + np.where(np.arange(96) == 5, 0.05, 0.0)
    _, _, fit = make_even("nearly even", even, {"X": smooth(even, 4) * noise})
    assert fit.rms == pytest.approx(0.01 * (47 / 96) ** 0.5, rel=0.2)
    assert fit.rms < fit.largest < 6 * fit.rms


def test_a_closed_day_says_its_first_instant_twice_and_is_read():
    lst = np.linspace(0.0, 24.0, 25)
    _, _, fit = make_even("closed", lst, {"X": smooth(lst, 6)})
    assert (fit.harmonics, fit.largest < 1e-9) == (8, True)


@pytest.mark.parametrize("hole", [2.5, 4.0, 12.0])
def test_a_hole_is_refused_with_its_place(hole):
    lst = np.arange(0.0, 24.0, 0.5)
    kept = lst[(lst <= 8.0) | (lst >= 8.0 + hole)]
    with pytest.raises(BadInputError, match=f"found {hole:g} h without one after row 16"):
        make_even("hole", kept, {"X": smooth(kept, 3)})


@pytest.mark.shared
def test_the_published_hourly_tables_were_refused_for_their_uneven_steps(shared, tmp_path):
    text = (shared / "data/published_sky_power.csv").read_text()
    rows = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    lst, mhz = (sorted({float(row[name]) for row in rows}) for name in ("lst_h", "mhz"))
    tables = {}
    for dipole in "XY":
        value = {(float(row["lst_h"]), float(row["mhz"])): float(row[dipole]) for row in rows}
        tables[dipole] = [[value[t, f] for f in mhz] for t in lst]
    (tmp_path / "p.json").write_text(json.dumps({"frequency_mhz": mhz, "lst_hours": lst, **tables}))
    read = read_sky_power(tmp_path / "p.json")
    assert read.fit is not None
    # their times are rounded to 0.01 h: 0.003 h r.m.s. times a slope of up to 20 % an hour
    assert read.fit.rms < 0.001
    assert read.fit.largest < 0.002
    np.testing.assert_allclose(read.at("Y", np.array(lst)), tables["Y"], rtol=0.002)


@pytest.mark.parametrize("hours", [0.25, 3.0, 11.0])
@pytest.mark.parametrize("size", [9, 24])
def test_a_smeared_sky_is_its_mean_over_the_window(hours, size):
    table = make_sky_power(size)
    table = replace(table, stations={"B": make_sky_power(size, 0.4)})
    # the middles of 4,000 steps: exact to (12 pi hours / 24 / 4000)^2 / 24 of the fastest wave
    steps = hours * ((np.arange(4000) + 0.5) / 4000 - 0.5)
    for one, smeared in ((table, table.smeared(hours)), (table.stations["B"], table.smeared(hours).stations["B"])):
        expected = [one.at("X", at + steps).mean(axis=0) for at in ANYWHERE[:20]]
        np.testing.assert_allclose(smeared.at("X", ANYWHERE[:20]), expected, rtol=1e-6)
    assert table.smeared(hours).digest() != table.digest()


def test_a_sky_of_a_moment_stays_the_same_object():
    table = make_sky_power()
    assert table.smeared(0.0) is table
    assert table.smeared(9.0 / 3600) is table
