"""What each cause does to the recorded power, against its equation written out (docs/causes.md)."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, make_smoothing_spline

from lbacal_core.antenna.lofar import ResonanceCircuit
from lbacal_core.causes.antenna import STIFFNESS, fitted_log_gain, smoother
from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Conditions, Template
from lbacal_core.causes.sky import sky_ratios
from lbacal_core.instrument.chain import ChainTerms
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.power import vary_sky_power

NAMED = {cause.identifier: cause for cause in CAUSES}
YEAR_S = 365.25 * 86400
HOT = {"follows": "temperature", "model": "curve"}
NOON, SPRING = 12.0, 1.40e9
Law = Callable[[ChainTerms, Conditions, float], np.ndarray]


def warm(c: Conditions) -> np.ndarray:
    return (c.covariates["temperature_c"] - 10.0)[:, None] / 10.0


def chain(t: ChainTerms, sky=0.0, lna=0.0, front=1.0, rcu=1.0, adc=0.0) -> np.ndarray:
    """Eq. full_chain with terms added to the sky, the LNA and the converter, and factors on the gains."""
    return (t.sky + sky + t.n_lna + lna) * t.front * front + t.receiver_noise * rcu + t.adc_noise + adc


def at_55(c: Conditions) -> np.ndarray:
    return c.mean_sky[:, None, [25]]


def shown(c: Conditions, begin: float, end: float) -> np.ndarray:
    return ((c.utc_hours >= begin) & (c.utc_hours < end))[:, None]


def compressed(t: ChainTerms, f: float) -> np.ndarray:
    total = ((t.sky + t.n_lna) * t.front + t.receiver_noise).sum(axis=2, keepdims=True)
    return 1 - f * (total / total.mean(axis=1, keepdims=True) - 1)


def jittered(t: ChainTerms, c: Conditions, f: float) -> np.ndarray:
    power = chain(t)
    steep = (c.frequency_mhz**2 * power).sum(axis=2)
    return f * power.mean(axis=(1, 2))[:, None, None] * (steep / steep.mean(axis=1, keepdims=True))[..., None]


def moved(c: Conditions, log_gain: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Ratio of a curve read elsewhere, by scipy's default spline; shape of `at`."""
    return np.exp(CubicSpline(c.frequency_mhz, log_gain)(at) - log_gain)


LAWS: list[tuple[str, dict, float, Law]] = [
    ("lna_noise_slope", {}, 0.2, lambda t, c, f: chain(t, lna=t.n_lna * f * (c.frequency_mhz - 55) / 25)),
    ("missing_noise", {}, 0.2, lambda t, _c, f: chain(t, lna=f)),
    ("lna_noise_temperature", {}, 0.1, lambda t, c, f: chain(t, lna=t.n_lna * f * warm(c))),
    ("gain_temperature", {"delay_h": 0.0}, 0.1, lambda t, c, f: chain(t, front=1 + f * warm(c))),
    ("gain_step", {"date_unix": SPRING}, 0.1, lambda t, c, f: chain(t, front=1 + f * (c.time_unix >= SPRING)[:, None])),
    (
        "gain_drift", {}, 0.1,
        lambda t, c, f: chain(t, front=1 + f * (c.time_unix - c.time_unix.mean())[:, None] / YEAR_S),
    ),
    (
        "adc_noise_step", {"date_unix": SPRING}, 0.5,
        lambda t, c, f: chain(t, adc=f * t.adc_noise * (c.time_unix >= SPRING)[:, None]),
    ),
    ("cable_temperature", {}, 0.1, lambda t, c, f: chain(t, front=np.exp(f * warm(c) * c.cable_log_loss[:, None]))),
    ("compression", {}, 0.1, lambda t, _c, f: chain(t, front=compressed(t, f), rcu=compressed(t, f))),
    ("adc_jitter", {}, 0.1, lambda t, c, f: chain(t, adc=jittered(t, c, f))),
    ("isotropic_level", {}, 0.2, lambda t, c, f: chain(t, sky=f * c.mean_sky[:, None])),
    (
        "solar_emission", {"spectral_index": 1.5}, 0.2,
        lambda t, c, f: chain(t, sky=f * at_55(c) * (c.frequency_mhz / 55) ** 1.5 * c.sun_response),
    ),
    (
        "ionospheric_absorption", {"exponent": 0.5}, 0.1,
        lambda t, c, f: chain(
            t, sky=t.sky * np.expm1(-f * (30 / c.frequency_mhz) ** 2 * np.sqrt(np.sin(c.sun_altitude).clip(0))[:, None])
        ),
    ),
    (
        "rfi_broadband", {"spectral_index": -2.0, "utc_h": [6, 18]}, 0.2,
        lambda t, c, f: chain(t, sky=f * at_55(c) * (c.frequency_mhz / 55) ** -2.0 * shown(c, 6, 18)),
    ),
    (
        "rfi_line", {"frequency_mhz": 60.0, "width_mhz": 2.0, "utc_h": [6, 18]}, 0.2,
        lambda t, c, f: chain(
            t, adc=f * chain(t).mean(axis=1, keepdims=True) * 0.5 ** (c.frequency_mhz - 60) ** 2 * shown(c, 6, 18)
        ),
    ),
    ("dipole_swap", {}, 0.3, lambda t, _c, f: chain(t, sky=f * (t.sky[::-1] - t.sky))),
    ("lst_offset", {}, 0.5, lambda t, c, f: chain(t, sky=c.sky_at(c.lst_hours + f) - t.sky)),
    (
        "point_source", {"source": "Cas A"}, 0.5,
        lambda t, c, f: chain(t, sky=t.sky * 0.1 * f * np.sin(c.lst_hours + 3)[:, None]),
    ),
    (
        "filter_shift", {"follows": "temperature"}, 0.01,
        lambda t, c, f: chain(
            t, *[0, 0], *[moved(c, np.log(c.receiver_gain), c.frequency_mhz * (1 + f * warm(c)))] * 2
        ),
    ),
    (
        "resonance_shift", HOT, 0.5,
        lambda t, c, f: chain(t, front=moved(c, fitted_log_gain(t, c), c.frequency_mhz - f * warm(c))),
    ),
    (
        "resonance_width", HOT, 0.02,
        lambda t, c, f: chain(
            t, front=moved(c, fitted_log_gain(t, c), 58 + (c.frequency_mhz - 58) * np.exp(-f * warm(c)))
        ),
    ),
]  # fmt: skip


def test_ln_a_is_smoothed_by_the_spline_of_its_own_values():
    channels, values = np.arange(30.0, 81.0), np.random.default_rng(1).normal(size=51)
    expected = make_smoothing_spline(channels, values, lam=STIFFNESS)(channels)
    np.testing.assert_allclose(smoother(tuple(channels)) @ values, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("name", "law", "size", "expected"), LAWS, ids=[one[0] for one in LAWS])
def test_a_cause_acts_by_its_equation(name, law, size, expected, terms, conditions):
    cause = replace(conditions, sky_ratio={**conditions.sky_ratio, "Cas A": lambda f: 1 + 0.1 * f * _wave(conditions)})
    found = NAMED[name].apply(terms, cause, Template(law), size).power()
    wanted = np.broadcast_to(expected(terms, conditions, size), found.shape)
    # curves are read between channels by a spline with other ends
    inside, tolerance = (slice(8, -8), 1e-3) if name.startswith(("filter", "resonance")) else (slice(None), 1e-9)
    np.testing.assert_allclose(found[..., inside], wanted[..., inside], rtol=tolerance)


def _wave(c: Conditions) -> np.ndarray:
    return np.sin(c.lst_hours + 3)[:, None] * np.ones((2, 1, 1))


@pytest.mark.parametrize("name", ["resonance_shift", "resonance_width"])
def test_the_circuit_moves_as_it_is_told(name, conditions):
    """Its half-power points, found by scipy's root of the circuit's own gain, move by the size."""
    amount = 0.02
    circuit, grid = ResonanceCircuit(), np.arange(40.0, 75.0, 0.001)
    dense = replace(conditions, frequency_mhz=grid)

    def ends(log_gain):
        above = grid[log_gain > log_gain.max() - np.log(2.0)]
        return above[0], above[-1]

    log_gain = np.log(circuit.gain(grid))
    before, after = ends(log_gain), ends(log_gain + NAMED[name].of_circuit(dense, np.array(amount)))
    moves = np.mean(after) - np.mean(before) if name == "resonance_shift" else np.log(np.ptp(after) / np.ptp(before))
    assert moves == pytest.approx(amount, rel=0.1)  # first order, on a grid of 1 kHz


def test_a_later_temperature_is_that_of_the_fitted_day(conditions):
    hours = np.linspace(0, 24 * 200, 200)

    def warm_at(late):
        return 10 + 5 * np.cos(2 * np.pi * (hours - late) / 24)

    own = replace(
        conditions, utc_hours=hours % 24, time_unix=1.39e9 + 3600 * hours, covariates={"temperature_c": warm_at(0)}
    )
    np.testing.assert_allclose(10 * own.warmth(2.0)[:, 0] + 10.0, warm_at(2), atol=1e-6)


@pytest.mark.parametrize("memory_h", [6.0, 24.0])
def test_a_body_with_a_memory_follows_the_day_as_its_equation_says(memory_h, conditions):
    """A gain with a memory of 30 h was said to be 2.5 h late, and a fifth too small."""
    assert Template({"memory_h": 6.0}) in NAMED["gain_temperature"].finer_templates(conditions, Template())
    hours = np.random.default_rng(0).uniform(0.0, 24 * 200, 200)
    often = np.arange(-24 * 20, 24 * 201, 0.05)
    air = 10 + 5 * np.cos(2 * np.pi * often / 24) - np.sin(4 * np.pi * often / 24)
    body = [10.0]
    for now in air[1:]:
        body.append(body[-1] + (now - body[-1]) * 0.05 / memory_h)
    own = replace(
        conditions,
        utc_hours=hours % 24,
        time_unix=1.39e9 + 3600 * hours,
        covariates={"temperature_c": np.interp(hours, often, air)},
    )
    np.testing.assert_allclose(10 * own.warmth(0.0, memory_h)[:, 0] + 10.0, np.interp(hours, often, body), atol=0.03)


def test_a_ratio_is_that_of_the_sky_computed_anew():
    """Widths of the pattern and sources are linear in the size; what is computed at one size holds at another."""
    instrument = load_instrument("lofar-superterp").at_station("CS002")
    lst = np.array([1.0, 13.0])
    own, wider = vary_sky_power(instrument), vary_sky_power(instrument, zenith_gain_fraction=0.05)
    found = sky_ratios(instrument)["pattern_width"].at(["X"], lst)(np.array(0.05))
    np.testing.assert_allclose(found[0], wider.at("X", lst) / own.at("X", lst), rtol=2e-4)
