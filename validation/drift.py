"""What follows an array over years finds what breaks, when it did, and nothing else.

A campaign is 576 paths over seven years, of which all share 5 % from year to year and a season of 3 %. `nothing` looks
at growing data, from the second month to the end, as nights do: whatever any look finds is a false alarm. `steps`
plants steps of 3 % and 1 %, and a ladder of smaller ones that measures the size found in 90 %, at any date but the
first and last ten events of the path. `slopes` gives paths 1 % a year against their stations, and looks after three
years. `stations` plants one step that a station's paths share, and one of four paths. `whole` gives everything a trend
and compares it with the one told. `repairs` lets the gain of a path fail for weeks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lbacal_core.drift.follow import Followed, History, follow
from lbacal_core.drift.report import list_changes
from validation.drift_world import DAY, START, YEAR, World, cut_short, draw_history
from validation.hidden.detection import fit_detection
from validation.machinery.claims import Found, Interval, One, mean_of, rate_of
from validation.machinery.parts import Part, Row

WORLD = World()
LOOKS_YEARS = (2 / 12, 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 5, 6, 7)
LADDER = (0.03, 0.01, 0.008, 0.006, 0.004, 0.003, 0.002)
NEAR_90 = (0.01, 0.008, 0.006, 0.004)
"""Sizes about the one that is found in 90 %, to which the curve of detection is fitted."""
UNIT = 0.001
PATHS_A_SIZE = 12
SAME_STEP = 45 * DAY
"""A step found farther from a planted one than this is another one."""
SMALL_WORLD = replace(WORLD, stations=3, antennas=4, events_per_year=300)
TREND = 0.02
ANTENNAS, FAILS_DAYS, FAILS_BY = (4, 8, 16), (15.0, 120.0), (0.05, 0.5)
"""Antennas of a station, for how long a gain fails, and by how much ln C changes."""
SAME_REPAIR, FEWEST_OF_REPAIR = 10 * DAY, 12
"""Farthest that a date lies outside the interval told, and events of the path while it fails: with fewer, spectra are
anomalous."""
EDGE_EVENTS = 12


def look(world: World, seed: int, looks: Sequence[float]) -> Row:
    """Follow a campaign in which nothing breaks, again and again while it grows."""
    history = draw_history(world, np.random.default_rng([15, 1, seed]))
    alarmed: set[int] = set()
    alarms, stations = 0, 0
    for years in looks:
        found = follow(cut_short(history, years))
        has_step = np.any(np.isfinite(found.paths.terms.dates), axis=1)
        now = set(np.flatnonzero(has_step | (found.paths.slope_significance > found.paths.threshold)).tolist())
        alarms += len(now - alarmed)
        alarmed |= now
        if found.stations is not None:
            stations += int(np.isfinite(found.stations.terms.dates).sum())
            stations += int(np.sum(found.stations.slope_significance > found.stations.threshold))
    months = 12 * looks[-1]
    return {
        "series": len(history.antenna),
        "alarmed": len(alarmed) / len(history.antenna),
        "alarms_a_month": (alarms + stations) / months,
        "of_stations": stations,
    }


def judge_looks(rows: Sequence[Row]) -> list[Found]:
    return [
        mean_of("series", np.array([row["alarmed"] for row in rows]), "%"),
        mean_of("month", np.array([row["alarms_a_month"] for row in rows])),
    ]


def plant_steps(world: World, seed: int, paths_a_size: int = PATHS_A_SIZE) -> Row:
    """Plant steps of several sizes in paths of their own, follow, and compare."""
    rng = np.random.default_rng([15, 2, seed])
    history = draw_history(world, rng)
    chosen = rng.choice(len(history.antenna), paths_a_size * len(LADDER), replace=False)
    sizes = np.repeat(LADDER, paths_a_size) * rng.choice([-1.0, 1.0], chosen.size)
    dates = np.empty(chosen.size)
    for k, path in enumerate(chosen):
        own = history.time_unix[np.isfinite(history.ln_c[path, :, 0])]
        dates[k] = rng.uniform(own[EDGE_EVENTS], own[-EDGE_EVENTS])
        history.ln_c[path, history.time_unix >= dates[k], 0] += sizes[k]
    found = follow(history).paths
    steps = []
    for path, size, date in zip(chosen, sizes, dates, strict=True):
        off = np.abs(found.terms.dates[path] - date)
        j = int(np.argmin(off))
        if off[j] > SAME_STEP:
            steps.append({"size": float(size), "found": False})
            continue
        steps.append(
            {
                "size": float(size),
                "found": True,
                "off_days": float(off[j] / DAY),
                "sigma_days": float(found.step_sigma_s[path, j] / DAY),
                "within": bool(found.step_earliest[path, j] <= date <= found.step_latest[path, j]),
                "pull": float((found.step_size[path, j, 0] - size) / found.step_size_sigma[path, j, 0]),
            }
        )
    others = np.setdiff1d(np.arange(len(history.antenna)), chosen)
    return {"steps": steps, "others": float(np.mean(np.any(np.isfinite(found.terms.dates[others]), axis=1)))}


def _steps_of(rows: Sequence[Row], size: float | None = None) -> list[Row]:
    return [s for row in rows for s in row["steps"] if size is None or abs(abs(s["size"]) - size) < 1e-9]


def judge_steps(rows: Sequence[Row]) -> list[Found]:
    large, small = _steps_of(rows, LADDER[0]), _steps_of(rows, LADDER[1])
    seen = [s for s in _steps_of(rows) if s["found"]]
    dated = [s for s in large if s["found"]]
    return [
        rate_of("found", sum(s["found"] for s in large), len(large)),
        rate_of("date_95", sum(s["within"] for s in dated), len(dated)),
        rate_of("date_1", sum(s["off_days"] < s["sigma_days"] for s in dated), len(dated)),
        rate_of("size_2", sum(abs(s["pull"]) < 2.0 for s in seen), len(seen)),
        mean_of("others", np.array([row["others"] for row in rows]), "%"),
        rate_of("found_0.01", sum(s["found"] for s in small), len(small)),
        *measure_detection(rows),
    ]


def measure_detection(rows: Sequence[Row]) -> list[Found]:
    """Measure the sizes found in 50 % and 90 %: P(found) is a normal integral over the logarithm of the size."""
    near = [s for size in NEAR_90 for s in _steps_of(rows, size)]
    found = np.array([s["found"] for s in near], dtype=float)
    if not 0.0 < found.mean() < 1.0:
        return []
    curve = fit_detection(np.log(np.abs([s["size"] for s in near]) / UNIT), found)

    def bounds(part: float, confidence: float) -> Interval:
        low, high = UNIT * np.exp(curve.bounds(part, confidence))
        return float(low), float(high)

    return [
        One(f"size_{100 * part:g}", float(UNIT * np.exp(curve.snr_at(part))), partial(bounds, part), len(near), "%")
        for part in (0.5, 0.9)
    ]


def plant_slopes(world: World, seed: int, paths: int = 60) -> Row:
    """Give paths 1 % a year against their stations, and look after the campaign."""
    rng = np.random.default_rng([15, 3, seed])
    history = draw_history(world, rng)
    chosen = rng.choice(len(history.antenna), paths, replace=False)
    slopes = 0.01 * rng.choice([-1.0, 1.0], paths)
    years = (history.time_unix - START) / YEAR
    history.ln_c[chosen, :, 0] += (slopes[:, None] * years).astype(np.float32)
    found = follow(history).paths
    has_step = np.any(np.isfinite(found.terms.dates[chosen]), axis=1)
    is_found = (found.slope_significance[chosen] > found.threshold) | has_step
    others = np.setdiff1d(np.arange(len(history.antenna)), chosen)
    pull = (found.slope[chosen, 0] - slopes) / found.slope_sigma[chosen, 0]
    pull_of_others = found.slope[others, 0] / found.slope_sigma[others, 0]
    return {
        "found": float(np.mean(is_found)),
        "with_step": float(np.mean(has_step)),
        "within_2": float(np.mean(np.abs(pull) < 2.0)),
        "others_within_2": float(np.mean(np.abs(pull_of_others) < 2.0)),
        "sigma": float(np.median(found.slope_sigma[others, 0])),
    }


def judge_slopes(rows: Sequence[Row]) -> list[Found]:
    keys = ("found", "within_2", "others_within_2")
    return [mean_of(key, np.array([row[key] for row in rows]), "%") for key in keys]


def plant_in_stations(world: World, seed: int) -> Row:
    """Let all paths of one station step by 1 %, and four paths of another by 3 %."""
    rng = np.random.default_rng([15, 4, seed])
    history = draw_history(world, rng)
    one, other = rng.choice(world.names, 2, replace=False)
    dates = rng.uniform(0.1, 0.9, 2) * world.years * YEAR + START
    members = rng.choice(np.flatnonzero(history.station == other), 4, replace=False)
    _step(history, np.flatnonzero(history.station == one), dates[0], 0.01)
    _step(history, members, dates[1], 0.03)
    found = follow(history)
    changes = [change for change in list_changes(history, found) if not change.is_known]
    of_one = [change for change in changes if change.station == one]
    of_other = [change for change in changes if change.station == other]
    named = {(int(history.antenna[k]), str(history.dipole[k])) for k in members}
    return {
        "station_once": len(of_one) == 1 and {m.dipole for m in of_one[0].members if m.antenna is None} == {"X", "Y"},
        "board_once": len(of_other) == 1 and {(m.antenna, m.dipole) for m in of_other[0].members} == named,
        "elsewhere": len(changes) - len(of_one) - len(of_other),
    }


def _step(history: History, paths: np.ndarray, date: float, size: float) -> None:
    after = history.time_unix >= date
    history.ln_c[paths[:, None], np.flatnonzero(after), 0] += size


def judge_stations(rows: Sequence[Row]) -> list[Found]:
    return [rate_of(key, sum(row[f"{key}_once"] for row in rows), len(rows)) for key in ("station", "board")]


def age(world: World, seed: int) -> Row:
    """Give everything a trend, and compare with what is told."""
    rng = np.random.default_rng([15, 5, seed])
    trend = float(rng.uniform(-TREND, TREND))
    row: Row = {"trend": trend}
    for name, is_smooth in (("steps", False), ("smooth", True)):
        told: Followed = follow(draw_history(replace(world, trend=trend, is_smooth=is_smooth), rng))
        if told.whole is None:
            raise ValueError(f"{world.years} years tell no trend")
        row[name] = {
            "slope": float(told.whole.slope[0]), "sigma": float(told.whole.sigma[0]),
            "limit": float(told.whole.limit[0]), "scatter": float(told.whole.scatter[0]),
        }  # fmt: skip
    return row


def judge_whole(rows: Sequence[Row]) -> list[Found]:
    claims = []
    for name in ("steps", "smooth"):
        off = np.array([abs(row[name]["slope"] - row["trend"]) for row in rows])
        for key in ("sigma", "limit"):
            within = int(np.sum(off < np.array([row[name][key] for row in rows])))
            claims.append(rate_of(f"{name}_{key}", within, len(rows)))
    return [*claims, mean_of("sigma", np.array([row["steps"]["sigma"] for row in rows]), "%")]


def repair(world: World, seed: int) -> Row:
    """Let the gain of a path fail and be repaired weeks later."""
    rng = np.random.default_rng([15, 6, seed])
    history = draw_history(replace(world, antennas=int(rng.choice(ANTENNAS))), rng)
    path, days = int(rng.integers(len(history.antenna))), np.exp(rng.uniform(*np.log(FAILS_DAYS)))
    size = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(*np.log(FAILS_BY))))
    own = history.time_unix[np.isfinite(history.ln_c[path, :, 0])]
    begins = float(rng.uniform(own[EDGE_EVENTS], own[-EDGE_EVENTS] - days * DAY))
    dates = np.array([begins, begins + days * DAY])
    during = int(np.sum((own >= dates[0]) & (own < dates[1])))
    for date, change in zip(dates, (size, -size), strict=True):
        _step(history, np.array([path]), date, change)
    found = follow(history).paths
    order = np.argsort(found.terms.dates[path])[: np.isfinite(found.terms.dates[path]).sum()]
    told, limits = found.terms.dates[path, order], np.stack([found.step_earliest, found.step_latest])[:, path, order]
    others = np.any(np.isfinite(np.delete(found.terms.dates, path, axis=0)), axis=1)
    return {
        "size": size, "days": float(days), "antennas": int(history.antenna.max()) + 1, "events": during,
        "told": (told / DAY).tolist(), "planted": (dates / DAY).tolist(), "others": float(np.mean(others)),
        "found": told.size == 2 and not np.any((limits[0] > dates + SAME_REPAIR) | (limits[1] < dates - SAME_REPAIR)),
    }  # fmt: skip


def judge_repairs(rows: Sequence[Row]) -> list[Found]:
    seen = [row for row in rows if row["events"] >= FEWEST_OF_REPAIR]
    return [
        rate_of("found", sum(row["found"] for row in seen), len(seen)),
        mean_of("others", np.array([row["others"] for row in rows]), "%"),
    ]


PARTS = (
    Part("nothing", partial(look, WORLD, looks=LOOKS_YEARS), judge_looks, 12),
    Part("steps", partial(plant_steps, WORLD), judge_steps, 24, headlines=("found",)),
    Part("slopes", partial(plant_slopes, replace(WORLD, years=3.0)), judge_slopes, 8),
    Part("stations", partial(plant_in_stations, WORLD), judge_stations, 120),
    Part("whole", partial(age, SMALL_WORLD), judge_whole, 400),
    Part("repairs", partial(repair, replace(SMALL_WORLD, years=3.0)), judge_repairs, 400),
)
