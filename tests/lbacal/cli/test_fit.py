from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy.table import Table

from lbacal.calibration_files import read_calibrations
from lbacal_core.curves.galcal import find_problems
from lbacal_core.spectra.spectra import read_spectra, write_spectra
from tests import short_dipole
from tests.lbacal.cli.conftest import Lbacal

OUTPUTS = ["--output", "C.ecsv", "--report", "fit.json"]
FIT = ["fit", "spectra.h5", "--instrument", "instrument.json", "--sky-power", "sky_power.json", *OUTPUTS]


@pytest.mark.parametrize(("scope", "curves", "means"), [("antenna", 4, 0), ("station", 2, 2), ("array", 2, 2)])
def test_curves_of_a_scope_go_to_table_and_report_and_a_mean_of_paths_is_said_to_be_nobodys_cable(
    folder: Path, lbacal: Lbacal, scope: str, curves: int, means: int
) -> None:
    code, out, err = lbacal(*FIT, "--scope", scope)
    assert (code, err) == (0, "")
    assert f"{curves} of {curves} curves converged" in out
    report = json.loads((folder / "fit.json").read_text())
    assert len(report["curves"]) == curves
    for curve in report["curves"]:
        # 120 events of 2 % noise give about 0.3 % per channel: five times that.
        np.testing.assert_allclose(curve["c"], 0.5, rtol=0.03)
    assert len(Table.read(folder / "C.ecsv", format="ascii.ecsv")) == curves * 51
    assert out.count("reference chain of 2 paths, nobody's cable; too few paths could be fitted by themselves") == means
    assert [curve["reference"] is not None for curve in report["curves"]] == [bool(means)] * curves


@pytest.mark.usefixtures("folder")
def test_the_table_says_chi2_and_one_line_the_error_for_one_event(lbacal: Lbacal) -> None:
    _, out, _ = lbacal(*FIT, "--scope", "station")
    (line,) = [line for line in out.splitlines() if line.startswith("CS002 X ")]
    assert re.search(r"converged +120 +\d\.\d\d +\d+\.\d\d +\d+\.\d\d +\d+ of 51 ", line)
    assert out.count("error of C for one event on one antenna:") == 1
    assert "chi2/dof tests the chain along frequency: 1.0 ± 0.2" in out


@pytest.mark.long
def test_page_and_figure_are_written(folder: Path, lbacal: Lbacal) -> None:
    code, out, err = lbacal(*FIT, "--html", "fit.html", "--plot", "fit.svg")
    assert (code, err) == (0, "")
    assert "wrote C.ecsv and fit.json and fit.html and fit.svg" in out
    page = (folder / "fit.html").read_text()
    assert "for one event on one antenna" in page
    assert not re.findall(r"""(?:src|href)=["'](?!data:|#)""", page)
    assert "<svg" in (folder / "fit.svg").read_text()[:2000]


def test_two_halves_in_a_folder_are_the_whole(folder: Path, lbacal: Lbacal) -> None:
    lbacal(*FIT)
    whole = json.loads((folder / "fit.json").read_text())
    assert whole["provenance"]["settings"]["scope"] == "antenna", "unless another is given"
    spectra = read_spectra(folder / "spectra.h5")
    (folder / "halves").mkdir()
    for number, rows in enumerate((slice(0, None, 2), slice(1, None, 2))):
        write_spectra(spectra.select(np.arange(len(spectra))[rows]), folder / "halves" / f"{number}.h5")
    code, _, err = lbacal("fit", "halves", *FIT[2:])
    assert (code, err) == (0, "")
    halves = json.loads((folder / "fit.json").read_text())
    assert halves["provenance"]["inputs"] == whole["provenance"]["inputs"]
    assert halves["curves"] == whole["curves"]


def test_a_window_and_a_station_are_chosen(folder: Path, lbacal: Lbacal) -> None:
    spectra = read_spectra(folder / "spectra.h5")
    middle = datetime.fromtimestamp(float(np.median(spectra.time_unix)), UTC).isoformat()
    lbacal(*FIT, "--since", middle, "--station", "CS002")
    assert {curve["events"] for curve in json.loads((folder / "fit.json").read_text())["curves"]} == {60}
    code, _, err = lbacal(*FIT, "--station", "CS099")
    assert code == 2
    assert "of CS002" in err


def test_the_residual_of_uneven_instants_is_printed_and_kept(folder: Path, lbacal: Lbacal) -> None:
    content = json.loads((folder / "sky_power.json").read_text())
    kept = [k for k in range(96) if k % 9 != 4]
    uneven = {name: [content[name][k] for k in kept] for name in ("lst_hours", "X", "Y")}
    (folder / "sky_power.json").write_text(json.dumps(content | uneven))
    code, out, err = lbacal(*FIT)
    assert (code, err) == (0, "")
    assert "sky_power: 21 harmonics fitted to 85 uneven instants, residual 0.00% r.m.s. and 0.00% at most" in out
    notes = json.loads((folder / "fit.json").read_text())["provenance"]["notes"]
    assert notes["sky_power"].startswith("21 harmonics fitted to 85 uneven instants")


def cut_to(rows: int) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        with h5py.File(folder / "spectra.h5", "a") as file:
            for name in ("event_id", "time_unix", "station", "antenna", "dipole", "blocks", "power"):
                values = file[name][:rows]
                del file[name]
                file[name] = values

    return change


def test_too_few_events_exit_with_1_and_leave_a_report(folder: Path, lbacal: Lbacal) -> None:
    cut_to(20)(folder)
    code, out, err = lbacal(*FIT)
    assert (code, err) == (1, "")
    assert "CS002 antenna 0 X: too_few_events (20 events" in out
    report = json.loads((folder / "fit.json").read_text())
    assert (report["status"], report["curves"][0]["c"]) == ("too_few_events", None)
    assert len(Table.read(folder / "C.ecsv", format="ascii.ecsv")) == 0


def change_json(name: str, change: Callable[[dict[str, list[object]]], object]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        content = json.loads((folder / name).read_text())
        change(content)
        (folder / name).write_text(json.dumps(content))

    return apply


def change_spectra(change: Callable[[h5py.File], object]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        with h5py.File(folder / "spectra.h5", "a") as file:
            change(file)

    return apply


def write(name: str, content: bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes(content) and None


def make_folder(name: str) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        (folder / name).mkdir()

    return apply


def narrow(content: dict[str, list[object]]) -> None:
    for rows in (content["X"], content["Y"], [content["frequency_mhz"]]):
        for row in rows:
            row.pop()  # type: ignore[attr-defined]


BAD_INPUT: dict[str, tuple[Callable[[Path], None], str]] = {
    "no spectra": (
        lambda folder: (folder / "spectra.h5").unlink(),
        "spectra.h5: expected a spectra file, found no file",
    ),
    "a folder without spectra": (
        make_folder("spectra.h5"),
        "spectra.h5: expected spectra files .* none in this folder",
    ),
    "empty spectra": (write("spectra.h5", b""), "found an empty file"),
    "random spectra": (write("spectra.h5", bytes(range(256)) * 40), "found something unreadable"),
    "no rows": (cut_to(0), "spectra.h5: expected at least one spectrum, found none"),
    "NaN": (change_spectra(lambda f: f["power"].__setitem__((7, 3), np.nan)), "power, row 7: .* found nan at 33 MHz"),
    "future": (
        change_spectra(lambda f: f["time_unix"].__setitem__(7, 4e9)),
        "time_unix, row 7: .*found 2096-10-02T07:06:40Z",
    ),
    "unknown antenna": (
        change_spectra(lambda f: f["antenna"].__setitem__(slice(240, 480), 9)),
        (
            "spectra.h5: antenna, row 240: station CS002, antenna 9: expected an antenna of instrument one station "
            r"\(antennas 0 to 1 of it\), found"
        ),
    ),
    "unknown station": (
        change_spectra(lambda f: f["station"].__setitem__(slice(0, 480), b"CS009")),
        "row 0: station CS009, antenna 0: expected an antenna of instrument one station",
    ),
    "channels between ours": (
        change_spectra(lambda f: f["frequency_mhz"].__setitem__(slice(None), f["frequency_mhz"][()] + 0.5)),
        "spectra.h5: frequency_mhz, channel 0: expected 30 MHz as in instrument one station, found 30.5 MHz",
    ),
    "sky power of fewer channels": (
        change_json("sky_power.json", narrow),
        "sky_power.json: frequency_mhz: expected the 51 channels of instrument one station, found 50 channels",
    ),
    "sky power of another instrument": (
        change_json("sky_power.json", lambda content: content.update(instrument="another")),
        "sky_power.json: instrument: expected that of the fit, 'one station', found 'another'",
    ),
    "no sky power": (lambda folder: (folder / "sky_power.json").unlink(), "sky_power.json: cannot be read"),
    "sky power is a folder": (make_folder("sky_power.json"), r"sky_power.json: cannot be read \(Is a directory\)"),
    "empty sky power": (write("sky_power.json", b""), "sky_power.json: expected JSON, found an empty file"),
    "truncated sky power": (write("sky_power.json", b'{"X": [[1.0, 2'), "sky_power.json: expected JSON"),
    "no instrument": (lambda folder: (folder / "instrument.json").unlink(), "unknown instrument 'instrument.json'"),
    "instrument without gain": (
        change_json("instrument.json", lambda content: content.pop("antenna_gain")),
        "instrument.json: expected the fields .* found no antenna_gain",
    ),
    "instrument is a folder": (make_folder("instrument.json"), "instrument.json: cannot be read"),
    "table is a folder": (make_folder("C.ecsv"), "--output C.ecsv: expected a file to write, found a folder"),
    "cable changed": (
        change_json(
            "instrument.json",
            lambda content: [
                content["cables"].__setitem__("50 m", [0.9] * 51),
                content["antennas"][0].__setitem__("until", "2014-10-01"),
                content["antennas"].append({"station": "CS002", "antenna": 0, "cable": "50 m", "since": "2014-10-01"}),
            ],
        ),
        "station CS002, antenna 0: expected one cable over the window: .* found cables 80 m, 50 m",
    ),
}


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_exits_with_2_and_one_clear_sentence(folder: Path, lbacal: Lbacal, case: str) -> None:
    change, sentence = BAD_INPUT[case]
    change(folder)
    code, out, err = lbacal(*FIT)
    assert (code, out) == (2, "")
    assert err.startswith("lbacal: ")
    assert err.count("\n") == 1
    assert re.search(sentence, err), err
    assert not (folder / "fit.json").exists()


@pytest.mark.parametrize(
    ("outputs", "sentence"),
    [
        (["same", "same"], "--report same: expected a file of its own, found the file of --output"),
        (
            ["C.ecsv", "sky_power.json"],
            "--report sky_power.json: expected a file of its own, found the file of --sky-power",
        ),
        (["C.txt", "fit.json"], "a name that ends in .ecsv, .fits, .h5, .hdf5, .json, .csv"),
    ],
)
def test_outputs_are_refused_before_the_work(folder: Path, lbacal: Lbacal, outputs: list[str], sentence: str) -> None:
    before = sorted(path.name for path in folder.iterdir())
    code, out, err = lbacal(*FIT[:6], "--output", outputs[0], "--report", outputs[1])
    assert (code, out) == (2, "")
    assert sentence in err
    assert sorted(path.name for path in folder.iterdir()) == before


def test_an_unknown_scope_is_refused_with_the_known_ones(lbacal: Lbacal) -> None:
    code, _, err = lbacal(*FIT, "--scope", "planet")
    assert code == 2
    assert all(scope in err for scope in ("array", "station", "antenna"))


@pytest.mark.shared
def test_every_path_of_the_example_data_set_converges(shared: Path, lbacal: Lbacal) -> None:
    example = shared / "examples"
    files = [str(example / "spectra.h5"), "--instrument", str(example / "instrument.json")]
    code, out, _ = lbacal("fit", *files, "--sky-power", str(example / "sky_power.json"), *OUTPUTS)
    assert code == 0
    assert "12 of 12 curves converged" in out


def test_the_report_gives_g_ant_its_hash_and_c_over_h(folder: Path, lbacal: Lbacal) -> None:
    _, out, _ = lbacal(*FIT)
    assert "antenna_gain: unchecked" in out
    assert "sky_power: unchecked" in out
    gain = json.loads((folder / "instrument.json").read_text())["antenna_gain"]
    for curve in json.loads((folder / "fit.json").read_text())["curves"]:
        assert curve["antenna_gain"] == gain
        assert len(curve["antenna_gain_sha256"]) == 64
        np.testing.assert_allclose(curve["c_over_h"], np.array(curve["c"]) / np.sqrt(gain))


def test_c_over_h_is_the_same_with_another_g_ant(folder: Path, lbacal: Lbacal) -> None:
    """C of the Superterp with the height of another antenna table made fields 17 % low."""
    lbacal(*FIT)
    first = json.loads((folder / "fit.json").read_text())["curves"]
    instrument = json.loads((folder / "instrument.json").read_text())
    gain = [2.0 * value for value in instrument["antenna_gain"]]
    (folder / "instrument.json").write_text(json.dumps(instrument | {"antenna_gain": gain}))
    lbacal(*FIT)
    for one, other in zip(first, json.loads((folder / "fit.json").read_text())["curves"], strict=True):
        np.testing.assert_allclose(np.array(other["c"]) / one["c"], 2**0.5, rtol=1e-9)
        np.testing.assert_allclose(other["c_over_h"], one["c_over_h"], rtol=1e-9)


def test_a_path_that_does_not_follow_the_sky_has_no_curve_and_a_reason(folder: Path, lbacal: Lbacal) -> None:
    spectra = read_spectra(folder / "spectra.h5")
    dead = spectra.antenna == 0
    level = np.random.default_rng(1).normal(1.0, 0.02, spectra.power[dead].shape)
    power = spectra.power.copy()
    power[dead] = level * np.nanmean(spectra.power[dead], axis=0)
    write_spectra(replace(spectra, power=power), folder / "spectra.h5")
    code, out, _ = lbacal(*FIT)
    assert code == 0
    assert re.search(
        r"CS002 antenna 0 X: not_identifiable \(\d+ events, LST coverage 0.74\): its power does not f", out
    )


def test_data_at_one_sidereal_time_end_with_their_coverage_and_a_report(folder: Path, lbacal: Lbacal) -> None:
    instrument = short_dipole.make_instrument(79.4, -90.8)
    (folder / "one.json").write_text(json.dumps(instrument.as_dict()))
    write_spectra(short_dipole.daily_means(instrument, np.random.default_rng(1)), folder / "means.h5")
    code, out, _ = lbacal("fit", "means.h5", "--instrument", "one.json", *OUTPUTS)
    assert code == 1
    assert "D1 antenna 0 X: not_identifiable (82 events, LST coverage 0.04, 0.25 needed)" in out
    (curve,) = json.loads((folder / "fit.json").read_text())["curves"]
    assert (curve["status"], curve["lst_coverage"]) == ("not_identifiable", 4 / 96)


@pytest.mark.parametrize("name", ["C.fits", "C.csv", "C.h5", "C.ecsv", "C.json"])
def test_the_table_is_what_its_name_says(folder: Path, lbacal: Lbacal, name: str) -> None:
    """`--output C.fits` and `C.csv` held ECSV text, exit 0."""
    assert lbacal(*FIT[:-4], "--output", name, "--report", "fit.json")[0] == 0
    curves = [curve for curve in json.loads((folder / "fit.json").read_text())["curves"] if curve["c"] is not None]
    expected = np.concatenate([curve["c"] for curve in curves])
    if name == "C.csv":
        table = Table.read(folder / name, format="ascii.csv")
        np.testing.assert_array_equal(table["c"], expected)
    else:
        content = read_calibrations(folder / name)
        np.testing.assert_array_equal(np.concatenate([one["c"] for one in content["curves"]]), expected)
        assert content["provenance"]["inputs"]
        assert find_problems(content) == []


def test_a_table_without_a_converged_curve_is_empty_and_still_readable(folder: Path, lbacal: Lbacal) -> None:
    spectra = read_spectra(folder / "spectra.h5")
    write_spectra(spectra.select(np.arange(8)), folder / "few.h5")
    for name in ("C.ecsv", "C.fits", "C.csv"):
        assert lbacal("fit", "few.h5", *FIT[2:-4], "--output", name, "--report", "fit.json")[0] == 1
    table = Table.read(folder / "C.ecsv", format="ascii.ecsv")
    assert (len(table), table["c"].unit, table.meta["status"]) == (0, "V", "too_few_events")
    assert read_calibrations(folder / "C.fits")["curves"] == []
