import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lbacal_core.antenna.names import load_antenna
from lbacal_core.antenna.varied import VariedAntenna
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import GainProvenance
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.antenna_of import antenna_of
from lbacal_core.sky.model import find_sources
from lbacal_core.sky.power import compute_sky_power, vary_sky_power
from lbacal_core.sky.sources import add_sources, response_towards
from lbacal_core.sky.table import read_sky_power, write_sky_power

LST = np.arange(24.0)


@pytest.fixture
def content(chain: Instrument, tmp_path: Path) -> dict[str, Any]:
    """A sky power file as it is written."""
    write_sky_power(compute_sky_power(chain, lst_hours=LST), tmp_path / "P.json")
    read: dict[str, Any] = json.loads((tmp_path / "P.json").read_text())
    return read


def check(content: dict[str, Any], instrument: Instrument, folder: Path) -> str:
    (folder / "Q.json").write_text(json.dumps(content))
    sky_power = read_sky_power(folder / "Q.json")
    sky_power.require_made_for(instrument)
    return sky_power.note_for(instrument)


def test_a_file_says_instrument_sky_antenna_and_arms_and_passes(content, chain, tmp_path):
    assert (content["instrument"], content["sky"], content["antenna"]) == ("lofar-superterp", "gsm", "hamaker")
    assert content["dipoles"] == {"X": {"azimuth_deg": 45.0}, "Y": {"azimuth_deg": 135.0}}
    assert set(content["hashes"]) == {"instrument", "sky", "antenna"}
    assert set(content["versions"]) == {"lbacal", "model_version"}
    assert check(content, chain, tmp_path) == "sky gsm, antenna hamaker"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"instrument": "another"}, "instrument: expected that of the fit, 'lofar-superterp', found 'another'"),
        ({"dipoles": {"X": {"azimuth_deg": 135.0}}}, "dipoles.X.azimuth_deg: expected 45"),
        ({"dipoles": {"Z": {"azimuth_deg": 135.0}}}, "dipoles.Z.azimuth_deg: expected no such dipole"),
        ({"hashes": {"instrument": "0" * 64}}, "hashes.instrument: expected that of the place, arms and channels"),
        ({"hashes": {"sky": "0" * 64}}, "hashes.sky: expected this package's sky gsm"),
        ({"hashes": {"antenna": "0" * 64}}, "hashes.antenna: expected this package's antenna hamaker"),
        ({"antenna": "isotropic"}, "hashes.antenna: expected this package's antenna isotropic"),
        ({"dipoles": {"X": 45.0}}, "dipoles.X: expected an object with azimuth_deg"),
        ({"sky": 3}, "sky: expected a name"),
    ],
)
def test_a_mismatch_of_what_is_there_is_an_error(content, chain, tmp_path, change, said):
    with pytest.raises(BadInputError, match=said):
        check(content | change, chain, tmp_path)


def test_a_file_that_says_nothing_is_accepted_and_said_to_be_unchecked(content, chain, tmp_path):
    bare = {name: content[name] for name in ("frequency_mhz", "lst_hours", "X", "Y")}
    assert check(bare, chain, tmp_path).startswith("unchecked")


def test_other_cables_are_no_mismatch_but_another_place_is(content, chain, tmp_path):
    check(content, replace(chain, receiver_gain=chain.receiver_gain / 2), tmp_path)
    with pytest.raises(BadInputError, match=r"hashes\.instrument"):
        check(content, replace(chain, latitude_deg=50.0), tmp_path)


def test_d_of_one_antenna_is_not_joined_with_the_absolute_gain_of_another(content, chain, tmp_path):
    gain = GainProvenance("absolute", "a table", antenna_sha256="0" * 64)
    with pytest.raises(BadInputError, match="antenna: expected the antenna of which"):
        check(content, replace(chain, gain_provenance=gain), tmp_path)
    own = replace(gain, antenna_sha256=content["hashes"]["antenna"])
    check(content, replace(chain, gain_provenance=own), tmp_path)


def test_another_antenna_than_the_named_one_is_told(chain):
    sky_power = compute_sky_power(chain, antenna="short-dipole", lst_hours=LST)
    assert sky_power.note_for(chain).endswith("instrument lofar-superterp names the antenna hamaker")


def test_a_sky_with_a_source_added_is_not_called_by_the_name_of_the_model(chain):
    added = add_sources(compute_sky_power(chain, lst_hours=LST), chain, find_sources(["cas-a"]), 2015.0)
    assert added.made_for is not None
    assert added.made_for.sky == "gsm + cas-a 2015"
    assert "sky" not in added.made_for.hashes


def test_an_instrument_elsewhere_does_not_get_the_pattern_of_lofar(chain):
    """Before, the LBA's pattern on another antenna put C wrong by 24-51 % and nobody was told."""
    auger = replace(chain, name="AERA", latitude_deg=-35.2, longitude_deg=-69.3, antenna=None)
    with pytest.raises(BadInputError, match=r"hamaker, hamaker-resonant, .*short-dipole"):
        compute_sky_power(auger)
    named = compute_sky_power(replace(auger, antenna="short-dipole"), lst_hours=LST)
    assert named.origin == "sky gsm, antenna short-dipole"
    assert vary_sky_power(auger, lst_hours=LST, zenith_exponent=1.0).power["X"].shape == (24, 51), "for ratios"


def test_a_file_of_a_lofar_station_that_names_no_antenna_gets_that_of_lofar(chain):
    assert antenna_of(replace(chain, name="RS509", latitude_deg=53.41, longitude_deg=6.79, antenna=None)) == "hamaker"


def test_changes_of_the_beam_are_those_of_the_antenna_that_the_instrument_names(chain):
    """Before, sources and beam variations of any instrument were seen by the pattern of LOFAR."""
    named = replace(chain, antenna="short-dipole")
    zenith, azimuth = np.array([0.9]), np.array([1.0])
    plain, other = (response_towards(one, "X", zenith, azimuth) for one in (chain, named))
    np.testing.assert_array_equal(other, response_towards(chain, "X", zenith, azimuth, "short-dipole"))
    assert np.max(np.abs(other / plain - 1)) > 0.1
    varied = vary_sky_power(named, lst_hours=LST, azimuth_deg=10.0)
    turned = compute_sky_power(chain, None, VariedAntenna(load_antenna("short-dipole"), 10.0), LST)
    np.testing.assert_allclose(varied.power["Y"], turned.power["Y"], rtol=1e-12)


@pytest.mark.parametrize(("factor", "is_said"), [(1.0, False), (7.53, False), (1e6, True), (1e-6, True)])
def test_a_sky_in_another_unit_is_said_to_make_c_relative(content, chain, tmp_path, factor, is_said):
    """One 1e6 too large converged, with C a thousand times too small."""
    scaled = content | {letter: (factor * np.array(content[letter])).tolist() for letter in "XY"}
    assert ("times the Galaxy in W m^-2 MHz^-1: C is relative" in check(scaled, chain, tmp_path)) == is_said
