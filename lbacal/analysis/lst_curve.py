"""`lbacal.lst_curve`: a measured LST curve against simulated sky power."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from astropy import units as u
from astropy.table import QTable

from lbacal.analysis.instrument import Described, simulation_of
from lbacal.analysis.result import Result
from lbacal.files import path_of
from lbacal.pages.curve import draw_comparison
from lbacal.pages.report import list_origin
from lbacal.units import convert_band
from lbacal_core.data.lofar import DIPOLES, SUPERTERP
from lbacal_core.lstcurve.curve import BAND_MHZ, Comparison, LstCurve, compare_lst_curve, read_lst_curve
from lbacal_core.sky.table import SkyPower


@dataclass(frozen=True, repr=False, kw_only=True)
class LstComparison(Result):
    """A measured LST curve beside a simulated one, without and with electronic noise."""

    comparison: Comparison


def lst_curve(
    curve: LstCurve | str | Path,
    instrument: Described = SUPERTERP,
    sky_power: SkyPower | str | Path | None = None,
    band: tuple[Any, Any] = BAND_MHZ,
) -> LstComparison:
    """Compare band power against sidereal time, measured and simulated.

    Nothing is fitted but, for each dipole, an offset and the share of electronic noise in the power (0 to 1).

    Parameters
    ----------
    curve
        File of the curve (CSV: lst_h, x_db, y_db, error_db), or the curve.
    band
        First and last channel, MHz or Quantities.

    Examples
    --------
    >>> import lbacal
    >>> lbacal.lst_curve("measured.csv").save("lst.png")  # doctest: +SKIP
    """
    measured = curve if isinstance(curve, LstCurve) else read_lst_curve(path_of("curve", curve))
    simulation = simulation_of(instrument, sky_power)
    limits = convert_band(band)
    found = compare_lst_curve(measured, simulation.sky_power, simulation.instrument, limits)
    every = [found.of(d, has_noise=has_noise) for has_noise in (False, True) for d in DIPOLES]
    words = [f"sky and noise (share {one.noise_share:.3f})" if one.has_noise else "sky alone" for one in every]
    return LstComparison(
        title=f"{measured.origin}, {limits[0]:g}-{limits[1]:g} MHz",
        rows=[
            ("dipole", "simulation", "chi2 per point", "rms, dB"),
            *(
                (one.dipole, said, f"{one.chi2 / one.points:.2f}", f"{one.rms_db:.3f}")
                for one, said in zip(every, words, strict=True)
            ),
        ],
        words=2,
        charts=partial(draw_comparison, found, simulation),
        origin=list_origin(measured.origin, simulation, provenance=found.provenance.as_dict()),
        as_table=partial(_list_points, found),
        as_dict=found.as_dict,
        comparison=found,
    )


def _list_points(found: Comparison) -> QTable:
    """A row a point: measured, and what the simulation with noise leaves."""
    columns = {"lst": found.curve.lst_hours * u.h}
    for d in DIPOLES:
        columns[f"{d.lower()}_db"] = found.curve.variation_db[d]
        columns[f"{d.lower()}_residual_db"] = found.of(d, has_noise=True).residual_db
    return QTable({**columns, "error_db": found.curve.error_db})
