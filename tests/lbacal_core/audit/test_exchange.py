from __future__ import annotations

from dataclasses import replace

import numpy as np

from lbacal_core.audit.antennas import compare_polarisations, tell_exchanged
from lbacal_core.audit.station import AuditedStation

EVERYBODY = np.ones(6, dtype=bool)


def exchange(station: AuditedStation, *rows: int) -> AuditedStation:
    """A station in which some antennas' dipoles bear each other's letter."""
    power = station.power.copy()
    power[list(rows)] = power[list(rows), ::-1]
    return replace(station, power=power)


def test_an_exchanged_antenna_is_named_with_odds(station: AuditedStation) -> None:
    changed = exchange(station, 2)
    lines = tell_exchanged(changed, compare_polarisations(changed, EVERYBODY))
    assert [(line.verdict, line.antennas) for line in lines] == [("wrong", (2,))]
    assert (lines[0].log_odds or 0.0) > 7


def test_a_field_is_told_from_single_antennas(station: AuditedStation) -> None:
    changed = exchange(station, 1, 3, 5)
    letters = compare_polarisations(changed, EVERYBODY)
    letters = letters if set(letters.exchanged()) == {1, 3, 5} else letters.flipped()
    assert "all odd antennas" in tell_exchanged(changed, letters)[0].sentence


def test_nothing_is_said_of_a_station_whose_letters_agree(station: AuditedStation) -> None:
    assert tell_exchanged(station, compare_polarisations(station, EVERYBODY)) == []


def test_one_instant_says_what_it_cannot(station: AuditedStation) -> None:
    ratio = np.log(station.power[:, 0] / station.power[:, 1]).mean(axis=(0, 2))
    quiet = int(np.argmin(np.abs(ratio)))
    one = replace(
        station, power=station.power[:, :, [quiet]], time_unix=station.time_unix[[quiet]],
        lst_hours=station.lst_hours[[quiet]],
    )  # fmt: skip
    lines = tell_exchanged(one, compare_polarisations(one, EVERYBODY))
    assert [line.verdict for line in lines] == ["undecided"]
    assert "some hours would" in lines[0].sentence


def test_antennas_that_do_not_work_are_not_compared(station: AuditedStation) -> None:
    assert compare_polarisations(station, np.zeros(6, dtype=bool)).rows.size == 0


def test_an_odd_gain_in_one_instant_is_no_exchange(station: AuditedStation) -> None:
    """A drawn station of which one antenna's gains were off by 14 % was said to be exchanged there."""
    power = np.repeat(station.power[:, :1, :1], 2, axis=1)
    power[:, 0] *= np.exp(0.1 + np.array([0.01, -0.01, 0.02, -0.135, 0.0, -0.02]))[:, None, None]
    one = replace(station, power=power, time_unix=station.time_unix[:1], lst_hours=station.lst_hours[:1])
    odds = compare_polarisations(one, EVERYBODY)
    assert odds.exchanged().size == 0
    assert odds.odds[3] > odds.odds[[0, 1, 2, 4, 5]].max()
