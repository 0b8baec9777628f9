"""Two judges of one data set: *search* names what chance does not explain, *compete* what no sentence explains better.

Parts, each of small stations: one effect of a cause in a drawn world (one), effects of no catalogue in a drawn world
(unlisted), gains of 1-6 % along LST, UTC and temperature, in a drawn world or with P_sky given (waves), nothing hidden
in a drawn world (nothing). Where one effect is hidden, *compete* is asked first: if it names that and nothing else,
*search* can be no better and is not asked, so that what *compete* gains is not counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lbacal_twin.faults.composed import Composed
from lbacal_twin.faults.fault import Fault
from lbacal_twin.faults.uncatalogued import FrostAndHeat, uncatalogued_faults
from validation.hidden.data_sets import EVENTS, SMALL, DataSet, Planted, moving_causes
from validation.hidden.drawn import describe_world
from validation.hidden.finder import Judged
from validation.hidden.no_catalogue import FIRST_SIZE, is_right_axis
from validation.hidden.one_effect import NAMING_SNR
from validation.hidden.sizes import size_pull
from validation.hidden.worlds import EVERYTHING, OWN
from validation.hidden.worlds import draw as draw_world
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

ONE_FROM, UNLISTED_FROM, WAVES_FROM, NOTHING_FROM = 1_100_000_000, 1_200_000_000, 1_300_000_000, 1_400_000_000
"""Seeds of data sets of these parts; those of others begin elsewhere."""
LARGE = 25.0
"""Ideal SNR of a large effect."""
SNRS = (NAMING_SNR, LARGE)
TRIES = 2
"""Draws of an effect until one can have the size: those of the sky by direction are dear."""
ALONG = ("lst", "utc", "temperature")
"""Axes that gains follow in `waves`."""
LEAST, MOST = 0.01, 0.06
"""Limits of their size, fraction."""
JUDGES: Sequence[Judged] = ("compete", "search")


def small_world(seed: int) -> DataSet:
    """A station of six antennas in a drawn world, with every nuisance."""
    return DataSet(seed, SMALL, EVERYTHING, EVENTS, world=draw_world(seed, OWN))


def ask_both(data: DataSet, fault: Fault | None, axes: str = "") -> Row:
    """Ask both judges."""
    row: Row = {}
    for judge in JUDGES:
        answer = data.ask([] if fault is None else [fault], judge=judge)
        is_right = is_right_axis(axes, answer.axis, answer.target)
        row[judge] = {"verdict": answer.verdict, "named": answer.named, "axis": answer.axis, "is_right_axis": is_right}
    return row


def try_one(seed: int) -> Row:
    """One effect; the causes take turns, then two sizes."""
    causes, data = moving_causes(), small_world(ONE_FROM + seed)
    cause, snr = causes[seed % len(causes)], SNRS[seed // len(causes) % len(SNRS)]
    rng = np.random.default_rng([13, seed])
    tried = (data.with_snr(data.draw(cause, rng), snr) for _ in range(TRIES))
    planted = next((sized for sized in tried if sized is not None), None)
    row: Row = {
        **describe_world(data),
        "cause": cause,
        "snr": snr,
        "label": "",
        "compete": [],
        "search": [],
        "pull": None,
    }
    if planted is None:
        return row
    new = data.ask([planted.fault], judge="compete")
    old = new if new.named == [cause] else data.ask([planted.fault], judge="search")
    is_first = new.named[:1] == [cause]
    pull = size_pull(data, planted, new.findings[0]) if is_first else None
    return row | {"label": planted.label, "compete": new.sets, "search": old.sets, "pull": pull}


def try_unlisted(seed: int) -> Row:
    """An effect of no catalogue; they take turns."""
    kinds = uncatalogued_faults()
    axes = list(kinds)[seed % len(kinds)]
    kind, data = kinds[axes], small_world(UNLISTED_FROM + seed)
    planted = data.with_snr(Planted(kind.__name__, kind(size=FIRST_SIZE), "station", "station"), LARGE)
    row: Row = {**describe_world(data), "kind": kind.__name__, "made": planted is not None}
    return row if planted is None else row | ask_both(data, planted.fault, axes)


def try_waves(seed: int) -> Row:
    """A gain of the whole station of 1-6 %; what it follows takes turns, then whether P_sky is given."""
    rng, along = np.random.default_rng([15, seed]), ALONG[seed % len(ALONG)]
    size, is_given = float(rng.uniform(LEAST, MOST)), bool(seed // len(ALONG) % 2)
    data = DataSet(WAVES_FROM + seed, SMALL, events=EVENTS) if is_given else small_world(WAVES_FROM + seed)
    waves, phase = int(rng.integers(1, 3)), float(rng.uniform(0.0, 2.0 * np.pi))
    course = ("sidereal wave", (waves, phase)) if along == "lst" else ("wave", (1.0 / waves, phase))
    wave = Composed(size=size, place="gain", law=("level", ()), courses=(course,))
    fault = FrostAndHeat(size=size) if along == "temperature" else wave
    return {"along": along, "given": is_given, "size": round(size, 4), **ask_both(data, fault, along)}


def try_nothing(seed: int) -> Row:
    data = small_world(NOTHING_FROM + seed)
    return {**describe_world(data), **ask_both(data, None)}


def _is_named(sets: Sequence[Sequence[str]], cause: str) -> bool:
    return any(cause in one for one in sets)


def _are_others(sets: Sequence[Sequence[str]], cause: str) -> bool:
    return any(cause not in one for one in sets)


def judge_one(rows: Sequence[Row]) -> list[Found]:
    made = [row for row in rows if row["label"]]
    named, others = (
        {judge: [of(row[judge], row["cause"]) for row in made] for judge in JUDGES} for of in (_is_named, _are_others)
    )
    lost = sum(old and not new for new, old in zip(named["compete"], named["search"], strict=True))
    misnamed = sum(new and not old for new, old in zip(others["compete"], others["search"], strict=True))
    pulls = [abs(row["pull"]) for row in made if row["pull"] is not None]
    return [
        rate_of("lost", lost, len(made)),
        rate_of("misnamed_alone", misnamed, len(made)),
        rate_of("named", sum(named["compete"]), len(made)),
        rate_of("sizes", sum(pull <= 2.0 for pull in pulls), len(pulls)),
    ]


def judge_unlisted(rows: Sequence[Row]) -> list[Found]:
    made = [row for row in rows if row["made"]]
    lost = sum(row["search"]["is_right_axis"] and not row["compete"]["is_right_axis"] for row in made)
    return [
        rate_of("lost", lost, len(made)),
        *(
            rate_of(f"{judge}_{key}", sum(bool(row[judge][field]) for row in made), len(made))
            for judge in JUDGES
            for key, field in (("axis", "is_right_axis"), ("forced", "named"))
        ),
    ]


IS: dict[str, Callable[[Row], bool]] = {
    "named": lambda answer: bool(answer["named"]),
    "said": lambda answer: answer["verdict"] != "consistent",
}


def judge_names(rows: Sequence[Row]) -> list[Found]:
    return [
        rate_of(f"{judge}_{key}", sum(is_so(row[judge]) for row in rows), len(rows))
        for judge in JUDGES
        for key, is_so in (
            ("named", lambda one: bool(one["named"])),
            ("said", lambda one: one["verdict"] != "consistent"),
        )
    ]


PARTS = (
    Part("one", try_one, judge_one, 400, by("cause")),
    Part("unlisted", try_unlisted, judge_unlisted, 100, by("kind")),
    Part("waves", try_waves, judge_names, 150, by("along", "given")),
    Part("nothing", try_nothing, judge_names, 150, by("noise")),
)
