"""What `lbacal` says and fits in worlds that are not its own: drawn skies, antennas and noise, 12 antennas, 900 events.

Every data set draws a sky and an antenna that are not the finder's, nor among the models from which it makes its modes;
a third of the skies lies outside every model. Event gains act where they are drawn to. A tenth of the data sets has the
whole station, 48 antennas. No effect is hidden in an antenna that is deaf, or that died before it had the 60
spectra of a fit: a search leaves them out.
Parts: nothing hidden (nothing); pulls of C, the sky told (pulls); one effect of a drawn cause (one); effects on a cable
name or a group (targets); effects in no catalogue (unknown); gains of 1-6 % along LST, UTC and temperature, in a drawn
world of six antennas or with P_sky given (waves); effects that look like a vector of the noise, at three sizes
(like-noise); the sizes of causes of sky, pattern and time that a free sky hides (hidden).

Where nothing is hidden a name is never right, and silence is where the models span the difference. Where the resonance
moves in rain, a resonance that is named as following rain says what the world does
(`docs/decisions/rain-that-moves-the-resonance.md`). It counts as a name all the same; rows of their own tell it apart.

The noise of an event may lie along three vectors: a gain behind everything, one in front of N_RCU, a resonance that
moves. An effect along one of them is seen only as far as it follows an axis of the data: the efficiency is the score of
the true cause over the ideal SNR, at three sizes, since a large effect must not become noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial

import numpy as np

from lbacal_twin.faults.composed import Composed
from lbacal_twin.faults.uncatalogued import FrostAndHeat
from validation.hidden import no_catalogue, pulls
from validation.hidden.data_sets import STATIC, DataSet, moving_causes
from validation.hidden.drawn import SPANNED_SIGMA, describe_world, drawn_data, unspanned_sigma
from validation.hidden.one_effect import NAMING_SNR, Outcome, detection_curve, hide_in, outcomes_of
from validation.hidden.worlds import EVERYTHING, OWN
from validation.hidden.worlds import draw as draw_world
from validation.machinery.claims import Found, One, mean_of, median_interval, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

NOTHING_FROM, ONE_FROM, TARGETS_FROM, LIKE_NOISE_FROM = 500_000_000, 600_000_000, 700_000_000, 900_000_000
"""Seeds of data sets of these parts; those of others begin elsewhere."""
WET, RESONANCE, RAIN = "wetness", ("resonance_shift", "resonance_width"), "wetness"
"""Form of the gains in which the resonance moves in rain, the causes that say so, and what they then follow."""
SNRS = (10.0, 10.0, 10.0, 10.0, 4.0, 5.0, 6.0, 7.5)
"""Ideal SNR of one data set after the other: half are as strong as names are judged at."""
TARGETS = tuple(
    (cause, scope) for scope in ("cable", "group") for cause in ("gain_step", "gain_drift", "adc_noise_step")
)
FEWEST_OF_CURVE = 20
"""Weaker data sets from which on a curve of detection is fitted: one SNR, seen almost always, tells no 50 %."""
ALIKE = (
    ("resonance_shift", "resonance"),
    ("gain_temperature", "front"),
    ("ionospheric_absorption", "station in front"),
)
"""Causes, and the form of the noise that looks like each along frequency."""
NOISE_SNRS = (10.0, 30.0, 100.0)
FEWEST = 3
WAVES_FROM, HIDDEN_FROM = 1_500_000_000, 1_600_000_000
"""Seeds of these parts."""
ALONG = ("lst", "utc", "temperature")
"""Axes that gains follow."""
LEAST, MOST = 0.01, 0.06
"""Limits of their size, fraction."""
OF_THE_SKY = {
    "lst_offset": "h",
    "zenith_weighting": "",
    "pattern_width": "%",
    "isotropic_level": "%",
    "point_source": "",
    "dipole_azimuth": "deg",
    "dipole_swap": "%",
}
"""Static causes of sky, pattern and time, with the units of their sizes."""
SEEN_SNR = 5.0
"""Ideal SNR at which half of the effects are seen, about."""


def listen(seed: int) -> Row:
    data = drawn_data(NOTHING_FROM + seed)
    answer = data.ask()
    return {
        **describe_world(data),
        "unspanned": round(unspanned_sigma(data), 3),
        "verdict": answer.verdict,
        "named": answer.named,
        "axis": answer.axis,
        "follows": [str(finding["parameters"].get("follows", "")) for finding in answer.findings],
    }


def hide(data: DataSet, seed: int, cause: str, snr: float, scopes: tuple[str, ...] = ()) -> Row:
    """A drawn world with an effect of an ideal SNR, and what is said of it."""
    return {**describe_world(data), **asdict(hide_in(data, cause, snr, np.random.default_rng([1, seed]), scopes))}


def try_one(seed: int) -> Row:
    causes, number = [*moving_causes(), *STATIC], ONE_FROM + seed
    return hide(drawn_data(number), number, causes[seed % len(causes)], SNRS[seed // len(causes) % len(SNRS)])


def try_target(seed: int) -> Row:
    """A data set in which a cable name or a group is concerned; the causes take turns."""
    (cause, scope), number = TARGETS[seed % len(TARGETS)], TARGETS_FROM + seed
    return hide(drawn_data(number), number, cause, NAMING_SNR, (scope,))


def try_like_noise(seed: int) -> Row:
    """A drawn world with such noise and such an effect on the station; causes and sizes take turns."""
    cause, noise = ALIKE[seed % len(ALIKE)]
    data = drawn_data(LIKE_NOISE_FROM + seed)
    if data.world is None:
        raise ValueError(f"data set {data.seed} has no world of its own")
    data = replace(data, world=replace(data.world, noise=noise))
    return hide(data, seed, cause, NOISE_SNRS[seed // len(ALIKE) % len(NOISE_SNRS)], ("station",))


def try_waves(seed: int) -> Row:
    """A gain of the whole station; what it follows takes turns, then whether P_sky is given."""
    rng, along = np.random.default_rng([15, seed]), ALONG[seed % len(ALONG)]
    size, is_given, number = float(rng.uniform(LEAST, MOST)), bool(seed // len(ALONG) % 2), WAVES_FROM + seed
    data = DataSet(number, nuisances=EVERYTHING, world=draw_world(number, OWN))
    waves, phase = int(rng.integers(1, 3)), float(rng.uniform(0.0, 2.0 * np.pi))
    course = ("sidereal wave", (waves, phase)) if along == "lst" else ("wave", (1.0 / waves, phase))
    wave = Composed(size=size, place="gain", law=("level", ()), courses=(course,))
    fault = FrostAndHeat(size=size) if along == "temperature" else wave
    answer = (DataSet(number) if is_given else data).ask([fault])
    return {
        "along": along,
        "given": is_given,
        "size": round(size, 4),
        "verdict": answer.verdict,
        "named": answer.named,
        "axis": answer.axis,
    }


def try_hidden(seed: int) -> Row:
    """The size of each cause of sky, pattern and time, in the whole station, that an ideal detector begins to see."""
    data, rng = drawn_data(HIDDEN_FROM + seed), np.random.default_rng([3, seed])
    drawn = {cause: data.draw(cause, rng, ("station",)).fault for cause in OF_THE_SKY}
    seen = {cause: abs(fault.size) * SEEN_SNR / data.detector.linear_snr([fault]) for cause, fault in drawn.items()}
    return {**describe_world(data), **seen}


def is_spanned(row: Row) -> bool:
    """Whether the models that the finder knows span the difference between its sky and the true one."""
    return bool(row["unspanned"] < SPANNED_SIGMA)


def is_of_rain(row: Row) -> bool:
    """Whether every name is that of a resonance which follows rain, in a world where it moves in rain."""
    told = zip(row["named"], row["follows"], strict=True)
    return row["noise"] == WET and bool(row["named"]) and all(c in RESONANCE and f == RAIN for c, f in told)


def is_silent(row: Row) -> bool:
    return bool(row["verdict"] == "consistent")


def judge_nothing(rows: Sequence[Row]) -> list[Found]:
    inside, outside = [r for r in rows if is_spanned(r)], [r for r in rows if not is_spanned(r)]
    honest = sum(is_silent(row) or (not row["named"] and row["axis"] == "lst") for row in outside)
    dry, wet = [r for r in rows if r["noise"] != WET], [r for r in rows if r["noise"] == WET]
    claims = [
        rate_of("named", sum(bool(row["named"]) for row in rows), len(rows)),
        rate_of("alarms", sum(not is_silent(row) for row in inside), len(inside)),
        rate_of("apart", len(outside) - honest, len(outside)),
    ]
    if dry:
        claims.append(rate_of("named_dry", sum(bool(row["named"]) for row in dry), len(dry)))
    if wet:
        claims.append(rate_of("named_wet", sum(bool(row["named"]) and not is_of_rain(row) for row in wet), len(wet)))
    return claims


def judge_one(rows: Sequence[Row]) -> list[Found]:
    outcomes = outcomes_of(rows)
    strong = [o for o in outcomes if o.snr == NAMING_SNR]
    wanted = [row for row in rows if row["snr"] == NAMING_SNR]
    sizes = [abs(o.pull) for o in strong if o.pull is not None]
    claims = [
        *_judge_names(strong),
        rate_of("sizes", sum(pull <= 2.0 for pull in sizes), len(sizes)),
        rate_of("first", len(sizes), len(strong)),
        rate_of("alone", sum(o.sets[:1] == [[o.cause]] for o in strong), len(strong)),
        rate_of("left_out", sum(not row["label"] for row in wanted), len(wanted)),
    ]
    if len(outcomes) - len(strong) >= FEWEST_OF_CURVE:
        curve = detection_curve(outcomes)
        claims.append(One("snr_50", curve.snr_at(0.5), partial(curve.bounds, 0.5), len(outcomes)))
    return claims


def judge_targets(rows: Sequence[Row]) -> list[Found]:
    outcomes = outcomes_of(rows)
    right = sum(o.said_of == o.label for o in outcomes if o.is_named)
    return [*_judge_names(outcomes), rate_of("target", right, sum(o.is_named for o in outcomes))]


def _judge_names(outcomes: Sequence[Outcome]) -> list[Found]:
    named, wrong = sum(o.is_named for o in outcomes), sum(o.is_misnamed for o in outcomes)
    return [rate_of("named", named, len(outcomes)), rate_of("misnamed", wrong, len(outcomes))]


def judge_like_noise(rows: Sequence[Row]) -> list[Found]:
    kept = {snr: np.array([o.score / o.snr for o in outcomes_of(rows) if o.snr == snr]) for snr in NOISE_SNRS}
    return [mean_of(f"kept_{snr:g}", shares) for snr, shares in kept.items() if len(shares) >= FEWEST]


def judge_waves(rows: Sequence[Row]) -> list[Found]:
    return [
        rate_of("named", sum(bool(row["named"]) for row in rows), len(rows)),
        rate_of("said", sum(not is_silent(row) for row in rows), len(rows)),
    ]


def judge_hidden(rows: Sequence[Row]) -> list[Found]:
    sizes = {cause: np.array([row[cause] for row in rows]) for cause in OF_THE_SKY}
    return [
        One(cause, float(np.median(own)), partial(median_interval, own), own.size, OF_THE_SKY[cause])
        for cause, own in sizes.items()
    ]


PARTS = (
    Part("nothing", listen, judge_nothing, 3000, by("noise", "outside"), ("named",)),
    *pulls.PARTS,
    Part("one", try_one, judge_one, 2000, by("cause", "snr"), ("named",)),
    Part("targets", try_target, judge_targets, 200, by("cause", "scope")),
    *no_catalogue.PARTS_IN_WORLDS,
    Part("waves", try_waves, judge_waves, 300, by("along", "given")),
    Part("like-noise", try_like_noise, judge_like_noise, 90, by("cause", "snr")),
    Part("hidden", try_hidden, judge_hidden, 40),
)
