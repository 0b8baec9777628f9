"""A measured LST curve in Python: compared, investigated, and drawn with what the simulation leaves of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lbacal
from lbacal.pages.chart import Chart
from lbacal_core.lstcurve.curve import measured_curve


@pytest.fixture(scope="module")
def found() -> lbacal.Investigation:
    return lbacal.investigate(measured_curve())


def require_rest(top: Chart, left: Chart, words: str) -> None:
    """What is drawn as left is what was measured less the line of the same words."""
    measured = next(one for one in top.series if one.name.startswith("measured"))
    line = next(one for one in top.series if words in one.name)
    rest = next(one for one in left.series if one.name.startswith(words.removeprefix("simulation ").rstrip(":")))
    expected = np.asarray(measured.y) - np.interp(measured.x, line.x, line.y)
    np.testing.assert_allclose(rest.y, expected, atol=0.03)


def test_a_comparison_has_a_row_a_point_and_draws_what_it_leaves() -> None:
    compared = lbacal.lst_curve(measured_curve())
    table, charts = compared.table, list(compared.charts())
    assert (str(table["lst"].unit), len(charts)) == ("h", 4)
    for k, dipole in enumerate("xy"):
        top, left = charts[2 * k : 2 * k + 2]
        measured, *simulated = top.series
        told = [row[2] for row in compared.rows[1:] if row[0] == dipole.upper()]
        share = compared.comparison.of(dipole.upper(), has_noise=True).noise_share
        told = told[-1:] if share == 0.0 else told  # sky alone is the same curve
        assert len(simulated) == len(left.series) - 1 == len(told)
        np.testing.assert_array_equal(measured.y, table[f"{dipole}_db"])
        is_known = np.isfinite(np.asarray(measured.y))
        error = (np.asarray(measured.high) - measured.low) / 2
        np.testing.assert_allclose(error[is_known], np.asarray(table["error_db"])[is_known])
        for alone in left.series[1:-1]:
            require_rest(top, left, "sky alone")
            np.testing.assert_array_equal(alone.high, alone.low)
        require_rest(top, left, "sky and")
        np.testing.assert_array_equal(left.series[-1].y, table[f"{dipole}_residual_db"])
        chi2 = [float(one.name.rpartition(" ")[2]) for one in simulated]
        assert chi2 == pytest.approx([float(one) for one in told], abs=0.06)


def test_an_investigation_of_a_curve_has_a_row_a_finding(found: lbacal.Investigation) -> None:
    assert len(found.table) == len(found.findings) >= 1
    for row, one in zip(found.table, found.findings, strict=True):
        size, sigma = one.content["size"]["value"], one.content["size"]["sigma"]
        assert (row["cause"], row["size"], row["unit"]) == (one.cause, size, one.content["size"]["unit"])
        assert np.isnan(row["size_sigma"]) if sigma is None else row["size_sigma"] == sigma
        words = f"{size:.3g} {one.content['size']['unit']}" if sigma is None else f"{size:.3g} ± {sigma:.2g} "
        assert one.title.startswith(f"{one.cause} {words}")
        assert f"  {one.significance:.1f} sigma: {one.sentence}" in found.lines
    assert found.lines[1].startswith("    these data cannot tell it from ") == bool(
        found.findings[0].content["indistinguishable"]
    )


def test_an_investigation_of_a_curve_draws_before_and_after(found: lbacal.Investigation, tmp_path: Path) -> None:
    *curves, ranking, change_x, change_y = found.charts()
    assert [one.title.partition(":")[0] for one in curves[::2]] == ["X", "Y", "difference X - Y"]
    for top, left in zip(curves[::2], curves[1::2], strict=True):
        require_rest(top, left, "simulation before")
        require_rest(top, left, "simulation after")
        drawn, estimated = top.series[:2]
        noise = np.asarray(estimated.high) - estimated.low
        assert np.nanmax(noise) - np.nanmin(noise) < 1e-9
        assert np.nanmin(np.asarray(drawn.high) - drawn.low) > 0.0
    x, y, both = (np.nanmax(np.asarray(top.series[0].high) - top.series[0].y) for top in curves[::2])
    assert (y, both) == (pytest.approx(x), pytest.approx(x * 2**0.5)), "the bars of two dipoles are independent"
    named, _, excluded, before, noise = ranking.series
    assert len(named.x) == 1
    assert ranking.rows[0].partition(" ")[0] == found.findings[0].cause.partition("_")[0]
    assert max(named.x) <= max(excluded.x)
    assert (before.x[0] > named.x[0], noise.x) == (True, [1.0])
    fraction = found.report["findings"][0]["calibration_change"]["max_fraction"]
    assert max(np.abs(one.series[0].y).max() for one in (change_x, change_y)) == pytest.approx(100 * fraction, rel=0.05)
    found.save(tmp_path / "L.html")
    assert (tmp_path / "L.html").read_text().count("<svg ") == len(curves) + 3
