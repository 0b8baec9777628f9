"""A short dipole under a toy sky, summed pixel by pixel: its spectra need nothing of the code under test."""

from __future__ import annotations

import numpy as np

from lbacal_core.grids import Floats
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.spectra.spectra import Spectra

FREQUENCY = np.arange(42.0, 56.0)
DAY_S, SIDEREAL_DAY_S, START = 86_400.0, 86_164.09, 1_656_633_600.0
PIXELS = 4000
POLE, CENTRE, NODE = np.radians([27.13, 192.86, 122.93])
"""Declination and right ascension of the Galactic pole, and longitude of the celestial one, of 2000."""


def make_instrument(latitude_deg: float = 52.9, longitude_deg: float = 6.9) -> Instrument:
    flat = np.ones(FREQUENCY.size)
    return Instrument(
        "single dipole", latitude_deg, longitude_deg, 0.0, FREQUENCY, {"X": 90.0}, flat, flat, {"none": flat},
        [AntennaRecord("D1", 0, "none")], antenna="short-dipole",
    )  # fmt: skip


def antenna_temperature(instrument: Instrument, lst_hours: Floats, frequency_mhz: Floats) -> Floats:
    """Kelvin, shape (event, freq): a plane whose brightness has its peak at the Galactic centre."""
    k = np.arange(PIXELS) + 0.5
    sine, ascension = 1 - 2 * k / PIXELS, np.pi * (1 + 5**0.5) * k
    cosine = np.sqrt(1 - sine**2)
    b = np.arcsin(np.sin(POLE) * sine + np.cos(POLE) * cosine * np.cos(ascension - CENTRE))
    east = cosine * np.sin(ascension - CENTRE)
    north = np.cos(POLE) * sine - np.sin(POLE) * cosine * np.cos(ascension - CENTRE)
    longitude = (NODE - np.arctan2(east, north) + np.pi) % (2 * np.pi) - np.pi
    plane = np.exp(-np.abs(b) / 0.1) * (0.25 + 0.75 * np.exp(-0.5 * (longitude / 0.8) ** 2))
    spectrum = (frequency_mhz[:, None] / 50) ** -np.where(plane > 0.1, 2.45, 2.6)
    brightness = (4500.0 + 40_000.0 * plane) * spectrum
    latitude, arm = np.radians([instrument.latitude_deg, instrument.dipole_azimuth_deg["X"]])
    seen = []
    for hours in lst_hours:
        angle = np.pi / 12 * hours - ascension
        up = np.sin(latitude) * sine + np.cos(latitude) * cosine * np.cos(angle)
        to_north = np.cos(latitude) * sine - np.sin(latitude) * cosine * np.cos(angle)
        along = to_north * np.cos(arm) - cosine * np.sin(angle) * np.sin(arm)
        response = np.where(up > 0, 1 - along**2, 0.0)
        seen.append(brightness @ response / response.sum())
    return np.array(seen)


def sidereal_hours(time_unix: Floats, longitude_deg: float) -> Floats:
    days = time_unix / DAY_S + 2_440_587.5 - 2_451_545.0
    return (18.697374558 + 24.06570982441908 * days + longitude_deg / 15) % 24


def make_spectra(instrument: Instrument, time_unix: Floats, rng: np.random.Generator) -> Spectra:
    frequency = instrument.frequency_mhz
    kelvin = antenna_temperature(instrument, sidereal_hours(time_unix, instrument.longitude_deg), frequency)
    power = (kelvin + 400.0) * frequency**2 * rng.gamma(1e6, 1e-6, kelvin.shape)
    count = time_unix.size
    return Spectra(
        frequency, power, np.array([f"e{k:04d}" for k in range(count)]), time_unix, np.full(count, "D1"),
        np.zeros(count, dtype=np.int64), np.full(count, "X"), np.full(count, 10_000),
    )  # fmt: skip


def daily_means(instrument: Instrument, rng: np.random.Generator, days: int = 82) -> Spectra:
    """A mean a day, at one sidereal time within 0.03 of a day."""
    scatter = 0.03 * DAY_S * rng.uniform(-0.5, 0.5, days)
    return make_spectra(instrument, START + SIDEREAL_DAY_S * np.arange(days) + scatter, rng)


def one_day(instrument: Instrument, rng: np.random.Generator, spectra: int = 144) -> Spectra:
    return make_spectra(instrument, START + DAY_S / spectra * np.arange(spectra), rng)
