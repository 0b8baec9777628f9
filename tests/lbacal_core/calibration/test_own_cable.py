from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.spreads import SinglePaths, carry_to_path, fit_random_effect, measure_spreads
from lbacal_core.curves.reference_chain import CableTable, ReferenceChain
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.chain import calibration_factor
from lbacal_core.simulation.simulation import Simulation, noise_at_input

AT = 1_400_000_000.0


@pytest.fixture(scope="module")
def report(scene):
    spectra = scene.spectra(np.random.default_rng(12), events=400)
    return fit_calibration(spectra, scene.simulation, "station")


@pytest.fixture(scope="module")
def answer(report):
    return report.curves[0], report.chains[0]


def test_the_reference_chain_is_the_mean_of_exactly_the_paths_with_enough_events(scene):
    spectra = scene.spectra(np.random.default_rng(13), events=200)
    is_lost = (spectra.antenna == 0) & (spectra.dipole == "X") & (np.arange(len(spectra)) % 5 > 0)
    curves = fit_calibration(spectra.select(~is_lost), scene.simulation, "station")
    of_x, of_y = curves.chains
    assert [antenna for _, antenna in of_x.members] == [1, 2, 3], "antenna 0 X has 40 events"
    assert [antenna for _, antenna in of_y.members] == [0, 1, 2, 3]
    cables = scene.instrument.cables
    np.testing.assert_allclose(of_x.mean_loss, (2 * cables["80"] + cables["50"]) / 3)
    np.testing.assert_allclose(of_y.mean_loss, (cables["80"] + cables["50"]) / 2)


@pytest.mark.parametrize(("antenna", "cable"), [(0, "50"), (1, "80")])
def test_a_path_is_told_the_curve_of_its_own_cable(scene, answer, antenna, cable):
    served = carry_to_path(*answer, "CS002", antenna, "X", AT)
    truth = calibration_factor(scene.slope(cable), scene.instrument.antenna_gain)
    assert (served.curve.station, served.curve.antenna, served.curve.dipole, served.cable) == (
        "CS002",
        antenna,
        "X",
        cable,
    )
    # 400 events: the station's curve is known to 0.5 %, its cables differ by 15-50 % in power
    assert np.max(np.abs(served.curve.c - truth) / served.curve.c_sigma_stat) < 4
    assert np.min(np.abs(answer[0].c / truth - 1)) > 0.1
    np.testing.assert_allclose(served.curve.c / answer[0].c, served.factor)
    np.testing.assert_allclose(served.curve.c_sigma_stat / served.curve.c, answer[0].c_sigma_stat / answer[0].c)


def test_the_noise_at_the_input_follows_the_cable_and_at_the_output_stays(scene, answer):
    served = carry_to_path(*answer, "CS002", 1, "X", AT)
    assert served.curve.parameters == answer[0].parameters
    slope = scene.instrument.antenna_gain / served.curve.c**2
    terms = noise_at_input(served.curve, scene.instrument)
    np.testing.assert_allclose(terms["adc"] * slope, answer[0].parameters["n_adc"].value)
    np.testing.assert_allclose(terms["lna"], answer[0].parameters["n_lna"].value)
    np.testing.assert_allclose(terms["adc"] / noise_at_input(answer[0], scene.instrument)["adc"], served.factor**2)


def test_the_error_told_holds_offset_and_spread_of_its_cable(answer):
    curve, chain = answer
    assert chain.spreads.by_cable == {}, "two paths a cable"
    served = carry_to_path(curve, chain, "CS002", 0, "X", AT)
    variance = chain.spreads.all_paths.variance
    np.testing.assert_allclose(served.curve.c_sigma_sys / served.curve.c, np.sqrt(variance) / 2)
    assert (served.flag, served.reason) == ("ok", None)


def test_another_station_is_flagged_and_without_spread_between_stations_its_error_is_unknown(answer):
    served = carry_to_path(*answer, "CS003", 0, "X", AT)
    assert (served.flag, served.curve.c_sigma_sys) == ("uncertain", None)
    assert served.reason.startswith("there are no data of CS003")
    assert "from one" in served.reason


def test_a_station_without_data_is_told_a_larger_error_by_an_array_of_two(scene):
    records = tuple(AntennaRecord("CS004", antenna, "50") for antenna in range(4))
    wider = replace(scene.instrument, antennas=(*scene.instrument.antennas, *records))
    spectra = scene.spectra(np.random.default_rng(14), events=200, stations=2)
    array = fit_calibration(spectra, Simulation(wider, scene.sky_power), "array")
    near, far = (carry_to_path(array.curves[0], array.chains[0], s, 0, "X", AT) for s in ("CS003", "CS004"))
    assert (near.flag, far.flag) == ("ok", "uncertain")
    assert far.reason == "there are no data of CS004: this is the mean of other stations"
    np.testing.assert_array_equal(near.curve.c, far.curve.c)
    assert np.all(far.curve.c_sigma_sys >= near.curve.c_sigma_sys)


def test_a_spread_that_was_not_measured_is_unknown_and_never_zero(answer):
    served = carry_to_path(answer[0], replace(answer[1], spreads=None), "CS002", 0, "X", AT)
    assert (served.flag, served.curve.c_sigma_sys) == ("uncertain", None)
    assert "too few were fitted" in served.reason


def test_without_a_known_chain_or_cable_the_stored_curve_is_told_with_a_flag(answer):
    unknown = carry_to_path(answer[0], None, "CS002", 0, "X", AT)
    absent = carry_to_path(*answer, "CS002", 77, "X", AT)
    for served in (unknown, absent):
        assert served.flag == "uncertain"
        np.testing.assert_array_equal(served.factor, 1.0)
    assert absent.reason == "its cable is not known: CS002 antenna 77 X is not on record at 2014-05-13"
    assert carry_to_path(*answer, "CS002", 77, "X", -1e11).reason.endswith("-1199-02-15")


CHANGE = AT + 1000.0
CHANGED = (AntennaRecord("CS002", 0, "50", None, CHANGE), AntennaRecord("CS002", 0, "80", CHANGE, None))


def test_the_cable_is_that_of_the_instant(scene, answer):
    cables = scene.instrument.cables
    chain = replace(answer[1], cables=CableTable(cables, CHANGED))
    before, after = (carry_to_path(answer[0], chain, "CS002", 0, "X", t) for t in (AT, CHANGE))
    np.testing.assert_allclose((after.curve.c / before.curve.c) ** 2, cables["50"] / cables["80"])


def test_a_paths_own_curve_stays_until_its_cable_is_exchanged(scene, answer):
    own = replace(answer[0], antenna=0)
    cables = scene.instrument.cables
    chain = ReferenceChain((("CS002", 0),), cables["50"], CableTable(cables, CHANGED), None)
    same, other = (carry_to_path(own, chain, "CS002", 0, "X", t) for t in (AT, CHANGE))
    assert (same.flag, same.curve) == ("ok", own)
    assert other.reason == "fitted with another cable than the 80 that the path has then"
    np.testing.assert_allclose((other.curve.c / own.c) ** 2, cables["50"] / cables["80"])


CHANNELS = 5
LOSS = {"50": np.linspace(0.5, 0.4, CHANNELS), "80": np.linspace(0.3, 0.2, CHANNELS)}


def draw_paths(rng, *, paths=400, spread=0.05, noise=0.03, offset=0.0, stations=("CS002",), between=0.0):
    """Paths alternating between two cables; those with 80 m gain `offset` more power."""
    cables = np.where(np.arange(paths) % 2 == 0, "50", "80")
    names = np.array(stations)[np.arange(paths) // 2 % len(stations)]
    of_station = dict(zip(stations, between * rng.standard_normal(len(stations)), strict=True))
    loss = np.array([LOSS[cable] for cable in cables])
    departure = spread * rng.standard_normal((paths, 1)) + offset * (cables == "80")[:, None]
    departure = departure + np.array([of_station[name] for name in names])[:, None]
    sigma = noise * loss
    slope = loss * (1 + departure) + sigma * rng.standard_normal(loss.shape)
    return SinglePaths(names, cables, slope, sigma, loss)


def measure(paths):
    mean_loss = paths.loss.mean(axis=0)
    return measure_spreads(paths, mean_loss, mean_loss)


def test_offset_and_spread_by_cable_are_those_planted_and_noise_is_not_counted():
    # 200 paths a cable: the spread is known to 5 % and a little more because of the noise
    found = measure(draw_paths(np.random.default_rng(1), offset=0.1, noise=0.05))
    assert set(found.by_cable) == {"50", "80"}
    for cable, offset in (("50", 0.0), ("80", 0.1)):
        assert found.by_cable[cable].paths == 200
        np.testing.assert_allclose(found.by_cable[cable].offset, offset, atol=0.02)
        np.testing.assert_allclose(found.by_cable[cable].spread, 0.05, rtol=0.3)
    np.testing.assert_allclose(found.all_paths.spread, np.hypot(0.05, 0.05), rtol=0.2)


def test_a_channel_without_sight_of_the_spread_has_that_of_the_band():
    paths = draw_paths(np.random.default_rng(2))
    sigma = paths.sigma.copy()
    sigma[:, -1] *= 100.0
    found = measure(replace(paths, sigma=sigma)).all_paths.spread
    assert found[-1] == pytest.approx(found[0], rel=0.3)
    assert np.all(found > 0.03)


@pytest.mark.parametrize("slope", [0.0, 1.0])
def test_the_spread_of_a_channel_is_not_too_large_on_average_and_follows_the_band(slope):
    """The larger of its own and the band's was taken: of ten paths 10 % too large on average."""
    rng, true = np.random.default_rng(9), 0.1 * np.exp(slope * np.linspace(-1.0, 1.0, 51))
    sigma = np.full((10, 51), 0.03)
    found = [fit_random_effect(rng.normal(size=(10, 51)) * np.hypot(true, sigma), sigma).spread for _ in range(100)]
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(found), axis=0)), true, rtol=0.05 if slope == 0.0 else 0.25)
    assert abs(np.sqrt(np.mean(np.square(found) / true**2)) - 1.0) < (0.03 if slope == 0.0 else 0.1)


def test_two_paths_say_nothing_and_a_cable_with_two_has_the_spread_of_all():
    rng = np.random.default_rng(3)
    assert measure(draw_paths(rng, paths=2)) is None
    few = measure(draw_paths(rng, paths=4))
    assert few.by_cable == {}
    assert few.all_paths.paths == 4


def test_a_channel_that_was_not_determined_counts_for_nothing():
    paths = draw_paths(np.random.default_rng(4))
    slope = paths.slope.copy()
    slope[::4] = np.nan
    found = measure(replace(paths, slope=slope)).all_paths
    np.testing.assert_allclose(found.spread, 0.05, rtol=0.3)


def test_stations_that_differ_are_seen_to_differ_and_those_of_few_paths_that_are_alike_are_not():
    names = tuple(f"CS{k:03d}" for k in range(40))
    alike = measure(draw_paths(np.random.default_rng(5), stations=names, paths=1600))
    unlike = measure(draw_paths(np.random.default_rng(5), stations=names, paths=1600, between=0.06))
    assert (alike.stations, unlike.stations) == (40, 40)
    # 40 stations know their spread to 11 %
    np.testing.assert_allclose(unlike.between_stations, 0.06, rtol=0.35)
    assert np.all(alike.between_stations < 0.01)
    # The mean of four paths is off by 3 % by the spread of single paths alone; 100 stations leave 1 % of it.
    hundred = tuple(f"CS{k:03d}" for k in range(100))
    few_each = measure(draw_paths(np.random.default_rng(8), stations=hundred, paths=400))
    assert np.all(few_each.between_stations < 0.02)
    assert measure(draw_paths(np.random.default_rng(5))).between_stations is None


@pytest.mark.parametrize("noise", [0.0001, 0.05, 1.0])
def test_a_random_effect_solves_its_equation(noise):
    rng = np.random.default_rng(7)
    sigma = noise * rng.uniform(0.5, 2.0, (12, 3))
    values = 0.05 * rng.standard_normal((12, 3)) + sigma * rng.standard_normal((12, 3))
    found = fit_random_effect(values, sigma)
    left = np.sum((values - found.mean) ** 2 / (found.variance + sigma**2), axis=0)
    assert np.all((np.abs(left - 11) < 1e-6) | ((found.variance == 0) & (left < 11)))
