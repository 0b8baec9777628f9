from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lbacal.cli.fit_summary import align, describe_error, explain_chi2, tabulate_curves
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.uncertainty.one_event import ErrorOfC

FREQUENCY = np.arange(30.0, 81.0)
C = np.full(51, 2e-5)


def curve(antenna: int = 3, dipole: str = "X", **changes: Any) -> CalibrationCurve:
    one = CalibrationCurve(
        "CS002", antenna, dipole, "converged", 900, FREQUENCY, C, 0.01 * C, 0.1 * C, 1.13, 0.97, {},
        chi2_per_dof_profiled=0.87,
    )  # fmt: skip
    return replace(one, **changes)


def failed() -> CalibrationCurve:
    return curve(
        antenna=4, status="too_few_events", c=None, c_sigma_stat=None, c_sigma_sys=None, chi2_per_dof=None,
        chi2_per_dof_profiled=None, events=20,
    )  # fmt: skip


def test_a_few_curves_have_a_row_each_with_chi2_and_both_errors() -> None:
    header, row, other = tabulate_curves([curve(), failed()])
    assert header[:7] == ["", "curves", "events", "LST", "chi2/dof", "sky free", "flagged"]
    assert header[7:] == [f"C({nu} MHz), µV ±stat.% ±syst.%" for nu in (30, 55, 80)]
    assert row[:7] == ["CS002 antenna 3 X", "converged", "900", "0.97", "1.13", "0.87", "0 of 51"]
    assert row[7] == "20 ±1.0 ±10"
    assert other[:3] == ["CS002 antenna 4 X", "too_few_events", "20"]
    assert len({len(one) for one in (header, row, other)}) == 1
    lines = align([header, row, other])
    assert lines[1].index("converged") > lines[1].index("antenna")


def test_many_curves_are_told_by_station_and_polarisation() -> None:
    curves = [curve(k, dipole, chi2_per_dof=1.0 + 0.01 * k) for k in range(20) for dipole in "XY"]
    curves[4] = replace(failed(), antenna=2)
    _, x, y = tabulate_curves(curves)
    assert (x[0], y[0]) == ("CS002 X", "CS002 Y")
    assert x[1] == "19 converged, 1 too_few_events"
    assert x[4] == "1.00-1.19"


def test_a_flagged_channel_is_counted_and_one_without_a_value_is_outside() -> None:
    flag = ("outside", "uncertain", *["ok"] * 49)
    c = C.copy()
    c[0] = np.nan
    _, row = tabulate_curves([curve(flag=flag, c=c, c_sigma_stat=0.01 * c, c_sigma_sys=0.1 * c)])
    assert row[6:8] == ["2 of 51", "outside"]


def test_what_chi2_means_is_said_with_the_numbers_of_these_channels() -> None:
    sentence = explain_chi2([curve(), curve(chi2_per_dof=2.0)])
    assert "1.0 ± 0.2 (48 degrees of freedom)" in sentence
    assert "above 1.6 the systematic error of a curve is widened (1 here)" in sentence
    assert "(0 here)" in sentence


def test_one_number_for_one_event_on_one_antenna() -> None:
    sentence = describe_error(ErrorOfC(0.01, 0.1, 0.0, 0.025))
    assert sentence == (
        "error of C for one event on one antenna: 10.4 % (statistical 1.0 %, systematic 10.0 %, gain of an event "
        "2.5 %); for the mean of the events: 10.0 %"
    )
    assert "single antennas 1.6 %" in describe_error(ErrorOfC(0.002, 0.1, 0.016, 0.025))


@pytest.mark.parametrize("error", [ErrorOfC(0.01, 0.1, 0.0, np.nan), ErrorOfC(0.01, 0.1, np.nan, 0.02)])
def test_an_unknown_part_makes_the_number_unknown(error: ErrorOfC) -> None:
    assert describe_error(error).startswith("error of C for one event on one antenna: unknown (")
