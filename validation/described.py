"""Effects that no catalogue lists, in words: place in the chain, law along frequency and course in time.

Parts: the eight uncatalogued effects of the twin (unlisted), causes of the catalogue that were taken out of it
(left-out), and effects composed of laws and courses of which the finder has only some (composed). What is said is
compared with the planted effect by the templates of both in data that were not used, less what a fit of the chain
absorbs: no word of a sentence is judged but its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lbacal_twin.faults.composed import Composed, draw_composed
from lbacal_twin.faults.uncatalogued import uncatalogued_faults
from validation.hidden.data_sets import EVENTS, DataSet, Planted, moving_causes
from validation.hidden.held_out import chi_squared, found_ratio
from validation.machinery.claims import Found, mean_of, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

FIRST_SEED, LEFT_OUT_FROM, COMPOSED_FROM = 900_000_000, 950_000_000, 970_000_000
"""Seeds of data sets of these parts; those of others begin elsewhere."""
LARGE, SMALL, LEFT_OUT = 25.0, 10.0, 15.0
"""Ideal SNR of the effects, in the half of the events that is used."""
FIRST_SIZE, TRIES = 0.02, 10
HALVES = 2.0
"""Halves of a data set, to which events belong by turns."""
LEAST = 9.0
"""Chi^2 of an effect in the other events below which nothing can be taken out: some act in one half alone."""
ALIKE = 0.95
"""Correlation of two templates from which the law and the course are right."""
FEWEST = 2
"""Sentences of which more have a mean."""
MOST = 3
"""Sentences among which the right one may be."""

SOURCES = ("Cas A", "Cyg A", "Tau A", "Vir A")
PLACES = {
    "MainsHum": ("front",),
    "WorkingWeek": ("receiver",),
    "JovianBursts": ("antenna",),
    "AuroralAbsorption": ("sky",),
    "FieldGradient": ("sky",),
    "FrostAndHeat": ("front",),
    "BandSaturation": ("level", "record"),
    "Thunderstorms": ("antenna",),
    "adc_jitter": ("converter",),
    "adc_noise_step": ("converter",),
    "cable_temperature": ("front",),
    "compression": ("level", "behind"),
    "dipole_azimuth": ("polarisation", "sky"),
    "dipole_swap": ("letters", "polarisation", "sky"),
    "filter_shift": ("behind",),
    "gain_drift": ("front",),
    "gain_step": ("front",),
    "gain_temperature": ("front",),
    "ionospheric_absorption": ("sky",),
    "isotropic_level": ("antenna",),
    "lna_noise_slope": ("antenna",),
    "lna_noise_temperature": ("antenna",),
    "lst_offset": ("time", "sky"),
    "pattern_width": ("sky",),
    "point_source": ("antenna", "sky", *SOURCES),
    "resonance_shift": ("front",),
    "resonance_width": ("front",),
    "rfi_broadband": ("antenna",),
    "rfi_line": ("converter",),
    "solar_emission": ("antenna", "sky", "Sun"),
    "zenith_weighting": ("sky",),
    "sky": ("sky",),
    "added": ("antenna",),
    "gain": ("front",),
    "receiver noise": ("receiver",),
    "receiver": ("behind",),
    "converter": ("converter",),
}
"""Where each effect acts, by the twin: what is added to the sky may be called a change of it as well."""


def describe_hidden(seen: DataSet, planted: Planted | None, snr: float, kind: str, without: str = "") -> Row:
    """Ask about an effect in one half of the events, and compare what is said with it in the other."""
    row: Row = {"kind": kind, "snr": snr, "verdict": "", "named": [], "places": [], "alike": [], "kept": None}
    if planted is None:
        return row
    answer, model = seen.ask_and_fit([planted.fault], without=without)
    row |= {"verdict": answer.verdict, "named": answer.named}
    if model is None or not model.places:
        return row
    unseen = replace(seen, half=1)
    spectra, clean, detector = unseen.spectra([planted.fault]), unseen.spectra(), unseen.detector
    ratios = [found_ratio(model, unseen, spectra, number) for number in range(min(len(model.places), MOST))]
    templates = np.stack([detector.template([planted.fault]), *(ratio - 1.0 for ratio in ratios)])
    information = detector.information(templates)
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    nothing = chi_squared(unseen, clean)
    before, after = (chi_squared(unseen, spectra, ratio) - nothing for ratio in (None, ratios[0]))
    return row | {
        "places": model.places[:MOST],
        "alike": [round(float(r), 4) for r in (information[0] / size[0] / size)[1:]],
        "kept": round(1.0 - after / before, 4) if before > LEAST else None,
    }


def try_unlisted(seed: int) -> Row:
    kinds = list(uncatalogued_faults().values())
    kind, snr = kinds[seed % len(kinds)], (LARGE, SMALL)[seed // len(kinds) % 2]
    seen = DataSet(FIRST_SEED + seed, events=2 * EVENTS, half=0)
    planted = seen.with_snr(Planted(kind.__name__, kind(size=FIRST_SIZE), "station", "station"), snr)
    return describe_hidden(seen, planted, snr, kind.__name__)


def try_left_out(seed: int) -> Row:
    causes = moving_causes()
    cause, rng = causes[seed % len(causes)], np.random.default_rng([11, seed])
    seen = DataSet(LEFT_OUT_FROM + seed, events=2 * EVENTS, half=0)
    tried = (seen.with_snr(seen.draw(cause, rng), LEFT_OUT) for _ in range(TRIES))
    planted = next((sized for sized in tried if sized is not None), None)
    return describe_hidden(seen, planted, LEFT_OUT, cause, cause)


def try_composed(seed: int) -> Row:
    rng = np.random.default_rng([12, seed])
    seen = DataSet(COMPOSED_FROM + seed, events=2 * EVENTS, half=0)
    for _ in range(TRIES):
        fault = number_in_halves(draw_composed(rng, FIRST_SIZE))
        planted = seen.with_snr(Planted("composed", fault, "station", "station"), LARGE)
        if planted is not None:
            said = " x ".join(one for one, _ in (fault.law, *fault.courses))
            return {**describe_hidden(seen, planted, LARGE, fault.place), "composed": said}
    return {**describe_hidden(seen, None, LARGE, ""), "composed": ""}


def number_in_halves(fault: Composed) -> Composed:
    """Every n-th event of each half of the data set, which knows no events but its own."""
    courses = ((name, (*numbers, HALVES) if name == "third" else numbers) for name, numbers in fault.courses)
    return replace(fault, courses=tuple(courses))


def _found(rows: Sequence[Row], prefix: str = "") -> list[Found]:
    """What, of all that could be planted, is noticed, said, right in law and course, and right in place."""
    made = [row for row in rows if row["verdict"]]
    said = [row for row in made if row["places"]]

    def rate(name: str, hits: int) -> Found:
        return rate_of(f"{prefix}{name}", hits, len(made))

    def is_right(row: Row, number: int) -> bool:
        return row["places"][number] in PLACES[row["kind"]]

    found = [
        rate("noticed", sum(row["verdict"] != "consistent" for row in made)),
        rate("said", len(said)),
        rate("law", sum(row["alike"][0] > ALIKE for row in said)),
        rate("law_in_set", sum(max(row["alike"]) > ALIKE for row in said)),
        rate("place", sum(is_right(row, 0) for row in said)),
        rate("place_in_set", sum(any(is_right(row, k) for k in range(len(row["places"]))) for row in said)),
    ]
    kept = np.array([row["kept"] for row in said if row["kept"] is not None])
    return [*found, *([mean_of(f"{prefix}kept", kept)] if len(kept) > FEWEST else [])]


def judge_unlisted(rows: Sequence[Row]) -> list[Found]:
    return [
        one
        for snr, prefix in ((LARGE, ""), (SMALL, "small_"))
        for one in _found([row for row in rows if row["snr"] == snr], prefix)
    ]


def judge_one_size(rows: Sequence[Row]) -> list[Found]:
    return _found(rows)


PARTS = (
    Part("unlisted", try_unlisted, judge_unlisted, 80, by("kind")),
    Part("left-out", try_left_out, judge_one_size, 110, by("kind")),
    Part("composed", try_composed, judge_one_size, 60, by("composed")),
)
