"""Removing what was found from events that were not used: chi^2 returns to that of clean data, as the report claims.

A year of twice as many events is cut in two: the finder sees every second one, and what it found is divided out of the
others. Chi^2 is the ideal detector's: exact covariance, and everything that the fit absorbs projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import product

import numpy as np

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from lbacal_core.spectra.spectra import Spectra
from validation.hidden.data_sets import EVENTS, DataSet, draw_one, moving_causes, sky_power
from validation.hidden.finder import FittedModel
from validation.machinery.claims import Found, One, mean_of, median_interval, rate_of
from validation.machinery.parts import Part, Row

SNR = 10.0
FIRST_SEED = 500_000
FEWEST = 5
"""Data sets behind a median."""


@dataclass(frozen=True)
class Outcome:
    """What was found in one half of the events, and what it does to the other.

    Attributes
    ----------
    claimed
        Held-out gain in log-likelihood that the report states, of all findings.
    before, after
        Chi^2 of the other half less that of the same data without the effect, before and after what was found is
        divided out.
    """

    cause: str
    named: Sequence[str]
    claimed: float
    before: float
    after: float

    @property
    def confirmed(self) -> float:
        """Gain in log-likelihood of the other half."""
        return 0.5 * (self.before - self.after)

    @property
    def pull(self) -> float:
        """(Claimed - confirmed) / its error: either scatters by the SNR, the root of twice the gain."""
        return (self.claimed - self.confirmed) / float(np.sqrt(4 * max(self.claimed, self.confirmed, 1.0)))


def hide_in_halves(number: int) -> Outcome | None:
    """Find an effect in one half of the events, and divide it out of the other; None where nothing is named."""
    rng = np.random.default_rng([7, number])
    seen = DataSet(FIRST_SEED + number, events=2 * EVENTS, half=0)
    unseen = replace(seen, half=1)
    planted = draw_one(seen, SNR, rng, moving_causes())
    answer, model = seen.ask_and_fit([planted.fault])
    if model is None or not answer.findings:
        return None
    with_effect, clean = unseen.spectra([planted.fault]), unseen.spectra()
    ratio = found_ratio(model, unseen, with_effect)
    nothing = chi_squared(unseen, clean)
    return Outcome(
        planted.cause,
        answer.named,
        answer.claimed_gain,
        chi_squared(unseen, with_effect) - nothing,
        chi_squared(unseen, with_effect, ratio) - nothing,
    )


def found_ratio(model: FittedModel, data: DataSet, spectra: Spectra) -> Floats:
    """Power with what was found over power without, in other spectra; shape (path, event, freq) of the twin."""
    ratio, paths, times = model.ratio(spectra, data.instrument, sky_power())
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


def try_held_out(seed: int) -> Row:
    """A data set with one effect in both halves of its events."""
    outcome = hide_in_halves(seed)
    if outcome is None:
        return {"cause": ""}
    row = asdict(outcome)
    return {name: round(value, 3) if isinstance(value, float) else value for name, value in row.items()}


def judge(rows: Sequence[Row]) -> list[Found]:
    names = [field.name for field in fields(Outcome)]
    outcomes = [Outcome(**{name: row[name] for name in names}) for row in rows if row["cause"]]
    n, found = len(outcomes), rate_of("found", len(outcomes), len(rows))
    if n < FEWEST:
        return [found]
    means = [
        mean_of(name, np.array([getattr(o, name) for o in outcomes]))
        for name in ("before", "after", "claimed", "confirmed")
    ]
    scale, after = float(np.median([o.before for o in outcomes])), np.array([o.after for o in outcomes])
    left = One("left", float(np.median(after)) / scale, partial(median_interval, after / scale), n, "%")
    covered, kept = sum(abs(o.pull) < 1.96 for o in outcomes), sum(o.confirmed > 0 for o in outcomes)
    return [found, left, rate_of("covered", covered, n), rate_of("kept", kept, n), *means]


PARTS = (Part("held-out", try_held_out, judge, 40),)
