from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.chain_test import LARGEST_GAIN, Mistake, describe_mistakes, list_mistakes, name_mistakes
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power

LST_HOURS = np.arange(48) / 2.0


@pytest.fixture(scope="module")
def power():
    return compute_sky_power(load_instrument("lofar-superterp"), lst_hours=LST_HOURS).power


@pytest.fixture(scope="module")
def mistakes(power):
    return {one.name: one for one in list_mistakes(load_instrument("lofar-superterp"), power, LST_HOURS)}


def test_each_mistake_leads_to_what_p_sky_would_be_without_it(power, mistakes):
    exchanged = mistakes["dipoles X and Y exchanged"]
    assert power["X"] * np.exp(exchanged.change["X"]) == pytest.approx(power["Y"])
    # local summer time taken for UTC: the sky is what it was two hours before
    late = mistakes["times 2 h too late"]
    assert (power["Y"] * np.exp(late.change["Y"]))[4:] == pytest.approx(power["Y"][:-4])


def test_of_another_antenna_the_data_show_its_form_along_lst_and_not_its_level(mistakes):
    other = mistakes["the antenna is like short-dipole"]
    assert other.antenna == "short-dipole"
    assert other.change["X"].mean(axis=0)[-1] == pytest.approx(0.83, abs=0.02)
    assert np.abs(other.shown("X").mean(axis=0)).max() < 1e-12
    assert "the antenna is like hamaker" not in mistakes


def test_an_instrument_with_one_arm_has_no_letters_to_exchange():
    lofar = load_instrument("lofar-superterp")
    one_arm = replace(lofar, dipole_azimuth_deg={"A": 20.0}, antenna="short-dipole", gain_provenance=None)
    power = compute_sky_power(one_arm, lst_hours=LST_HOURS).power
    names = [one.name for one in list_mistakes(one_arm, power, LST_HOURS)]
    assert not any("exchanged" in name for name in names)
    assert "the antenna is like hamaker" in names
    assert "the antenna is like short-dipole" not in names


def curve(antenna, dipole):
    return CalibrationCurve(
        "CS002", antenna, dipole, "too_few_events", 3, np.array([50.0]), None, None, None, None, 0.1, {}
    )


def test_the_dipoles_of_an_antenna_share_a_mistake():
    mistakes = [Mistake(name, {}) for name in ("a", "b")]
    half = np.array([-5.0, 0.6 * LARGEST_GAIN])
    found = [(curve(1, "X"), half), (curve(1, "Y"), half), (curve(2, "X"), half), (curve(3, "X"), 3 * half[::-1])]
    mistaken = name_mistakes(found, mistakes)
    assert mistaken == {("CS002", 1): "b", ("CS002", 3): "a"}
    assert describe_mistakes({**mistaken, ("CS002", 4): "b"}) == "b (CS002 antenna 1 and 1 more); a (CS002 antenna 3)"
