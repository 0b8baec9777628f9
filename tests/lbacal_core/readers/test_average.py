from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.readers.open import choose_channels, open_source
from lbacal_core.readers.source import Channels, Integrations, Source, average

PATHS = 3
FREQUENCY = np.arange(40.0, 44.0, 0.25)


def make_source(power: np.ndarray, time_unix: np.ndarray, duration_s: np.ndarray, at_once: int = 4) -> Source:
    def read() -> Iterator[Integrations]:
        for start in range(0, len(time_unix), at_once):
            rows = slice(start, start + at_once)
            yield Integrations(time_unix[rows], duration_s[rows], power[rows])

    return Source(
        "made", FREQUENCY, np.full(FREQUENCY.size, 0.25), np.array(["A"] * PATHS), np.arange(PATHS),
        np.array(["X"] * PATHS), read,
    )  # fmt: skip


@given(st.integers(0, 10_000), st.integers(1, 40), st.integers(1, 7))
def test_average_is_the_plain_sum_over_every_sample_that_is_not_flagged(seed, rows, at_once):
    rng = np.random.default_rng(seed)
    duration = rng.uniform(1.0, 5.0, rows)
    time = 1.4e9 + np.cumsum(duration) - duration / 2
    power = rng.uniform(1.0, 2.0, (rows, PATHS, FREQUENCY.size))
    power[rng.uniform(size=power.shape) < 0.1] = np.nan
    channels = Channels(np.array([40.5, 42.5]), np.array([1.0, 1.0]))
    spectra = average(make_source(power, time, duration, at_once), 20.0, channels).spectra
    interval = ((time - (time[0] - duration[0] / 2)) // 20.0).astype(int)
    for row in range(len(spectra)):
        at = int(np.argmin([abs(time[interval == k].mean() - spectra.time_unix[row]) for k in np.unique(interval)]))
        rows_of_it = np.flatnonzero(interval == np.unique(interval)[at])
        for j, centre in enumerate(spectra.frequency_mhz):
            total = weight = 0.0
            for i in rows_of_it:
                for f in np.flatnonzero((centre - 0.5 <= FREQUENCY) & (centre + 0.5 > FREQUENCY)):
                    if np.isfinite(power[i, spectra.antenna[row], f]):
                        total += duration[i] * power[i, spectra.antenna[row], f]
                        weight += duration[i]
            assert spectra.power[row, j] == pytest.approx(total / weight, rel=1e-12)


def test_a_channel_that_is_always_flagged_is_left_out_and_a_spectrum_that_lacks_another_one_too():
    power = np.ones((6, PATHS, FREQUENCY.size))
    power[:, :, 2] = np.nan
    power[:2, 1, 5] = 0.0
    time = 1.4e9 + np.arange(6.0)
    found = average(make_source(power, time, np.ones(6)), 2.0)
    assert found.channels_left_out.tolist() == [FREQUENCY[2]]
    assert found.spectra_left_out == 1
    assert len(found.spectra) == 3 * PATHS - 1
    assert found.spectra.environment["flagged_fraction"].min() == pytest.approx(1 / 16)


def test_durations_and_widths_are_kept_and_blocks_count_the_same_time():
    time = 1.4e9 + np.arange(6.0)
    spectra = average(make_source(np.ones((6, PATHS, 16)), time, np.ones(6)), 3.0).spectra
    assert spectra.duration_s is not None
    np.testing.assert_allclose(spectra.duration_s, 3.0)
    np.testing.assert_allclose(spectra.blocks, 3.0 / 5.12e-6, rtol=1e-6)
    np.testing.assert_allclose(spectra.channel_widths(), 0.25)


def test_source_in_which_everything_is_flagged_and_a_channel_outside_it_are_refused():
    source = make_source(np.full((2, PATHS, 16), np.nan), 1.4e9 + np.arange(2.0), np.ones(2))
    with pytest.raises(BadInputError, match="everything flagged"):
        average(source, 10.0)
    with pytest.raises(BadInputError, match=r"within 0.5 MHz of 50 MHz"):
        average(source, 10.0, Channels(np.array([50.0]), np.array([1.0])))


def test_channels_of_one_width_lie_at_its_multiples_and_those_of_an_instrument_are_its_own(low_band):
    source = make_source(np.empty((0, PATHS, 16)), np.empty(0), np.empty(0))
    assert choose_channels(source, width_mhz=1.0).frequency_mhz.tolist() == [41.0, 42.0, 43.0]
    assert choose_channels(source, width_mhz=1.0, band_mhz=(42, 60)).frequency_mhz.tolist() == [42.0, 43.0]
    with pytest.raises(BadInputError, match=r"some between 40 and 43.75 MHz"):
        choose_channels(source, band_mhz=(60, 70))
    assert choose_channels(source, low_band).frequency_mhz.tolist() == low_band.frequency_mhz.tolist()


def test_a_folder_without_data_and_a_file_of_an_unknown_kind_say_what_is_known(tmp_path):
    with pytest.raises(BadInputError, match="sst_rcuNNN"):
        open_source(tmp_path)
    (tmp_path / "a.txt").write_text("1 2 3")
    with pytest.raises(BadInputError, match=r"uvh5.*a file \.txt"):
        open_source(tmp_path / "a.txt")
    with pytest.raises(UnreadableFileError, match="no such file"):
        open_source(tmp_path / "b.uvh5")


@pytest.mark.parametrize(
    ("antennas", "dipoles", "message"),
    [([], [], "at least one path"), ([1], ["?"], "a letter or name"), ([1, 1], ["X", "X"], "A antenna 1 X twice")],
)
def test_paths_that_no_spectra_file_could_hold_are_refused(antennas, dipoles, message):
    frequency = np.array([40.0, 41.0])
    with pytest.raises(BadInputError, match=message):
        Source(
            "made", frequency, np.ones(2), np.array(["A"] * len(antennas)), np.array(antennas), np.array(dipoles),
            lambda: iter(()),
        )  # fmt: skip


def drifting_sky(intervals: int, channels: int) -> np.ndarray:
    """Power that varies by a half over the day, less at high frequencies, with a filter of its own for each path."""
    day = 2 * np.pi * np.arange(intervals) / intervals
    slope = np.linspace(1.0, 0.8, channels)
    shape = 1.0 + 0.8 * np.sin(np.linspace(0.0, 9.0, channels)) ** 2
    sky = np.exp(0.4 * np.cos(day)[:, None, None] * slope)
    return sky * shape * np.array([1.0, 3.0, 0.2])[:, None]


def test_a_spectrum_that_lacks_one_channel_is_kept_with_what_the_path_has_in_it_at_other_times():
    truth = drifting_sky(20, FREQUENCY.size)
    power = truth.copy()
    power[3, 1, 5], power[3, 0, 0], power[9, 1, 15] = np.nan, 0.0, -1.0
    time = 1.4e9 + np.arange(20.0)
    found = average(make_source(power, time, np.ones(20)), 1.0)
    assert (found.spectra_filled, found.spectra_left_out, len(found.spectra)) == (3, 0, 60)
    measured = found.spectra.power.reshape(20, PATHS, -1)
    is_recorded = np.isfinite(power) & (power > 0)
    np.testing.assert_array_equal(measured[is_recorded], power[is_recorded])
    # what remains is how differently the sky varies in a channel and beside it: 0.4 x 0.2 / 15 between neighbours
    np.testing.assert_allclose(measured, truth, rtol=0.4 * 0.2 / 15)


@pytest.mark.parametrize(
    ("lacking", "filled", "lost"),
    [
        ([(k, 1, 5) for k in range(4)], 4, 0),
        ([(k, 1, 5) for k in range(5)], 0, 5),
        ([(3, 1, 5), (3, 1, 6)], 0, 1),
        ([(k, 1, k) for k in range(16)], 16, 0),
        ([(k, 1, k % 16) for k in range(17)], 0, 17),
    ],
    ids=["in a fifth", "in more", "two of 16 channels", "four complete", "three complete"],
)
def test_a_spectrum_that_lacks_much_or_often_is_left_out(lacking, filled, lost):
    power = drifting_sky(20, FREQUENCY.size)
    power[tuple(np.transpose(lacking))] = np.nan
    found = average(make_source(power, 1.4e9 + np.arange(20.0), np.ones(20)), 1.0)
    assert (found.spectra_filled, found.spectra_left_out) == (filled, lost)
