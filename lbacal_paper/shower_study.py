"""Section 5.1 on simulated signals: what each calibration, and each term of the budget, does to the slopes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lbacal_core.antenna.names import DEFAULT_ANTENNA, load_antenna
from lbacal_core.curves import covariance
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from lbacal_paper.budget import MEASURED, OTHER_SKY, TIED, Budget
from lbacal_paper.reference_source import (
    SCALED_M,
    Geometry,
    SourceCalibration,
    calibrate_with_source,
    expected_power,
    stand_in_tables,
    true_field,
)
from lbacal_paper.showers.comparison import Displacement, compare_calibrations
from lbacal_paper.showers.coreas import Shower
from lbacal_paper.showers.recording import Recording, field_power, record, true_power
from lbacal_paper.showers.signals import draw_signals, signals_of_showers
from lbacal_paper.study import SEED, Study

TOTAL = "all together"
RIGHT, FITTED = "true C", "Galactic fit"
EDGE_BAND_MHZ = (70.0, 78.0)
WEAK, STRONG = (1.0, 10.0), (30.0, 3000.0)
"""Signal over background of weak events, and of the strongest."""
PUBLISHED_SPREAD = 0.065
DISTANCE_SIGMA_M = 0.1


@dataclass(frozen=True)
class ShowerStudy:
    """Recorded signals and their slopes with every calibration.

    Attributes
    ----------
    displacements
        By the name of the calibration.
    weak_power, weak_unsubtracted
        Reconstructed over true power of weak signals at 70-78 MHz with its standard deviation, and without the
        background subtracted.
    sources
        The two calibrations with the stand-in of the reference source.
    terms
        By today's budget and its term: changes of the slopes below and above the resonance, and of their difference, by
        one standard deviation of the term, 10^-3 per MHz; `TOTAL` is their quadrature.
    """

    recording: Recording
    calibrations: Mapping[str, Floats]
    displacements: Mapping[str, Displacement]
    weak_power: tuple[float, float]
    weak_unsubtracted: float
    sources: tuple[SourceCalibration, SourceCalibration]
    showers: Sequence[Shower]
    terms: Mapping[str, Mapping[str, Floats]]


def study_showers(study: Study, budget: Budget, showers: Sequence[Shower] = ()) -> ShowerStudy:
    """Record signals of the paper's number with the planted chain, and calibrate them in every way.

    Parameters
    ----------
    showers
        CoREAS showers; without any, stand-in pulses.
    """
    rng = np.random.default_rng(SEED)
    instrument, channels = study.instrument, study.frequency_mhz
    antenna = load_antenna(DEFAULT_ANTENNA)
    truth = np.array([study.campaign.truth.curve(dipole) for dipole in DIPOLES])
    midnight = np.zeros(1)
    background = np.array([study.simulation.background(study.mean_curve(d), midnight)[0] for d in DIPOLES])
    signals = signals_of_showers(showers) if showers else draw_signals(rng)
    strong = record(signals, instrument, antenna, truth, background, rng, STRONG)
    faint = record(draw_signals(rng), instrument, antenna, truth, background, rng, WEAK)
    sources = calibrate_with_stand_in(study)
    calibrations = {
        RIGHT: truth,
        FITTED: np.array([study.mean_curve(dipole).c for dipole in DIPOLES], dtype=float),
        **{one.name: truth * one.c / study.campaign.truth.curve("X") for one in sources},
        **_wrong(study, budget, truth, strong, rng),
    }
    return ShowerStudy(
        strong,
        calibrations,
        compare_calibrations(strong, channels, calibrations),
        _power_at_edge(faint, truth, channels, subtract=True),
        _power_at_edge(faint, truth, channels, subtract=False)[0],
        sources,
        tuple(showers),
        {name: _displace_by_terms(strong, channels, truth, one) for name, one in budget.today.items()},
    )


def _displace_by_terms(
    recording: Recording, channels: Floats, truth: Floats, budget: covariance.Budget
) -> dict[str, Floats]:
    """What one standard deviation of each term does to the slopes; the vectors of a term are added in quadrature.

    An error of G_ant is none of the field: C and H have the same one.
    """
    of_field = [term for term in budget.terms if not term.is_of_gain]
    calibrations = {RIGHT: truth} | {
        f"{term.name}, {k}": truth * np.exp([term.vectors[dipole][k] for dipole in DIPOLES])
        for term in of_field
        for k in range(len(term.vectors[DIPOLES[0]]))
    }
    moved = compare_calibrations(recording, channels, calibrations)

    def steps(term: covariance.BudgetTerm) -> Floats:
        found = [moved[f"{term.name}, {k}"] for k in range(len(term.vectors[DIPOLES[0]]))]
        numbers = [(one.low_shift, one.high_shift, one.difference) for one in (moved[RIGHT], *found)]
        return np.asarray(np.linalg.norm(np.subtract(numbers[1:], numbers[0]), axis=0))

    terms = {term.name: steps(term) for term in of_field}
    return terms | {TOTAL: np.linalg.norm(list(terms.values()), axis=0)}


def _power_at_edge(recording: Recording, c: Floats, channels: Floats, *, subtract: bool) -> tuple[float, float]:
    """Mean over signals of reconstructed over true power in the last channels, and its standard deviation."""
    bins = recording.signals.frequency_mhz
    edge = (bins >= EDGE_BAND_MHZ[0]) & (bins <= EDGE_BAND_MHZ[1])
    power, _ = field_power(recording, c, channels, subtract=subtract)
    ratio = power[:, edge].sum(axis=1) / true_power(recording)[:, edge].sum(axis=1)
    return float(ratio.mean()), float(ratio.std() / np.sqrt(ratio.size))


def _wrong(
    study: Study, budget: Budget, truth: Floats, recording: Recording, rng: np.random.Generator
) -> dict[str, Floats]:
    """The true C with one standard deviation of each error."""
    terms = {}
    for name, term in budget.terms.items():
        is_exchange = name == MEASURED or name.startswith(OTHER_SKY)
        label = name if is_exchange else f"+1 sigma: {name}"
        terms[label] = truth * np.exp([term[dipole] for dipole in DIPOLES])
    spread = rng.normal(0.0, PUBLISHED_SPREAD, (recording.signals.event.size, 2, 1))
    cables = study.instrument.cables
    first, last = sorted(cables, key=lambda name: float(cables[name].mean()))[:: len(cables) - 1]
    return {
        **terms,
        "one C for all antennas, 6.5 % flat spread": truth * np.exp(spread),
        f"cable {last} m taken for {first} m": truth * np.sqrt(cables[first] / cables[last]),
        "no dependence on frequency": np.broadcast_to(truth.mean(axis=1)[:, None], truth.shape),
    }


def calibrate_with_stand_in(study: Study) -> tuple[SourceCalibration, SourceCalibration]:
    """C of the mean X path by both characterisations of the stand-in, from what that path records of it."""
    frequency, instrument = study.frequency_mhz, study.instrument
    truth = study.campaign.truth.curve("X")
    received = expected_power(true_field(frequency), instrument.antenna_gain) / truth**2
    geometry = Geometry(SCALED_M, DISTANCE_SIGMA_M)
    first, second = (
        calibrate_with_source(table, geometry, instrument.antenna_gain, received, np.full_like(frequency, 0.01))
        for table in stand_in_tables(frequency)
    )
    return first, second


def describe_measured_sky(budget: Budget, showers: ShowerStudy) -> str:
    """Describe the change of sections 5.1 and 5.2 by a sky tied to absolute measurements, in one paragraph."""
    change = 100.0 * np.expm1(np.mean([budget.terms[MEASURED][dipole] for dipole in DIPOLES], axis=0))
    right, tied = (showers.displacements[name] for name in (RIGHT, MEASURED))
    low, high, apart = (
        getattr(tied, name) - getattr(right, name) for name in ("low_shift", "high_shift", "difference")
    )
    before, after = (showers.terms[name][TOTAL][2] for name in ("models", TIED))
    return (
        f"What the measured sky changes in 5.1 and 5.2: with the {MEASURED} C changes by {change[0]:+.0f} % at the "
        f"lowest frequency, {np.median(change):+.0f} % in the median and {change[-1]:+.0f} % at the highest. Its level "
        f"moves no slope; its tilt moves the slope below the resonance by {low:+.2f}, that above by {high:+.2f} and "
        f"their difference by {apart:+.2f}, 1e-3/MHz: {abs(apart) / right.difference_sigma:.0f} standard deviations of "
        f"what these events know. The error of the difference by our budget is {after:.1f}, where it is {before:.1f} "
        "with the error of the sky from models. In 5.2 the ratio to the reference source changes by what C does "
        "(figure 8, dotted)."
    )


def describe_displacements(showers: ShowerStudy) -> list[list[str]]:
    """Rows of a table: calibration, change of both slopes, distance from the diagonal."""
    rows = []
    for name, one in showers.displacements.items():
        rows.append(
            [
                name,
                f"{one.low_shift:+.2f}",
                f"{one.high_shift:+.2f}",
                f"{one.difference:+.2f} ± {one.difference_sigma:.2f}",
                f"{one.significance:+.1f}",
            ]
        )
    return rows


def describe_terms(showers: ShowerStudy) -> list[list[str]]:
    """Rows of a table: budget, term, and what one standard deviation changes."""
    return [
        [budget, name, *(f"{size:.2f}" for size in sizes)]
        for budget, terms in showers.terms.items()
        for name, sizes in terms.items()
    ]
