from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.names import load_sky
from lbacal_core.sky.sources import find_sources
from lbacal_core.skypower.model import compute_sky_power, vary_sky_power
from lbacal_core.skypower.sources import add_sources


def test_the_sky_of_the_superterp_has_a_physical_size() -> None:
    power = compute_sky_power(load_instrument("lofar-superterp"))
    mean = np.mean([power.power[dipole].mean(axis=0) for dipole in "XY"], axis=0)
    # k_B Z_0 nu^2 / (c^2 R_r) T Omega with T = 3999 K at 60 MHz (all-sky mean) and Omega between pi/2 and pi.
    per_kelvin = 1.380649e-23 * 376.73 * (60e6 / 2.99792458e8) ** 2 / 50 * 1e6
    assert per_kelvin * 3999 * np.pi / 2 < mean[30] < per_kelvin * 3999 * np.pi


def test_the_galactic_centre_passes_first_over_the_ne_sw_dipole() -> None:
    power = compute_sky_power(load_instrument("lofar-superterp"))
    peak = {dipole: power.lst_hours[power.power[dipole].sum(axis=1).argmax()] for dipole in "XY"}
    assert 17 < peak["X"] < 19
    assert 19.5 < peak["Y"] < 21


@pytest.mark.shared
def test_the_embedded_sky_has_the_lst_shape_of_the_map_it_stands_for(shared: Path) -> None:
    instrument = load_instrument("lofar-superterp")
    own = compute_sky_power(instrument)
    full = compute_sky_power(instrument, str(shared / "data/sky/gsm-408locked.npz"))
    for dipole in "XY":
        ratio = own.power[dipole] / full.power[dipole]
        shape = ratio / ratio.mean(axis=0)
        # 1 %: another release of the Global Sky Model, and below 50 MHz an extrapolation; 0.3 % at 50-80 MHz.
        assert np.abs(shape - 1).max() < 0.01
        assert np.abs(shape[:, 10:] - 1).max() < 0.006


def test_the_grid_does_not_matter_between_its_points() -> None:
    instrument = load_instrument("lofar-superterp")
    coarse = compute_sky_power(instrument, lst_hours=np.arange(48) / 2 + 0.1)
    fine = compute_sky_power(instrument)
    lst = np.array([0.3, 7.77, 19.01])
    assert coarse.at("X", lst) == pytest.approx(fine.at("X", lst), rel=1e-9)


def test_the_digest_of_a_computed_table_is_that_of_its_inputs() -> None:
    instrument = load_instrument("lofar-superterp")
    one, again = compute_sky_power(instrument), compute_sky_power(instrument)
    rounded = replace(one, power={dipole: values * (1 + 1e-15) for dipole, values in one.power.items()})
    assert one.digest() == again.digest()
    # Numbers without inputs are named by their bits, and a changed table never keeps the name of the old one.
    assert rounded.digest() != one.digest()
    assert rounded.of_inputs(one.digest()).digest() == one.digest()


def test_another_sky_antenna_arm_or_place_is_another_digest() -> None:
    instrument = load_instrument("lofar-superterp")
    turned = replace(instrument, dipole_azimuth_deg={"X": 46.0, "Y": 136.0})
    moved = replace(instrument, latitude_deg=50.0)
    tables = [
        compute_sky_power(instrument),
        compute_sky_power(instrument, load_sky("gsm").changed(scale=1.1)),
        compute_sky_power(instrument, antenna="short-dipole"),
        compute_sky_power(turned),
        compute_sky_power(moved),
        vary_sky_power(instrument, zenith_gain_fraction=0.1),
        add_sources(compute_sky_power(instrument), instrument, find_sources(["cas-a"])),
    ]
    assert len({table.digest() for table in tables}) == len(tables)


def test_another_gain_of_the_same_antenna_is_the_same_sky_power() -> None:
    # The gain is the instrument's; a fit names that input by itself.
    instrument = load_instrument("lofar-superterp")
    louder = replace(instrument, antenna_gain=2 * instrument.antenna_gain)
    assert compute_sky_power(instrument).digest() == compute_sky_power(louder).digest()
