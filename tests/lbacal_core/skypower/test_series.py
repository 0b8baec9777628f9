from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.skypower.series import fewest_harmonics, make_even, most_harmonics
from lbacal_core.skypower.table import read_sky_power

CHANNELS = np.array([1.0, 3.0])


def sky(lst_hours, harmonics):
    """A sky with that many harmonics, shape (lst, 2)."""
    angle = 2 * np.pi / 24.0 * np.outer(lst_hours, np.arange(1, harmonics + 1))
    return np.outer(3.0 + np.sin(angle) @ (1.0 / np.arange(1.0, harmonics + 1) ** 2), CHANNELS)


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
    even, power, fit = make_even("made up", lst, {"X": sky(lst, harmonics)})
    np.testing.assert_allclose(power["X"], sky(even, harmonics), rtol=1e-8)
    assert fit.largest < 1e-8


def test_what_the_harmonics_do_not_hold_is_the_residual():
    lst = np.sort(np.random.default_rng(1).uniform(0, 24, 96))
    noise = 1 + 0.01 * np.random.default_rng(2).standard_normal((96, 2))
    # instants at random leave holes, and fewer than 24 harmonics are determined
    _, _, fit = make_even("at random", lst, {"X": sky(lst, 4) * noise})
    assert 8 <= fit.harmonics < 24
    assert fit.rms == pytest.approx(0.01 * (1 - (2 * fit.harmonics + 1) / 96) ** 0.5, rel=0.2)
    # 96 instants, 49 coefficients: the residual keeps (96 - 49) / 96 of the variance
    even = np.arange(96) / 4 + np.where(np.arange(96) == 5, 0.05, 0.0)
    _, _, fit = make_even("nearly even", even, {"X": sky(even, 4) * noise})
    assert fit.rms == pytest.approx(0.01 * (47 / 96) ** 0.5, rel=0.2)
    assert fit.rms < fit.largest < 6 * fit.rms


def test_a_closed_day_says_its_first_instant_twice_and_is_read():
    lst = np.linspace(0.0, 24.0, 25)
    _, _, fit = make_even("closed", lst, {"X": sky(lst, 6)})
    assert (fit.harmonics, fit.largest < 1e-9) == (8, True)


@pytest.mark.parametrize("hole", [2.5, 4.0, 12.0])
def test_a_hole_is_refused_with_its_place(hole):
    lst = np.arange(0.0, 24.0, 0.5)
    kept = lst[(lst <= 8.0) | (lst >= 8.0 + hole)]
    with pytest.raises(BadInputError, match=f"found {hole:g} h without one after row 16"):
        make_even("hole", kept, {"X": sky(kept, 3)})


@pytest.mark.shared
def test_the_published_hourly_tables_were_refused_for_their_uneven_steps(shared: Path, tmp_path: Path):
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
