from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.antennas import compare_paths, find_ill_paths
from lbacal_core.audit.station import AuditedStation

ANTENNA, DIPOLE = 3, 1


def spoil(station: AuditedStation, kind: str) -> AuditedStation:
    """A station of which one path does not work."""
    power = station.power.copy()
    path = power[ANTENNA, DIPOLE]
    if kind == "dead":
        path[:] = 1e-3 * path.mean()
    elif kind == "deaf":
        path[:] = path.mean() / 3
    elif kind == "oscillating":
        path[:, 20:23] *= 10.0
    elif kind == "clipped":
        path[:] = 5 * path.mean() * (path / path.mean()) ** 0.3
    else:
        path *= 1.8
    return replace(station, power=power)


@pytest.mark.parametrize("kind", ["dead", "deaf", "oscillating", "clipped", "outlying"])
def test_a_path_that_does_not_work_is_named_and_no_other(station: AuditedStation, kind: str) -> None:
    spoilt = spoil(replace(station, cables=np.full(6, "80"), loss=station.loss[[1] * 6]), kind)
    spoilt = replace(spoilt, power=spoilt.power / (station.loss / spoilt.loss)[:, None, None, :])
    lines, is_ill = find_ill_paths(spoilt, compare_paths(spoilt))
    assert [(line.check, line.antennas, line.dipole) for line in lines] == [(kind, (ANTENNA,), "Y")]
    assert np.argwhere(is_ill).tolist() == [[ANTENNA, DIPOLE]]


def test_nothing_is_named_in_a_station_that_works(station: AuditedStation) -> None:
    assert find_ill_paths(station, compare_paths(station))[0] == []


def test_a_working_path_follows_the_others_wholly(station: AuditedStation) -> None:
    comparison = compare_paths(station)
    np.testing.assert_allclose(comparison.follows, 1.0, atol=1e-6)
    np.testing.assert_allclose(comparison.shares, 1.0, atol=0.05)
