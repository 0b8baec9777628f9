import numpy as np
import pytest

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.lofar import load_hamaker
from lbacal_core.antenna.model import AntennaModel
from lbacal_core.antenna.unfolding import jones_matrix, unfold_field
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import load_instrument

FREQUENCY = np.arange(30.0, 81.0)
ARMS = {"X": 45.0, "Y": 135.0}
GAIN = 1.0 + 4.0 / (1.0 + ((FREQUENCY - 58.0) / 4.0) ** 2)
DIRECTIONS = [(0.0, 0.0), (10.0, 200.0), (45.0, 90.0), (60.0, 45.0), (75.0, 312.0)]


def matrix(zenith_deg: float, azimuth_deg: float, antenna: AntennaModel | None = None) -> np.ndarray:
    return jones_matrix(antenna or load_hamaker(), GAIN, ARMS, FREQUENCY, zenith_deg, azimuth_deg)


def fields(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.normal(size=(*shape, 2, FREQUENCY.size)) + 1j * rng.normal(size=(*shape, 2, FREQUENCY.size))


@pytest.mark.parametrize(("zenith_deg", "azimuth_deg"), DIRECTIONS)
def test_a_field_folded_and_unfolded_is_the_field(zenith_deg, azimuth_deg):
    jones, field = matrix(zenith_deg, azimuth_deg), fields(np.random.default_rng(1))
    voltage = np.einsum("fij,jf->if", jones, field)
    found = unfold_field(FREQUENCY, voltage, jones)
    assert found.field == pytest.approx(field, rel=1e-9)
    assert not np.any(found.is_degenerate)
    assert np.all(found.covariance == 0)


def test_at_the_zenith_a_field_along_an_arm_is_seen_by_that_dipole_alone():
    # from the zenith at azimuth 45 deg, increasing zenith angle points along the X arm and increasing azimuth along Y's
    jones = matrix(0.0, 45.0)
    assert np.abs(jones[:, 0, 0]) ** 2 == pytest.approx(GAIN, rel=0.01)
    assert np.all(np.abs(jones[:, 0, 1]) < 1e-9 * np.sqrt(GAIN))
    assert np.all(np.abs(jones[:, 1, 0]) < 1e-9 * np.sqrt(GAIN))
    assert np.abs(jones[:, 1, 1]) ** 2 == pytest.approx(GAIN, rel=0.01)


def test_turning_antenna_and_wave_together_changes_nothing():
    turned = jones_matrix(load_hamaker(), GAIN, {"X": 75.0, "Y": 165.0}, FREQUENCY, 40.0, 130.0)
    assert turned == pytest.approx(matrix(40.0, 100.0), rel=1e-12)


def test_four_times_the_gain_halves_the_field():
    jones, voltage = matrix(30.0, 10.0), fields(np.random.default_rng(2))
    doubled = jones_matrix(load_hamaker(), 4 * GAIN, ARMS, FREQUENCY, 30.0, 10.0)
    once, twice = (unfold_field(FREQUENCY, voltage, one).field for one in (jones, doubled))
    assert twice == pytest.approx(once / 2)


def test_parallel_dipoles_do_not_determine_the_field_and_say_so():
    parallel = jones_matrix(load_hamaker(), GAIN, {"X": 45.0, "Y": 45.0}, FREQUENCY, 30.0, 10.0)
    found = unfold_field(FREQUENCY, fields(np.random.default_rng(3)), parallel)
    assert np.all(found.is_degenerate)
    assert np.all(np.isinf(found.condition) | (found.condition > 1e8))


def test_nearly_horizontal_waves_are_nearly_degenerate():
    dipole = ShortDipole(height_m=1.5)
    # over a conducting plane the response to E_theta falls as cos(zenith angle) against that to E_phi
    for zenith_deg, is_degenerate in ((60.0, False), (87.0, True)):
        found = unfold_field(FREQUENCY, fields(np.random.default_rng(4)), matrix(zenith_deg, 45.0, dipole))
        assert found.condition == pytest.approx(np.full(51, 1 / np.cos(np.radians(zenith_deg))))
        assert np.all(found.is_degenerate == is_degenerate)


@pytest.mark.parametrize(("zenith_deg", "azimuth_deg"), DIRECTIONS)
def test_errors_cover_the_truth(zenith_deg, azimuth_deg):
    rng = np.random.default_rng(6)
    jones = matrix(zenith_deg, azimuth_deg)
    truth = fields(rng) * np.array([[1.0], [0.4]])
    clean = np.einsum("fij,jf->if", jones, truth)
    variance = np.stack([np.full(51, 0.02), np.linspace(0.05, 0.01, 51)])
    # two errors of single curves and one that both share
    factors = np.zeros((3, 2, 51))
    factors[0, 0], factors[1, 1], factors[2] = 0.03, 0.04, 0.06
    trials = 2000
    pulls, shared = np.empty((trials, 2, 51)), np.empty(trials)
    for k in range(trials):
        noise = np.sqrt(variance / 2) * fields(rng)
        wrong = np.exp(np.einsum("k,kif->if", rng.normal(size=3), factors))
        found = unfold_field(FREQUENCY, (clean + noise) * wrong, jones, variance, factors)
        error = found.field - truth
        pulls[k] = np.abs(error) / found.sigma
        covariance = found.covariance[20]
        shared[k] = (error[:, 20].conj() @ np.linalg.solve(covariance, error[:, 20])).real
    # mean |error|^2 is the variance, and the two components with their covariance give 2 on average
    assert np.mean(pulls**2) == pytest.approx(1.0, abs=0.06)
    assert np.mean(shared) == pytest.approx(2.0, abs=0.2)


def test_a_direction_below_the_horizon_and_unequal_shapes_are_refused():
    with pytest.raises(BadInputError, match="horizon"):
        matrix(90.0, 0.0)
    with pytest.raises(BadInputError, match="voltage"):
        unfold_field(FREQUENCY, np.zeros((2, 50), dtype=complex), matrix(0.0, 0.0))


def test_two_dipoles_on_one_arm_are_degenerate_in_every_direction_and_raise_nothing():
    # zenith 52.4, azimuth 80.2 deg was a LinAlgError: rounding left a smallest singular value of a few 1e-16
    voltage = np.ones((2, FREQUENCY.size), dtype=complex)
    gain = load_instrument("lofar-superterp").antenna_gain
    rng = np.random.default_rng(2)
    directions = [(52.40373413002243, 80.16466953206078), *rng.uniform((0, 0), (85, 360), (60, 2)).tolist()]
    for zenith, azimuth in directions:
        one_arm = dict.fromkeys(("X", "Y"), 45.0)
        jones = jones_matrix(load_hamaker(), gain, one_arm, FREQUENCY, zenith, azimuth)
        found = unfold_field(FREQUENCY, voltage, jones)
        assert np.all(found.is_degenerate)
        assert np.all(np.isinf(found.condition))
