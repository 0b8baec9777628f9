"""`lbacal.predict`: what a path should see at an instant, from a fit, a simulation alone, or what is in effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from astropy import units as u
from astropy.constants import k_B
from astropy.table import QTable

from lbacal.analysis.fit import Calibration
from lbacal.analysis.instrument import Described, simulation_of
from lbacal.analysis.result import Result
from lbacal.client import Client
from lbacal.curve_table import SHOWN_NAMES
from lbacal.instants import format_instant, format_time, parse_instant
from lbacal.pages.chart import BAND, LINE, Chart, Series
from lbacal.pages.curves import FREQUENCY
from lbacal.units import convert_number, make_rng
from lbacal.with_model import Extended, read_model
from lbacal_core.calibration.prediction import EventNoise
from lbacal_core.calibration.spreads import carry_to_path
from lbacal_core.discovery.forward import predict as predict_path
from lbacal_core.discovery.forward import predict_alone
from lbacal_core.errors import BadInputError, UnknownNameError, require_kind
from lbacal_core.grids import Floats
from lbacal_core.traces.noise import draw_noise

LEAST_GAIN = 0.01
SHOWN = 6
"""Frequencies of the printed table, from the lowest channel to the highest."""


@dataclass(frozen=True, repr=False, kw_only=True)
class Prediction(Result):
    """The expected power of a path: `content` is the answer of ``GET /v1/predictions``.

    Attributes
    ----------
    power
        Expected power, shape (freq,).
    covariance
        How well it is known: its covariance by calibration and sky, shape (freq, freq).
    event_covariance
        That of the recorded power of one event about it: its gain and its radiometer noise.
    """

    content: Mapping[str, Any]
    power: Floats
    covariance: Floats
    event_covariance: Floats

    def draw_events(self, count: int, seed: int = 1) -> Floats:
        """Recorded power of single events, shape (event, freq), with the right spectrum and correlation along it.

        Events are independent of each other, and of those of other antennas: `draw_together` draws what antennas share.
        """
        return draw_together([self], count, seed)[0]


def draw_together(predictions: Sequence[Prediction], count: int, seed: int = 1) -> list[Floats]:
    """Recorded power of the same events in several paths, shape (event, freq) for each of them.

    The gain of an event is in part common to the paths of a station, as measured or as published. A little of the
    sky's own noise, which near antennas share too, is not.

    Examples
    --------
    >>> import lbacal
    >>> at = {"station": "CS002", "dipole": "X", "at": "2014-05-01"}
    >>> paths = [lbacal.predict("lofar-superterp", antenna=antenna, **at) for antenna in (1, 2)]
    >>> one, other = lbacal.draw_together(paths, 1000)
    >>> bool(np.corrcoef(one.mean(axis=1), other.mean(axis=1))[0, 1] > 0.2)
    True
    """
    if not isinstance(count, int | np.integer) or count < 1:
        raise BadInputError("count", "a number of events, 1 or more", repr(count))
    rng = make_rng(seed)
    gains = _draw_stations(predictions, count, rng)
    return [
        np.asarray(one.power * _noise_of(one.content).draw(count, rng, gains[one.content["station"]]))
        for one in predictions
    ]


def draw_traces(
    predictions: Sequence[Prediction], samples: int, sample_rate_mhz: float = 200.0, rng: np.random.Generator | int = 1
) -> list[Floats]:
    """Noise of one event in several paths in the time domain, shape (sample,) for each of them.

    In ADC units; in V across 50 Ohm, in front of the converter, where the prediction is of an instrument alone. The
    gain of the event is drawn as in `draw_together`. `lbacal_core.traces.noise.draw_noise` says the convention.

    Examples
    --------
    >>> import lbacal
    >>> seen = lbacal.predict("lofar-superterp", at="2014-05-01", station="CS002", antenna=1, dipole="X")
    >>> [trace.shape for trace in lbacal.draw_traces([seen], samples=4096)]
    [(4096,)]
    """
    rng = rng if isinstance(rng, np.random.Generator) else make_rng(rng)
    gains, traces = _draw_stations(predictions, 1, rng), []
    for one in predictions:
        gain = _noise_of(one.content).draw_gains(1, rng, gains[one.content["station"]])
        frequency = np.array(one.content["frequency_mhz"], dtype=float)
        # a gain of 5 % is never as far off as this, one of an oscillating path may be
        traces.append(draw_noise(frequency, one.power * np.maximum(gain, LEAST_GAIN), samples, sample_rate_mhz, rng)[0])
    return traces


def _draw_stations(predictions: Sequence[Prediction], count: int, rng: np.random.Generator) -> dict[str, Floats]:
    """Standard normal numbers of events that the paths of a station have in common, by its name."""
    if isinstance(predictions, Prediction):
        raise BadInputError("predictions", "a list of them", "one")
    if len(instants := sorted({one.content["at"] for one in predictions})) > 1:
        raise BadInputError("predictions", "those of one instant", " and ".join(instants))
    return {name: rng.standard_normal(count) for name in sorted({one.content["station"] for one in predictions})}


def predict(
    source: Calibration | Described | None = None,
    *,
    at: Any,
    station: str,
    antenna: int,
    dipole: str,
    temperature: Any = None,
    with_: Extended = None,
) -> Prediction:
    """Predict the spectrum of an antenna with its covariance, contributions, SEFD, and noise of events.

    Parameters
    ----------
    source
        A `Calibration`: its curve of the path, whose spectra say how events scatter, or that of its station or the
        array through the path's cable; or an instrument by itself, as in `lbacal.fit`; or None for the calibration in
        effect, which the server of `LBACAL_URL` answers with.
    at
        An astropy Time, a date, a datetime (naive = UTC) or ISO 8601 text.
    temperature
        Outside temperature, deg C or a Quantity, for adopted causes that follow it.
    with_
        What an instrument by itself is extended by, as in `lbacal.fit`.

    Examples
    --------
    >>> import lbacal
    >>> where = {"station": "CS002", "antenna": 1, "dipole": "X"}
    >>> alone = lbacal.predict("lofar-superterp", at="2014-05-01T12:00:00Z", **where)
    >>> alone.table["power"].unit
    Unit("W / MHz")
    >>> seen = lbacal.predict(at="2014-05-01T12:00:00Z", **where)  # doctest: +SKIP
    >>> seen.draw_events(100).shape  # doctest: +SKIP
    (100, 51)
    """
    celsius = None if temperature is None else convert_number(temperature, u.deg_C)
    path: dict[str, Any] = {"station": station, "antenna": antenna, "dipole": dipole}
    for name, kind, expected in (
        ("station", str, "a name"), ("antenna", int | np.integer, "a number"), ("dipole", str, "a letter"),
    ):  # fmt: skip
        require_kind(name, path[name], kind, expected)
    path["antenna"] = antenna = int(antenna)
    instant = parse_instant("at", format_time(at))
    if with_ is not None and (source is None or isinstance(source, Calibration)):
        raise BadInputError("with_", "an instrument by itself: a calibration has its causes", "a calibration")
    if source is None:
        with Client() as client:
            return _make(client.get("/v1/predictions", **path, at=format_instant(instant), temperature_c=celsius))
    if not isinstance(source, Calibration):
        simulation = simulation_of(source)
        simulation = simulation if with_ is None else simulation.with_causes(read_model(with_, "with_"))
        found = predict_alone(simulation, station, antenna, dipole, 1e-6 * instant, celsius)
        return _make({"at": format_instant(instant), **found.as_dict()})
    curves = {one.path: k for k, one in enumerate(source.report.curves)}
    owners = ((station, antenna, dipole), (station, None, dipole), (None, None, dipole))
    at_curve = next((curves[owner] for owner in owners if owner in curves), None)
    if at_curve is None:
        wanted, names = f"{station} antenna {antenna} {dipole}", [one.name for one in source.report.curves]
        raise UnknownNameError("curve", wanted, names[:SHOWN_NAMES])
    curve, noise = source.report.curves[at_curve], None
    is_own = curve.antenna is not None
    if not is_own:
        source.instrument.cable_of(station, antenna, 1e-6 * instant)
        curve = carry_to_path(curve, source.report.chains[at_curve], station, antenna, dipole, 1e-6 * instant).curve
    elif curve.c is not None:
        noise = EventNoise.measured(curve, source.without_causes, source.simulation, source.report.curves)
    named = None if curve.covariance is None else source.report.budgets.get(str(curve.covariance.budget))
    found = predict_path(curve, source.with_sizes, 1e-6 * instant, noise, named, celsius, is_own=is_own)
    return _make({"at": format_instant(instant), **found.as_dict()})


def _make(content: Mapping[str, Any]) -> Prediction:
    nu, power, sefd, sefd_sigma = (
        np.array(content[name], dtype=float) for name in ("frequency_mhz", "power", "sefd_jy", "sefd_sigma")
    )
    covariance = np.array(content["covariance"], dtype=float)
    of_event = _noise_of(content).covariance() * np.outer(power, power)
    sigma, event_sigma = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(of_event))
    unit = u.Unit("adu2 / (Ohm MHz)" if content["adc"] else "W / MHz")
    words = {unit: "ADC²/Ω/MHz" if content["adc"] else "W/MHz"}
    columns = {"frequency": nu * u.MHz, "power": power * unit, "sigma": sigma * unit, "event_sigma": event_sigma * unit}
    for name, one in content["contributions"].items():
        columns[f"{name}_fraction"] = np.array(one["fraction"]) * u.dimensionless_unscaled
        if one["kelvin"] is not None:
            columns[f"{name}_temperature"] = np.array(one["kelvin"]) * u.K
    columns |= {"sefd": sefd * u.Jy, "sefd_sigma": sefd_sigma * u.Jy}
    sensitivity = (2.0 * k_B / columns["sefd"]).to(u.m**2 / u.K)
    columns |= {"a_eff_t_sys": sensitivity, "a_eff_t_sys_sigma": sensitivity * sefd_sigma / sefd}
    at = np.unique(np.linspace(0, nu.size - 1, SHOWN).round().astype(int))
    adc, shown = content["adc"], []
    if adc is not None:
        low, high = adc["band_mhz"]
        shown = [f"the ADC shows {adc['rms']:.3g} ± {adc['sigma']:.2g} counts r.m.s. by {low:g}-{high:g} MHz"]
    write = partial(write_prediction, content)
    path, when = f"{content['station']} {content['antenna']} {content['dipole']}", f"at {content['at']}"
    known = {"one event": event_sigma, "known to": sigma}
    return Prediction(
        title=f"{path} {when}, LST {content['lst_h']:.2f} h",
        rows=[
            [f"{name}, {words.get(one.unit, one.unit)}".rstrip(", "), *(f"{one[k].value:.4g}" for k in at)]
            for name, one in columns.items()
        ],
        notes=[*shown, f"noise of an event: {content['noise']['source']}", *content["notes"]],
        charts=lambda: [_draw(f"{path} {when}", nu, power, known, words[unit])],
        as_dict=lambda: content,
        as_table=lambda: QTable(columns),
        more={".h5": write, ".hdf5": write},
        content=content,
        power=power,
        covariance=covariance,
        event_covariance=of_event,
    )


def _noise_of(content: Mapping[str, Any]) -> EventNoise:
    noise, size = content["noise"], len(content["power"])
    shared, own = np.reshape(noise["shared"], (-1, size)), np.array(noise["own"], dtype=float)
    return EventNoise(shared, own, noise["source"], noise["common"])


def write_prediction(content: Mapping[str, Any], path: Path, events: Floats | None = None) -> None:
    """Write P.h5: what the answer holds under its names, and single events, shape (event, freq), as `realisations`."""
    with h5py.File(path, "w") as root:
        _write_group(root, content)
        if events is not None:
            root["realisations"] = events


def _write_group(group: h5py.Group, content: Mapping[str, Any]) -> None:
    for name, value in content.items():
        if isinstance(value, Mapping):
            _write_group(group.create_group(name), value)
        elif isinstance(value, list) and not any(isinstance(one, str) for one in value):
            group[name] = np.array(value, dtype=float)
        elif value is not None:
            group.attrs[name] = "; ".join(value) if isinstance(value, list) else value


def _draw(title: str, nu: Floats, power: Floats, bands: Mapping[str, Floats], unit: str) -> Chart:
    """The expected power with what one event scatters about it, and how well it is known."""
    series = [
        Series(BAND, nu, low=power - sigma, high=power + sigma, name=f"{name}, 68 %", colour=k)
        for k, (name, sigma) in enumerate(bands.items(), start=1)
    ]
    series.append(Series(LINE, nu, power, name="expected"))
    return Chart(title, FREQUENCY, f"expected power ({unit})", series, ("linear", "log"))
