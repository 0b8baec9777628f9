import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import speed_of_light

from lbacal_core.antenna.ideal import InvertedV, IsotropicAntenna, ShortDipole
from lbacal_core.antenna.lofar import ResonanceCircuit, load_hamaker
from lbacal_core.antenna.model import directional_response, power_pattern, zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.antenna.varied import VariedAntenna, mean_cosine, raise_arm
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import load_instrument
from tests.oracles import beam_solid_angle

FREQUENCY = np.array([30.0, 55.0, 80.0])


def test_the_response_is_symmetric_about_the_arm():
    azimuth = np.linspace(0, np.pi / 2, 7)
    zenith = np.full(7, 0.9)
    response = directional_response(load_hamaker(), FREQUENCY, zenith, azimuth)
    for mirrored in (-azimuth, np.pi - azimuth, np.pi + azimuth):
        assert directional_response(load_hamaker(), FREQUENCY, zenith, mirrored) == pytest.approx(response)


def test_a_dipole_sees_low_directions_better_across_its_arm_than_along_it():
    low = np.full(2, np.radians(60.0))
    response = directional_response(load_hamaker(), FREQUENCY, low, np.array([0.0, np.pi / 2]))
    assert np.all(response[:, 1] > 1.5 * response[:, 0])


def test_the_response_is_one_at_zenith_and_nothing_below_the_horizon():
    zenith, azimuth = np.array([0.0, 1.7, 3.0]), np.array([np.pi / 4, 0.0, 0.0])
    response = directional_response(load_hamaker(), FREQUENCY, zenith, azimuth)
    assert response[:, 0] == pytest.approx(1.0, abs=3e-3)  # theta and phi parts of the fit differ by 0.2 %
    assert np.all(response[:, 1:] == 0)


def test_the_element_beam_has_no_resonance():
    assert zenith_gain(load_hamaker(), np.arange(30.0, 81.0)) == pytest.approx(1.0, abs=0.02)


def test_both_dipoles_agree_with_everybeam():
    content = json.loads((Path(__file__).parent / "everybeam_values.json").read_text())
    antenna = load_hamaker()
    assert len(content["rows"]) == 20
    for nu, zenith, angle, *values in content["rows"]:
        matrix = (np.array(values[::2]) + 1j * np.array(values[1::2])).reshape(2, 2)
        for row, arm in zip(matrix, (0.0, np.pi / 2), strict=True):
            ours = antenna.jones(np.array([nu]), np.array(zenith), np.array(angle - arm))
            # Rounding of double precision: the same polynomials.
            assert np.array(ours)[:, 0] == pytest.approx(row, abs=1e-13)


DIRECTIONS = np.array([0.2, 0.9, 1.3]), np.array([0.1, 2.0, 4.0])


def test_zenith_gain_changes_the_zenith_and_not_the_total_power():
    base = load_hamaker()
    varied = VariedAntenna(base, zenith_gain=0.1)
    gain = zenith_gain(varied, FREQUENCY) / zenith_gain(base, FREQUENCY)
    assert gain == pytest.approx(1.1, rel=1e-12)
    assert gain * beam_solid_angle(varied, FREQUENCY) == pytest.approx(beam_solid_angle(base, FREQUENCY))


def test_a_turned_arm_sees_what_the_arm_saw_further_on():
    base = load_hamaker()
    zenith, azimuth = DIRECTIONS
    turned = directional_response(VariedAntenna(base, azimuth_deg=7.0), FREQUENCY, zenith, azimuth)
    assert turned == pytest.approx(directional_response(base, FREQUENCY, zenith, azimuth - np.radians(7.0)))


def test_zenith_weighting_multiplies_by_a_power_of_the_cosine():
    base = load_hamaker()
    zenith, azimuth = DIRECTIONS
    varied = directional_response(VariedAntenna(base, zenith_exponent=0.3), FREQUENCY, zenith, azimuth)
    ratio = varied / directional_response(base, FREQUENCY, zenith, azimuth)
    assert ratio == pytest.approx(np.broadcast_to(np.cos(zenith) ** 0.3, (3, 3)))


def test_a_tilted_antenna_looks_where_it_leans():
    base = load_hamaker()
    tilted = VariedAntenna(base, tilt_deg=5.0, tilt_towards_deg=90.0)
    leaning = power_pattern(tilted, FREQUENCY, np.radians([5.0]), np.radians([90.0]))
    assert leaning == pytest.approx(power_pattern(base, FREQUENCY, np.zeros(1), np.radians([90.0])))
    away = power_pattern(tilted, FREQUENCY, np.radians([50.0]), np.radians([270.0]))
    assert away == pytest.approx(power_pattern(base, FREQUENCY, np.radians([55.0]), np.radians([270.0])))


def test_the_mean_cosine_of_an_isotropic_antenna_is_one_half():
    assert mean_cosine(IsotropicAntenna(), FREQUENCY) == pytest.approx(0.5)


ZENITH, AZIMUTH = np.meshgrid(np.linspace(0.0, 1.5, 7), np.linspace(0.0, 2 * np.pi, 9), indexing="ij")


def test_short_level_arms_over_a_conductor_are_the_short_dipole():
    short = InvertedV(arm_m=1e-3, feed_m=1.5, droop_deg=0.0, conductivity=np.inf)
    expected = directional_response(ShortDipole(1.5), FREQUENCY, ZENITH, AZIMUTH)
    # Arms of a millimetre differ from points by (k l)^2 ~ 1e-6.
    np.testing.assert_allclose(directional_response(short, FREQUENCY, ZENITH, AZIMUTH), expected, atol=1e-5)


def test_level_arms_in_free_space_have_the_pattern_of_the_textbook():
    """Balanis, eq. 4-62: [cos(k l cos psi) - cos(k l)] / sin(psi), psi the angle from the arms."""
    free = InvertedV(droop_deg=0.0, permittivity=1.0, conductivity=0.0)
    electrical = 2e6 * np.pi * FREQUENCY[:, None, None] / speed_of_light * free.arm_m
    along = np.sin(ZENITH) * np.cos(AZIMUTH)
    pattern = (np.cos(electrical * along) - np.cos(electrical)) ** 2 / np.maximum(1 - along**2, 1e-12)
    expected = pattern / (1 - np.cos(electrical)) ** 2
    np.testing.assert_allclose(directional_response(free, FREQUENCY, ZENITH, AZIMUTH), expected, rtol=1e-6)


def test_an_upright_v_sees_vertical_waves_at_the_horizon_of_a_conductor():
    """Level arms see nothing there; the arms that slope down have a vertical moment, which the ground doubles."""
    low = np.full(1, np.pi / 2 - 1e-6)
    level = InvertedV(droop_deg=0.0, conductivity=np.inf)
    sloping = InvertedV(droop_deg=45.0, conductivity=np.inf)
    along = np.zeros(1)
    assert np.all(power_pattern(level, FREQUENCY, low, along) < 1e-8)
    assert np.all(
        power_pattern(sloping, FREQUENCY, low, along) > 1e-3 * power_pattern(sloping, FREQUENCY, along, along)
    )


@pytest.mark.parametrize("name", ["inverted-v", "inverted-v-wet"])
def test_shipped_antennas_resemble_the_element_beam_and_are_not_it(name):
    own = directional_response(load_antenna(name), FREQUENCY, ZENITH, AZIMUTH)
    beam = directional_response(load_antenna("hamaker"), FREQUENCY, ZENITH, AZIMUTH)
    difference = np.abs(own - beam)[:, :5]  # to a zenith angle of 57 degrees
    assert 0.02 < difference.max() < 0.4
    assert np.all(own >= 0)
    assert np.all(directional_response(load_antenna(name), FREQUENCY, np.full(2, 1.6), np.zeros(2)) == 0)
    assert load_antenna(name).digest() != load_antenna("hamaker").digest()


NU = np.arange(30.0, 81.0)


def test_the_default_circuit_follows_the_antenna_gain_of_the_superterp():
    ratio = np.log(ResonanceCircuit().gain(NU) / load_instrument("lofar-superterp").antenna_gain)
    assert np.std(ratio) < 0.06  # 5 % as its docstring says


def test_a_longer_arm_and_a_larger_capacitance_resonate_lower():
    plain = ResonanceCircuit()
    peak = NU[plain.gain(NU).argmax()]
    assert NU[replace(plain, arm_m=1.6).gain(NU).argmax()] < peak
    assert NU[replace(plain, lna_farad=20e-12).gain(NU).argmax()] < peak


def test_the_circuit_changes_the_gain_and_not_the_response():
    plain, resonant = load_antenna("hamaker"), load_antenna("hamaker-resonant")
    directions = np.array([0.3, 1.0]), np.array([0.0, 2.0])
    assert directional_response(resonant, NU, *directions) == pytest.approx(
        directional_response(plain, NU, *directions)
    )
    expected = zenith_gain(plain, NU) * ResonanceCircuit().gain(NU)
    assert zenith_gain(resonant, NU) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("make", "changes", "said"),
    [
        (ResonanceCircuit, {"lna_ohm": 0.0}, "lna_ohm"),
        (InvertedV, {"feed_m": 0.5}, "above the ground"),
        (InvertedV, {"permittivity": 0.5}, "permittivity"),
        (VariedAntenna, {"base": load_hamaker(), "zenith_gain": 0.6}, r"zenith_gain: expected -0\.4 to 0\.4"),
    ],
)
def test_what_no_antenna_can_be_is_refused(make, changes, said):
    with pytest.raises(BadInputError, match=said):
        make(**changes)


TWO_MHZ = np.array([50.0, 120.0])
LOW_ZENITH, LOW_AZIMUTH = np.radians([[20.0, 50.0, 80.0]]), np.radians([[10.0, 130.0, 250.0]])


@pytest.mark.parametrize("tilt", [-30.0, 25.0, 90.0])
def test_a_raised_dipole_is_two_currents_above_a_mirror(tilt):
    """The sum of the fields of the dipole and its image, written with vectors."""
    up = np.radians(tilt)
    arm, image = np.array([np.cos(up), 0, np.sin(up)]), np.array([-np.cos(up), 0, np.sin(up)])
    theta, phi = raise_arm(ShortDipole(1.5), tilt).jones(TWO_MHZ, LOW_ZENITH, LOW_AZIMUTH)
    for z, a, found_theta, found_phi in zip(LOW_ZENITH[0], LOW_AZIMUTH[0], theta[:, 0].T, phi[:, 0].T, strict=True):
        e_theta = np.array([np.cos(z) * np.cos(a), np.cos(z) * np.sin(a), -np.sin(z)])
        e_phi = np.array([-np.sin(a), np.cos(a), 0.0])
        phase = 2j * np.pi * 1e6 * TWO_MHZ / speed_of_light * 1.5 * np.cos(z)
        for unit, found in ((e_theta, found_theta), (e_phi, found_phi)):
            np.testing.assert_allclose(found, unit @ arm * np.exp(phase) + unit @ image * np.exp(-phase), atol=1e-12)


def test_an_arm_upright_sees_nothing_at_zenith_and_all_azimuths_alike():
    upright = raise_arm(ShortDipole(1.5), 90.0)
    assert np.all(power_pattern(upright, TWO_MHZ, np.zeros(3), np.arange(3.0)) < 1e-25)
    around = directional_response(upright, TWO_MHZ, np.full(8, 1.2), np.arange(8.0), ShortDipole(1.5))
    np.testing.assert_allclose(around, around[:, :1] * np.ones(8))


def test_another_pattern_leans_away_from_the_raised_end_and_no_further_than_20_degrees():
    antenna = load_hamaker()
    zenith = np.zeros(1), np.full(1, np.pi)
    for one in (antenna, VariedAntenna(antenna, zenith_gain=0.1)):
        leaning = power_pattern(raise_arm(one, 10.0), TWO_MHZ, np.radians([10.0]), np.radians([180.0]))
        np.testing.assert_allclose(leaning, power_pattern(one, TWO_MHZ, *zenith))
    with pytest.raises(BadInputError, match="tilt_deg: expected -20 to 20"):
        raise_arm(antenna, 45.0)


def test_a_varied_dipole_is_raised_before_it_is_varied():
    varied = VariedAntenna(ShortDipole(1.5), zenith_exponent=0.5)
    found = power_pattern(raise_arm(varied, 60.0), TWO_MHZ, LOW_ZENITH, LOW_AZIMUTH)
    raised = power_pattern(raise_arm(ShortDipole(1.5), 60.0), TWO_MHZ, LOW_ZENITH, LOW_AZIMUTH)
    np.testing.assert_allclose(found, raised * np.cos(LOW_ZENITH) ** 0.5)
