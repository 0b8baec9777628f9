from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.spectra.blocks import SpectraBlock
from lbacal_core.spectra.screening import (
    CUT_SIGMA,
    FEWEST_EVENTS,
    LASTING_EVENTS,
    Screened,
    find_lasting,
    median_over,
    screen_block,
)

LONGITUDE = 6.87
PATHS, EVENTS, CHANNELS = 4, 400, 51
SCATTER = 0.05


def year(factor: np.ndarray | None = None, events: int = EVENTS, seed: int = 1) -> SpectraBlock:
    """A year whose sky swings by 40 %, with a gain of 5 % an event and radiometer noise, and a factor on top.

    `factor` broadcasts to (path, event, freq).
    """
    rng = np.random.default_rng(seed)
    time_unix = 1.4e9 + np.sort(rng.uniform(0, 3.1e7, events))
    sky = 1 + 0.4 * np.cos(2 * np.pi * (local_sidereal_time(time_unix, LONGITUDE) - 18) / 24)
    bandpass = np.geomspace(1.0, 30.0, CHANNELS)
    power = sky[:, None] * bandpass * rng.normal(1, SCATTER, (PATHS, events, 1))
    power = power * rng.normal(1, 0.045, (PATHS, events, CHANNELS))
    return SpectraBlock(
        station="CS002",
        dipole="X",
        frequency_mhz=np.arange(30.0, 81.0),
        antennas=np.arange(PATHS),
        event_id=np.array([f"e{k}" for k in range(events)]),
        time_unix=time_unix,
        power=power if factor is None else power * factor,
        is_present=np.ones((PATHS, events), dtype=bool),
        blocks=np.full((PATHS, events), 100),
    )


def ones(events: int = EVENTS) -> np.ndarray:
    return np.ones((PATHS, events, CHANNELS))


def screened(factor: np.ndarray) -> Screened:
    return screen_block(year(factor), LONGITUDE)


def test_a_clean_year_keeps_every_spectrum():
    for seed in range(10):
        found = screen_block(year(seed=seed), LONGITUDE)
        assert found.anomalies == ()
        assert np.all(found.block.is_present)


@pytest.mark.parametrize("size", [1000.0, 30.0, 3.0, 1.6, 0.4, 1e-3])
def test_one_spectrum_that_is_off_is_left_out_and_named(size):
    factor = ones()
    factor[2, 70] = size
    found = screened(factor)
    (anomaly,) = found.anomalies
    assert (anomaly.event_id, anomaly.path, anomaly.frequency_mhz, anomaly.kept) == ("e70", "CS002/2/X", None, None)
    # the gain of the event stands beside the factor
    assert anomaly.factor == pytest.approx(size, rel=4 * SCATTER)
    assert np.argwhere(~found.block.is_present).tolist() == [[2, 70]]
    assert (found.block.blocks[2, 70], found.block.power[2, 70].tolist()) == (0, [1.0] * CHANNELS)
    assert np.all(found.is_steady)


@pytest.mark.parametrize("size", [1e-300, 1e300])
def test_powers_at_the_end_of_the_numbers_are_left_out_without_a_warning(size):
    factor = ones()
    factor[0, 3] = size
    assert [anomaly.event_id for anomaly in screened(factor).anomalies] == ["e3"]


def test_one_channel_that_is_off_by_far_takes_its_spectrum_and_names_the_channel():
    factor = ones()
    factor[1, 9, 20] = 12.0
    (anomaly,) = screened(factor).anomalies
    assert (anomaly.event_id, anomaly.frequency_mhz) == ("e9", 50.0)
    assert anomaly.reason.startswith("power 1")
    assert anomaly.reason.endswith("times the usual at 50 MHz")


def test_a_thunderstorm_takes_every_path_of_the_station():
    factor = ones()
    factor[:, 40:43] = 1.8
    found = screened(factor)
    assert {(anomaly.antenna, anomaly.event_id) for anomaly in found.anomalies} == {
        (antenna, f"e{event}") for antenna in range(PATHS) for event in (40, 41, 42)
    }


def test_a_path_is_judged_by_its_own_spectra_alone():
    factor = ones()
    factor[1, 50] = 4.0
    block = year(factor)
    rows = {name: getattr(block, name)[1:2] for name in ("antennas", "power", "is_present", "blocks")}
    alone = replace(block, **rows)
    found, of_all = screen_block(alone, LONGITUDE), screen_block(block, LONGITUDE)
    np.testing.assert_array_equal(found.block.is_present[0], of_all.block.is_present[1])
    # sums over other numbers of paths may differ in the last digit
    assert found.anomalies[0].factor == pytest.approx(of_all.anomalies[0].factor, rel=1e-12)


@pytest.mark.parametrize(("begins", "size"), [(200, 1.3), (200, 0.5), (350, 1.3), (385, 1.7), (EVENTS - 12, 1.7)])
def test_a_gain_step_is_left_to_those_who_look_for_it(begins, size):
    factor = ones()
    factor[0, begins:] = size
    found = screened(factor)
    assert np.all(found.block.is_present)
    assert all(anomaly.kept for anomaly in found.anomalies)


def test_what_lasts_is_fitted_and_said():
    factor = ones()
    factor[0, 100 : 100 + LASTING_EVENTS] = 1.7
    found = screened(factor)
    assert {anomaly.kept for anomaly in found.anomalies} == {f"it lasts for {LASTING_EVENTS} events"}
    assert np.all(found.block.is_present)


def test_a_receiver_that_is_dead_for_a_week_is_left_out_however_long_it_lasts():
    factor = ones()
    factor[0, 100:118] = 0.01
    found = screened(factor)
    assert len(found.anomalies) == 18
    assert not np.any(found.block.is_present[0, 100:118])


def test_a_path_with_too_many_keeps_them_all_and_is_no_member_of_a_mean():
    factor = ones()
    factor[3, ::12] = 5.0
    found = screened(factor)
    assert np.all(found.block.is_present)
    assert found.is_steady.tolist() == [True, True, True, False]
    assert {anomaly.kept for anomaly in found.anomalies} == {"34 of the 400 spectra of this path are like this"}


def test_a_receiver_that_is_dead_for_five_months_and_returns_is_fitted_by_what_it_saw():
    """43 % of a path's spectra were dead and therefore fitted: C had an error of 8 %, and nothing took effect."""
    factor = ones()
    factor[1, 60:232] = 1e-4
    found = screened(factor)
    assert np.flatnonzero(~found.block.is_present[1]).tolist() == list(range(60, 232))
    assert np.all(found.block.is_present[[0, 2, 3]])
    assert np.all(found.is_steady)


def test_spectra_of_few_blocks_may_scatter_more():
    rng = np.random.default_rng(4)
    block = year()
    noisy = block.power[:, ::10] * rng.normal(1, 0.4, block.power[:, ::10].shape).clip(0.05)
    power, blocks = block.power.copy(), block.blocks.copy()
    power[:, ::10], blocks[:, ::10] = noisy, 1
    assert screen_block(replace(block, power=power, blocks=blocks), LONGITUDE).anomalies == ()


def test_spectra_that_are_absent_are_not_looked_at():
    block = year()
    is_present = block.is_present.copy()
    is_present[0, 5:300], is_present[1] = False, False
    power = np.where(is_present[:, :, None], block.power, 1.0)
    found = screen_block(replace(block, power=power, is_present=is_present), LONGITUDE)
    assert found.anomalies == ()
    np.testing.assert_array_equal(found.block.is_present, is_present)


@pytest.mark.parametrize("events", [FEWEST_EVENTS - 1, FEWEST_EVENTS, 61, 95])
def test_few_events_are_left_alone_and_some_are_judged(events):
    factor = ones(events)
    factor[0, 3] = 10.0
    found = screen_block(year(factor, events), LONGITUDE)
    assert [anomaly.event_id for anomaly in found.anomalies] == (["e3"] if events >= FEWEST_EVENTS else [])


def test_the_scatter_of_clean_years_stays_far_from_the_cut():
    """At 60 events the daily variation takes up the most of the scatter, and the spread is least known."""
    left_out = sum(len(screen_block(year(events=60, seed=seed), LONGITUDE).anomalies) for seed in range(50))
    assert left_out <= 2, f"{left_out} of {50 * PATHS * 60}: a Gaussian scatter has 2e-9 beyond {CUT_SIGMA} sigma"


@pytest.mark.parametrize(
    ("came", "lasting"),
    [
        ("." * 20 + "x" * 9, 0),
        ("." * 20 + "x" * 10, 10),
        ("x" * 12 + "." * 40, 12),
        ("." * 30 + "x" * 40 + "." * 50, 0),
        (".x" * 40, 0),
        ("xxx" + "." * 50 + "xx.xxx" * 4, 20),
        ("x" * 15, 15),
        ("." * 15, 0),
    ],
)
def test_a_level_lasts_that_the_newest_or_the_oldest_events_have(came: str, lasting: int) -> None:
    found = find_lasting(np.array([one == "x" for one in came]))
    assert found.sum() == lasting
    assert not np.any(found & np.array([one == "." for one in came]))


def test_the_median_is_that_of_the_known_values():
    rng = np.random.default_rng(1)
    values = rng.standard_normal((7, 40, 3)).astype(np.float32)
    values[rng.uniform(size=(7, 40)) < 0.2] = np.nan
    assert median_over(values, axis=0) == pytest.approx(np.nanmedian(values, axis=0), nan_ok=True)
    assert median_over(values, axis=1) == pytest.approx(np.nanmedian(values, axis=1), nan_ok=True)
