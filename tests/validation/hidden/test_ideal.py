from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.table import SkyPower
from lbacal_twin.campaign import draw_stations, expected_power, simulate_campaign
from lbacal_twin.faults.fault import Fault, Where
from lbacal_twin.faults.hardware import AdcJitter, CableLength, CableReflection, Compression, GainStep, GainTemperature
from lbacal_twin.gains import BEHIND_EVERYTHING, NOISES, EventGains, shift_resonance
from lbacal_twin.nuisances import NONE, Nuisances
from lbacal_twin.settings import TwinSettings
from validation.hidden.ideal import IdealDetector, ideal_detector
from validation.hidden.noise import count_blocks

SETTINGS = TwinSettings(stations=("CS002",), antennas=3, events_per_year=30, fewest_blocks=50, most_blocks=150)
HARD = Nuisances(
    missing=0.1, dead_antennas=1, noisy_stations=("CS002",), noise_factor=1.4, departures=0.01, sky_correlation=0.05
)


@pytest.fixture
def few_channels(low_band: Instrument) -> Instrument:
    return replace(
        low_band,
        frequency_mhz=low_band.frequency_mhz[::8],
        antenna_gain=low_band.antenna_gain[::8],
        receiver_gain=low_band.receiver_gain[::8],
        cables={name: loss[::8] for name, loss in low_band.cables.items()},
    )


@pytest.fixture
def thin_sky(two_waves: SkyPower) -> SkyPower:
    return SkyPower(
        two_waves.frequency_mhz[::8], two_waves.lst_hours, {k: v[:, ::8] for k, v in two_waves.power.items()}, "thin"
    )


def _detector(
    instrument: Instrument,
    sky: SkyPower,
    nuisances: Nuisances = NONE,
    gains: EventGains = BEHIND_EVERYTHING,
    modes: np.ndarray | None = None,
    settings: TwinSettings = SETTINGS,
) -> IdealDetector:
    spectra = simulate_campaign(settings, instrument, sky, np.random.default_rng(3), (), nuisances).spectra
    (station,), _ = draw_stations(settings, instrument, sky, np.random.default_rng(3), nuisances)
    return ideal_detector(settings, nuisances, station, spectra, gains, modes)


SIX = TwinSettings(stations=("CS002",), antennas=6, events_per_year=200)


@pytest.fixture
def alike(low_band: Instrument) -> Instrument:
    return replace(low_band, antennas=[AntennaRecord("CS002", a, "80") for a in range(6)])


@pytest.mark.parametrize(
    ("nuisances", "noise", "has_modes"),
    [
        (NONE, "behind", False),
        (HARD, "behind", False),
        (HARD, "front", True),
        (NONE, "station in front", False),
        (HARD, "resonance of paths", False),
        (NONE, "wetness", True),
    ],
)
def test_it_is_the_dense_generalised_least_squares_of_the_same_data(
    few_channels, thin_sky, nuisances, noise, has_modes
) -> None:
    """Covariance written out number by number, the derivatives of the power by differences."""
    gains = NOISES[noise]
    events = SETTINGS.events_per_year
    modes = 0.1 * np.random.default_rng(1).normal(size=(3, 2, events, 7)) if has_modes else None
    detector = _detector(few_channels, thin_sky, nuisances, gains=gains, modes=modes)
    scene, stages = detector.station.scene, detector.station.stages
    spectra = simulate_campaign(SETTINGS, few_channels, thin_sky, np.random.default_rng(3), (), nuisances).spectra
    blocks = count_blocks(spectra, scene)
    power = expected_power(stages, scene, ())
    antennas, dipoles, _, channels = power.shape
    place = np.array([k for k in np.ndindex(antennas * dipoles, events, channels) if blocks[k[0], k[1]] > 0])
    path, event, channel = place.T
    factor = nuisances.noise_factor if nuisances.noisy_stations else 1.0
    same_event = event[:, None] == event
    same_channel = same_event & (channel[:, None] == channel)
    same_path = path[:, None] == path
    radiometer = SETTINGS.radiometer * np.sqrt(100.0 / blocks[path, event])
    product = radiometer[:, None] * radiometer
    c = nuisances.sky_correlation
    covariance = same_channel * same_path * (1 - c) * product
    covariance += same_channel * (path[:, None] % 2 == path % 2) * c * product
    behind, before = gains.behind(SETTINGS), gains.before_receiver(SETTINGS)
    covariance += same_event * (behind.event_gain_common**2 + same_path * behind.event_gain_path**2)
    covariance *= factor**2

    def seen(**changed: np.ndarray) -> np.ndarray:
        change = expected_power(replace(stages, **changed), scene, ()) / power - 1.0
        return change.reshape(-1, *power.shape[2:])[path, event, channel] / 1e-5

    front = seen(gain=stages.gain * (1 + 1e-5))
    shift = np.full((1, 1, len(scene.time_unix), 1), 1e-5) * gains.jitters_at(scene)
    moved = seen(antenna=shift_resonance(stages.antenna, scene.frequency_mhz, shift))
    covariance += same_event * np.outer(front, front) * (before[0] ** 2 + same_path * before[1] ** 2)
    jitter = gains.common_jitter_mhz**2 + same_path * gains.path_jitter_mhz**2
    covariance += same_event * np.outer(moved, moved) * jitter
    if modes is not None:  # a mode of known size is noise of that size
        sky = seen(sky=stages.sky * (1 + 1e-5))
        known = modes[:, path % 2, event, channel] * sky
        covariance += known.T @ known
    columns = []
    shape = (antennas, dipoles, events, channels)
    for name in ("antenna", "lna_noise", "rcu_noise", "adc_noise"):
        stage = np.broadcast_to(getattr(stages, name), shape).copy()
        for p in range(antennas * dipoles):
            for f in range(channels) if name == "antenna" else [slice(None)]:
                moved = stage.copy().reshape(-1, events, channels)
                moved[p, :, f] *= 1.001
                changed = expected_power(replace(stages, **{name: moved.reshape(shape)}), scene, ())
                column = (changed / power - 1.0).reshape(-1, events, channels)[path, event, channel]
                columns.append(column / max(np.linalg.norm(column), 1e-300))
    free = np.linalg.qr(np.linalg.solve(np.linalg.cholesky(covariance), np.array(columns).T))[0]
    faults = [GainTemperature(size=0.01), GainStep(size=0.02, date="2014-06-01", where=Where(antennas=(1,)))]
    templates = np.stack([detector.template([fault]) for fault in faults])
    white = np.linalg.solve(np.linalg.cholesky(covariance), templates[:, path, event, channel].T)
    white -= free @ (free.T @ white)
    # Differences of 1e-3 of a stage are the derivative to 1e-3 times its curvature, which is none: power is linear.
    np.testing.assert_allclose(detector.information(templates), white.T @ white, rtol=1e-6)


def test_a_gain_step_of_one_path_has_the_textbook_signal_to_noise(low_band: Instrument, two_waves: SkyPower) -> None:
    """Flat in frequency: the step of a mean, with the event gain's error and a little of the radiometer's."""
    settings = TwinSettings(stations=("CS002",), antennas=1, events_per_year=400, event_gain_common=0.0)
    spectra = simulate_campaign(settings, low_band, two_waves, np.random.default_rng(1)).spectra
    (station,), _ = draw_stations(settings, low_band, two_waves, np.random.default_rng(1))
    none = np.zeros((1, 1, 1, 1))
    front_alone = replace(station, stages=replace(station.stages, rcu_noise=none, adc_noise=none))
    detector = ideal_detector(settings, NONE, front_alone, spectra)
    step = GainStep(size=0.01, date="2014-07-02", where=Where(antennas=(0,), dipoles=("X",)))
    after = np.mean(station.scene.time_unix >= 1_404_259_200)
    variance = settings.event_gain_path**2 + settings.radiometer**2 / 51
    textbook = 0.01 * np.sqrt(400 * after * (1 - after) / variance)
    # LST and date of 400 events are correlated by about 1/20 for each of the few functions of LST that are free.
    assert detector.snr([step]) == pytest.approx(textbook, rel=0.01)


def test_a_static_gain_is_absorbed_but_shows_against_other_antennas(alike: Instrument, two_waves: SkyPower) -> None:
    detector = _detector(alike, two_waves, settings=SIX)
    longer = CableLength(size=5.0, where=Where(antennas=(2,)))
    assert detector.snr([longer]) < 1e-3
    snr = detector.snr_against_others(longer)
    assert snr > 1.0
    twice = replace(longer, size=10.0)
    assert detector.snr_against_others(twice) == pytest.approx(2 * snr, rel=1e-6)
    ripple = CableReflection(size=0.01, delay_us=0.4, where=Where(antennas=(2,)))
    # Each channel of the mean of two dipoles is known to about 0.04 / sqrt(2 x 200 x the sky's share of the scatter).
    assert 1.0 < detector.snr_against_others(ripple) < 60.0


def test_a_cable_name_shows_against_the_others_and_a_free_sky_hides_some_of_it(
    low_band: Instrument, two_waves: SkyPower
) -> None:
    named = replace(low_band, antennas=[AntennaRecord("CS002", a, "80" if a % 2 else "50") for a in range(6)])
    bend = np.linspace(-0.1, 0.1, 51) * np.ones((1, 2, 200, 1))
    told, free = (_detector(named, two_waves, modes=modes, settings=SIX) for modes in (None, bend))
    longer = CableLength(size=5.0, where=Where(cables=("50",)))
    assert told.snr_against_others(longer) > free.snr_against_others(longer) > 0.1
    shorter = CableLength(size=-5.0, where=Where(cables=("80",)))
    assert told.snr_against_others(shorter) == pytest.approx(told.snr_against_others(longer), rel=1e-6)


def test_what_paths_depart_by_hides_a_static_fault_and_no_other(alike: Instrument, two_waves: SkyPower) -> None:
    snr = {}
    for size in (0.0, 0.02):
        detector = _detector(alike, two_waves, replace(NONE, departures=size), settings=SIX)
        longer = CableLength(size=5.0, where=Where(antennas=(2,)))
        snr[size] = detector.snr_against_others(longer), detector.snr([GainTemperature(size=0.01)])
    assert snr[0.02][0] < 0.7 * snr[0.0][0]
    assert snr[0.02][1] == pytest.approx(snr[0.0][1], rel=0.05)


def test_what_the_fit_leaves_free_has_no_chi_squared_however_large(low_band: Instrument, two_waves: SkyPower) -> None:
    """Three tenths of gain along frequency and of every noise: bent far beyond the first derivative."""
    detector = _detector(low_band, two_waves)
    stages, scene = detector.station.stages, detector.station.scene
    bent = replace(
        stages,
        antenna=stages.antenna * (1 + 0.3 * np.cos(scene.frequency_mhz / 3.0)),
        lna_noise=1.3 * stages.lna_noise,
        rcu_noise=0.7 * stages.rcu_noise,
        adc_noise=1.3 * stages.adc_noise,
    )
    power = expected_power(bent, scene, ()).reshape(detector.power(()).shape)
    linear = detector.information((power / detector.power(()) - 1.0)[None])[0, 0]
    assert linear > 10.0
    assert detector.chi_squared(power) < 0.02 * linear


@pytest.mark.parametrize(("fault", "overstated"), [(Compression(size=0.5), 1.2), (AdcJitter(size=0.5), 2.0)])
def test_a_large_fault_has_the_chi_squared_that_is_left_beside_the_best_of_all_chains(
    few_channels: Instrument, thin_sky: SkyPower, fault: Fault, overstated: float
) -> None:
    """The best chain found by `scipy`; of one of Newton's steps, or about the true chain, more would be left."""
    detector = _detector(few_channels, thin_sky, NONE)
    chains, power = detector.chains, detector.power([fault])
    unit = np.eye(power.size).reshape(-1, *power.shape)
    root = np.linalg.cholesky(detector.noise.weigh(unit).reshape(power.size, -1)).T
    channels, paths = power.shape[2], len(power)

    def left(factors: np.ndarray) -> np.ndarray:
        free = np.exp(factors).reshape(paths, channels + 3)
        n_lna, n_rcu, n_adc = (free[:, channels + k, None, None] for k in range(3))
        front = chains.front * free[:, None, :channels]
        before = (chains.sky + chains.n_lna * n_lna) * front
        now = before + chains.n_rcu * n_rcu * chains.receiver + chains.n_adc * n_adc
        return np.asarray(root @ (power / now - 1.0).ravel())

    best = least_squares(left, np.zeros(paths * (channels + 3)), xtol=1e-12, ftol=1e-12)
    assert detector.chi_squared(power) == pytest.approx(2 * best.cost, rel=0.02)
    assert detector.left_of(power) > overstated * 2 * best.cost


def test_two_faults_share_what_they_have_in_common(low_band: Instrument, two_waves: SkyPower) -> None:
    detector = _detector(low_band, two_waves)
    faults = [GainTemperature(size=0.01), GainTemperature(size=0.01, delay_h=3.0)]
    together = detector.information_together(faults)
    alone = detector.information(np.stack([detector.template([one]) for one in faults]))
    # Small faults: what one adds to the other is its own template, but for products of 1 %.
    np.testing.assert_allclose(together, alone, rtol=0.05)
    assert 1 / np.linalg.inv(together)[0, 0] < 0.9 * together[0, 0]
