"""A module for NuRadioReco pipelines that applies the calibration in effect of every channel's own path.

It stands in the place of NuRadioReco's stationGalacticCalibrator, which has one curve for all channels and scales each
to a mean Galaxy. Nothing of NuRadioReco is imported: events, stations, channels and the detector are used as its
modules do (version 3.1.0).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from lbacal.client import Client
from lbacal.voltages import calibrate_trace
from lbacal_core.curves.curves import OK
from lbacal_core.errors import BadInputError

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

    def begin(self) -> None:
        """Nothing to prepare."""

    def run(self, event: Any, detector: Any) -> dict[int, str]:
        """Calibrate the channels of all stations of an event; one question a station.

        Returns
        -------
        What is to be known of each channel, by its id: ``ok``, or why it is uncertain. A channel for whose path
        nothing is in effect is left in ADC units, and said to be so.
        """
        said = {}
        for station in event.get_stations():
            channels = {self._path_of(station, channel, detector): channel for channel in station.iter_channels()}
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
