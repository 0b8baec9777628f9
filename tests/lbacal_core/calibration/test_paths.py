from __future__ import annotations

import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from lbacal_core.calibration import paths
from lbacal_core.calibration.paths import paths_of_scope, require_one_cable_each
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.blocks import SpectraBlock, iterate_blocks
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings


@pytest.mark.long
def test_the_mean_of_an_array_holds_the_spectra_of_one_station_at_a_time(
    chain: Instrument, sky: SkyPower, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The spectra of fifty stations were in memory twice."""
    stations = tuple(sorted({one.station for one in chain.antennas}))[:4]
    settings = TwinSettings(stations=stations, antennas=2, events_per_year=80)
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(3)).spectra
    simulation = Simulation(chain, sky)
    made: list[weakref.ref[SpectraBlock]] = []
    most = [0]

    def watch(*of: Any) -> Iterator[SpectraBlock]:
        for block in iterate_blocks(*of):
            made.append(weakref.ref(block))
            most[0] = max(most[0], sum(one() is not None for one in made))
            yield block

    monkeypatch.setattr(paths, "iterate_blocks", watch)
    means = [read() for read in paths_of_scope(spectra, simulation, "array", require_one_cable_each(spectra, chain))]
    assert [len(one.members) for one in means] == [2 * len(stations)] * 2
    assert len(made) == 2 * len(stations)
    assert most[0] <= 2, "the one before and the next"
