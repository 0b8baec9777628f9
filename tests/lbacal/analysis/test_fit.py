"""A calibration in Python: the parts of an instrument, units at the edge, results that show themselves."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable
from matplotlib.figure import Figure

import lbacal
from lbacal.analysis.data import spectra_of
from lbacal_core.errors import BadInputError, MissingExtraError, UnknownNameError
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.spectra.spectra import Spectra, write_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

SITE = lbacal.Site(-30.7 * u.deg, 21.4 * u.deg, 1.05 * u.km)
ANTENNA = lbacal.Antenna("short-dipole", {"E": 90, "N": 0 * u.rad, "UP": (0, 90 * u.deg)}, gain=2 * u.m**2)


def make(chain, frequency, **more) -> lbacal.Instrument:
    return lbacal.Instrument("mine", SITE, ANTENNA, chain, frequency, **more)


@pytest.fixture(scope="module")
def found() -> lbacal.Calibration:
    instrument = lbacal.Instrument("mine", SITE, ANTENNA, lbacal.Chain(), np.arange(50, 80) * u.MHz, antennas=2)
    return lbacal.fit(lbacal.simulate(instrument, events=150), instrument)


def test_an_instrument_from_its_parts_is_that_of_its_file(tmp_path):
    made = make(lbacal.Chain(cable=-3 * u.dB), np.arange(50e6, 80e6, 1e6) * u.Hz, antennas=[3, 8])
    made.save(tmp_path / "mine.json")
    core = lbacal.Instrument.load(tmp_path / "mine.json").core
    assert core.as_dict() == made.core.as_dict()
    assert core.height_m == 1050.0
    assert core.dipole_azimuth_deg == {"E": 90.0, "N": 0.0, "UP": 0.0}
    assert core.dipole_tilt_deg == {"UP": 90.0}
    assert core.cables["all"] == pytest.approx(10**-0.3)
    assert core.antenna_gain == pytest.approx(2.0)
    assert [record.antenna for record in core.antennas] == [3, 8]
    assert repr(made).startswith("<Instrument mine: 2 antennas with E, N, UP, 30 channels 50-79 MHz")


def test_a_path_that_was_at_twice_the_power_for_a_quarter_of_its_events_is_named(found):
    spectra = found.spectra
    late = (spectra.time_unix > np.quantile(spectra.time_unix, 0.75)) & (spectra.antenna == 1) & (spectra.dipole == "N")
    changed = replace(spectra, power=np.where(late[:, None], 2.0, 1.0) * spectra.power)
    (said,) = [note for note in lbacal.fit(changed, found.instrument).notes if "changed, or fails at times" in note]
    assert said.startswith("S1 antenna 1 N: its power scatters by 3")
    assert not any("fails at times" in note for note in found.notes)


def test_what_changes_along_the_year_is_told_with_its_size(found):
    """C of a path that had stepped or faded converged, and nothing was said."""
    spectra = found.spectra
    assert not any("C steps" in note or "steady" in note for note in found.notes)
    year = (spectra.time_unix - spectra.time_unix.min()) / 31557600.0
    is_own = (spectra.antenna == 1) & (spectra.dipole == "N")
    step, slope = 0.7 ** (year > 0.5), 1.0 - 0.5 * year
    for change, told, percent in ((step, "C steps by about +", 19.5), (slope, "not steady: about +", 34.7)):
        power = spectra.power * np.where(is_own, change, 1.0)[:, None]
        notes = lbacal.fit(replace(spectra, power=power), found.instrument).notes
        (said,) = [note for note in notes if told in note]
        assert said.startswith("S1 antenna 1 N: ")
        assert float(said.partition("+")[2].split()[0]) == pytest.approx(percent, abs=4.0)


@pytest.mark.parametrize("ask", [lbacal.fit, lbacal.investigate, lbacal.audit])
def test_data_whose_arms_point_elsewhere_than_the_instrument_s_are_refused(found, ask):
    turned = replace(found.spectra, arms_deg={"E": 270.4, "N": 44.0})
    with pytest.raises(
        BadInputError, match=r"arm of N: expected 0 deg, the azimuth of the arm N of .* mine, found 44 deg"
    ):
        ask(turned, found.instrument)


def test_c_of_integrations_of_six_hours_is_that_of_the_path():
    """The sky of the data is the brute-force mean of the sky over six hours about each instant."""
    antenna = lbacal.Antenna("short-dipole", {"N": 0}, gain=2 * u.m**2)
    instrument = lbacal.Instrument("mine", SITE, antenna, lbacal.Chain(), np.arange(50, 80, 2) * u.MHz, antennas=2)
    sky = compute_sky_power(instrument.core)
    steps = 6.0 * ((np.arange(200) + 0.5) / 200 - 0.5)
    mean = np.array([sky.at("N", at + steps).mean(axis=0) for at in sky.lst_hours])
    settings, rng = TwinSettings(events_per_year=200, stations=("S1",)), np.random.default_rng(3)
    campaign = simulate_campaign(settings, instrument.core, replace(sky, power={"N": mean}), rng)
    long = replace(campaign.spectra, duration_s=np.full(len(campaign.spectra), 6 * 3590.17))
    truth = campaign.truth.stations[0].c[:, 0]
    pulls = {
        name: np.mean(
            [np.mean((curve.c - true) / curve.c_sigma_stat) for curve, true in zip(curves, truth, strict=True)]
        )
        for name, curves in (
            ("smeared", lbacal.fit(long, instrument).report.curves),
            ("at an instant", lbacal.fit(campaign.spectra, instrument).report.curves),
        )
    }
    # two paths of 1 % each; the first harmonic is 10 % weaker, and C 5 % or more larger where nobody knows
    assert abs(pulls["smeared"]) < 2.0
    assert pulls["at an instant"] > 4.0


def test_stages_of_a_chain_multiply_whatever_their_kind():
    nu = np.array([50.0, 60.0, 70.0])
    table = ([50, 70] * u.MHz, [0, -20] * u.dB)
    chain = lbacal.Chain([20 * u.dB, 0.5, table, lambda frequency_mhz: 1 + (frequency_mhz > 55)])
    assert chain.receiver_gain(nu) == pytest.approx([50.0, 10.0, 1.0])
    assert lbacal.Chain().receiver_gain(nu) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        (([50, 60] * u.MHz, [1, 2]), "a table from 50 to 70 MHz, found 50 to 60 MHz"),
        (([60, 50] * u.MHz, [1, 2]), "channels rise"),
        (([50, 60] * u.MHz, [1, 2, 3]), "a value for each of 2 frequencies"),
    ],
)
def test_a_table_that_does_not_cover_the_channels_is_refused(table, sentence):
    with pytest.raises(BadInputError, match=sentence):
        lbacal.Chain([table]).receiver_gain(np.array([50.0, 70.0]))


def test_a_quantity_of_another_kind_is_no_angle():
    with pytest.raises(BadInputError, match="a quantity: expected one in deg, or a number"):
        lbacal.Instrument("mine", lbacal.Site(3 * u.m, 0), ANTENNA, lbacal.Chain(), [50, 60] * u.MHz)


def test_a_curve_is_a_table_with_units(found):
    curve = found["S1", 1, "UP"]
    assert curve["c"].unit == u.V
    assert curve["frequency_mhz"].to_value(u.Hz) == pytest.approx(np.arange(50e6, 80e6, 1e6))
    report = next(one for one in found.report.curves if (one.antenna, one.dipole) == (1, "UP"))
    np.testing.assert_array_equal(curve["c"].value, report.c)
    assert len(found.table) == 6 * 30
    with pytest.raises(UnknownNameError, match="unknown curve 'S1 7 E'; known: S1 antenna 0 E"):
        found["S1", 7, "E"]


def test_a_table_from_a_file_has_its_curves_by_name_and_its_columns_as_ever(found, tmp_path):
    found.save(tmp_path / "C.ecsv")
    found.save(tmp_path / "C.csv")
    with pytest.raises(BadInputError, match=r"C\.csv: expected curves as \.ecsv, .*QTable\.read reads"):
        lbacal.read(tmp_path / "C.csv")
    table = lbacal.read(tmp_path / "C.ecsv")
    np.testing.assert_array_equal(table["S1", 1, "UP"]["c"], found["S1", 1, "UP"]["c"])
    assert table["S1", 1, "UP"].mean(50, 60).c.to_value(u.V) == found["S1", 1, "UP"].mean(50, 60).c.to_value(u.V)
    assert table["c", "flag"][:1].colnames == ["c", "flag"]
    assert len(table[[0, 1]]) == 2
    with pytest.raises(UnknownNameError, match="unknown curve 'S1 E'; known: S1 antenna 0 E"):
        table["S1", "E"]


def test_a_result_shows_itself_in_a_shell_and_in_a_notebook(found):
    assert repr(found).startswith("<Calibration mine: ")
    assert "6 of 6 curves converged" in repr(found)
    assert "\nS1 antenna 0 E   converged" in repr(found)
    page = found._repr_html_()
    assert page.count("<tr>") == 1 + 6
    assert "N_RCU, N_ADC cannot be told apart" in page


def test_a_figure_is_drawn_whole_or_on_axes_that_are_given(found):
    figure = found.plot()
    assert [axes.get_title() for axes in figure.axes[:3]] == [f"C, polarisation {d}" for d in ("E", "N", "UP")]
    assert "power (W m⁻² MHz⁻¹)" in [axes.get_ylabel() for axes in figure.axes]
    axes = Figure().subplots()
    assert found.plot(axes) is axes.figure
    assert found["S1", 1, "UP"].plot(axes) is axes.figure
    assert axes.get_ylabel() == "C (µV per ADC unit)"


@pytest.mark.parametrize("suffix", ["ecsv", "fits", "h5", "json"])
def test_what_is_saved_is_read_back_with_its_covariance(found, tmp_path, suffix):
    found.save(tmp_path / f"c.{suffix}")
    read = lbacal.read(tmp_path / f"c.{suffix}")
    again = read[(read["antenna"] == 1) & (read["dipole"] == "UP")].mean(55, 75)
    assert again.sigma.value == pytest.approx(found["S1", 1, "UP"].mean(55, 75).sigma.value, rel=1e-5)


@pytest.mark.parametrize("suffix", ["ecsv", "fits", "h5", "json", "png", "html"])
def test_a_table_of_curves_is_saved_as_it_was_read(found, tmp_path, suffix):
    table = found.table[found.table["antenna"] == 1]
    table.save(tmp_path / f"c.{suffix}")
    if suffix in ("png", "html"):
        assert (tmp_path / f"c.{suffix}").stat().st_size > 10_000
        return
    read = lbacal.read(tmp_path / f"c.{suffix}")
    np.testing.assert_array_equal(read["c"], table["c"])
    assert read.meta["provenance"] == table.meta["provenance"]
    again, value = (one["S1", 1, "UP"].at(60).sigma.value for one in (read, table))
    assert again == pytest.approx(value, rel=1e-5)
    with pytest.raises(BadInputError, match=r"\.fits.*, found \.xls"):
        table.save(tmp_path / "c.xls")


def test_a_part_of_a_curves_channels_has_no_mean_and_says_how_to_ask(found):
    curve = found["S1", 1, "UP"]
    with pytest.raises(BadInputError, match=r"all 30 channels of the curve, .*, found 19 rows \(mean\(low, high\)"):
        curve[curve["frequency_mhz"] > 60 * u.MHz].mean(60, 70)
    with pytest.raises(BadInputError, match="expected one in MHz, or a number"):
        curve.mean("low", 70)
    for band in ((10, 90), (60, 95), (55.2, 55.3)):
        with pytest.raises(BadInputError, match="a band with a channel that has C, within 50 to 79 MHz, found"):
            curve.mean(*band)
    assert curve.mean(49.5, 79.5).c == curve.mean(50, 79).c


def test_an_ending_says_the_format_and_an_unknown_one_is_refused(found, tmp_path):
    for suffix, begins in (("png", b"\x89PNG"), ("html", b"<!doctype html>"), ("csv", b"station,antenna")):
        found.save(tmp_path / f"c.{suffix}")
        assert (tmp_path / f"c.{suffix}").read_bytes().startswith(begins)
    with pytest.raises(BadInputError, match=r"a name that ends in .*\.fits.*, found \.xls"):
        found.save(tmp_path / "c.xls")


def test_the_error_of_a_mean_is_that_of_its_channels_as_they_move_together(found):
    curve = found["S1", 1, "UP"]
    mean, single = curve.mean(50, 79), curve["c_sigma_sys"]
    together = np.mean(single)  # fully correlated: an upper limit
    assert 0.5 * together < mean.c_sigma_sys <= 1.0001 * together
    assert mean.c.to_value(u.V) == pytest.approx(np.mean(curve["c"].value))
    assert mean.sigma == np.hypot(mean.c_sigma_stat, mean.c_sigma_sys)


def test_a_value_on_a_channel_is_that_of_the_channel_and_between_two_lies_between(found):
    curve = found["S1", 1, "UP"]
    on, between = curve.at(60 * u.MHz), curve.at([60.5, 61.25])
    row = curve[curve["frequency_mhz"] == 60 * u.MHz]
    assert on.c == row["c"][0]
    assert on.c_sigma_stat.to_value(u.V) == pytest.approx(row["c_sigma_stat"][0].to_value(u.V), rel=1e-3)
    assert on.c_sigma_sys.to_value(u.V) == pytest.approx(row["c_sigma_sys"][0].to_value(u.V), rel=1e-3)
    assert between.c[0] == (curve["c"][10] + curve["c"][11]) / 2
    assert between.covariance.shape == (2, 2)
    np.testing.assert_allclose(np.sqrt(np.diag(between.covariance.value)), between.sigma.to_value(u.V))
    with pytest.raises(BadInputError, match="at: expected 50 to 79 MHz"):
        curve.at(81)
    with pytest.raises(BadInputError, match="where C is known"):
        curve.at([])
    with pytest.raises(BadInputError, match="2 paths"):
        found.table[np.isin(found.table["dipole"], ["E"])].mean(50, 60)


def test_no_antenna_named_is_an_error_that_lists_what_there_is():
    core = load_instrument("lofar-superterp")
    elsewhere = lbacal.Instrument("mine", SITE, lbacal.Antenna("nothing", {"A": 0}), lbacal.Chain(), [50, 60] * u.MHz)
    with pytest.raises(
        UnknownNameError, match=r"unknown antenna model 'nothing', and no such file; known: hamaker.*quarter-wave"
    ):
        elsewhere.sky_power()
    assert lbacal.Instrument.load("lofar-superterp").core.as_dict() == core.as_dict()


def test_importing_lbacal_loads_nothing_that_fits():
    code = "import sys, lbacal; print([m for m in ('scipy', 'healpy', 'matplotlib') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_without_the_extra_one_sentence_names_it(monkeypatch):
    monkeypatch.setattr("lbacal.find_spec", lambda _: None)
    with pytest.raises(MissingExtraError, match=r"^lbacal.fit needs the extra fit: pip install 'lbacal\[fit\]'$"):
        _ = lbacal.fit
    with pytest.raises(AttributeError, match="no attribute 'fitt'"):
        _ = lbacal.fitt


def test_stations_with_sites_of_their_own_are_simulated_and_fitted_where_they_stand() -> None:
    east = lbacal.Site(-30.7 * u.deg, 51.4 * u.deg)
    nu = np.arange(50, 80, 5) * u.MHz
    instrument = make(lbacal.Chain(), nu, antennas={"S1": 1, "S2": [7]}, sites={"S2": east})
    spectra = lbacal.simulate(instrument, events=80, stations=["S1", "S2"])
    found = lbacal.fit(spectra, instrument)
    assert {(curve.station, curve.antenna) for curve in found.report.curves} == {("S1", 0), ("S2", 7)}
    assert instrument.core.at_station("S2").longitude_deg == 51.4
    assert set(spectra.truth["station"]) == {"S1", "S2"}
    assert np.all(np.isfinite(found["S2", 7, found.report.curves[0].dipole]["c"]))


def test_the_quick_audit_runs_before_a_fit_and_refuses_volts() -> None:
    spectra = lbacal.simulate("lofar-superterp", events=60, antennas=6)
    assert "nothing wrong between 6 antennas" in lbacal.fit(spectra, "lofar-superterp").report.provenance.notes["audit"]
    with pytest.raises(BadInputError, match="volts"):
        lbacal.fit(replace(spectra, power=spectra.power**0.5), "lofar-superterp")


@pytest.fixture(scope="module")
def without_40() -> Spectra:
    whole = lbacal.simulate("lofar-superterp", events=80, antennas=2)
    kept = whole.frequency_mhz != 40.0
    return Spectra(**{
        one.name: getattr(whole, one.name) for one in fields(Spectra)
    } | {"frequency_mhz": whole.frequency_mhz[kept], "power": whole.power[:, kept], "width_mhz": None})  # fmt: skip


@pytest.mark.parametrize("dead", [0.0, np.nan, 1e-30])
def test_a_channel_without_power_is_left_out_and_told(without_40, dead, tmp_path: Path) -> None:
    at = int(np.searchsorted(without_40.frequency_mhz, 40.0))
    file = tmp_path / "s.h5"
    write_spectra(without_40, file)
    with h5py.File(file, "r+") as content:
        nu, power = (
            np.insert(content[name][:], at, put, -1) for name, put in (("frequency_mhz", 40.0), ("power", dead))
        )
        del content["frequency_mhz"], content["power"]
        content["frequency_mhz"], content["power"] = nu, power
    found, expected = (lbacal.fit(one, "lofar-superterp").report for one in (file, without_40))
    for curve, other in zip(found.curves, expected.curves, strict=True):
        assert curve.frequency_mhz.size == 50
        np.testing.assert_array_equal(curve.c, other.c)
    assert found.provenance.notes["channels"] == "1 of 51 hold no power or are not in the spectra: 40 MHz"


def test_a_channel_of_hardly_any_power_is_left_out_of_spectra_in_memory(without_40) -> None:
    nu, power = np.append(without_40.frequency_mhz, 90.0), np.insert(without_40.power, 50, 1e-30, axis=1)
    assert spectra_of(replace(without_40, frequency_mhz=nu, power=power)).frequency_mhz[-1] == 80.0
    assert spectra_of(without_40) is without_40


def test_budget_audit_and_investigation_are_without_a_channel_that_the_spectra_lack(without_40) -> None:
    assert lbacal.budget(without_40, "lofar-superterp").budget.frequency_mhz.size == 50
    assert lbacal.audit(without_40, "lofar-superterp").wrong == []
    notes = lbacal.investigate(without_40, "lofar-superterp").as_dict()["provenance"]["notes"]
    assert notes["channels"].endswith("40 MHz")


NU = np.array([30.0, 55.0, 80.0])
GAIN = np.array([3.5, 310.0, 19.0])


def make_table() -> QTable:
    table = QTable()
    table["frequency_mhz"] = np.tile(NU, 2) * u.MHz
    table["c"] = np.tile([1.0, 2.0, 3.0], 2) * 1e-5 * u.V
    table["c_sigma_stat"] = 0.01 * table["c"]
    table["c_sigma_sys"] = 0.1 * table["c"]
    table["antenna_gain"] = np.tile(GAIN, 2) * u.m**2
    table["c_over_h"] = table["c"] / np.sqrt(table["antenna_gain"])
    return table


def test_c_carried_to_another_antenna_gives_the_same_field() -> None:
    table, other = make_table(), np.array([20.0, 3.5, 457.0])
    carried = lbacal.carry_to_antenna(table, NU[[2, 0, 1]], other)  # in any order of channels
    np.testing.assert_allclose((carried["c"] / np.sqrt(carried["antenna_gain"]) / table["c_over_h"]).value, 1.0)
    np.testing.assert_allclose((carried["c"] / table["c"]).value[:3], np.sqrt(other[[1, 2, 0]] / GAIN))
    np.testing.assert_allclose((carried["c_sigma_stat"] / carried["c"]).value, 0.01)
    np.testing.assert_array_equal(table["antenna_gain"].value, np.tile(GAIN, 2))  # the table given is as it was


def test_c_carried_to_its_own_antenna_is_what_it_was() -> None:
    np.testing.assert_array_equal(lbacal.carry_to_antenna(make_table(), NU, GAIN)["c"], make_table()["c"])
    with_units = lbacal.carry_to_antenna(make_table(), NU / 1e3 * u.GHz, GAIN * 1e4 * u.cm**2)
    np.testing.assert_allclose(with_units["c"].value, make_table()["c"].value)


@pytest.mark.parametrize(
    ("nu", "gain", "said"),
    [
        (NU[:2], GAIN[:2], "none at 80 MHz"),
        (NU, GAIN[:2], "a number for each of 3 frequencies, found 2"),
        (NU, -GAIN, rf"finite m\^2 > 0, found {-GAIN[0]:g} at {NU[0]:g} MHz"),
        (NU / 1e3, GAIN, "looks like GHz"),
        (NU, GAIN * u.dB, "one in m2"),
    ],
)
def test_a_gain_that_does_not_cover_the_channels_is_refused(nu: np.ndarray, gain: np.ndarray, said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        lbacal.carry_to_antenna(make_table(), nu, gain)


def test_c_of_unknown_antenna_gain_is_not_mixed_with_another_antenna() -> None:
    table = make_table()
    table["antenna_gain"] = np.nan * u.m**2
    with pytest.raises(BadInputError, match="refit"):
        lbacal.carry_to_antenna(table, NU, GAIN)
    table.remove_column("antenna_gain")
    with pytest.raises(BadInputError, match="no such column"):
        lbacal.carry_to_antenna(table, NU, GAIN)


NU_OF_CHAIN = np.array([50.0, 60.0, 80.0])


def chain_of(*stages):
    return lbacal.Chain([
        lbacal.Stage("lna", 25 * u.dB, noise=150 * u.K, error=15),
        lbacal.Stage("cable"),
        lambda nu: 1 / (1 + (nu / 70) ** 12),
        lbacal.Stage("amplifier", 30 * u.dB, noise="free", name="amp"),
        lbacal.Stage("adc", noise="free"),
        *stages,
    ], cable=-4 * u.dB)  # fmt: skip


def test_stages_that_say_their_noise_are_those_of_the_instrument_file(tmp_path):
    site, antenna = lbacal.Site(52.9, 6.9), lbacal.Antenna("short-dipole", {"A": 0}, gain=2.0, gain_source="a table")
    made = lbacal.Instrument("mine", site, antenna, chain_of(), NU_OF_CHAIN * u.MHz)
    kinds = [(stage.name, stage.kind) for stage in made.core.stages]
    assert kinds == [("lna", "lna"), ("cable", "cable"), ("gain 2", "filter"), ("amp", "amplifier"), ("adc", "adc")]
    np.testing.assert_allclose(made.core.receiver_gain, 1000 / (1 + (NU_OF_CHAIN / 70) ** 12))
    np.testing.assert_allclose(made.core.cables["all"], 10**-0.4)
    made.save(tmp_path / "mine.json")
    assert lbacal.Instrument.load(tmp_path / "mine.json").core.digest() == made.core.digest()


def test_a_noise_temperature_is_a_number_or_a_table_and_a_cable_may_have_a_gain_of_its_own():
    table = ([40, 90] * u.MHz, [100, 200] * u.K)
    chain = lbacal.Chain([
        lbacal.Stage("load", noise=table), lbacal.Stage("cable", 0.5), lbacal.Stage("adc", noise="free")
    ])  # fmt: skip
    np.testing.assert_allclose(chain.core_stages(NU_OF_CHAIN)[0].noise_k, [120, 140, 180])
    np.testing.assert_allclose(chain.cable_loss(NU_OF_CHAIN), 0.5)


def test_bare_gains_alone_make_the_chain_of_the_paper():
    assert lbacal.Chain([20 * u.dB, 0.5]).core_stages(NU_OF_CHAIN) == ()


def test_a_list_that_is_no_chain_is_refused_as_in_a_file():
    with pytest.raises(BadInputError, match="the adc as the last stage"):
        chain_of(lbacal.Stage("amplifier", 2.0)).core_stages(NU_OF_CHAIN)


def test_a_touchstone_file_is_a_gain(tmp_path):
    (tmp_path / "f.s2p").write_text("# MHz S DB R 50\n40 -20 0 -20 0 -60 0 -20 0\n90 -20 0 -20 0 -60 0 -20 0\n")
    np.testing.assert_allclose(lbacal.Chain([str(tmp_path / "f.s2p")]).receiver_gain(NU_OF_CHAIN), 0.01)


@pytest.mark.long
def test_where_no_path_has_a_c_at_the_hours_on_record_the_fit_says_what_the_audit_finds():
    """A longitude of the wrong sign left every curve without values, called the paths dead and named no mistake."""
    spectra = lbacal.simulate("lofar-superterp", events=200, antennas=3)
    found = lbacal.fit(replace(spectra, time_unix=spectra.time_unix + 9 * 3600), "lofar-superterp")
    assert {curve.status for curve in found.report.curves} == {"not_identifiable"}
    (said,) = [note for note in found.notes if note.startswith("likely mistake: ")]
    assert re.search(r"a clock that is 5[34]\d min ahead", said)  # 540; sidereal time is known to 7 min
    assert not any(note.startswith("audit: nothing wrong") for note in found.notes)
    assert any("does not follow P_sky at these sidereal times" in note for note in found.notes)
