from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.instrument import Instrument
from lbacal_core.skypower.table import SkyPower
from lbacal_twin.settings import TwinSettings
from service.cli.demo import SHOWN_MHZ, Demonstration, demonstrate, describe_recovery, render_report, tabulate


@pytest.fixture(scope="module")
def shown(low_band: Instrument, two_waves: SkyPower) -> Demonstration:
    settings = TwinSettings(events_per_year=300, stations=("CS002",), antennas=3)
    return demonstrate(low_band, two_waves, settings, seed=1)


def test_the_demonstration_fits_every_path_and_the_station(shown: Demonstration) -> None:
    assert shown.paths.status == shown.station.status == "converged"
    assert (len(shown.paths.curves), len(shown.station.curves)) == (6, 2)
    assert describe_recovery(shown).startswith("6 of 6 paths converged")


def test_a_flagged_channel_costs_the_demonstration_that_channel(shown: Demonstration) -> None:
    first, *others = shown.paths.curves
    at = int(np.argmin(np.abs(first.frequency_mhz - SHOWN_MHZ[-1])))
    flag = np.array(first.flags, dtype="U12")
    flag[at] = "outside"
    values = {name: np.array(getattr(first, name)) for name in ("c", "c_sigma_stat")}
    for one in values.values():
        one[at] = np.nan
    first = replace(first, flag=tuple(flag.tolist()), **values, c_sigma_sys=None, covariance=None)
    flagged = replace(shown, paths=replace(shown.paths, curves=(first, *others)))
    assert flagged.paths.status == "converged"
    sentence = describe_recovery(flagged)
    assert sentence.startswith("6 of 6 paths converged")
    assert "nan" not in sentence
    assert tabulate(flagged)[0][-1] == "outside"
    assert "nan" not in str(tabulate(flagged))
    render_report(flagged)


def test_the_expected_band_of_one_campaign_is_said(shown: Demonstration) -> None:
    assert "Expected of one campaign are 44 to 80 %" in describe_recovery(shown)


def test_the_table_has_fitted_planted_and_published_values(shown: Demonstration) -> None:
    rows = tabulate(shown)
    assert {len(row) for row in rows} == {1 + len(SHOWN_MHZ)}
    assert rows[0][0] == "CS002 antenna 0 X"
    assert "±" in rows[0][1]
    (systematic,) = {row[0] for row in rows if row[1].endswith(" %")}
    assert systematic == "  systematic error"
    assert all(4.0 < float(row[2].removesuffix(" %")) < 30.0 for row in rows if row[0] == systematic)
    assert rows[-1][:2] == ["published", "13.73"]  # the first value of the published table, 1.373e-5 V at 30 MHz


@pytest.mark.long
def test_the_report_is_one_page_that_loads_nothing(shown: Demonstration) -> None:
    page = render_report(shown)
    assert page.count("data:image/png;base64,") == 4
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert "http" not in re.sub(r"base64,[^\"]*", "", page)
