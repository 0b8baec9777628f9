from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration import singles
from lbacal_core.calibration.budget import compute_budget
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.singles import MIN_EVENTS, fit_singles
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import split_into_blocks


@pytest.fixture(scope="module")
def spectra(scene):
    return scene.spectra(np.random.default_rng(12), events=120, stations=2)


def test_scopes_and_budget_of_the_same_spectra_look_at_each_block_once(scene, spectra, monkeypatch):
    scopes, fitted = ("antenna", "station", "array"), []

    def ask(*simulations):
        reports = [fit_calibration(spectra, one, scope) for one, scope in zip(simulations, scopes, strict=True)]
        return reports, compute_budget(spectra, simulations[0], "paper")

    alone, budget = ask(*(Simulation(scene.instrument, scene.sky_power) for _ in scopes))
    fit_lines = singles.fit_lines
    monkeypatch.setattr(singles, "fit_lines", lambda *given: fitted.append(given) or fit_lines(*given))
    together, same = ask(*[Simulation(scene.instrument, scene.sky_power)] * 3)
    assert same.digest == budget.digest
    assert len(fitted) == len(split_into_blocks(spectra)) == 4
    for one, other in zip(alone, together, strict=True):
        assert [curve.c.tolist() for curve in one.curves] == [curve.c.tolist() for curve in other.curves]


def test_another_power_of_a_single_event_is_another_block(scene, spectra):
    simulation, power = Simulation(scene.instrument, scene.sky_power), spectra.power.copy()
    power[7] *= 1.01
    blocks = [split_into_blocks(one)[0] for one in (spectra, replace(spectra, power=power))]
    found = [fit_singles(block, simulation, 100.0) for block in blocks]
    assert not np.array_equal(found[0].lines.slope, found[1].lines.slope)


def test_paths_with_too_few_events_have_lines_and_no_chain(scene, spectra):
    block = split_into_blocks(spectra)[0]
    is_present = block.is_present.copy()
    is_present[1, MIN_EVENTS - 1 :] = False
    block = replace(block, is_present=is_present, blocks=np.where(is_present, block.blocks, 0))
    found = fit_singles(block, Simulation(scene.instrument, scene.sky_power), 100.0)
    assert len(found.lines.slope) == len(block.antennas)
    assert found.solved.tolist() == [0, 2, 3]
