"""The audit of drawn stations: every kind of fault named, nothing named where nothing is wrong.

A station has 12 to 256 antennas, is seen for a sidereal day, an hour or a minute, and stands in a drawn world: its sky,
its antenna and the gains of its integrations are not what the audit believes, nor are sky and antenna among the models
whose differences it takes for its errors. The fault lies in the record (letters,
cable, arms, latitude), in the clock, in the unit, or in one path; it is made from the recorded values here, and shares
no code with the audit. The parts `unlike` have antennas that differ by as much as measured ones do, or not at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lbacal_core.audit.audit import audit
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.sky.differences import DifferenceModels
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.nuisances import Nuisances
from lbacal_twin.settings import TwinSettings
from lbacal_twin.world import draw_world
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

SKIES, ANTENNAS = ("gsm408", "lfsm", "haslam", "maeda"), ("hamaker", "inverted-v")
STATION = "CS002"
LENGTHS = {"day": (23.93, 96), "hour": (1.0, 60), "minute": (1 / 60, 1)}
"""Hours, and spectra a path."""
SIZES, SIZE_CHANCES = (12, 24, 48, 96, 256), (0.3, 0.3, 0.2, 0.1, 0.1)
GAINS = (0.0, 0.01, 0.03)
"""Gain of an integration common to the station: a stable receiver to a trace buffer's event."""
PATH_KINDS = ("dead", "deaf", "oscillating", "clipped", "outlying")
SKY_KINDS = ("letters of all", "clock", "arms", "latitude", "longitude", "decibels", "volts")
KINDS = (*PATH_KINDS, "letters of one", "letters of a field", "cable", *SKY_KINDS)
CHECKS = {
    "letters of one": ("exchange",), "letters of a field": ("exchange",), "letters of all": ("exchange",),
    "latitude": ("place",), "longitude": ("place",), "decibels": ("unit",), "volts": ("unit",),
    "dead": ("dead", "deaf"), "deaf": ("dead", "deaf"), "clipped": ("clipped", "oscillating"),
}  # fmt: skip
"""Names that are right for a fault: a clipped path is loud, and only hours show that it is clipped."""
UNLIKE = (0.0, 0.05, 0.10, 0.17)
"""How unlike antennas of a station are, r.m.s. of ln P: as at the better and the worse of two stations of the LWA."""


def name_size(unlike: float) -> str:
    """How claims name it: per cent."""
    return f"{100.0 * unlike:.0f}"


ARMS_WITHIN_DEG, CLOCK_WITHIN_MIN, CLOCK_SIGMAS = 5.0, 2.0, 3.0


@dataclass(frozen=True)
class Faulty:
    """Spectra and record with a fault; the antenna, or what the clock or the arms should be found to be off by."""

    spectra: Spectra
    instrument: Instrument
    antenna: int | None = None
    size: float | None = None


@dataclass(frozen=True)
class Station:
    """Spectra and true record of a drawn station, and the models that the audit may know: none that was drawn."""

    world: str
    spectra: Spectra
    instrument: Instrument
    others: DifferenceModels


def draw_station(rng: np.random.Generator, length: str, mismatch: float = 0.0) -> Station:
    """Spectra of a station in a drawn world, and its record; its antennas are as unlike as `mismatch` says."""
    instrument = load_instrument("lofar-superterp")
    hours, count = LENGTHS[length]
    world = draw_world(rng, SKIES, ANTENNAS)
    others = DifferenceModels(
        tuple(sky for sky in DifferenceModels().skies if sky != world.sky),
        tuple(antenna for antenna in DifferenceModels().antennas if antenna != world.antenna),
    )
    gain, size = float(rng.choice(GAINS)), int(rng.choice(SIZES, p=SIZE_CHANCES))
    instrument = _enlarge(instrument, size)
    years = hours / 24 / 365.25
    settings = TwinSettings(
        start_unix=1.4e9 + rng.uniform(0, 3e7), years=years, events_per_year=round(count / years), stations=(STATION,),
        antennas=size, event_gain_common=gain, event_gain_path=gain / 3, radiometer=0.005,
    )  # fmt: skip
    sky_power, missing = world.sky_power(instrument), 0.01 if count > 1 else 0.0
    nuisances = Nuisances(departures=0.01, missing=missing, mismatch=mismatch)
    while True:
        try:
            spectra = simulate_campaign(settings, instrument, sky_power, rng, nuisances=nuisances).spectra
        except BadInputError:  # two of the random instants lie in one second, which names an event
            continue
        break
    return Station(world.label, spectra, instrument, others)


def _enlarge(instrument: Instrument, antennas: int) -> Instrument:
    """The record of a station with at least so many antennas; what it lacks has its cables in turn."""
    records = [record for record in instrument.antennas if record.station == STATION]
    records += [replace(records[k % len(records)], antenna=k) for k in range(len(records), antennas)]
    return replace(instrument, antennas=tuple(records))


def hide(kind: str, spectra: Spectra, instrument: Instrument, rng: np.random.Generator) -> Faulty:
    """Make something wrong: with one path, with letters, or with the record, the clock or the unit."""
    antenna = int(rng.choice(np.unique(spectra.antenna)))
    if kind in PATH_KINDS:
        rows = (spectra.antenna == antenna) & (spectra.dipole == str(rng.choice(["X", "Y"])))
        return Faulty(replace(spectra, power=_break(kind, spectra, rows, rng)), instrument, antenna)
    if kind.startswith("letters"):
        of_kind = {"letters of one": spectra.antenna == antenna, "letters of a field": spectra.antenna % 2 == 1}
        other = np.where(spectra.dipole == "X", "Y", "X")
        dipole = np.where(of_kind.get(kind, True), other, spectra.dipole)
        return Faulty(replace(spectra, dipole=dipole), instrument, antenna if kind == "letters of one" else None)
    if kind == "cable":
        return Faulty(spectra, _exchange_cable(instrument, antenna, rng), antenna)
    sign = float(rng.choice([-1, 1]))
    hours, turned = sign * float(rng.uniform(0.5, 11.0)), sign * float(rng.uniform(15.0, 70.0))
    arms = {dipole: azimuth + turned for dipole, azimuth in instrument.dipole_azimuth_deg.items()}
    return {
        "clock": Faulty(replace(spectra, time_unix=spectra.time_unix + 3600 * hours), instrument, size=-hours),
        "arms": Faulty(spectra, replace(instrument, dipole_azimuth_deg=arms), size=-turned),
        "latitude": Faulty(spectra, replace(instrument, latitude_deg=-instrument.latitude_deg)),
        "longitude": Faulty(spectra, replace(instrument, longitude_deg=-instrument.longitude_deg)),
        "decibels": Faulty(replace(spectra, power=10 * np.log10(spectra.power) + 200), instrument),
        "volts": Faulty(replace(spectra, power=spectra.power**0.5), instrument),
    }[kind]


def _exchange_cable(instrument: Instrument, antenna: int, rng: np.random.Generator) -> Instrument:
    records = []
    for record in instrument.antennas:
        others = [name for name in instrument.cables if name != record.cable]
        is_it = (record.station, record.antenna) == (STATION, antenna)
        records.append(replace(record, cable=str(rng.choice(others))) if is_it else record)
    return replace(instrument, antennas=tuple(records))


def _break(kind: str, spectra: Spectra, rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    power = spectra.power.copy()
    shape = power[rows].shape
    if kind == "oscillating":
        peak = rng.uniform(3.0, 30.0) * np.exp(-0.5 * ((spectra.frequency_mhz - rng.uniform(40, 70)) / 1.5) ** 2)
        power[rows] *= 1.0 + peak
    elif kind == "outlying":
        power[rows] *= np.exp(rng.choice([-1, 1]) * rng.uniform(0.5, 0.9))
    elif kind == "clipped":
        mean = power[rows].mean(axis=0)
        power[rows] = rng.uniform(4.0, 20.0) * mean * (power[rows] / mean) ** rng.uniform(0.1, 0.5)
    else:
        level = 1e-3 * power[rows].mean() if kind == "dead" else rng.uniform(0.8, 1.5) * power[rows].min()
        power[rows] = level * rng.normal(1.0, 0.01, shape)
    return power


LETTERS = tuple(kind for kind in KINDS if kind.startswith("letters"))
PATHS = ("dead", "deaf", "oscillating", "clipped")
RECORD = ("arms", "latitude", "longitude", "clock")


def tell_audit(length: str, seed: int) -> Row:
    """Draw a station, hide one fault in every second one, and audit it."""
    return tell_fault(length, seed, KINDS[seed // 2 % len(KINDS)] if seed % 2 else "nothing")


def tell_fault(length: str, seed: int, kind: str, mismatch: float = 0.0) -> Row:
    rng = np.random.default_rng([20261122, seed])
    station = draw_station(rng, length, mismatch)
    spectra, instrument = station.spectra, station.instrument
    faulty = Faulty(spectra, instrument) if kind == "nothing" else hide(kind, spectra, instrument, rng)
    report = audit(faulty.spectra, faulty.instrument, others=station.others)
    wrong = [line for line in report.lines if line.verdict == "wrong"]
    row: Row = {"kind": kind, "world": station.world, "antennas": int(np.unique(spectra.antenna).size)}
    row["outcome"] = "right" if kind == "nothing" and not wrong else "false" if kind == "nothing" else "silent"
    if kind == "nothing" or not wrong:
        return row | {"said": [line.sentence for line in wrong]}
    names = CHECKS.get(kind, (kind,))
    hits = [line for line in wrong if line.check in names and faulty.antenna in (None, *line.antennas)]
    if hits and faulty.size is not None:
        turn, unit = (24.0, 60.0) if kind == "clock" else (180.0, 1.0)
        row["off"] = unit * float(((hits[0].value or 0.0) - faulty.size + turn / 2) % turn - turn / 2)
        row["sigma"] = unit * float(hits[0].sigma or 0.0)
    row["outcome"] = "right" if hits and len(wrong) == len(hits) else "wrong"
    if len(wrong) == 1 and set(names) & set(wrong[0].candidates):
        row["outcome"] = "among"
    return row | {"said": [line.sentence for line in wrong]}


def tell_letters(seed: int) -> Row:
    """A sidereal day with exchanged letters: of an antenna, a field or all."""
    return tell_fault("day", seed, LETTERS[seed % len(LETTERS)])


def tell_paths(seed: int) -> Row:
    """A path that does not work, for a sidereal day, an hour and a minute in turn."""
    length = tuple(LENGTHS)[seed % len(LENGTHS)]
    return tell_fault(length, seed, PATHS[seed // len(LENGTHS) % len(PATHS)]) | {"length": length}


def tell_unlike(length: str, kinds: Sequence[str], seed: int) -> Row:
    """A station of antennas as unlike as each of `UNLIKE` in turn, and one of the kinds."""
    unlike, kind = UNLIKE[seed % len(UNLIKE)], kinds[seed // len(UNLIKE) % len(kinds)]
    return tell_fault(length, seed, kind, unlike) | {"unlike": unlike}


def _count(rows: Sequence[Row], outcome: str) -> tuple[int, int]:
    return sum(row["outcome"] == outcome for row in rows), len(rows)


def judge_common(rows: Sequence[Row]) -> list[Found]:
    clean = [row for row in rows if row["kind"] == "nothing"]
    faulty = [row for row in rows if row["kind"] != "nothing"]
    return [
        rate_of("false", *_count(clean, "false")),
        rate_of("wrong", *_count(faulty, "wrong")),
        rate_of("path", *_count([row for row in faulty if row["kind"] in PATHS], "right")),
    ]


def judge_paths(rows: Sequence[Row]) -> list[Found]:
    return [rate_of(length, *_count([row for row in rows if row["length"] == length], "right")) for length in LENGTHS]


def judge_unlike(rows: Sequence[Row]) -> list[Found]:
    """Judge the audit of healthy stations, by how unlike their antennas are."""
    found = []
    for unlike in UNLIKE:
        said = [" ".join(row["said"]) for row in rows if row["unlike"] == unlike]
        found.append(rate_of(f"false_{name_size(unlike)}", sum(bool(one) for one in said), len(said)))
        oscillates = sum("oscillates" in one for one in said)
        found.append(rate_of(f"oscillates_{name_size(unlike)}", oscillates, len(said)))
    return found


def judge_unlike_paths(rows: Sequence[Row]) -> list[Found]:
    by_size = {unlike: [row for row in rows if row["unlike"] == unlike] for unlike in UNLIKE}
    return [rate_of(f"path_{name_size(unlike)}", *_count(some, "right")) for unlike, some in by_size.items()]


def judge_day(rows: Sequence[Row]) -> list[Found]:
    return [*judge_common(rows), *judge_letters([row for row in rows if row["kind"] in LETTERS]), *judge_record(rows)]


def judge_record(rows: Sequence[Row]) -> list[Found]:
    others = [row for row in rows if row["kind"] in ("latitude", "longitude", "decibels", "volts", "cable")]
    clocks = [row for row in rows if row["kind"] == "clock"]
    close = [row for row in clocks if abs(row.get("off", np.inf)) <= CLOCK_WITHIN_MIN]
    honest = [row for row in clocks if abs(row.get("off", np.inf)) <= CLOCK_SIGMAS * row.get("sigma", 0.0)]
    return [
        rate_of("record", *_count(others, "right")),
        *judge_arms([row for row in rows if row["kind"] == "arms"]),
        rate_of("clock", len(close), len(clocks)),
        rate_of("error", len(honest), len(clocks)),
    ]


def judge_unlike_record(rows: Sequence[Row]) -> list[Found]:
    """Judge place, arms and clock by how unlike the antennas are."""
    by_size = {name_size(unlike): [row for row in rows if row["unlike"] == unlike] for unlike in UNLIKE}
    return [replace(one, key=f"{one.key}_{size}") for size, some in by_size.items() for one in judge_record(some)]


def judge_letters(rows: Sequence[Row]) -> list[Found]:
    return [rate_of("letters", *_count(rows, "right"))]


def judge_arms(rows: Sequence[Row]) -> list[Found]:
    near = [row for row in rows if abs(row.get("off", np.inf)) <= ARMS_WITHIN_DEG]
    return [rate_of("arms", len(near), len(rows))]


PARTS = (
    Part("day", partial(tell_audit, "day"), judge_day, 3000, by("kind"), ("false",)),
    Part("letters", tell_letters, judge_letters, 500, by("kind")),
    Part("arms", partial(tell_fault, "day", kind="arms"), judge_arms, 500, by("kind")),
    Part("paths", tell_paths, judge_paths, 1350, by("kind")),
    Part("hour", partial(tell_audit, "hour"), judge_common, 3000, by("kind")),
    Part("minute", partial(tell_audit, "minute"), judge_common, 3000, by("kind")),
    Part("unlike", partial(tell_unlike, "minute", ("nothing",)), judge_unlike, 1600, by("unlike")),
    Part("unlike-day", partial(tell_unlike, "day", ("nothing",)), judge_unlike, 80, by("unlike")),
    Part("unlike-record", partial(tell_unlike, "day", RECORD), judge_unlike_record, 1280, by("unlike", "kind")),
    Part("unlike-paths", partial(tell_unlike, "minute", PATHS), judge_unlike_paths, 480, by("unlike", "kind")),
)
