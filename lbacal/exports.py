"""C(nu) in the formats of other programs: UVCal (pyuvdata) and the calibration tables of LOFAR 2.0 stations."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from lbacal.instants import SECOND_US, parse_instant
from lbacal_core.curves.galcal import make_head
from lbacal_core.errors import BadInputError, needing
from lbacal_core.grids import DAY_S, JULIAN_DATE_OF_1970, Floats
from lbacal_core.instrument.instrument import Instrument

JONES = {"X": -5, "Y": -6}
"""AIPS numbers of the gains of linear feeds (AIPS memo 117)."""
SUBBANDS, SUBBAND_MHZ = 512, 100.0 / 512
"""Sub-bands of a LOFAR station and their spacing, clock of 200 MHz, first Nyquist zone."""


def write_uvcal(content: Mapping[str, Any], instrument: Instrument, path: Path) -> None:
    """Write the C of one station's paths as UVCal gains, by pyuvdata: `.calfits`, else `.calh5`.

    Gains multiply (gain_convention); calibrated visibilities are in V^2. quality_array is sigma(C)/C; channels without
    a C are flagged. Antennas stand at the place of the instrument, whose file does not say where each one is.
    """
    with needing("writing UVCal", "import"):
        from astropy import units as u
        from astropy.coordinates import EarthLocation
        from pyuvdata import Telescope, UVCal
    curves, name = _of_one_station(content)
    feeds = _feeds_of(instrument)
    antennas = sorted({curve["antenna"] for curve in curves})
    letters = [letter for letter in feeds if any(curve["dipole"] == letter for curve in curves)]
    frequency_mhz = np.array(curves[0]["frequency_mhz"])
    shape = (len(antennas), frequency_mhz.size, 1, len(letters))
    gain, quality, is_flagged = np.ones(shape, dtype=complex), np.zeros(shape), np.ones(shape, dtype=bool)
    for curve in curves:
        c, sigma = np.array(curve["c"], dtype=float), _sigma(curve)
        at = (antennas.index(curve["antenna"]), np.flatnonzero(np.isfinite(c)), 0, letters.index(curve["dipole"]))
        gain[at], quality[at], is_flagged[at] = c[at[1]], (sigma / c)[at[1]], False
    there = instrument.at_station(name)
    place = EarthLocation(lat=there.latitude_deg * u.deg, lon=there.longitude_deg * u.deg, height=there.height_m * u.m)
    arms = np.radians([instrument.dipole_azimuth_deg[letter] for letter in letters])
    telescope = Telescope.new(
        name=instrument.name,
        location=place,
        antenna_positions={antenna: np.zeros(3) for antenna in antennas},
        antenna_names=[f"{name}{antenna:03d}" for antenna in antennas],
        instrument=name,
        feed_array=np.array([feeds[letter].lower() for letter in letters]),
        # pyuvdata counts feed angles as the azimuth of the arm, north through east
        feed_angle=arms,
        mount_type="fixed",
    )
    interval = _interval_jd(content, curves)
    made = UVCal.new(
        cal_style="sky",
        cal_type="gain",
        gain_convention="multiply",
        jones_array=np.array([JONES[feeds[letter]] for letter in letters]),
        telescope=telescope,
        time_range=np.array([interval]),
        integration_time=np.array([DAY_S * (interval[1] - interval[0])]),
        freq_array=1e6 * frequency_mhz,
        channel_width=np.full(frequency_mhz.size, 1e6 * float(np.median(np.diff(frequency_mhz)))),
        ant_array=np.array(antennas),
        ref_antenna_name="none",
        sky_catalog=str(content.get("models", {}).get("sky", "see history")),
        gain_scale="V^2",
        update_telescope_from_known=False,
        data={"gain_array": gain, "quality_array": quality, "flag_array": is_flagged},
        history=json.dumps(
            {
                **{name: value for name, value in make_head(content).items() if name != "covariances"},
                "feeds": {feeds[letter].lower(): letter for letter in letters},
            }
        ),
    )
    write = made.write_calfits if path.suffix.lower() == ".calfits" else made.write_calh5
    write(path, clobber=True)


def _feeds_of(instrument: Instrument) -> dict[str, str]:
    """The feed X or Y that each arm is in UVCal: by its letter, else in the order of the instrument."""
    arms = instrument.dipoles
    if len(arms) > len(JONES):
        raise BadInputError("dipole", "at most two arms, which are the feeds x and y of UVCal", ", ".join(arms))
    return {arm: arm for arm in arms} if set(arms) <= JONES.keys() else dict(zip(arms, JONES, strict=False))


def write_station_table(content: Mapping[str, Any], path: Path) -> None:
    """Write the C of one station's paths as a calibration table of a LOFAR 2.0 station.

    A group an antenna holds the complex gains `x` and `y` of its 512 sub-bands. A station multiplies its sub-bands by
    them in fixed point, so they are C over its mean, `lbacal_unit_v`; outside the band they are 1.
    """
    curves, name = _of_one_station(content)
    if not {curve["dipole"] for curve in curves} <= JONES.keys():
        raise BadInputError("dipole", "X and Y for a station table", ", ".join({str(c["dipole"]) for c in curves}))
    at = _require_at(content)
    unit = float(np.nanmean([np.nanmean(np.array(curve["c"], dtype=float)) for curve in curves]))
    subband_mhz = SUBBAND_MHZ * np.arange(SUBBANDS)
    with h5py.File(path, "w") as root:
        root.attrs.update({
            "observation_station": name, "observation_source": "Galaxy", "observation_date": at,
            "calibration_name": "lbacal", "calibration_version": 1, "calibration_date": str(content["as_of"] or at),
            "lbacal_unit_v": unit, "lbacal_calibrations": sorted({curve["calibration"] or "" for curve in curves}),
        })  # fmt: skip
        for curve in curves:
            c, frequency = np.array(curve["c"], dtype=float), np.array(curve["frequency_mhz"])
            known = np.isfinite(c)
            inside = np.interp(subband_mhz, frequency, known.astype(float), 0.0, 0.0) == 1.0
            value = np.where(inside, np.interp(subband_mhz, frequency[known], c[known]) / unit, 1.0)
            root.require_group(f"LBA{curve['antenna']:02d}")[str(curve["dipole"]).lower()] = value.astype(complex)


def _of_one_station(content: Mapping[str, Any]) -> tuple[list[dict[str, Any]], str]:
    """The curves of single paths of one station, on the same channels."""
    curves = [curve for curve in content["curves"] if curve["antenna"] is not None]
    if not curves:
        raise BadInputError("curves", "curves of single paths: a reference chain is nobody's antenna", "none")
    names = sorted({curve["station"] for curve in curves})
    if len(names) != 1:
        raise BadInputError("--station", f"one of {', '.join(names)}", "none")
    if any(curve["frequency_mhz"] != curves[0]["frequency_mhz"] for curve in curves):
        raise BadInputError("frequency_mhz", "the same channels in every curve", "others")
    return curves, str(names[0])


def _sigma(curve: Mapping[str, Any]) -> Floats:
    """Total standard deviation of C, shape (freq,)."""
    system = curve["c_sigma_sys"]
    return np.asarray(
        np.hypot(np.array(curve["c_sigma_stat"], dtype=float), 0.0 if system is None else np.array(system, dtype=float))
    )


def _interval_jd(content: Mapping[str, Any], curves: list[dict[str, Any]]) -> tuple[float, float]:
    """The interval in which all curves are in effect, as Julian dates; open ends are a day from what is known."""
    starts, ends = ([curve["valid"][name] for curve in curves if curve["valid"][name]] for name in ("from", "to"))
    first = max(_to_jd(text) for text in starts or [_require_at(content)])
    last = min((_to_jd(text) for text in ends), default=None)
    return first, last or max(first, _to_jd(content["at"]) if content["at"] else first) + 1.0


def _to_jd(text: str) -> float:
    return JULIAN_DATE_OF_1970 + parse_instant("valid", text) / SECOND_US / DAY_S


def _require_at(content: Mapping[str, Any]) -> str:
    if not content["at"]:
        raise BadInputError("--at", "when the data are taken, because the file does not say it", "none")
    return str(content["at"])
