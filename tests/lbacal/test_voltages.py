from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from astropy import units as u
from astropy.time import Time

import lbacal
from lbacal.client import make_table
from lbacal.nuradio import ABSENT, EffectiveCalibrator, NoiseAdder, path_of_lofar
from lbacal.voltages import curve_of
from lbacal_core.errors import BadInputError

CHANNELS = [30.0, 31.0, 32.0]


def answer(**changes: object) -> dict[str, Any]:
    curve = {
        "station": "CS002", "antenna": 17, "dipole": "X", "frequency_mhz": CHANNELS, "c": [1e-5, 2e-5, 3e-5],
        "c_sigma_stat": [1e-7, 2e-7, 3e-7], "c_sigma_sys": None, "factor": [1.0] * 3, "flag": ["ok"] * 3,
        "flag_reason": None, "calibration": "abc", "answered_by": "antenna", "valid": {"from": "2014", "to": None},
    } | changes  # fmt: skip
    return {"curves": [curve], "at": "2014-05-01", "as_of": None, "missing": []}


def test_a_trace_is_calibrated_with_what_effective_answers() -> None:
    time = np.arange(2000) / 200.0
    found = lbacal.calibrate_trace(np.cos(2 * np.pi * 31.0 * time), 200.0, make_table(answer()))
    assert found.samples == pytest.approx(2e-5 * np.cos(2 * np.pi * 31.0 * time), abs=1e-12)
    assert repr(found) == "<CalibratedTrace: 2000 samples in V at 200 MHz, known in 30-32 MHz>"
    inside = found.is_inside
    assert found.c_sigma[inside] == pytest.approx(0.01 * found.c[inside])


def test_samples_are_adc_units_and_a_rate_may_have_any_unit_of_frequency() -> None:
    samples, table = np.random.default_rng(1).normal(size=2000), make_table(answer())
    plain = lbacal.calibrate_trace(samples, 200.0, table)
    for given, rate in ((samples << u.adu, 0.2 * u.GHz), (samples << u.one, 200e6 * u.Hz)):
        found = lbacal.calibrate_trace(given, rate, table)
        assert type(found.samples) is np.ndarray
        assert found.samples == pytest.approx(plain.samples, rel=1e-9)
        assert found.sample_rate_mhz == pytest.approx(200.0)


@pytest.mark.parametrize(
    ("samples", "rate", "said"),
    [
        (
            np.ones(2000) * u.V,
            200.0,
            "samples: expected ADC units: adu, or numbers without a unit, found a Quantity in V",
        ),
        (np.ones(2000) * 1j, 200.0, "samples: expected real numbers, found complex128"),
        ("samples.npy", 200.0, "samples: expected real numbers, found str"),
        ([1.0, math.nan, 1.0], 200.0, "samples: expected finite numbers, found 1 NaN or infinite"),
        (np.ones(2000), 5.0 * u.ns, "sample_rate_mhz: expected one in MHz, or a number"),
        (np.ones(2000), "fast", "sample_rate_mhz: expected one in MHz, or a number"),
        (np.ones(2000), 200e6, "up to 1e.08 MHz: is the sampling rate in MHz, not in Hz or GHz?"),
    ],
)
def test_a_trace_that_is_none_is_refused_with_what_is_wrong(samples: Any, rate: Any, said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        lbacal.calibrate_trace(samples, rate, make_table(answer()))


def test_the_covariance_of_one_path_is_found_among_the_rows_of_many() -> None:
    def covariance(size: float) -> dict[str, object]:
        statistical = {"factor": [[0.0, 0.0, 0.0]], "diagonal": [1e-4] * 3}
        return {"statistical": statistical, "systematic": {"budget": "b", "own": [[size, 0.0, -size]]}}

    term = {"name": "level", "source": "a test", "is_of_gain": False, "vectors": {"X": [[0.1, 0.1, 0.1]]}}
    many = answer(covariance=covariance(0.05))
    many["curves"] = [*answer(antenna=16, covariance=covariance(9.0))["curves"], *many["curves"]]
    many["budgets"] = {"b": {"frequency_mhz": CHANNELS, "terms": [term]}}
    table = make_table(many)
    found = lbacal.calibrate_trace(np.ones(2000), 200.0, table[table["antenna"] == 17])
    (low,), (high,) = (np.flatnonzero(found.frequency_mhz == mhz) for mhz in (30.0, 32.0))
    assert found.factors[:, low] @ found.factors[:, high] == pytest.approx(0.1**2 - 0.05**2)


def test_unknown_errors_are_not_taken_for_zero_errors() -> None:
    curve = curve_of(make_table(answer()))
    assert curve.c_sigma_sys is None
    assert curve.name == "CS002 antenna 17 X"


def test_rows_of_two_paths_are_refused() -> None:
    both = answer()
    both["curves"] = [*both["curves"], *answer(dipole="Y")["curves"]]
    with pytest.raises(BadInputError, match="2 paths"):
        curve_of(make_table(both))


def test_the_covariance_that_the_service_sends_reaches_the_trace() -> None:
    covariance = {
        "statistical": {"factor": [[0.01, 0.01, 0.01]], "diagonal": [0.0, 0.0, 0.0]},
        "systematic": {"budget": "b1", "own": []},
    }
    table = make_table(answer(covariance=covariance, c_sigma_sys=[1e-6, 2e-6, 3e-6]) | {"budgets": {}})
    curve = curve_of(table)
    assert curve.covariance is not None
    assert curve.covariance.factor.tolist() == [[0.01] * 3]
    # without the budget the systematic error is one number for all channels
    found = lbacal.calibrate_trace(np.random.default_rng(1).normal(size=2000), 200.0, table)
    assert found.errors == pytest.approx(np.array([[0.01] * 3, [0.1] * 3]))


EAST_TO_NORTH = {"X": math.radians(225.0), "Y": math.radians(135.0)}
"""As NuRadioReco's detector writes the arms: from east through north."""


@dataclass
class Channel:
    """As in NuRadioReco's framework (3.1.0): the methods that the module calls (`test_nuradio.py` has the package)."""

    number: int
    trace: np.ndarray

    def get_id(self) -> int:
        return self.number

    def get_trace(self) -> np.ndarray:
        return self.trace

    def set_trace(self, trace: np.ndarray, sampling_rate: float) -> None:
        assert sampling_rate == 0.2
        self.trace = trace

    def get_sampling_rate(self) -> float:
        return 0.2  # GHz


def station(*channels: Channel) -> Any:
    return SimpleNamespace(
        get_id=lambda: 2, get_station_time=lambda: Time("2014-05-01"), iter_channels=lambda: iter(channels)
    )


class Detector:
    def get_antenna_orientation(self, _station: int, channel: int) -> list[float]:
        # an even receiver is not X by its number: here it is the arm at 135 deg
        return [0.0, EAST_TO_NORTH["XY"[channel % 2 == 0]]]


@dataclass
class Answers:
    """Answers as a server does, and counts the questions."""

    answer: dict[str, Any]
    asked: list[tuple[str, Any]] = field(default_factory=list)

    def effective(self, station: str, **asked: Any) -> Any:
        self.asked.append((station, asked))
        return make_table(self.answer | {"missing": []})

    def close(self) -> None:
        self.answer = {}


def test_every_channel_of_an_event_gets_the_c_of_its_own_path(calibrations: dict[str, Any]) -> None:
    for k, curve in enumerate(calibrations["curves"]):
        curve["c"] = [None if c is None else (k + 1) * 1e-5 for c in curve["c"]]
    calibrations["curves"][3]["flag_reason"] = "held: the nearest in time answers"
    pulse = np.random.default_rng(1).normal(size=1024)
    channels = [Channel(2000000 + receiver, pulse) for receiver in (8, 9, 34, 35, 90)]
    client: Any = Answers(calibrations)
    module = EffectiveCalibrator(client, tag="paper")
    of_each = "ADC units to V by the C in effect for the path of each channel"
    assert repr(module) == f"<EffectiveCalibrator: {of_each}, tag paper>"
    adder = NoiseAdder(print), NoiseAdder(print, client)
    assert [repr(one)[-10:] for one in adder] == ["ADC units>", "hannel, V>"]
    module.begin()
    said = module.run(SimpleNamespace(get_stations=lambda: [station(*channels)]), Detector())
    module.end()
    assert [name for name, _ in client.asked] == ["CS002"]
    assert client.asked[0][1]["tag"] == "paper"
    spectrum, inside = np.fft.rfft(pulse), np.arange(154, 404)  # 30.1 to 78.7 MHz
    for channel, level in zip(channels, (2e-5, 1e-5, 4e-5, 3e-5), strict=False):
        np.testing.assert_allclose(np.fft.rfft(channel.trace)[inside], level * spectrum[inside], rtol=1e-9)
    np.testing.assert_array_equal(channels[4].trace, pulse)
    assert list(said.values()) == ["ok", "ok", "held: the nearest in time answers", "ok", ABSENT]


def test_the_letter_is_that_of_the_arm_not_of_the_receiver() -> None:
    even, odd = Channel(2000034, np.zeros(2)), Channel(2000035, np.zeros(2))
    assert path_of_lofar(station(), even, Detector()) == ("CS002", 17, "Y")
    assert path_of_lofar(station(), odd, Detector()) == ("CS002", 17, "X")


def test_an_arm_that_lofar_does_not_have_is_refused() -> None:
    turned = SimpleNamespace(get_antenna_orientation=lambda *_: [0.0, 0.0])
    with pytest.raises(BadInputError, match=r"an arm at 45 deg \(X\) or 135 deg \(Y\), found 90 deg"):
        path_of_lofar(station(), Channel(2000034, np.zeros(2)), turned)
