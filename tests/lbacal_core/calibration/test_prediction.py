"""What a path should see, against what is known in closed form; `validation/prediction.py` tries it on events."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lbacal
from lbacal_core.calibration.prediction import EventNoise, _split, power_per_kelvin, predict_path
from lbacal_core.discovery.forward import predict_alone
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.names import load_sky
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.sources import point_source_power

AT = 1_398_945_600.0


@pytest.fixture(scope="module")
def found() -> lbacal.Calibration:
    return lbacal.fit(lbacal.simulate("lofar-superterp", events=200, antennas=2), "lofar-superterp")


@pytest.mark.long
def test_parts_add_to_the_power_and_a_source_of_the_sefd_doubles_it(found: lbacal.Calibration) -> None:
    curve = found.report.curves[0]
    told = predict_path(curve, found.simulation, AT)
    total = np.sum(list(told.contributions.values()), axis=0)
    slope = found.instrument.antenna_gain / np.asarray(curve.c) ** 2
    np.testing.assert_allclose(told.power, slope * total)
    source = point_source_power(told.sefd_jy, np.ones(51))
    np.testing.assert_allclose(slope * (total + source), 2.0 * told.power)
    content = told.as_dict()
    assert sum(np.array(one["fraction"]) for one in content["contributions"].values()) == pytest.approx(1.0)
    assert content["adc"]["rms"] == pytest.approx((50.0 * told.power.sum()) ** 0.5)
    with pytest.raises(BadInputError, match="a curve of one polarisation that converged"):
        predict_path(curve.as_not_converged(), found.simulation, AT)


@pytest.mark.long
def test_a_curve_of_others_says_less_of_a_path_than_its_own(found: lbacal.Calibration) -> None:
    curve = found.report.curves[0]
    assert curve.covariance is not None
    spread = replace(curve, covariance=curve.covariance.with_own(np.full(51, 0.03)))
    own, others = (predict_path(spread, found.simulation, AT, is_own=is_own) for is_own in (True, False))
    assert np.all(np.diag(own.covariance()) < np.diag(others.covariance()))
    in_front = others.contributions["sky"] + others.contributions["lna"]
    expected = 2 * 0.03 * in_front / np.sum(list(others.contributions.values()), axis=0)
    np.testing.assert_array_less(expected, np.linalg.norm(others.errors, axis=0) + 1e-12)


@pytest.fixture
def dipole(low_band: Instrument) -> Instrument:
    return replace(low_band, antenna="short-dipole", sky="gsm")


def test_1_kelvin_adds_what_an_isotropic_sky_does(dipole: Instrument) -> None:
    plain, letter = load_sky("gsm"), dipole.dipoles[0]
    added = plain.changed(extra_isotropic=1.0)
    monopole = (added.temperature(dipole.frequency_mhz) - plain.temperature(dipole.frequency_mhz))[:, 0, 0].real
    seen = compute_sky_power(dipole, added).power[letter][0] - compute_sky_power(dipole, plain).power[letter][0]
    expected = power_per_kelvin(dipole, letter) * monopole / np.sqrt(4.0 * np.pi)
    np.testing.assert_allclose(seen, expected, rtol=1e-3)  # of the multipoles that the sky integral keeps


def test_the_sky_of_a_model_has_its_mean_temperature(dipole: Instrument) -> None:
    simulation = Simulation(dipole)
    record = dipole.antennas[0]
    told = predict_alone(simulation, record.station, record.antenna, dipole.dipoles[0], AT)
    kelvin = told.contributions["sky"] / told.per_kelvin
    at_55 = kelvin[np.argmin(np.abs(dipole.frequency_mhz - 55.0))]
    assert 2000 < at_55 < 9000  # K, from the coldest to the brightest hour of the Galaxy
    assert told.as_dict()["adc"] is None
    assert "n_lna" in told.notes[0]


def test_drawn_events_have_the_covariance_that_they_are_drawn_with() -> None:
    noise = EventNoise(np.array([[0.05, 0.04, 0.03]]), np.array([0.002, 0.001, 0.0]), "a test")
    drawn = noise.draw(40_000, np.random.default_rng(2))
    np.testing.assert_allclose(drawn.mean(axis=0), 1.0, atol=1e-3)
    np.testing.assert_allclose(np.cov(drawn, rowvar=False), noise.covariance(), atol=6e-5)


def test_events_of_other_stations_are_drawn_apart() -> None:
    here, there = (
        lbacal.predict("lofar-superterp", at="2014-05-01", station=name, antenna=1, dipole="X")
        for name in ("CS002", "CS003")
    )
    one, same, other = (events.mean(axis=1) for events in lbacal.draw_together([here, here, there], 20_000))
    assert np.corrcoef(one, same)[0, 1] == pytest.approx(0.36, abs=0.04)  # 0.01 by so many, less the radiometer noise
    assert np.corrcoef(one, other)[0, 1] == pytest.approx(0.0, abs=0.04)


@pytest.mark.parametrize(("variance", "is_shared"), [(2.15, False), (2.35, True), (9.0, True)])
def test_channels_share_what_is_beyond_the_largest_variance_of_independent_noise(
    variance: float, is_shared: bool
) -> None:
    channels, events = 50, 200  # (1 + (50 / 200)^1/2)^2 = 2.25
    axis = np.full(channels, -(channels**-0.5))
    shared, own = _split(np.eye(channels) + (variance - 1.0) * np.outer(axis, axis), events)
    assert len(shared) == is_shared
    np.testing.assert_allclose(own, 1.0 + (0.0 if is_shared else (variance - 1.0) / channels))
    if is_shared:
        np.testing.assert_allclose(shared[0], -axis * (variance - 1.0) ** 0.5)
