"""Run in an environment that has NuRadioReco: our modules and our table in a pipeline of its classes.

usage: python nuradio_pipeline.py FOLDER; writes FOLDER/found.npz.
"""

from __future__ import annotations

import shutil
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import NuRadioReco
from astropy.time import Time
from NuRadioReco.detector import detector as detectors
from NuRadioReco.framework.channel import Channel
from NuRadioReco.framework.event import Event
from NuRadioReco.framework.station import Station
from NuRadioReco.modules.LOFAR.stationGalacticCalibrator import stationGalacticCalibrator
from NuRadioReco.utilities import units

import lbacal
from lbacal.nuradio import EffectiveCalibrator, NoiseAdder, path_of_lofar
from lbacal.tables import mean_curve, write_nuradio

SAMPLES, RATE = 8192, 0.2 * units.GHz
AT = Time("2014-05-01T12:00:00")
EVENTS = 20
LOFAR_ERA_UNIX = 1_262_304_000


def make_event(detector: detectors.Detector) -> Event:
    """An event of station 2 with four channels that recorded nothing."""
    event, station = Event(0, int(AT.unix) - LOFAR_ERA_UNIX), Station(2)
    station.set_station_time(AT)
    for number in detector.get_channel_ids(2)[2:6]:
        channel = Channel(number)
        channel.set_trace(np.zeros(SAMPLES), RATE)
        station.add_channel(channel)
    event.set_station(station)
    return event


def traces_of(event: Event) -> np.ndarray:
    return np.array([channel.get_trace() for channel in event.get_station(2).iter_channels()])


def main(folder: Path) -> None:
    """Add noise to events, calibrate it by our module and by theirs with our table."""
    detector = detectors.Detector(json_filename="LOFAR/LOFAR.json", assume_inf=False, antenna_by_depth=False)
    detector.update(AT)
    found = lbacal.fit(lbacal.simulate("lofar-superterp", events=150, antennas=3), "lofar-superterp")
    answers = SimpleNamespace(effective=lambda *_, **__: found.table, close=lambda: None)
    adder, calibrator = NoiseAdder(partial(lbacal.predict, found)), EffectiveCalibrator(answers)
    events = [make_event(detector) for _ in range(EVENTS)]
    for event in events:
        adder.run(event, detector)
    adc = np.array([traces_of(event) for event in events])
    said = [list(calibrator.run(event, detector).values()) for event in events]
    volts = np.array([traces_of(event) for event in events])
    in_volts = make_event(detector)
    NoiseAdder(partial(lbacal.predict, found), answers).run(in_volts, detector)

    data = Path(NuRadioReco.__file__).parent / "utilities/data/galactic_calibration"
    shutil.copy(data / "LOFAR_LBA_Fourier_coefficients.txt", data / "OURS_Fourier_coefficients.txt")
    table = write_nuradio(mean_curve(dict(found.as_dict())))
    (data / "OURS_abs_calibration_curve.txt").write_bytes(table)
    module, event = stationGalacticCalibrator(experiment="OURS"), make_event(detector)
    NoiseAdder(partial(lbacal.predict, found)).run(event, detector)
    before = traces_of(event)
    module.begin()
    module.run(event, detector)
    paths = [path_of_lofar(event.get_station(2), one, detector) for one in event.get_station(2).iter_channels()]
    names = ("station", "antenna", "dipole")
    told = [lbacal.predict(found, at=AT, **dict(zip(names, path, strict=True))) for path in paths]
    np.savez(
        folder / "found.npz",
        adc=adc,
        volts=volts,
        said=said,
        in_volts=traces_of(in_volts),
        power=[one.power for one in told],
        common=[one.content["noise"]["common"] for one in told],
        c=[found.table.of_path(*path)["c"].to_value("V") for path in paths],
        before=before,
        after=traces_of(event),
        table=np.array([float(line) for line in table.decode().splitlines() if not line.startswith("#")]),
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
