from __future__ import annotations

import json

import numpy as np
import pytest

from lbacal_core.curves.reference_chain import (
    CableTable,
    GainSpread,
    GainSpreads,
    ReferenceChain,
    parse_cable_table,
    parse_spreads,
)
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.provenance import hash_content

TABLE = CableTable(
    {"50": np.array([0.5, 0.4]), "80": np.array([0.3, 0.2])},
    (AntennaRecord("CS002", 0, "50", None, 1000.0), AntennaRecord("CS002", 0, "80", 2000.0, None)),
)
ALL = GainSpread(9, np.array([0.0, 0.01]), np.array([0.04, 0.05]))
SPREADS = GainSpreads(
    {"50": GainSpread(5, np.array([0.03, 0.0]), np.array([0.04, 0.04]))}, ALL, 3, np.array([0.02, 0.03])
)


@pytest.mark.parametrize(
    ("instant", "cable"), [(-1e12, "50"), (999.0, "50"), (1000.0, None), (1999.9, None), (2000.0, "80"), (1e12, "80")]
)
def test_the_cable_is_that_of_the_instant_and_none_in_a_gap(instant: float, cable: str | None) -> None:
    assert TABLE.cable_of("CS002", 0, instant) == cable


def test_an_antenna_that_is_not_in_the_table_has_no_cable() -> None:
    assert TABLE.cable_of("CS002", 1, 0.0) is None


def test_tables_and_spreads_keep_their_hash_through_json() -> None:
    for value, parse in ((TABLE, parse_cable_table), (SPREADS, parse_spreads)):
        again = parse(json.loads(json.dumps(value.as_dict())))
        assert again.digest == value.digest == hash_content(value.as_dict())


def test_a_cable_that_was_not_measured_has_the_departures_of_all_paths() -> None:
    np.testing.assert_allclose(SPREADS.variance_of("50", has_station=True), [0.03**2 + 0.04**2, 0.04**2])
    np.testing.assert_allclose(SPREADS.variance_of("80", has_station=True), [0.04**2, 0.01**2 + 0.05**2])


def test_another_station_departs_further_and_from_one_station_nobody_knows_how_far() -> None:
    near, far = SPREADS.variance_of("80", has_station=True), SPREADS.variance_of("80", has_station=False)
    np.testing.assert_allclose(far - near, 2 / 3 * SPREADS.between_stations**2)
    assert GainSpreads({}, ALL, 1, None).variance_of("80", has_station=False) is None


def test_jensens_term_is_three_eighths_of_the_variance_of_power_gains() -> None:
    chain = ReferenceChain((("CS002", 0),), TABLE.cables["50"], TABLE, SPREADS)
    np.testing.assert_allclose(chain.jensen, 3 / 8 * ALL.spread**2)
    gains = 1 + 0.05 * np.random.default_rng(1).standard_normal(1_000_000)
    assert np.mean(gains**-0.5) / np.mean(gains) ** -0.5 - 1 == pytest.approx(3 / 8 * 0.05**2, rel=0.1)
