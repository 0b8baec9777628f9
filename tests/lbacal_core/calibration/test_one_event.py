from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.budget import electronics_sigma
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.one_event import (
    ErrorOfC,
    compare_paths,
    map_departures,
    measure_error,
    measure_event_gains,
)
from lbacal_core.curves.curves import CalibrationCurve, Parameter
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.simulation.prior import list_changes
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.spectra.blocks import SpectraBlock
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

INSTRUMENT = load_instrument("lofar-superterp")
SKY = compute_sky_power(INSTRUMENT)
OWN = Simulation(INSTRUMENT, SKY)


def draw(seed, **settings):
    drawn = TwinSettings(stations=("CS002",), **settings)
    return simulate_campaign(drawn, INSTRUMENT, SKY, np.random.default_rng(seed)).spectra


@pytest.mark.parametrize("scope", ["antenna", "station", "array"])
@pytest.mark.parametrize(("common", "own"), [(0.03, 0.04), (0.0, 0.01)])
def test_the_gain_of_events_is_the_planted_one(scope, common, own):
    spectra = draw(2, antennas=6, events_per_year=600, event_gain_common=common, event_gain_path=own)
    curves = fit_calibration(spectra, OWN, scope).curves
    gains = np.array(list(measure_event_gains(curves, spectra, OWN).values()))
    assert gains.size == 12
    # 600 events know a spread to 3 %, and twelve paths share the common part. A path whose cable differs from the
    # mean's has another share of the sky, so that its ratio to the mean's prediction varies with LST by a per cent
    beside = 0.0 if scope == "antenna" else 0.01
    planted = np.hypot(common, own)
    assert 0.88 * planted < np.median(gains) < 1.12 * np.hypot(planted, beside)


def test_one_event_on_one_antenna_is_worse_known_than_the_mean():
    spectra = draw(4, antennas=8, events_per_year=500)
    own, mean = (measure_error(fit_calibration(spectra, OWN, one), spectra, OWN) for one in ("antenna", "station"))
    assert own.antenna == 0.0
    assert 0.005 < mean.antenna < 0.05
    assert mean.statistical < own.statistical
    for error in (own, mean):
        # 5 % of power is 2.5 % of C
        assert error.event == pytest.approx(0.025, rel=0.12)
        assert error.of_one_event == pytest.approx(
            np.sqrt(error.statistical**2 + error.systematic**2 + error.antenna**2 + error.event**2)
        )
        assert error.of_one_event > error.of_mean


def test_without_a_curve_there_is_no_error():
    spectra = draw(4, antennas=2, events_per_year=30)
    assert measure_error(fit_calibration(spectra, OWN, "antenna"), spectra, OWN) is None


def test_what_is_not_known_is_not_taken_for_zero():
    assert np.isnan(ErrorOfC(0.01, 0.1, 0.0, np.nan).of_one_event)
    assert np.isnan(ErrorOfC(0.01, 0.1, np.nan, 0.02).of_one_event)
    assert ErrorOfC(0.03, 0.04, 0.0, np.nan).of_mean == pytest.approx(0.05)


def test_the_papers_budget_holds_the_papers_terms():
    sizes = {change.name: float(np.mean(change.d_ln_p["X"])) for change in list_changes(INSTRUMENT, "paper")[:3]}
    assert sizes == pytest.approx({"scale of the sky maps": 0.2, "fit of the maps": 0.1, "choice of the map": 0.05})
    assert list_changes(INSTRUMENT, "paper")[-1].name == "antenna pattern"


@pytest.mark.parametrize("name", ["paper", "models", "measured"])
def test_every_change_is_finite_and_smaller_than_the_sky(name):
    for change in list_changes(INSTRUMENT, name):
        for values in change.d_ln_p.values():
            assert values.shape == (change.lst_hours.size, INSTRUMENT.frequency_mhz.size)
            assert np.max(np.abs(values)) < 0.5


def test_the_pattern_changes_the_power_along_lst_and_the_ground_is_largest_when_the_sky_is_cold():
    of_name = {change.name: change for change in list_changes(INSTRUMENT, "models")}
    assert np.ptp(of_name["antenna pattern"].d_ln_p["X"][:, 25]) > 0.01
    ground = of_name["ground and losses"].d_ln_p["X"][:, 25]
    assert 0.005 < ground.min() < 0.017 < ground.max() < 0.04


def test_where_no_model_reaches_the_channels_the_level_of_the_sky_is_left():
    high = replace(INSTRUMENT, frequency_mhz=INSTRUMENT.frequency_mhz + 400.0)
    (change,) = list_changes(high, "models")
    assert float(change.d_ln_p["X"][0, 0]) == pytest.approx(0.229, abs=0.001)
    with pytest.raises(BadInputError):  # the error of a sky that was asked for, and is not there
        list_changes(high, "measured")


def test_beyond_the_default_sky_the_wide_skies_differ():
    """At 50-350 MHz the budget of the models was the level of the paper alone, as if no model reached."""
    channels = INSTRUMENT.frequency_mhz * 6.0 - 130.0
    wide = replace(INSTRUMENT, frequency_mhz=channels, antenna="quarter-wave", sky=None)
    changes = {change.name: change for change in list_changes(wide, "models")}
    shapes = [f"spectrum and LST shape ({name})" for name in ("haslam-wide", "lfsm-wide")]
    assert set(changes) == {"level of the sky", *shapes, "antenna pattern", "ground and losses"}
    rms = [float(np.sqrt(np.mean(np.square(changes[name].d_ln_p["X"])))) for name in shapes]
    assert 0.01 < min(rms) < max(rms) < 0.15
    assert len(list_changes(wide, "paper")) == 4


FREQUENCY = np.arange(30.0, 81.0)
EVENTS = 400


def curve(antenna: int | None, station: str | None = "CS002", dipole: str = "X") -> CalibrationCurve:
    parameters = {name: Parameter(value, 0.0) for name, value in (("n_lna", 0.3), ("n_rcu", 0.7), ("n_adc", 0.1))}
    c = np.full(51, 0.5)
    return CalibrationCurve(station, antenna, dipole, "converged", 900, FREQUENCY, c, 0.01 * c, None, 1, 1, parameters)


def block(simulation: Simulation, gains: tuple[float, float]) -> SpectraBlock:
    """Two antennas whose power is that of the curve times a gain; the second lacks every other event."""
    time_unix = 1.4e9 + np.sort(np.random.default_rng(1).uniform(0, 3e7, EVENTS))
    instrument, sky = simulation.instrument, simulation.sky_at("CS002", "X", time_unix)
    slope = instrument.antenna_gain / 0.25
    power = (sky + 0.3) * slope + 0.7 * instrument.receiver_gain + 0.1
    is_present = np.ones((2, EVENTS), dtype=bool)
    is_present[1, ::2] = False
    return SpectraBlock(
        "CS002", "X", FREQUENCY, np.array([4, 9]), np.array([f"E{k}" for k in range(EVENTS)]), time_unix,
        np.stack([gains[0] * power, gains[1] * power]), is_present, np.where(is_present, 100, 0),
    )  # fmt: skip


@pytest.fixture
def simulation(low_band, two_waves):
    return Simulation(low_band, two_waves)


def test_a_path_is_compared_with_the_narrowest_curve_that_answers(simulation):
    seen = block(simulation, (1.0, 1.1))
    curves = [curve(4), curve(None), curve(None, station=None), curve(9, dipole="Y"), curve(4, station="CS003")]
    found = {row: (one.antenna, ratio) for row, one, ratio in compare_paths(seen, curves, simulation)}
    assert {row: antenna for row, (antenna, _) in found.items()} == {0: 4, 1: None}
    assert found[0][1] == pytest.approx(np.ones((EVENTS, 51)))
    assert found[1][1] == pytest.approx(np.full((EVENTS // 2, 51), 1.1))
    assert list(compare_paths(seen, [curve(9, dipole="Y")], simulation)) == []


def test_the_map_shows_what_was_added_and_nothing_else(simulation):
    plain, curves = block(simulation, (1.02, 1.1)), [curve(4), curve(9)]
    lst = local_sidereal_time(plain.time_unix, simulation.instrument.longitude_deg)
    power = plain.power.copy()
    power[:, (lst >= 6.0) & (lst < 6.5), 20] *= 1.3
    before, after = (map_departures(one, curves, simulation) for one in (plain, replace(plain, power=power)))
    assert before.shape == (48, 51)
    assert np.nanmean(before) == pytest.approx((0.02 * 2 + 0.1) / 3, abs=0.005)
    difference = after - before
    assert difference[12, 20] == pytest.approx(0.3 * (1 + before[12, 20]))
    difference[12, 20] = 0.0
    assert np.nanmax(np.abs(difference)) == 0.0


def test_the_gain_of_a_path_is_no_departure_from_its_stations_curve(simulation):
    seen = block(simulation, (0.9, 1.1))
    found = map_departures(seen, [curve(None)], simulation)
    assert np.nanmax(np.abs(found)) < 1e-12
    assert found.shape == (48, 51)


def test_what_the_sky_is_given_too_much_the_electronics_get_too_little(simulation, low_band, two_waves):
    slope = 2.0 * low_band.antenna_gain
    c = np.sqrt(low_band.antenna_gain / slope)
    frequency = low_band.frequency_mhz
    curve = CalibrationCurve("CS002", 0, "X", "converged", 900, frequency, c, 0.01 * c, None, 1.0, 1.0, {})
    # C is 1 % larger, so the sky's part is 2 % smaller, and the mean recorded power is as it was
    sky = two_waves.power["X"].mean(axis=0)
    assert electronics_sigma(curve, simulation) == pytest.approx(0.02 * slope * sky)
    with pytest.raises(BadInputError, match="statistical"):
        electronics_sigma(replace(curve, c_sigma_stat=None), simulation)
