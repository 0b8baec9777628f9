from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.gains import BEHIND, FRONT, NOISES, EventGains, shift_resonance
from lbacal_twin.settings import TwinSettings

STILL = TwinSettings(events_per_year=400, radiometer=0, stations=("CS002",))


def relative(instrument: Instrument, sky: SkyPower, gains: EventGains, settings: TwinSettings = STILL) -> np.ndarray:
    """Departure of the power from that without event gains, shape (antenna, dipole, event, freq)."""
    quiet = replace(settings, event_gain_common=0, event_gain_path=0)
    changed, plain = (
        simulate_campaign(one, instrument, sky, np.random.default_rng(3), gains=kind).spectra
        for one, kind in ((settings, gains), (quiet, EventGains()))
    )
    return (changed.power / plain.power - 1).reshape(6, 2, 400, 51)


def test_a_gain_in_front_shows_less_where_electronic_noise_is_a_large_share(
    low_band: Instrument, two_waves: SkyPower
) -> None:
    seen = relative(low_band, two_waves, EventGains(FRONT, FRONT))
    by_channel = seen.std(axis=(0, 1, 2))
    # N_RCU and N_ADC are a tenth of the power at the resonance and three quarters of it at 80 MHz.
    assert by_channel.max() == pytest.approx(0.05, rel=0.1)
    assert by_channel[-1] < 0.4 * by_channel.max()
    behind = relative(low_band, two_waves, EventGains(BEHIND, BEHIND))
    np.testing.assert_allclose(np.ptp(behind, axis=-1), 0.0, atol=1e-12)


def test_each_part_acts_where_it_is_put(low_band: Instrument, two_waves: SkyPower) -> None:
    for gains, of_common, of_path in (
        (EventGains(FRONT, BEHIND), True, False),
        (EventGains(BEHIND, FRONT), False, True),
    ):
        for name, has_shape in (("event_gain_common", of_common), ("event_gain_path", of_path)):
            alone = replace(STILL, **{"event_gain_common": 0.0, "event_gain_path": 0.0, name: 0.04})
            assert (np.ptp(relative(low_band, two_waves, gains, alone), axis=-1).max() > 1e-3) == has_shape


def test_a_jitter_of_the_resonance_raises_one_side_of_it_and_lowers_the_other(
    low_band: Instrument, two_waves: SkyPower
) -> None:
    flat = replace(STILL, event_gain_common=0, event_gain_path=0, response=0)
    seen = relative(low_band, two_waves, EventGains(common_jitter_mhz=0.05), flat)
    _, sizes, patterns = np.linalg.svd(seen.mean(axis=(0, 1)), full_matrices=False)
    assert sizes[1] < 0.1 * sizes[0]
    assert patterns[0].min() < -0.1
    assert patterns[0].max() > 0.1
    # All paths of an event move together.
    np.testing.assert_allclose(np.corrcoef(seen[..., 20].reshape(12, -1)), 1.0, atol=0.05)


def test_in_a_wet_world_the_resonance_jitters_in_rain_alone(low_band: Instrument, two_waves: SkyPower) -> None:
    settings = replace(STILL, event_gain_common=0, event_gain_path=0)
    campaign = simulate_campaign(settings, low_band, two_waves, np.random.default_rng(3), gains=NOISES["wetness"])
    seen = relative(low_band, two_waves, NOISES["wetness"], settings)
    is_wet = rain_of(campaign.spectra) > 0
    assert np.abs(seen[:, :, ~is_wet]).max() < 1e-9
    assert np.all(np.abs(seen[:, :, is_wet]).max(axis=(0, 1, 3)) > 1e-4)


def rain_of(spectra: Spectra) -> np.ndarray:
    return spectra.environment["rain_mm_h"].reshape(12, -1)[0]


def test_a_resonance_that_moves_up_is_the_curve_read_lower() -> None:
    frequency = np.arange(30.0, 81.0)
    curve = 1.0 + 20.0 * np.exp(-(((frequency - 58.0) / 6.0) ** 2))
    moved = shift_resonance(curve[None, None, None], frequency, np.full((1, 1, 1, 1), 2.0))
    np.testing.assert_allclose(moved[0, 0, 0, 5:], curve[3:-2], rtol=1e-9)


def test_the_form_of_the_gains_changes_no_other_random_number(low_band: Instrument, two_waves: SkyPower) -> None:
    quiet = replace(STILL, event_gain_common=0, event_gain_path=0)
    first, second = (
        simulate_campaign(quiet, low_band, two_waves, np.random.default_rng(3), gains=kind).spectra
        for kind in (NOISES["behind"], NOISES["front"])
    )
    np.testing.assert_array_equal(first.power, second.power)


def test_places_and_jitters_that_cannot_be_are_refused() -> None:
    with pytest.raises(BadInputError, match="front or behind"):
        EventGains("beside")
    with pytest.raises(BadInputError, match="0 to 2"):
        EventGains(common_jitter_mhz=-1.0)
