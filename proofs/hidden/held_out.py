"""Removing what was found from events that were not used: chi^2 returns to that of clean data, as the report claims.

A year of twice as many events is cut in two: the finder sees every second one, and what it found is divided out of the
others. Chi^2 is the ideal detector's: exact covariance, and everything that the fit absorbs projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES
from lbacal_core.spectra import Spectra
from proofs.hidden.data_sets import EVENTS, DataSet, draw_one, moving_causes, sky_power
from proofs.hidden.finder import FittedModel
from proofs.machinery.trials import Rate, run_trials

SNR = 10.0
FIRST_SEED = 500_000


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
    row = {path: k for k, path in enumerate(paths)}
    order = [row[int(antenna), dipole] for antenna in data.scene.antennas for dipole in DIPOLES]
    whole = np.ones((len(order), len(data.scene.time_unix), len(data.scene.frequency_mhz)))
    whole[:, np.searchsorted(data.scene.time_unix, times)] = ratio[order]
    return whole


def chi_squared(data: DataSet, spectra: Spectra, ratio: Floats | None = None) -> float:
    """Chi^2 of spectra, divided by a ratio, about the chains that fit them best."""
    scene = data.scene
    power = data.detector.power(()).copy()  # where a spectrum is absent; it has no weight
    antenna = np.searchsorted(scene.antennas, spectra.antenna)
    dipole = np.array([DIPOLES.index(str(letter)) for letter in spectra.dipole])
    path, event = len(DIPOLES) * antenna + dipole, np.searchsorted(scene.time_unix, spectra.time_unix)
    power[path, event] = spectra.power if ratio is None else spectra.power / ratio[path, event]
    # Twice, because the noise moves the chain too far for one of Newton's steps: by some hundreds of chi^2.
    return data.detector.fitted_to(power).chi_squared(power)


def prove_held_out(count: int) -> tuple[bool, list[str]]:
    """Data sets with one effect of SNR 10 in either half."""
    outcomes = [o for o in run_trials(hide_in_halves, range(count), "held out") if o is not None]
    if not outcomes:
        return False, ["", "**Held out**: nothing was named in any data set."]
    before, after = (np.array([getattr(o, name) for o in outcomes]) for name in ("before", "after"))
    claimed, confirmed = (np.array([getattr(o, name) for o in outcomes]) for name in ("claimed", "confirmed"))
    covered = Rate(sum(abs(o.pull) < 1.96 for o in outcomes), len(outcomes))
    kept = Rate(sum(o.confirmed > 0 for o in outcomes), len(outcomes))
    error = float(after.std(ddof=1) / after.size**0.5)
    median = float(np.median(after))
    had = f"{len(outcomes)} of {count} data sets with one effect of SNR {SNR:g} in each half had a finding"
    left = f"{after.mean():.1f} +- {error:.1f} after what was found is divided out (median {median:.1f})"
    gain = f"claimed {claimed.mean():.1f}, confirmed by the unseen events {confirmed.mean():.1f}"
    lines = ["", f"**Held out**: {had}. Chi^2 of unseen events above that of the same data without the effect:"]
    lines += [f"{before.mean():.1f} before, {left}. Gain in log-likelihood {gain};"]
    lines += [f"claimed within 1.96 errors of confirmed in {covered}, asked 95 %; confirmed as a gain in {kept}."]
    worst = sorted(outcomes, key=lambda o: -o.after)[:5]
    lines += [
        "",
        "Least removed: " + "; ".join(f"{o.cause} as {'+'.join(o.named)}: {o.after:.0f}" for o in worst) + ".",
    ]
    # One size is fitted: what its error leaves is chi^2 of one degree of freedom; a tenth of the effect is allowed.
    return covered.is_at_least(0.95) and median < 0.1 * float(np.median(before)), lines
