from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.antenna.circuit import ResonanceCircuit
from lbacal_core.antenna.model import directional_response, zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import load_instrument

NU = np.arange(30.0, 81.0)


def test_the_default_circuit_follows_the_antenna_gain_of_the_superterp() -> None:
    ratio = np.log(ResonanceCircuit().gain(NU) / load_instrument("lofar-superterp").antenna_gain)
    assert np.std(ratio) < 0.06  # 5 % as its docstring says


def test_a_longer_arm_and_a_larger_capacitance_resonate_lower() -> None:
    plain = ResonanceCircuit()
    peak = NU[plain.gain(NU).argmax()]
    assert NU[replace(plain, arm_m=1.6).gain(NU).argmax()] < peak
    assert NU[replace(plain, lna_farad=20e-12).gain(NU).argmax()] < peak


def test_the_circuit_changes_the_gain_and_not_the_response() -> None:
    plain, resonant = load_antenna("hamaker"), load_antenna("hamaker-resonant")
    directions = np.array([0.3, 1.0]), np.array([0.0, 2.0])
    assert directional_response(resonant, NU, *directions) == pytest.approx(
        directional_response(plain, NU, *directions)
    )
    expected = zenith_gain(plain, NU) * ResonanceCircuit().gain(NU)
    assert zenith_gain(resonant, NU) == pytest.approx(expected)


def test_a_circuit_without_resistance_is_refused() -> None:
    with pytest.raises(BadInputError, match="lna_ohm"):
        ResonanceCircuit(lna_ohm=0.0)
