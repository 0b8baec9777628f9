from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.calibration.chain_test import list_other_antennas
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.differences import LST_HOURS
from lbacal_core.skypower.model import compute_sky_power


def test_dipoles_of_all_heights_are_tried_and_not_one():
    """One height stood for all: a dipole 0.1 m lower passed for LOFAR's antenna, and C was off by 0.35."""
    instrument = load_instrument("lofar-superterp")
    own = compute_sky_power(instrument, lst_hours=LST_HOURS).power
    others = {one.name: one.change for one in list_other_antennas(instrument, own, LST_HOURS)}
    assert "hamaker" not in others
    assert "quarter-wave" in others
    of_dipoles = [change["X"] for name, change in others.items() if name.startswith("a short dipole")]
    levels = np.array([change.mean(axis=0)[-1] for change in of_dipoles])
    # from less power than LOFAR's antenna gets, relative to the zenith, to ten times as much
    assert levels[0] < 0.0
    assert levels[-1] > 2.0
    assert np.all(np.diff(levels) > 0.0)
    # any height between 0.6 and 1.7 m is near one of them
    for height in (0.66, 1.01, 1.37, 1.61):
        true = np.log(
            compute_sky_power(instrument, antenna=ShortDipole(height), lst_hours=LST_HOURS).power["X"] / own["X"]
        )
        assert (
            min(np.abs(true - change).max() for change in of_dipoles) < 0.4
        )  # between neighbours that differ by 0.8 at 80 MHz


def test_an_instrument_elsewhere_is_asked_for_other_heights_and_for_the_lba():
    dipole = replace(load_instrument("lofar-superterp"), antenna="short-dipole", gain_provenance=None)
    own = compute_sky_power(dipole, lst_hours=LST_HOURS).power
    others = list_other_antennas(dipole, own, LST_HOURS)
    names = [one.name for one in others]
    assert names[:2] == ["hamaker", "quarter-wave"]
    assert [one.share for one in others[:2]] == pytest.approx([1 / 3, 1 / 3])
    assert sum(one.share for one in others) == pytest.approx(1.0)
    assert len(names) > 10
    assert "a short dipole at 1.43 m" in names


def test_heights_follow_the_band():
    lofar = load_instrument("lofar-superterp")
    low = replace(
        lofar,
        frequency_mhz=lofar.frequency_mhz[:20],
        **{name: getattr(lofar, name)[:20] for name in ("antenna_gain", "receiver_gain")},
        cables={name: loss[:20] for name, loss in lofar.cables.items()},
        gain_provenance=None,
    )
    own = compute_sky_power(low, lst_hours=LST_HOURS).power
    names = [one.name for one in list_other_antennas(low, own, LST_HOURS)]
    assert names[-1] == "a short dipole at 2.92 m"
    assert pytest.approx(3.0, abs=0.01) == 2 * np.pi * 49e6 * 2.92 / 299792458.0
