"""The documentation says what the code does: commands, settings, fields of formats, links."""

from __future__ import annotations

import ast
import inspect
import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import lbacal
from lbacal import tables
from lbacal_core.audit import audit
from lbacal_core.audit.verdict import Line
from lbacal_core.causes.catalogue import ANTENNA_CAUSES, CAUSES
from lbacal_core.causes.grammar import COURSES, PLACES
from lbacal_core.curves.curves import CalibrationCurve, FitReport, parse_curve
from lbacal_core.curves.reference_chain import CableTable, GainSpread, GainSpreads, ReferenceChain
from lbacal_core.discovery import curve_search as report_of_curve
from lbacal_core.discovery import report as report_of_spectra
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.lstcurve import curve as lst_curve
from lbacal_core.provenance import Provenance
from lbacal_core.sky.table import read_sky_power
from lbacal_core.spectra import spectra
from lbacal_core.traces import assembly
from lbacal_core.traces.assembly import COVARIATES, read_event_facts
from service.wire import answers as formats
from validation.reference import describe_causes, describe_commands, describe_settings

LINK = re.compile(r"(?<!\\)\]\(([^)\s]+)\)")
CALIBRATION_FILE = "The calibration file: galcal-1"
FENCE = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)


def test_the_page_of_commands_is_that_of_the_commands(repository: Path) -> None:
    assert (repository / "docs/commands.md").read_text() == describe_commands(), "run ./dev docs"


def test_the_page_of_settings_is_that_of_the_settings(repository: Path) -> None:
    assert (repository / "docs/settings.md").read_text() == describe_settings(), "run ./dev docs"


def test_the_page_of_causes_is_that_of_the_catalogue(repository: Path) -> None:
    page = (repository / "docs/causes.md").read_text()
    assert page == describe_causes(), "run ./dev docs"
    for cause in (*CAUSES, *ANTENNA_CAUSES):
        assert f"\n## {cause.identifier}\n" in page
        assert cause.confirm in page


def test_every_setting_that_code_names_is_documented(repository: Path, tracked: list[Path]) -> None:
    page = (repository / "docs/settings.md").read_text()
    named = set()
    for path in tracked:
        if path.suffix in (".py", ".yml", ".yaml") or path.name == "dev":
            named |= set(re.findall(r"\bLBACAL_[A-Z][A-Z_]*[A-Z]\b", (repository / path).read_text()))
    assert {name for name in named if f"`{name}`" not in page} == set()


def page_of_format(repository: Path, title: str) -> str:
    """The page of docs/formats with this title, or the part of one from this title on."""
    for path in (repository / "docs/formats").glob("*.md"):
        found = re.search(rf"^##? {title}\n(.*)", path.read_text(), re.MULTILINE | re.DOTALL)
        if found is not None:
            return found[1]
    raise AssertionError(f"no page of docs/formats has the title {title}")


def example_report() -> FitReport:
    instrument = load_instrument("lofar-superterp")
    curve = CalibrationCurve(
        "CS002", 0, "X", "too_few_events", 1, instrument.frequency_mhz, None, None, None, None, 0.0, {}
    )
    return FitReport((curve,), Provenance({"spectra": "", "instrument": "", "sky_power": ""}))


def fields_written_by(*modules: ModuleType) -> set[str]:
    """Every field of an object that these modules write: the names in their dictionaries."""
    trees = [ast.parse(inspect.getsource(module)) for module in modules]
    return {
        key.value
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.Dict)
        for key in node.keys
        if isinstance(key, ast.Constant)
    }


def fields_of_formats() -> list[tuple[str, str]]:
    """Section and field of everything that readers and writers name."""
    instrument = load_instrument("lofar-superterp")
    report = example_report().as_dict()
    none = np.zeros(1)
    spreads = GainSpreads({}, GainSpread(0, none, none), 0, none)
    chain = ReferenceChain((), none, CableTable.of(instrument), spreads).as_dict()
    return [
        *(("Spectra", name) for name in (*spectra._KINDS, "format", "resistance_ohm", spectra.FORMAT)),
        *(("Spectra", f"env/{name}") for name in COVARIATES),
        *(("Instrument", name) for name in (*instrument.as_dict(), "station", "antenna", "cable", "since", "until")),
        *(("Sky power", name) for name in ("frequency_mhz", "lst_hours", "X", "Y")),
        *(("LST curve", name) for name in (*lst_curve.COLUMNS, lst_curve.CENTRE_LINE)),
        *(("Event facts", name) for name in ("event_id", "pulse_unix", *COVARIATES)),
        *((CALIBRATION_FILE, name) for name in ("station", "antenna", "dipole", "frequency_mhz", "flag")),
        *((CALIBRATION_FILE, name) for name in ("c", "c_sigma_stat", "c_sigma_sys")),
        *((CALIBRATION_FILE, name) for name in (*tables.COLUMNS, *formats.FORMATS, tables.FORMAT)),
        *(("Fit report", name) for name in (*report, *report["curves"][0], *report["provenance"])),
        *(("Fit report", name) for name in ("n_lna", "n_rcu", "n_adc", "inputs")),
        *(("Fit report", name) for name in (*chain, *(chain["spreads"] or {}), "offset", "spread")),
        *(("Investigation report", name) for name in sorted(fields_written_by(report_of_spectra, report_of_curve))),
        *(("Audit report", name) for name in sorted({*fields_written_by(audit), *Line("", "", "", "").as_dict()})),
        *(("Report of traces", name) for name in sorted(fields_written_by(assembly) - {"power"})),
    ]


@pytest.mark.parametrize(("title", "field"), fields_of_formats())
def test_every_field_of_a_format_is_documented(repository: Path, title: str, field: str) -> None:
    text = page_of_format(repository, title)
    assert f"`{field}`" in text or f'"{field}"' in text


def example(repository: Path, title: str) -> str:
    """The first block of code of the page of a format."""
    found = re.search(r"^```\w*\n(.*?)^```", page_of_format(repository, title), re.MULTILINE | re.DOTALL)
    assert found is not None, title
    return found[1]


def test_the_example_of_each_format_is_read(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(example(repository, "Spectra"), {})  # noqa: S102  (our own page)
    assert len(spectra.read_spectra(Path("spectra.h5"), now_unix=1.5e9)) == 2
    for title, read in (
        ("Instrument", lambda path: load_instrument(str(path))),
        ("Sky power", read_sky_power),
        ("LST curve", lst_curve.read_lst_curve),
        ("Event facts", read_event_facts),
    ):
        Path("example").write_text(example(repository, title), encoding="utf-8")
        read(Path("example"))
    report = json.loads(example(repository, "Fit report"))
    assert set(report) == set(example_report().as_dict())
    (curve,) = report["curves"]
    assert {**parse_curve(curve).as_dict(), "reference": None} == curve


def test_the_example_of_an_instrument_is_fitted(repository: Path, tmp_path: Path) -> None:
    (tmp_path / "i.json").write_text(example(repository, "Instrument"), encoding="utf-8")
    spectra_of_it = lbacal.simulate(tmp_path / "i.json", events=300)
    found = lbacal.fit(spectra_of_it, tmp_path / "i.json")
    assert [curve.status for curve in found.report.curves] == ["converged"] * 4


def fields_of(value: Any) -> set[str]:
    """Names of the fields of a JSON value at every depth."""
    if isinstance(value, dict):
        return set(value).union(*(fields_of(one) for one in value.values()))
    return set().union(*(fields_of(one) for one in value)) if isinstance(value, list) else set()


def test_the_example_of_an_investigation_has_the_fields_of_a_report(repository: Path) -> None:
    report = json.loads(example(repository, "Investigation report"))
    written = report_of_spectra.join([], Provenance({}))
    assert report.keys() == written.keys()
    assert report["provenance"].keys() == written["provenance"].keys()
    (finding,) = report["findings"]
    parameters = {*finding.pop("parameters"), *report["scores"]["CS002"][0].pop("parameters")}
    assert parameters == {"date_unix", "date"}
    named = {"CS002", *fields_of(report["provenance"])}
    assert fields_of(report) - named <= fields_written_by(report_of_spectra)


def anchors_of(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_link_inside_the_repository_leads_somewhere(repository: Path, tracked: list[Path]) -> None:
    broken = []
    for path in tracked:
        if path.suffix != ".md":
            continue
        for target in LINK.findall(FENCE.sub("", (repository / path).read_text())):
            if re.match(r"[a-z]+:", target):
                continue
            name, _, anchor = target.partition("#")
            there = (repository / path.parent / name).resolve() if name else repository / path
            if not there.exists() or (anchor and anchor not in anchors_of(there)):
                broken.append(f"{path}: {target}")
    assert broken == []


def test_every_page_is_reached_from_the_first_one(repository: Path, tracked: list[Path]) -> None:
    pages = {repository / path for path in tracked if path.suffix == ".md" and path.parts[0] == "docs"}
    first = repository / "docs/README.md"
    linked = {(first.parent / target.partition("#")[0]).resolve() for target in LINK.findall(first.read_text())}
    unreached = [page for page in pages - {first} if page not in linked and page.parent not in linked]
    assert unreached == []


def test_the_first_screen_shows_both_commands_and_a_plot(repository: Path) -> None:
    first_screen = "\n".join((repository / "README.md").read_text().splitlines()[:45])
    assert all(command in first_screen for command in ("$ ./dev demo", "$ ./dev test", "](docs/images/"))


def test_the_main_path_is_three_clicks_from_the_readme(repository: Path) -> None:
    assert "docs/README.md" in LINK.findall((repository / "README.md").read_text())
    assert "../lbacal_core/pipeline.py" in LINK.findall((repository / "docs/README.md").read_text())


# Spelt in two halves, so that this file does not name them itself.
MACHINE_PATHS = ["/wo" + "rk/", "/ro" + "ot/", "/ho" + "me/", "file:" + "///"]
REGISTRIES = ["py" + "pi.org", "python" + "hosted.org", "npm" + "js.org", "deb.deb" + "ian.org", "index-" + "url"]


def test_no_machine_and_no_registry_is_named_in_a_file(repository: Path, tracked: list[Path]) -> None:
    named = []
    for path in tracked:
        try:
            text = (repository / path).read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        named += [f"{path}: {word}" for word in MACHINE_PATHS + REGISTRIES if word in text]
    assert named == []


def test_the_examples_of_unfolding_run(repository: Path) -> None:
    page = (repository / "docs/how-to/calibrate-traces.md").read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", page.split("## Field")[1].split("\n## ")[0], re.MULTILINE | re.DOTALL)
    assert len(blocks) == 2
    exec("\n".join(blocks), {})  # noqa: S102  (our own page)


def test_the_page_counts_the_parts_of_sentences(repository: Path) -> None:
    page = (repository / "docs/explanation/what-the-simulation-gets-wrong.md").read_text()
    assert f"a place ({len(PLACES)})" in page
    assert f"a course in time ({len(COURSES)} kinds:" in page
