from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.antenna.lofar import load_hamaker
from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.instrument.instrument import Instrument
from lbacal_paper.showers.coreas import read_coreas, sky_basis
from lbacal_paper.showers.recording import Recording, field_power, record, true_power
from lbacal_paper.showers.signals import EVENTS, SAMPLES, SIGNALS, band_bins, draw_signals, signals_of_showers

C = np.array([1e-5 * (1 + np.arange(51) / 30.0), 1.2e-5 * (1 + np.arange(51) / 40.0)])


def recording(low_band: Instrument, ratio: float, signals: int = 400) -> Recording:
    rng = np.random.default_rng(2)
    background = np.full((2, 51), 3.0)
    drawn = draw_signals(rng, 10, signals)
    return record(drawn, low_band, load_hamaker(), C, background, rng, (ratio, ratio * 1.01))


def test_strong_pulses_come_back_as_the_field_they_were(low_band: Instrument) -> None:
    strong = recording(low_band, 1e9)
    power, _ = field_power(strong, C, low_band.frequency_mhz)
    assert np.median(np.abs(power / true_power(strong) - 1)) < 1e-3


def test_power_without_background_is_unbiased_and_with_it_is_not(low_band: Instrument) -> None:
    weak = recording(low_band, 3.0, 2000)
    truth = true_power(weak).sum()
    subtracted, background = field_power(weak, C, low_band.frequency_mhz)
    assert subtracted.sum() == pytest.approx(truth, rel=0.03)
    plain, _ = field_power(weak, C, low_band.frequency_mhz, subtract=False)
    assert plain.sum() == pytest.approx(truth + background.sum(), rel=0.03)
    assert background.sum() > 0.2 * truth


def test_events_have_the_ratio_of_signal_to_background_that_was_asked_for(low_band: Instrument) -> None:
    made = recording(low_band, 50.0)
    bins = made.signals.frequency_mhz
    middle = (bins > 45) & (bins < 65)
    pulse = np.einsum("sbij,sjb->sib", made.jones, made.signals.field)
    channels = low_band.frequency_mhz
    density = 3.0 * 50.0 * 200.0 * 256 / 2
    ratio = np.abs(pulse / np.array([np.interp(bins, channels, one) for one in C])) ** 2 / density
    by_event = [ratio[made.signals.event == k][:, :, middle].mean() for k in range(10)]
    assert by_event == pytest.approx(np.full(10, 50.0), rel=0.02)


def test_a_calibration_of_each_signal_acts_on_it_alone(low_band: Instrument) -> None:
    made = recording(low_band, 1e6, 20)
    factor = np.linspace(1.0, 2.0, 20)[:, None, None]
    once, _ = field_power(made, C, low_band.frequency_mhz)
    each, _ = field_power(made, C * factor, low_band.frequency_mhz)
    assert each == pytest.approx(once * factor[:, 0] ** 2)


def test_the_spectrum_of_a_sampled_pulse_is_its_fourier_transform(hdf5_shower: Path) -> None:
    signals = signals_of_showers([read_coreas(hdf5_shower)])
    # a Gaussian of 2 ns and 1 V/m: sqrt(2 pi) sigma exp(-2 (pi nu sigma)^2), times the sampling rate
    omega = 2 * np.pi * 1e6 * signals.frequency_mhz
    expected = 200e6 * np.sqrt(2 * np.pi) * 2e-9 * np.exp(-0.5 * (omega * 2e-9) ** 2)
    assert np.abs(signals.field[1, 1]) == pytest.approx(expected, rel=1e-6)
    assert np.abs(signals.field[0, 0]) == pytest.approx(0.5 * expected, rel=1e-6)


def test_a_sampled_pulse_stands_in_the_middle_of_its_block(hdf5_shower: Path) -> None:
    signals = signals_of_showers([read_coreas(hdf5_shower)])
    spectrum = np.zeros(SAMPLES // 2 + 1, dtype=complex)
    at = np.isin(np.fft.rfftfreq(SAMPLES, 1 / 200.0), signals.frequency_mhz)
    spectrum[at] = signals.field[1, 1]
    assert np.argmax(np.abs(np.fft.irfft(spectrum, SAMPLES))) == SAMPLES // 2


def test_drawn_signals_have_the_numbers_of_the_paper_and_straight_spectra() -> None:
    signals = draw_signals(np.random.default_rng(1))
    assert np.unique(signals.event).size == EVENTS == 20
    assert signals.event.size == SIGNALS == 1653
    power = np.log10(np.sum(np.abs(signals.field) ** 2, axis=1))
    slope = np.diff(power, axis=1) / np.diff(band_bins())
    assert slope == pytest.approx(slope[:, :1] * np.ones_like(slope), abs=1e-9)
    assert signals.zenith_deg.max() <= 50


def test_axes_become_east_north_up_in_si(hdf5_shower: Path) -> None:
    shower = read_coreas(hdf5_shower)
    # x points north, y to the west
    assert shower.position_m == pytest.approx(np.array([[0, 100, 7], [-200, 0, 7], [50, -50, 7]]))
    strongest = shower.field[np.arange(3), 500]
    assert strongest == pytest.approx(np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), abs=1e-9)
    assert shower.energy_ev == 1e17


def test_a_shower_that_moves_north_comes_from_the_south(hdf5_shower: Path) -> None:
    shower = read_coreas(hdf5_shower)
    assert (shower.zenith_deg, shower.azimuth_deg) == (60.0, 180.0)
    # from the south at 60 deg: zenith angle grows to the south and down, azimuth grows to the west
    assert sky_basis(60.0, 180.0) == pytest.approx(np.array([[0, -0.5, -np.sqrt(0.75)], [-1, 0, 0]]), abs=1e-12)
    on_sky = shower.on_sky()[np.arange(3), 500]
    assert on_sky == pytest.approx(np.array([[-0.5, 0], [0, 1], [-np.sqrt(0.75), 0]]), abs=1e-9)


def test_text_files_and_hdf5_give_the_same_shower(hdf5_shower: Path, reas_shower: Path) -> None:
    one, other = read_coreas(hdf5_shower), read_coreas(reas_shower)
    assert other.field == pytest.approx(one.field, rel=1e-6)
    assert other.position_m == pytest.approx(one.position_m)
    assert (other.zenith_deg, other.azimuth_deg, other.energy_ev) == (60.0, 180.0, 1e17)


def test_broken_showers_are_refused_by_name(hdf5_shower: Path, reas_shower: Path, tmp_path: Path) -> None:
    (tmp_path / "no.hdf5").write_text("no")
    with pytest.raises(UnreadableFileError, match=r"no\.hdf5"):
        read_coreas(tmp_path / "no.hdf5")
    (tmp_path / "SIM2_coreas/raw_a1.dat").unlink()
    with pytest.raises(UnreadableFileError, match="raw_a1"):
        read_coreas(reas_shower)
    reas_shower.write_text("ShowerZenithAngle = 60\n")
    with pytest.raises(BadInputError, match="ShowerAzimuthAngle"):
        read_coreas(reas_shower)
    shower = read_coreas(hdf5_shower)
    with pytest.raises(BadInputError, match="time"):
        replace(shower, time_s=shower.time_s**2)


def test_the_field_of_a_real_shower_is_transverse() -> None:
    """The examples of the PyPI package nuradiomc: a wrong axis or angle would leave a field along the line of sight."""
    package = importlib.util.find_spec("NuRadioReco")
    if package is None or package.origin is None:
        pytest.skip("needs the PyPI package nuradiomc, which is no dependency")
    folder = Path(package.origin).parent / "examples/example_data"
    for name in ("example_data.hdf5", "example_event.h5", "greenland_starshape_32obs.hdf5"):
        shower = read_coreas(folder / name)
        zenith, azimuth = np.radians([shower.zenith_deg, shower.azimuth_deg])
        towards = np.array([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)])
        # the wave front is curved by a degree or two
        assert np.abs(shower.field @ towards).max() < 0.03 * np.abs(shower.field).max()
