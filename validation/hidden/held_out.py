"""Removing what was found from events that were not used: chi^2 returns to that of clean data, as the report claims.

A year of twice as many events is cut in two: the finder sees every second one, and what it found is divided out of the
others. Chi^2 is the ideal detector's: exact covariance, and everything that the fit absorbs projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from lbacal_core.spectra.spectra import Spectra
from validation.hidden.data_sets import EVENTS, DataSet, draw_one, moving_causes
from validation.hidden.finder import FittedModel
from validation.hidden.worlds import OWN
from validation.machinery.claims import Found, One, mean_of, median_interval, rate_of
from validation.machinery.parts import Part, Row

SNR = 10.0
FIRST_SEED = 500_000
FEWEST = 5
"""Data sets behind a median."""


def hide_in_halves(number: int) -> Row:
    """Find an effect in one half of the events, and divide it out of the other; no cause where nothing is named.

    `claimed` is the held-out gain in log-likelihood that the report states, of all findings; `before` and `after` are
    chi^2 of the other half less that of the same data without the effect, before and after what was found is divided
    out.
    """
    rng = np.random.default_rng([7, number])
    seen = DataSet(FIRST_SEED + number, events=2 * EVENTS, half=0)
    unseen = replace(seen, half=1)
    planted = draw_one(seen, SNR, rng, moving_causes())
    answer, model = seen.ask_and_fit([planted.fault])
    if model is None or not answer.findings:
        return {"cause": ""}
    with_effect, clean = unseen.spectra([planted.fault]), unseen.spectra()
    ratio = found_ratio(model, unseen, with_effect)
    nothing = chi_squared(unseen, clean)
    return {
        "cause": planted.cause,
        "named": answer.named,
        "claimed": round(answer.claimed_gain, 3),
        "before": round(chi_squared(unseen, with_effect) - nothing, 3),
        "after": round(chi_squared(unseen, with_effect, ratio) - nothing, 3),
    }


def found_ratio(model: FittedModel, data: DataSet, spectra: Spectra, sentence: int | None = None) -> Floats:
    """Power with what was found over power without, in other spectra; shape (path, event, freq) of the twin."""
    ratio, paths, times = model.ratio(spectra, data.instrument, OWN.power(), sentence)
    row = {(int(antenna), dipole): k for k, (antenna, dipole) in enumerate(product(data.scene.antennas, DIPOLES))}
    whole = np.ones((len(row), len(data.scene.time_unix), len(data.scene.frequency_mhz)))
    event = np.searchsorted(data.scene.time_unix, times)
    whole[np.ix_(np.array([row[path] for path in paths]), event)] = ratio
    return whole


def chi_squared(data: DataSet, spectra: Spectra, ratio: Floats | None = None) -> float:
    """Chi^2 of spectra, divided by a ratio, about the chains that fit them best."""
    scene = data.scene
    power = data.detector.power(()).copy()  # where a spectrum is absent; it has no weight
    antenna = np.searchsorted(scene.antennas, spectra.antenna)
    dipole = np.array([DIPOLES.index(str(letter)) for letter in spectra.dipole])
    path, event = len(DIPOLES) * antenna + dipole, np.searchsorted(scene.time_unix, spectra.time_unix)
    power[path, event] = spectra.power if ratio is None else spectra.power / ratio[path, event]
    return data.detector.chi_squared(power)


def gains_of(rows: Sequence[Row]) -> tuple[Floats, Floats, Floats]:
    """Gain in log-likelihood claimed and confirmed by the other half, and its pull.

    The pull is (claimed - confirmed) / its error: either scatters by the SNR, the root of twice the gain.
    """
    claimed = np.array([row["claimed"] for row in rows])
    confirmed = np.array([0.5 * (row["before"] - row["after"]) for row in rows])
    return claimed, confirmed, (claimed - confirmed) / np.sqrt(4 * np.maximum(np.maximum(claimed, confirmed), 1.0))


def judge(rows: Sequence[Row]) -> list[Found]:
    made = [row for row in rows if row["cause"]]
    n, found = len(made), rate_of("found", len(made), len(rows))
    if n < FEWEST:
        return [found]
    claimed, confirmed, pull = gains_of(made)
    before, after = (np.array([row[name] for row in made]) for name in ("before", "after"))
    of_names = {"before": before, "after": after, "claimed": claimed, "confirmed": confirmed}
    scale = float(np.median(before))
    left = One("left", float(np.median(after)) / scale, partial(median_interval, after / scale), n, "%")
    covered, kept = int(np.sum(np.abs(pull) < 1.96)), int(np.sum(confirmed > 0))
    means = [mean_of(name, values) for name, values in of_names.items()]
    return [found, left, rate_of("covered", covered, n), rate_of("kept", kept, n), *means]


PARTS = (Part("held-out", hide_in_halves, judge, 40),)
