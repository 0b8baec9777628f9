from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.simulation.simulation import Simulation
from validation.demo import __main__ as demo


@pytest.fixture(scope="module")
def shown() -> demo.Demonstration:
    simulation = Simulation.load("lofar-superterp")
    return demo.compute(simulation, *demo.simulate(simulation))


def test_the_fit_finds_the_calibration_that_was_planted(shown: demo.Demonstration) -> None:
    assert shown.paths.status == shown.station.status == "converged"
    assert demo.describe_recovery(shown).startswith("12 of 12 paths converged")
    rows = demo.tabulate(shown)
    assert {len(row) for row in rows} == {1 + len(demo.SHOWN_MHZ)}
    assert rows[0][0] == "CS002 antenna 0 X"
    fitted, sigma = map(float, rows[0][1].split(" ± "))
    assert abs(fitted - float(rows[1][1])) < 4.0 * sigma  # one value of one campaign
    assert rows[-1][:2] == ["published", "13.73"]  # the first value of the published table, 1.373e-5 V at 30 MHz


def test_the_sun_is_named_with_its_size_and_nothing_is_left(shown: demo.Demonstration) -> None:
    (finding,) = shown.found["findings"]
    assert (shown.found["verdict"], finding["cause"]) == ("explained", "solar_emission")
    assert abs(finding["size"]["value"] - demo.SUN.size) < 4.0 * finding["size"]["sigma"]
    assert finding["gain"]["held_out_log_likelihood_gain"] > 100.0
    assert "the Sun adds power by day" in demo.describe_hidden(shown)[0]


def test_a_flagged_channel_costs_the_demonstration_that_channel(shown: demo.Demonstration) -> None:
    first, *others = shown.paths.curves
    at = int(np.argmin(np.abs(first.frequency_mhz - demo.SHOWN_MHZ[-1])))
    flag = np.array(first.flags, dtype="U12")
    flag[at] = "outside"
    values = {name: np.array(getattr(first, name)) for name in ("c", "c_sigma_stat")}
    for one in values.values():
        one[at] = np.nan
    first = replace(first, flag=tuple(flag.tolist()), **values, c_sigma_sys=None, covariance=None)
    flagged = replace(shown, paths=replace(shown.paths, curves=(first, *others)))
    assert "nan" not in demo.describe_recovery(flagged)
    assert demo.tabulate(flagged)[0][-1] == "outside"
    assert "nan" not in str(demo.tabulate(flagged))
    demo.render_report(flagged)
