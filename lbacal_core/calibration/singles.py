"""The paths of a block by themselves: what is left out of their spectra, and the lines through the rest.

Every scope begins with them. A path's curve follows from its lines; a mean over antennas has the lines of its members,
and so has the budget. Whoever fits several scopes of the same spectra need not look at each spectrum for each of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.lines import ChainForms, Lines, fit_lines
from lbacal_core.calibration.separable import SeparableSolution, solve_separable
from lbacal_core.curves.curves import Anomaly
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import SpectraBlock
from lbacal_core.spectra.screening import screen_block
from lbacal_core.spectra.spectra import Spectra

MIN_EVENTS = 60
"""Fewer events leave C worse than 2 % and the noise levels worse than 10 %."""
FEWEST_EVENTS = 5
"""Fewer know the gain of a window no better than 2.5 %."""


SMALLEST_SHARE = 0.3
"""Share of the sky in the power of a path, over the median of all paths. The longest cables have 0.6 to 0.7 of it, deaf
ones in drawn worlds 0.04 to 0.23, and a path whose gain falls by 0.4 of its excess power seems to have 0.34 to 0.5."""


def hears_the_sky(share: Floats) -> NDArray[np.bool_]:
    """Whether paths hear the sky as the others do, from its share in the power of each, shape (path,)."""
    return np.asarray(share >= SMALLEST_SHARE * np.median(share))


def has_enough(spectra: Spectra) -> bool:
    """Whether any path has the events that a fit needs."""
    paths = np.stack([codes for name, (_, codes) in spectra.key_codes.items() if name != "event_id"])
    return len(spectra) > 0 and bool(np.unique(paths, axis=1, return_counts=True)[1].max() >= MIN_EVENTS)


@dataclass(frozen=True)
class SingleFits:
    """The paths of a block, each by itself.

    Attributes
    ----------
    is_left_out
        Anomalous spectra that are not fitted, shape (path, event).
    anomalies
        All anomalous spectra, those that are fitted too.
    is_steady
        Whether the anomalous spectra of a path are few enough to be exceptions, shape (path,).
    lines
        Those of all paths, however few events they have.
    solved, solution
        The paths with events enough for a fit, shape (solved,), and the chain of each.
    """

    is_left_out: NDArray[np.bool_]
    anomalies: Sequence[Anomaly]
    is_steady: NDArray[np.bool_]
    lines: Lines
    solved: NDArray[np.intp]
    solution: SeparableSolution

    def slopes_of(self, paths: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """S of some of the solved paths and its standard deviation, shape (path, freq); NaN where there is none."""
        found = self.solution.take(np.searchsorted(self.solved, paths))
        variance = np.einsum("pii->pi", found.covariance)[:, : found.x.shape[1]]
        is_good = (found.is_converged & found.is_identifiable)[:, None] & np.isfinite(found.x) & (variance > 0)
        return np.where(is_good, found.x, np.nan), np.sqrt(np.where(is_good, variance, np.nan))


def fit_singles(block: SpectraBlock, simulation: Simulation, typical_blocks: float) -> SingleFits:
    """Screen the spectra of a block, and fit the lines and the chain of each of its paths.

    Parameters
    ----------
    typical_blocks
        The number of blocks whose radiometer noise the noise levels are.
    """
    key = "single paths", block.digest(), typical_blocks, simulation.form
    found: SingleFits = simulation.made.get(key, lambda: _fit_singles(block, simulation, typical_blocks))
    return found


def _fit_singles(block: SpectraBlock, simulation: Simulation, typical_blocks: float) -> SingleFits:
    longitude_deg = simulation.instrument.at_station(block.station).longitude_deg
    screened = screen_block(block, longitude_deg)
    kept = screened.block
    sky = simulation.sky_at(block.station, block.dipole, block.time_unix)
    forms, relative_variance = chain_forms(simulation.instrument), relative_variance_of(kept, typical_blocks)
    lines = fit_lines(kept.power, sky, relative_variance, forms, kept.time_unix)
    at = np.flatnonzero(kept.is_present.sum(axis=1) >= MIN_EVENTS)
    terms = simulation.noise
    return SingleFits(
        is_left_out=block.is_present & ~kept.is_present,
        anomalies=screened.anomalies,
        is_steady=screened.is_steady,
        lines=lines,
        solved=at,
        solution=solve_separable(lines.slope[at], lines.intercept[at], lines.information[at], terms),
    )


def relative_variance_of(block: SpectraBlock, typical_blocks: float) -> Floats:
    """Variance of the radiometer noise over that of a typical spectrum, shape (path, event); infinite where absent.

    The typical spectrum is the mean of `typical_blocks` blocks.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(typical_blocks / block.blocks)


def chain_forms(instrument: Instrument) -> ChainForms:
    """The forms along frequency by which the gain of an event may fluctuate."""
    return ChainForms.of(instrument.frequency_mhz, instrument.antenna_gain, instrument.receiver_gain)
