from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.spectra.screening import FEWEST_EVENTS
from lbacal_core.spectra.spectra import Spectra
from lbacal_core.traces.assembly import find_anomalous_spectra
from lbacal_core.traces.background import CleaningSettings, bin_spectrum, measure_background, measure_traces
from lbacal_core.traces.density import channel_frequencies, density_per_square, transform_in_place
from lbacal_core.traces.selection import find_keyed_blocks, select_background
from lbacal_core.traces.trace import Trace, group_traces, list_traces
from lbacal_twin.voltages import Shower, Transmitter

MakeTrace = Callable[..., Trace]
SETTINGS = CleaningSettings()
CHANNELS = channel_frequencies(1024, 200e6)


def measure_one(trace, settings=SETTINGS):
    (found,) = measure_traces([trace], settings, is_station=False)
    return found


def test_white_noise_gives_its_density_over_the_resistance(make_trace):
    found, half = (measure_one(make_trace(1), one) for one in (SETTINGS, CleaningSettings(resistance_ohm=100.0)))
    assert found.blocks == 400
    assert found.excluded == ""
    assert np.mean(found.power) == pytest.approx((4.0 + 1 / 1200) / 50, rel=0.015)  # 2.9 % / sqrt(51), 3 sigma
    assert np.allclose(2 * half.power, found.power)


def test_a_channel_by_itself_is_as_wide_as_each_of_the_band(make_trace):
    trace, alone = make_trace(1), CleaningSettings(frequency_mhz=np.array([55.0]))
    assert (alone.width_mhz, SETTINGS.width_mhz) == (1.0, 1.0)
    assert CleaningSettings(frequency_mhz=np.arange(30.0, 80.0, 0.5)).width_mhz == 0.5
    ((one,), of_band) = (measure_one(trace, settings).power for settings in (alone, SETTINGS))
    assert one == pytest.approx(of_band[25])


def test_a_carrier_of_blocks_that_are_in_no_segment_is_left_out(make_trace):
    """The fine search sees consecutive blocks only; the last 80 of these 400 stand alone."""
    noise, spoilt = make_trace(3), make_trace(3)
    time = np.arange(80 * 1024) / 200e6
    carrier = np.rint(2.0 * np.cos(2 * np.pi * 45.03e6 * time)).astype(np.int16).reshape(80, 1024)
    samples = np.concatenate([spoilt.samples[:320], spoilt.samples[320:] + carrier])
    position = noise.position.copy()
    position[320:] += 2 * np.arange(80)
    alone, found = (measure_one(replace(noise, samples=s, position=position)) for s in (noise.samples, samples))
    near = np.abs(found.channel_mhz - 45.03) < 0.3
    assert found.blocks == alone.blocks == 400
    assert np.any(found.is_flagged[near])
    assert not np.any(alone.is_flagged[near])
    assert found.line_mhz.size == 0
    assert found.power[15] == pytest.approx(alone.power[15], rel=0.03)  # some channels less: 2 % of noise


def test_what_a_carrier_leaks_into_far_bins_is_subtracted(make_trace):
    """The same noise with a carrier and without: its feet three bins away are 0.4 % of the noise there."""
    change = []
    for seed in range(8):
        noise = make_trace(seed)
        time = np.arange(noise.samples.size) / 200e6
        carrier = np.rint(1000.0 * np.cos(2 * np.pi * 45.03e6 * time)).astype(np.int16)
        spoilt = replace(noise, samples=noise.samples + carrier.reshape(noise.samples.shape))
        alone, found = (measure_one(one) for one in (noise, spoilt))
        change.append((found.power / alone.power - 1.0)[[12, 18]])
    assert np.mean(change) == pytest.approx(0.0, abs=0.0015)  # 0.04 % of noise: other roundings to 12 bits


def test_bins_on_a_slope_are_unbiased_whatever_is_flagged():
    shape = (CHANNELS + 1.0) ** -2.5
    rng = np.random.default_rng(2)
    for _ in range(20):
        is_flagged = rng.random(CHANNELS.size) < 0.4
        power, is_filled = bin_spectrum(np.where(is_flagged, 1e9, 3 * shape), shape, is_flagged, CHANNELS, SETTINGS)
        expected, _ = bin_spectrum(3 * shape, shape, np.zeros(CHANNELS.size, bool), CHANNELS, SETTINGS)
        assert np.allclose(power[~is_filled], expected[~is_filled], rtol=1e-9)
        assert np.allclose(power[is_filled] * 3, expected[is_filled], rtol=1e-9)  # the shape itself, filled


def test_without_flags_a_bin_is_the_plain_weighted_mean():
    density = np.random.default_rng(3).gamma(50, 1 / 50, CHANNELS.size)
    power, is_filled = bin_spectrum(density, np.exp(-CHANNELS / 9), np.zeros(CHANNELS.size, bool), CHANNELS, SETTINGS)
    low, high = 44.5 * 1024 / 200 + 0.5, 45.5 * 1024 / 200 + 0.5  # in channels, edges at integers
    edges = np.arange(int(low), int(high) + 1)
    overlap = np.minimum(edges + 1, high) - np.maximum(edges, low)
    assert not np.any(is_filled)
    assert power[15] * 50 == pytest.approx(np.sum(overlap * density[edges]) / 5.12, rel=1e-9)


def test_a_number_of_blocks_is_spread_over_the_trace(make_trace):
    trace = make_trace(4)
    found = measure_one(trace, CleaningSettings(blocks=100))
    rows = (np.arange(100) * 400) // 100
    same = measure_one(
        replace(trace, samples=trace.samples[rows], position=trace.position[:100], is_intact=trace.is_intact[rows])
    )
    assert found.blocks == 100
    assert np.allclose(found.power, same.power, rtol=1e-5)


def test_gaps_are_bridged_without_segments_across_them(make_trace):
    trace = make_trace(5, disturbances=[Transmitter(45.0, 2.0)])
    keep = np.ones(400, dtype=bool)
    keep[37::41] = False
    holed = Trace(trace.reference, trace.samples[keep], trace.position[keep], trace.is_intact[keep], {"lost_frames": 9})
    found = measure_one(holed)
    assert found.blocks == np.sum(keep)
    assert found.faults == {"lost_frames": 9}
    assert np.any(np.abs(found.line_mhz - 45.0) < 0.1)


def test_unusable_traces_say_why(make_trace):
    trace = make_trace(6)
    short = Trace(trace.reference, trace.samples[:10], trace.position[:10], trace.is_intact[:10], {})
    dead = replace(trace, samples=np.zeros_like(trace.samples))
    few, silent, good = measure_traces([short, dead, trace], SETTINGS)
    assert few.excluded.startswith("too few background blocks: 10")
    assert silent.excluded.startswith("dead")
    assert good.excluded == ""


def test_a_band_full_of_interference_is_excluded(make_trace):
    lines = [Transmitter(f, 40.0, phase=f**2) for f in np.arange(31.0, 80.0, 1.0)]
    found = measure_one(make_trace(7, disturbances=lines))
    assert found.excluded.startswith("interference")


def test_settings_check_themselves():
    with pytest.raises(BadInputError, match="evenly"):
        CleaningSettings(frequency_mhz=np.array([30.0, 31.0, 33.0]))
    with pytest.raises(BadInputError, match="blocks"):
        CleaningSettings(blocks=5)
    with pytest.raises(BadInputError, match="150 MHz"):
        bin_spectrum(
            np.ones(513), np.ones(513), np.zeros(513, bool), CHANNELS, CleaningSettings(np.array([50.0, 100.0, 150.0]))
        )


@pytest.mark.shared
def test_the_real_dumps_show_the_resonance_and_known_transmitters(shared):
    files = sorted((shared / "data/tbb").glob("*.dat"))
    (event,) = group_traces([reference for file in files for reference in list_traces(file)])
    found = measure_background(event.references, SETTINGS)
    assert [item.blocks for item in found] == [1000] * 4
    for item in found:
        assert item.excluded == ""
        assert abs(SETTINGS.frequency_mhz[np.argmax(item.power)] - 58) <= 2
        assert item.power[28] / item.power[0] > 5
        # Carriers of analogue television in band I: sound of R1 and E2, vision of R2 and E4 (ITU-R BT.470).
        for line in (53.75, 56.25, 59.25, 62.25):
            assert np.min(np.abs(item.line_mhz - line)) < 0.1
        assert np.max(item.power[1:] / item.power[:-1]) < 1.6  # no line survives


@pytest.mark.shared
def test_the_dump_of_2008_shows_its_glitches_and_its_band(shared):
    (reference,) = list_traces(shared / "data/tbb/rw_20080701_162002_0109.h5")
    (found,) = measure_background([reference], SETTINGS)
    assert found.dropped == {"pulse": 22}  # two samples of 2000 ADC units in a noise of 141
    assert found.rms == pytest.approx(141, abs=1)
    assert abs(SETTINGS.frequency_mhz[np.argmax(found.power)] - 57) <= 1
    assert np.sum(found.is_filled) == 0


def test_noise_loses_no_block(make_trace):
    selection = select_background(make_trace(1))
    assert np.all(selection.is_background)
    assert selection.dropped == {}


@pytest.mark.parametrize("spike", [None, 400, -400])
def test_a_pulse_above_or_below_the_noise_takes_five_blocks_on_either_side(make_trace, spike):
    trace = make_trace(2, disturbances=[Shower(sample=200 * 1024 + 500, peak=400.0)] if spike is None else [])
    if spike is not None:
        trace.samples[200, 500] = spike
    selection = select_background(trace)
    assert selection.dropped == {"pulse": 11}
    assert np.flatnonzero(~selection.is_background).tolist() == list(range(195, 206))
    assert selection.pulses == (trace.position[200],)


def test_a_known_pulse_is_left_out_even_when_it_cannot_be_seen(make_trace):
    trace = make_trace(3)
    instant = trace.reference.time_unix + (50 * 1024 + 500) / 200e6
    selection = select_background(trace, instant)
    assert np.flatnonzero(~selection.is_background).tolist() == list(range(45, 56))


def test_saturated_damaged_and_burst_blocks_are_dropped_for_their_own_reason(make_trace):
    trace = make_trace(4)
    samples = trace.samples.copy()
    samples[30] *= 3
    samples[60, 17] = 2047
    samples[90, 3] = -2048
    is_intact = np.ones(len(samples), dtype=bool)
    is_intact[120] = False
    selection = select_background(replace(trace, samples=samples, is_intact=is_intact))
    assert selection.dropped["damaged"] == 1
    assert selection.dropped["saturated"] == 2
    # The lone extreme samples are pulses too, and so, being three times the noise, is the burst.
    assert not np.any(selection.is_background[[30, 60, 90, 120]])
    assert np.sum(selection.is_background) >= 400 - 4 - 3 * 10


def test_a_weak_burst_without_a_peak_is_a_burst(make_trace):
    trace = make_trace(5)
    samples = trace.samples.copy()
    samples[30] = np.rint(samples[30] * 1.4)
    selection = select_background(replace(trace, samples=samples))
    assert selection.dropped == {"burst": 3}  # with the blocks in which it begins and ends


@pytest.mark.parametrize(("duty", "is_keyed"), [(0.2, True), (1.0, False), (0.9, False)])
def test_only_a_transmitter_that_is_mostly_silent_costs_blocks(make_trace, duty, is_keyed):
    line = Transmitter(45.0, mean_square=60.0, duty=duty, period_s=4e-4)
    trace = make_trace(6, disturbances=[line])
    strength = np.zeros(513)
    strength[round(45.0 * 1024 / 200)] = 10.0
    to_density = density_per_square(1024, 200e6)
    found = find_keyed_blocks(
        transform_in_place(trace.samples.astype(np.float32)), strength, np.full(513, 4.0), to_density
    )
    on = (np.arange(400) * 1024 / 200e6 / 4e-4) % 1.0 < duty
    if is_keyed:
        assert np.all(found[on])
        assert found.mean() < 0.3
    else:
        assert not np.any(found)


LONGITUDE = 6.87
EVENTS, ANTENNAS = 150, 6


def campaign(factor: np.ndarray, events: int = EVENTS) -> Spectra:
    """A sky that swings by 40 % over the sidereal day, 5 % gain scatter, and a factor (antenna, event) on top."""
    rng = np.random.default_rng(1)
    time_unix = 1.4e9 + np.sort(rng.uniform(0, 3e7, events))
    sky = 1 + 0.4 * np.cos(2 * np.pi * (local_sidereal_time(time_unix, LONGITUDE) - 18) / 24)
    gain = rng.normal(1, 0.03, (1, events)) * rng.normal(1, 0.04, (ANTENNAS, events))
    level = sky * gain * rng.normal(1, 0.3, (ANTENNAS, 1)) ** 2 * factor[:, :events]
    rows = ANTENNAS * events
    return Spectra(
        frequency_mhz=np.arange(30.0, 81.0),
        power=level.reshape(-1, 1) * rng.normal(1, 0.04, (rows, 51)),
        event_id=np.tile([f"e{k}" for k in range(events)], ANTENNAS),
        time_unix=np.tile(time_unix, ANTENNAS),
        station=np.full(rows, "CS002"),
        antenna=np.repeat(np.arange(ANTENNAS), events),
        dipole=np.full(rows, "X"),
        blocks=np.full(rows, 400),
    )


def test_ordinary_scatter_and_the_turning_sky_are_not_anomalous():
    assert find_anomalous_spectra(campaign(np.ones((ANTENNAS, EVENTS))), LONGITUDE) == {}


@pytest.mark.parametrize("factor", [0.5, 1.6, 30.0])
def test_a_thunderstorm_takes_the_station_and_a_bad_receiver_its_path(factor):
    change = np.ones((ANTENNAS, EVENTS))
    change[:, 40] = factor
    change[2, 70] = factor
    found = find_anomalous_spectra(campaign(change), LONGITUDE)
    station = {("e40", "CS002", antenna, "X") for antenna in range(ANTENNAS)}
    assert set(found) == station | {("e70", "CS002", 2, "X")}
    words = found["e70", "CS002", 2, "X"]
    assert words.startswith("anomalous power: this path's is ")
    assert float(words.split(" is ")[1].split(" times")[0]) == pytest.approx(factor, rel=0.2)


def test_a_bad_receiver_is_seen_where_the_gain_of_the_whole_station_scatters():
    """What all paths share is taken out before one of them is compared with the others."""
    change = np.exp(0.12 * np.random.default_rng(2).standard_normal((1, EVENTS))) * np.ones((ANTENNAS, 1))
    change[2, 70] *= 1.6
    assert set(find_anomalous_spectra(campaign(change), LONGITUDE)) == {("e70", "CS002", 2, "X")}


def test_few_events_are_left_alone():
    change = np.ones((ANTENNAS, EVENTS))
    change[:, 3] = 10.0
    assert find_anomalous_spectra(campaign(change, FEWEST_EVENTS - 1), LONGITUDE) == {}
