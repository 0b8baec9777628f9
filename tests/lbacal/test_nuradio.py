"""Classes with the methods of NuRadioReco's framework (3.1.0) that the module calls; that package needs a compiler."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from astropy.time import Time

from lbacal.client import make_table
from lbacal.nuradio import ABSENT, EffectiveCalibrator, path_of_lofar
from lbacal_core.errors import BadInputError

EAST_TO_NORTH = {"X": math.radians(225.0), "Y": math.radians(135.0)}
"""As NuRadioReco's detector writes the arms: from east through north."""


@dataclass
class Channel:
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


@dataclass
class Station:
    channels: list[Channel]

    def get_id(self) -> int:
        return 2

    def get_station_time(self) -> Time:
        return Time("2014-05-01")

    def iter_channels(self) -> Any:
        return iter(self.channels)


@dataclass
class Event:
    stations: list[Station]

    def get_stations(self) -> list[Station]:
        return self.stations


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
    module.begin()
    said = module.run(Event([Station(channels)]), Detector())
    module.end()
    assert [name for name, _ in client.asked] == ["CS002"]
    assert client.asked[0][1]["tag"] == "paper"
    spectrum, inside = np.fft.rfft(pulse), np.arange(154, 404)  # 30.1 to 78.7 MHz
    for channel, level in zip(channels, (2e-5, 1e-5, 4e-5, 3e-5), strict=False):
        np.testing.assert_allclose(np.fft.rfft(channel.trace)[inside], level * spectrum[inside], rtol=1e-9)
    np.testing.assert_array_equal(channels[4].trace, pulse)
    assert list(said.values()) == ["ok", "ok", "held: the nearest in time answers", "ok", ABSENT]


def test_the_letter_is_that_of_the_arm_not_of_the_receiver() -> None:
    station, even, odd = Station([]), Channel(2000034, np.zeros(2)), Channel(2000035, np.zeros(2))
    assert path_of_lofar(station, even, Detector()) == ("CS002", 17, "Y")
    assert path_of_lofar(station, odd, Detector()) == ("CS002", 17, "X")


def test_an_arm_that_lofar_does_not_have_is_refused() -> None:
    class Turned(Detector):
        def get_antenna_orientation(self, _station: int, _channel: int) -> list[float]:
            return [0.0, 0.0]

    with pytest.raises(BadInputError, match=r"an arm at 45 deg \(X\) or 135 deg \(Y\), found 90 deg"):
        path_of_lofar(Station([]), Channel(2000034, np.zeros(2)), Turned())
