"""What the published curves themselves say of the chain: edges, rises, and the feature at the resonance.

No simulation enters: C(nu), G_ant, L_coax and G_RCU are the published ones, so that A(nu) S = 1/(C^2 L_coax G_RCU)
is fixed.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.traces.trace import BLOCK_SAMPLES
from lbacal_paper.statements import Result
from lbacal_paper.study import Study

SAMPLE_RATE_MHZ = 200.0
SAMPLES_PER_BIN, LST_BINS = 7250, 96
FEATURE_MHZ = (48.0, 70.0)
"""Where the feature near the resonance is compared with a straight line in ln A."""
ELECTRONICS, ELECTRONICS_AT_EDGE = 0.065, 0.20
"""Published uncertainties of C from antenna to antenna, below and above 77 MHz: the errors of C in a ratio of two of
its values."""


def mean_loss(instrument: Instrument) -> Floats:
    """L_coax averaged over the antennas of the instrument, shape (freq,)."""
    return np.asarray(np.mean([instrument.cables[record.cable] for record in instrument.antennas], axis=0))


def published_correction(study: Study) -> Floats:
    """A(nu) of the published C with the mean cable, median 1, shape (freq,)."""
    correction = 1.0 / (study.published_c() ** 2 * mean_loss(study.instrument) * study.instrument.receiver_gain)
    return np.asarray(correction / np.median(correction))


def find_about_chain(study: Study) -> dict[str, Result]:
    """Results from the published curves alone."""
    instrument, frequency = study.instrument, study.frequency_mhz
    antennas = len(instrument.antennas)
    events = SAMPLES_PER_BIN * LST_BINS / antennas
    edge = edge_of_pass_band(frequency, instrument.receiver_gain)
    peak = find_peak(frequency, instrument.antenna_gain)
    with_correction = find_peak(frequency, instrument.antenna_gain * published_correction(study))
    return {
        "frequency-resolution": Result(
            SAMPLE_RATE_MHZ / BLOCK_SAMPLES, 0.0, f"{SAMPLE_RATE_MHZ:g} MHz / {BLOCK_SAMPLES} samples", True
        ),
        "samples-per-bin": Result(
            events,
            0.0,
            f"{SAMPLES_PER_BIN} x {LST_BINS} bins / {antennas} antennas: events that must have had every antenna in "
            "the outer set. Read as samples of one station it would take six times as many, more than were recorded.",
            True,
        ),
        "resonance": Result(
            peak,
            0.5,
            "peak of G_ant = C^2 / N_ADC,in from the published C and noise terms, parabola through its three largest "
            f"channels; with A(nu) the peak lies at {with_correction:.1f} MHz",
            True,
        ),
        "pass-band-edge": Result(edge, 0.1, _describe_edge(frequency, instrument.receiver_gain)),
        "rise-by-cable": _rise(study, mean_loss(instrument), 30.0, 77.0, ELECTRONICS, "loss of the mean cable"),
        "rise-at-edge": _rise(study, instrument.receiver_gain, 77.0, 80.0, ELECTRONICS_AT_EDGE, "receiver's pass band"),
        "feature-at-58": describe_feature(study),
    }


def edge_of_pass_band(frequency_mhz: Floats, gain: Floats, fall_db: float = 3.0) -> float:
    """The highest frequency at which the gain lies `fall_db` below its mean over 40-60 MHz."""
    level = 10.0 * np.log10(gain)
    plateau = level[(frequency_mhz >= 40) & (frequency_mhz <= 60)].mean()
    above = int(np.flatnonzero(level > plateau - fall_db)[-1])
    both = slice(above, above + 2)
    return float(np.interp(-(plateau - fall_db), -level[both], frequency_mhz[both]))


def _describe_edge(frequency_mhz: Floats, gain: Floats) -> str:
    level = 10.0 * np.log10(gain)
    at_edge = float(np.interp(78.0, frequency_mhz, level))
    plateau = float(level[(frequency_mhz >= 40) & (frequency_mhz <= 60)].mean())
    return (
        "where the shipped pass band lies 3 dB below its mean over 40-60 MHz; at 78 MHz it lies "
        f"{plateau - at_edge:.1f} dB below that mean, {level.max() - at_edge:.1f} dB below its maximum and "
        f"{-at_edge:.1f} dB below its reference of 0 dB"
    )


def find_peak(frequency_mhz: Floats, gain: Floats) -> float:
    """The maximum of ln gain by a parabola through its three largest channels."""
    k = int(np.clip(gain.argmax(), 1, gain.size - 2))
    left, middle, right = np.log(gain[k - 1 : k + 2])
    step = frequency_mhz[k + 1] - frequency_mhz[k]
    return float(frequency_mhz[k] + 0.5 * step * (left - right) / (left - 2 * middle + right))


def _rise(study: Study, gain: Floats, low: float, high: float, error: float, what: str) -> Result:
    """Share of the rise of ln C between two frequencies that a power gain explains."""
    at = [int(np.argmin(np.abs(study.frequency_mhz - mhz))) for mhz in (low, high)]
    c = study.published_c()
    rise = float(np.log(c[at[1]] / c[at[0]]))
    explained = float(0.5 * np.log(gain[at[0]] / gain[at[1]]))
    share = explained / rise
    return Result(
        share,
        abs(share) * np.sqrt(2.0) * error / rise,
        f"the published C rises by a factor {np.exp(rise):.2f} from {low:g} to {high:g} MHz, the {what} explains "
        f"{np.exp(explained):.2f}; A(nu) must explain the factor {np.exp(rise - explained):.2f}. Error: "
        f"{100 * error:.3g} % in each C.",
    )


def describe_feature(study: Study) -> Result:
    """How much of the feature of ln A at the resonance a shift, and a smeared resonance, can describe."""
    frequency = study.frequency_mhz
    inside = (frequency >= FEATURE_MHZ[0]) & (frequency <= FEATURE_MHZ[1])
    log_a = np.log(published_correction(study))
    log_gain = CubicSpline(frequency, np.log(study.instrument.antenna_gain))

    def left(model: Floats) -> float:
        """Root mean square of ln A beside a model and a straight line."""
        x = frequency[inside] / 10.0
        rest = (log_a - model)[inside]
        return float(np.std(rest - np.polyval(np.polyfit(x, rest, 1), x)))

    def shifted(by_mhz: float) -> Floats:
        return np.asarray(log_gain(frequency - by_mhz) - log_gain(frequency))

    def smeared(sigma_mhz: float) -> Floats:
        """Ln of the gain averaged over a normal distribution of the resonance's place."""
        nodes, weights = np.polynomial.hermite_e.hermegauss(15)
        places = [np.exp(log_gain(frequency - sigma_mhz * node)) for node in nodes]
        return np.asarray(np.log(np.tensordot(weights / weights.sum(), places, 1)) - log_gain(frequency))

    alone = left(np.zeros_like(log_a))
    shift = minimize_scalar(lambda by: left(shifted(by)), bounds=(-4.0, 4.0), method="bounded")
    smear = minimize_scalar(lambda sigma: left(smeared(sigma)), bounds=(0.0, 4.0), method="bounded")
    by_shift, by_smear = (1.0 - (float(one.fun) / alone) ** 2 for one in (shift, smear))
    return Result(
        by_shift,
        0.1,
        "share of the variance of ln A(nu) about a straight line, 48-70 MHz, that the best shift "
        f"({float(shift.x):+.1f} MHz) of the published G_ant describes. A(nu) has one dip to "
        f"{float(np.exp(log_a[inside].min())):.2f}, not the dip and bump of a shift; the same G_ant averaged over "
        f"places that scatter by {float(smear.x):.1f} MHz describes {100 * by_smear:.0f} %: the simulated resonance "
        "is too high and too narrow for a year's mean, rather than misplaced.",
    )
