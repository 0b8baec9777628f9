from __future__ import annotations

import numpy as np

from lbacal_twin.faults.interference import RfiBroadband, RfiLine


def test_a_line_stays_in_its_channel_and_hours(plant) -> None:
    line = plant(RfiLine(size=0.1, line_mhz=45.0, width_mhz=0.5, hours=(22.0, 4.0)))
    hour = line.time_unix / 3600 % 24
    is_on = (hour >= 22) | (hour < 4)
    assert np.abs(line.effect[:, :, ~is_on]).max() < 1e-12
    assert line.effect[:, :, is_on, 15].min() > 0.05
    assert np.abs(np.delete(line.effect, 15, axis=3)).max() < 1e-3
    broad = plant(RfiBroadband(size=0.1, index=-2.0, hours=(6.0, 18.0)))
    assert np.all((broad.effect[0, 0, :, 10] > 1e-9) == ((hour >= 6) & (hour < 18)))
