"""Modules for NuRadioReco pipelines: the calibration in effect of every channel's own path, and the noise that it sees.

The first stands in the place of NuRadioReco's stationGalacticCalibrator, which has one curve for all channels and
scales each to a mean Galaxy; the second in that of one recorded trace for all channels and hours. Nothing of
NuRadioReco is imported: events, stations, channels and the detector are used as its modules do (version 3.1.0).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from lbacal.client import Client
from lbacal.voltages import calibrate_trace
from lbacal_core.curves.curves import OK
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats

if TYPE_CHECKING:
    from astropy.table import QTable

MHZ_OF_THEIR_UNIT = 1e3
"""NuRadioReco counts frequencies in GHz."""
ARM_TOLERANCE_DEG = 5.0
ARMS_OF_LOFAR = {"X": 45.0, "Y": 135.0}
"""Azimuths of the arms by letter, as `lofar-superterp` names them."""
Path = tuple[str, int, str]
ABSENT = "no calibration is in effect"


def path_of_lofar(station: Any, channel: Any, detector: Any) -> Path:
    """Station, antenna and dipole of a LOFAR channel: CS and its number, half of the receiver, the arm's letter.

    The letter is that of the arm as the detector says it points, never that of the receiver's number.
    """
    number, receiver = int(station.get_id()), int(channel.get_id()) % 1000
    east_to_north = detector.get_antenna_orientation(station.get_id(), channel.get_id())[1]
    azimuth = (90.0 - math.degrees(east_to_north)) % 180.0
    for letter, arm in ARMS_OF_LOFAR.items():
        if abs((azimuth - arm + 90.0) % 180.0 - 90.0) < ARM_TOLERANCE_DEG:
            return f"CS{number:03d}", receiver // 2, letter
    expected = " or ".join(f"{arm:g} deg ({letter})" for letter, arm in ARMS_OF_LOFAR.items())
    raise BadInputError(f"channel {channel.get_id()}", f"an arm at {expected}", f"{azimuth:g} deg")


def _channels_of(station: Any, detector: Any, path_of: Callable[[Any, Any, Any], Path]) -> dict[Path, Any]:
    return {path_of(station, channel, detector): channel for channel in station.iter_channels()}


def _clock_of(channels: Iterable[Any]) -> tuple[float, int]:
    """Sampling rate, GHz, and number of samples of all channels."""
    found = {(channel.get_sampling_rate(), len(channel.get_trace())) for channel in channels}
    if len(found) != 1:
        raise BadInputError("channels of a station", "one sampling rate and length", f"{len(found)} of them")
    return found.pop()


class EffectiveCalibrator:
    """Brings every channel of an event from ADC units to volts with the C in effect for its path at that time.

    Parameters
    ----------
    client
        Whom to ask; by default the server of `LBACAL_URL`, or the cache of `LBACAL_CACHE`.
    path_of
        Station, antenna and dipole of (station, channel, detector).
    as_of, tag
        Pin the answer, so that a reconstruction can be repeated.
    """

    def __init__(
        self,
        client: Client | None = None,
        path_of: Callable[[Any, Any, Any], Path] = path_of_lofar,
        as_of: Any = None,
        tag: str | None = None,
    ) -> None:
        self._client = client or Client()
        self._path_of = path_of
        self._known = {"as_of": as_of, "tag": tag}

    def __repr__(self) -> str:
        """One line."""
        pinned = "".join(f", {name} {value}" for name, value in self._known.items() if value is not None)
        return f"<EffectiveCalibrator: ADC units to V by the C in effect for the path of each channel{pinned}>"

    def begin(self) -> None:
        """Prepare nothing; modules of NuRadioReco have this function."""

    def run(self, event: Any, detector: Any) -> dict[int, str]:
        """Calibrate the channels of all stations of an event; one question a station.

        Returns
        -------
        What is to be known of each channel, by its id: ``ok``, or why it is uncertain. A channel for whose path
        nothing is in effect is left in ADC units, and said to be so.
        """
        said = {}
        for station in event.get_stations():
            channels = _channels_of(station, detector, self._path_of)
            names = {name for name, _, _ in channels}
            found = {name: self._client.effective(name, at=station.get_station_time(), **self._known) for name in names}
            for path, channel in channels.items():
                said[channel.get_id()] = self._calibrate(channel, found[path[0]].of_path(*path))
        return said

    def _calibrate(self, channel: Any, rows: QTable) -> str:
        if len(rows) == 0:
            return ABSENT
        rate = channel.get_sampling_rate()
        calibrated = calibrate_trace(channel.get_trace(), rate * MHZ_OF_THEIR_UNIT, rows)
        channel.set_trace(calibrated.samples, rate)
        return str(rows["flag_reason"][0]) or OK

    def end(self) -> None:
        """Close the connection."""
        self._client.close()


class NoiseAdder:
    """Adds what the Galaxy and the electronics give every channel at the time of its station.

    Each channel gets noise of the spectrum that its path has then, ADC units; an event's gain is drawn, in part common
    to the channels of a station.

    Parameters
    ----------
    predict
        `lbacal.predict`, which asks the server of `LBACAL_URL`, or ``partial(lbacal.predict, found)`` of a fit.
    client
        Whom to ask for C where noise is wanted in V at the antenna's output, as simulated signals are; None for ADC
        units.
    path_of
        Station, antenna and dipole of (station, channel, detector).
    seed
        Seed of the noise of all events that follow.
    temperature
        Outside temperature of (event), deg C; None where it is not known.
    """

    def __init__(
        self,
        predict: Callable[..., Any] | None = None,
        client: Client | None = None,
        path_of: Callable[[Any, Any, Any], Path] = path_of_lofar,
        seed: int = 1,
        temperature: Callable[[Any], float | None] = lambda _: None,
    ) -> None:
        from lbacal.analysis import predict as forward

        self._forward, self._predict = forward, predict or forward.predict
        self._client, self._path_of, self._temperature = client, path_of, temperature
        self._rng = np.random.default_rng(seed)

    def __repr__(self) -> str:
        """One line."""
        return f"<NoiseAdder: noise of the path of each channel, {'ADC units' if self._client is None else 'V'}>"

    def begin(self) -> None:
        """Prepare nothing; modules of NuRadioReco have this function."""

    def run(self, event: Any, detector: Any) -> None:
        """Add noise to the traces of all channels of an event; those of a station have the same length and rate.

        Raises
        ------
        RefusedError
            Where no calibration is in effect for a path: no channel is left without noise unsaid.
        """
        for station in event.get_stations():
            at, channels = station.get_station_time(), _channels_of(station, detector, self._path_of)
            asked = {"at": at, "temperature": self._temperature(event)}
            told = [self._predict(station=name, antenna=k, dipole=letter, **asked) for name, k, letter in channels]
            rate, samples = _clock_of(channels.values())
            drawn = self._forward.draw_traces(told, samples, rate * MHZ_OF_THEIR_UNIT, self._rng)
            for (path, channel), noise in zip(channels.items(), drawn, strict=True):
                channel.set_trace(channel.get_trace() + self._in_volts(noise, rate, path, at), rate)

    def _in_volts(self, noise: Floats, rate: float, path: Path, at: Any) -> Floats:
        if self._client is None:
            return noise
        rows = self._client.effective(path[0], at=at).of_path(*path)
        return calibrate_trace(noise, rate * MHZ_OF_THEIR_UNIT, rows).samples

    def end(self) -> None:
        """Close the connection."""
        if self._client is not None:
            self._client.close()
