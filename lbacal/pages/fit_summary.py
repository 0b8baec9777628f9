"""What `lbacal fit` prints: a table of its curves, what chi2/dof means, and the error of C for one event."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lbacal_core.calibration.budget import largest_chi2_per_dof
from lbacal_core.calibration.channels import LARGEST_GOOD_ERROR
from lbacal_core.calibration.one_event import ErrorOfC
from lbacal_core.curves.curves import MISFIT, OK, CalibrationCurve

MOST_ROWS = 16
"""More curves are told by station and polarisation."""
SHOWN_CHANNELS = 3
HEADER = ("", "curves", "events", "LST", "chi2/dof", "sky free", "flagged")


def tabulate_curves(curves: Sequence[CalibrationCurve]) -> list[list[str]]:
    """Header and rows: curves one by one, or if there are many those of a station and polarisation together."""
    frequency = curves[0].frequency_mhz
    at = np.unique(np.linspace(0, frequency.size - 1, SHOWN_CHANNELS).round().astype(int))
    groups: Mapping[str, list[CalibrationCurve]]
    if len(curves) <= MOST_ROWS:
        groups = {curve.name: [curve] for curve in curves}
    else:
        groups = {}
        for curve in curves:
            groups.setdefault(" ".join(part for part in (curve.station, curve.dipole) if part), []).append(curve)
    header = [*HEADER, *(f"C({frequency[k]:g} MHz), µV ±stat.% ±syst.%" for k in at)]
    return [header, *(_row(name, group, at) for name, group in groups.items())]


def _row(name: str, group: Sequence[CalibrationCurve], at: np.ndarray) -> list[str]:
    with_values = [curve for curve in group if curve.c is not None]
    statuses = [curve.status for curve in group]
    counted = ", ".join(f"{statuses.count(one)} {one}" for one in dict.fromkeys(statuses))
    first = [name, statuses[0] if len(group) == 1 else counted, _range([float(c.events) for c in group], "{:.0f}")]
    first.append(_range([curve.lst_coverage for curve in group], "{:.2f}"))
    if not with_values:
        return [*first, *[""] * (3 + at.size)]
    flagged = sum(int(np.sum(curve.flags != OK)) for curve in with_values)
    cells = []
    for k in at:
        known = [curve for curve in with_values if curve.has_value[k]]
        cells.append(_value(known, int(k)) if known else "outside")
    return [
        *first,
        _range([float(curve.chi2_per_dof or np.nan) for curve in with_values], "{:.2f}"),
        _range([float(curve.chi2_per_dof_profiled or np.nan) for curve in with_values], "{:.2f}"),
        f"{flagged} of {sum(curve.frequency_mhz.size for curve in with_values)}",
        *cells,
    ]


def _value(curves: Sequence[CalibrationCurve], k: int) -> str:
    """C in one channel, microvolts, with both errors in per cent: the median of several curves."""

    def median(name: str) -> float:
        found = [float(values[k]) for curve in curves if (values := getattr(curve, name)) is not None]
        return float(np.median(found)) if found else float("nan")

    c = median("c")
    return f"{1e6 * c:.3g} ±{100 * median('c_sigma_stat') / c:.1f} ±{100 * median('c_sigma_sys') / c:.0f}"


def _range(values: Sequence[float], form: str) -> str:
    low, high = form.format(min(values)), form.format(max(values))
    return low if low == high else f"{low}-{high}"


def explain_chi2(curves: Sequence[CalibrationCurve]) -> str:
    """Explain the two numbers of the chain test for these channels, and why some are flagged."""
    dof = curves[0].frequency_mhz.size - 3
    misfits = sum(curve.status == MISFIT for curve in curves)
    widened = sum(
        1 for c in curves if c.status != MISFIT and (c.chi2_per_dof or 0.0) > largest_chi2_per_dof(c.frequency_mhz.size)
    )
    limit, sigma = largest_chi2_per_dof(dof + 3), np.sqrt(2.0 / dof)
    flags = [flag for curve in curves if curve.c is not None for flag in curve.flags.tolist() if flag != OK]
    counted = ", ".join(f"{flags.count(flag)} channels {flag}" for flag in dict.fromkeys(flags))
    flagged = (
        f" Flagged: {counted}; uncertain: a misfit, a statistical error above {LARGEST_GOOD_ERROR:.0%}, or another "
        "antenna that these data do not exclude moves C by more."
    )
    return (
        f"chi2/dof tests the chain along frequency: 1.0 ± {sigma:.1f} ({dof} degrees of freedom) if nothing but noise "
        f"parts data and model; above {limit:.1f} the systematic error of a curve is widened ({widened} here). "
        "'sky free' looks along LST as well, and lets sky and pattern differ by what is known of them: 1 or less if "
        "they explain the rest. A misfit is where even that is less probable than 1e-6, where a likely mistake is "
        f"named, where gains follow sidereal time, and every curve of a station half of whose are one ({misfits} here)."
        + (flagged if flags else "")
    )


def describe_error(error: ErrorOfC) -> str:
    """One line with one number: the error of C for one event on one antenna, beside that of the mean."""
    parts = [f"statistical {_percent(error.statistical)}", f"systematic {_percent(error.systematic)}"]
    of_mean = f"for the mean of the events: {_percent(error.of_mean)}"
    more = [f"single antennas {_percent(error.antenna)}"] if error.antenna != 0.0 else []
    more.append(f"gain of an event {_percent(error.event)}")
    terms = ", ".join([*parts, *more])
    return f"error of C for one event on one antenna: {_percent(error.of_one_event)} ({terms}); {of_mean}"


def _percent(fraction: float) -> str:
    return "unknown" if not np.isfinite(fraction) else f"{100 * fraction:.1f} %"
