from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.instrument import load_instrument
from lbacal_core.skypower.differences import model_difference_modes, model_level_spread
from lbacal_core.skypower.model import compute_sky_power

NU = np.arange(30.0, 81.0)
LST = np.arange(96) / 4


def test_there_are_four_modes_and_their_mean_over_lst_vanishes() -> None:
    modes = model_difference_modes(NU, LST)
    assert {dipole: values.shape for dipole, values in modes.items()} == {"X": (4, 96, 51), "Y": (4, 96, 51)}
    assert modes["X"].mean(axis=1) == pytest.approx(0.0, abs=1e-15)


def test_the_modes_come_strongest_first_and_are_a_few_percent() -> None:
    for values in model_difference_modes(NU, LST).values():
        size = values.std(axis=(1, 2))
        assert np.all(np.diff(size) < 0)
        assert 0.02 < size[0] < 0.05


def test_the_modes_may_be_asked_at_single_events() -> None:
    events = np.array([3.3, 3.3, 17.0])
    modes = model_difference_modes(NU, events)["Y"]
    assert modes[:, 0] == pytest.approx(modes[:, 1])
    assert modes[:, 2] == pytest.approx(model_difference_modes(NU, events[2:])["Y"][:, 0])


def test_the_level_of_the_models_spreads_by_ten_to_twenty_percent() -> None:
    for values in model_level_spread(NU).values():
        assert np.all((values > 0.08) & (values < 0.25))


def test_frequencies_beyond_the_table_have_the_modes_of_its_edge() -> None:
    modes = model_difference_modes(np.array([25.0, 30.0, 80.0, 85.0]), LST)["X"]
    assert modes[..., 0] == pytest.approx(modes[..., 1])
    assert modes[..., 3] == pytest.approx(modes[..., 2])


def test_a_letter_gets_the_modes_of_its_arm() -> None:
    named = model_difference_modes(NU, LST)
    exchanged = model_difference_modes(NU, LST, {"X": 310.0, "Y": 230.0})
    assert exchanged["X"] == pytest.approx(named["Y"])
    assert exchanged["Y"] == pytest.approx(named["X"])


@pytest.mark.shared
@pytest.mark.parametrize("sky", ["gsm-408locked", "lfsm-5.1deg"])
@pytest.mark.parametrize("antenna", ["hamaker", "lba_vout"])
def test_the_modes_span_every_exchange_of_models_they_were_made_from(shared: Path, sky: str, antenna: str) -> None:
    instrument = load_instrument("lofar-superterp")
    beam = antenna if antenna == "hamaker" else str(shared / "data/antenna/lba_vout.npz")
    other = compute_sky_power(instrument, str(shared / f"data/sky/{sky}.npz"), beam)
    default = compute_sky_power(instrument)
    for dipole, modes in model_difference_modes(NU, LST).items():
        change = np.log(other.power[dipole] / default.power[dipole])
        change -= change.mean(axis=0)
        basis = modes.reshape(4, -1).T
        amplitude = np.linalg.lstsq(basis, change.ravel(), rcond=None)[0]
        # 2e-4: the mode left out, and the nodes of the table; 3 % to begin with.
        assert np.std(change.ravel() - basis @ amplitude) < 2e-4
        assert np.all(np.abs(amplitude) < 1.6)  # within the prior
