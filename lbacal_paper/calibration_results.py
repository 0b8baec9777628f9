"""Section 4.2: Table 1, the spread of antennas, and what only the unpublished event spectra could show."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.lstcurve.curve import compare_lst_curve
from lbacal_core.skypower.model import vary_sky_power
from lbacal_core.uncertainty.refit import ZENITH_GAIN
from lbacal_paper.budget import EDGE_MHZ, Budget, spread_with_cables
from lbacal_paper.statements import Result, not_testable
from lbacal_paper.study import Study

GAIN_TABLES = "caltables/CalTable_*_mode1.dat"
SUBBANDS, RECEIVERS, HIGHEST_MHZ = 512, 96, 100.0
QUARTILES_TO_SIGMA = 0.7413
"""Standard deviation of a normal distribution over the distance of its quartiles."""
PUBLISHED_ELECTRONICS = 6.5
"""Table 1, %: a measurement that is not public."""
ZENITH_STEPS = np.linspace(-0.2, 0.2, 9)
TWO_SIGMA = 4.0
"""Rise of chi2 that excludes a value at two standard deviations."""
EVENTS_NEEDED = "the background spectra of the Superterp's cosmic-ray events, 2012-2018"
YEARS = 7


def find_about_calibration(study: Study, budget: Budget, data: Path | None) -> dict[str, Result]:
    """Results on C(nu) and its uncertainty."""
    below = study.frequency_mhz <= EDGE_MHZ
    cables = float(100.0 * max(spread_with_cables(study, dipole)[below].max() for dipole in DIPOLES))
    trend = 100.0 * 0.05 / np.sqrt(np.sum((np.arange(YEARS) - (YEARS - 1) / 2.0) ** 2))
    return {
        "sky-quadrature": Result(100.0 * budget.sky_fraction, 0.0, "root of the sum of the three squares", True),
        "table-sky": Result(
            100.0 * budget.typical("sky"),
            0.0,
            "refits of one simulated station-year with the sky 20, 10 and 5 % brighter and fainter, half the "
            "difference of ln C, in quadrature; the noise terms scale with the sky, so C follows its root",
            True,
        ),
        "table-antenna": _antenna_term(budget),
        "pattern-limit": _limit_of_pattern(study),
        **_electronics(data),
        "table-total": _total(budget),
        "one-curve-for-all": Result(
            cables,
            0.0,
            "standard deviation of ln C between the antennas of the simulated Superterp with their 50, 80 and 115 m "
            f"cables left in, largest up to {EDGE_MHZ:g} MHz; through each antenna's own cable it is "
            f"{100 * budget.largest('electronics'):.1f} % (the gain spread that the simulation draws). One curve "
            "serves all antennas only after the cable of each is accounted for",
        ),
        "event-fluctuation": not_testable(
            f"needs {EVENTS_NEEDED}: the scatter of the power of one antenna between events"
        ),
        "yearly-scatter": not_testable(f"needs {EVENTS_NEEDED}, fitted year by year (`lbacal fit` on each)"),
        "no-trend": not_testable(
            f"needs {EVENTS_NEEDED}. With {YEARS} years that scatter by 5 %, a slope is known to {trend:.2f} % a "
            f"year: trends below {2 * trend:.1f} % a year would not be seen, 'no trend' means no more than that"
        ),
    }


def _antenna_term(budget: Budget) -> Result:
    """The antenna term of Table 1 with both weights that a fit may give: half their difference is the error."""
    alike, own = (100.0 * budget.largest(name) for name in ("antenna, bins weighted alike", "antenna"))
    return Result(
        (alike + own) / 2,
        abs(own - alike) / 2,
        f"refits with the zenith gain +-{100 * ZENITH_GAIN:.0f} % at fixed total, largest half difference up to "
        f"{EDGE_MHZ:g} MHz: {alike:.1f} % with weights without event gain, which is what a least-squares fit of bins "
        f"amounts to, {own:.1f} % with the weights that the 5 % event gain calls for (a flat gain takes the common LST "
        "variation out, and C then depends on how it changes with frequency). The weights decide the verdict",
    )


def _limit_of_pattern(study: Study) -> Result:
    """The change of the zenith gain that the measured LST curve excludes at two standard deviations."""
    chi2 = []
    for fraction in ZENITH_STEPS:
        power = vary_sky_power(study.instrument, zenith_gain_fraction=float(fraction))
        compared = compare_lst_curve(study.exchanged.curve, power, study.instrument)
        chi2.append(sum(compared.of(dipole, has_noise=True).chi2 for dipole in DIPOLES))
    fine = np.linspace(ZENITH_STEPS[0], ZENITH_STEPS[-1], 401)
    smooth = np.polyval(np.polyfit(ZENITH_STEPS, chi2, 4), fine)
    allowed = fine[smooth < smooth.min() + TWO_SIGMA]
    return Result(
        float(100.0 * np.abs(allowed).max()),
        float(100.0 * np.ptp(allowed) / 4),
        "largest change of the zenith gain that the measured LST curve allows at two standard deviations (drawn bars, "
        "our sky, letters exchanged, a noise share free for each dipole), its error that of the fitted change: "
        f"{100 * allowed[0]:+.0f} to {100 * allowed[-1]:+.0f} % are allowed, the nominal pattern is at their edge",
    )


def _electronics(data: Path | None) -> dict[str, Result]:
    """The measured spread of the receivers' gains, where the station gain tables are at hand."""
    tables = [] if data is None else sorted(data.glob(GAIN_TABLES))
    edge = not_testable(
        f"needs {EVENTS_NEEDED}: the station gain tables hold one amplitude a receiver for all frequencies, and the "
        "simulated pass band is the same for all units"
    )
    if not tables:
        missing = not_testable(
            "needs measured gains of single antennas: the station gain tables (--data with caltables/) give their "
            "spread; in the simulation it is an input"
        )
        return {"table-electronics": missing, "table-electronics-edge": edge}
    frequency_mhz = np.arange(SUBBANDS) * HIGHEST_MHZ / SUBBANDS
    band = (frequency_mhz >= 30.0) & (frequency_mhz <= EDGE_MHZ)
    spreads = []
    for path in tables:
        gains = np.frombuffer(path.read_bytes(), dtype="<c16").reshape(SUBBANDS, RECEIVERS)
        log_gain = np.log(np.abs(gains[band]))
        quartiles = np.percentile(log_gain, [25, 75], axis=1)
        spreads.append(float(100.0 * QUARTILES_TO_SIGMA * np.mean(quartiles[1] - quartiles[0])))
    found = Result(
        max(spreads),
        float(np.std(spreads) / np.sqrt(len(spreads))),
        f"largest of {len(spreads)} stations: spread of |gain| between {RECEIVERS} receivers in their gain tables, "
        f"from the quartiles; {', '.join(f'{value:.1f}' for value in spreads)} %",
    )
    return {"table-electronics": found, "table-electronics-edge": edge}


def _total(budget: Budget) -> Result:
    """Table 1's total with our sky and antenna terms and the published term of the electronics."""
    ours = np.hypot(
        np.hypot(100 * budget.typical("sky"), 100 * budget.largest("antenna, bins weighted alike")),
        PUBLISHED_ELECTRONICS,
    )
    weighted = np.hypot(np.hypot(100 * budget.typical("sky"), 100 * budget.largest("antenna")), PUBLISHED_ELECTRONICS)
    return Result(
        float(ours),
        0.0,
        "our refits of sky and antenna in quadrature with the published 6.5 % of the electronics; with the antenna "
        f"term of our weights {weighted:.1f} %",
        True,
    )
