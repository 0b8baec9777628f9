from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.table import QTable

import lbacal
from lbacal.analysis.audit import Audit


@pytest.fixture(scope="module")
def audited() -> Audit:
    """A station of six antennas of which number 3 receives a thousandth."""
    spectra = lbacal.simulate("lofar-superterp", events=60, antennas=6)
    spectra.power[spectra.antenna == 3] *= 1e-3
    return lbacal.audit(spectra, "lofar-superterp")


@pytest.mark.parametrize("name", ["A.ecsv", "A.csv", "A.fits", "A.h5"])
def test_the_numbers_of_an_audit_are_a_table_in_every_format(audited: Audit, tmp_path: Path, name: str) -> None:
    """Its table had the words alone."""
    audited.save(tmp_path / name)
    table = QTable.read(tmp_path / name) if name != "A.h5" else QTable.read(tmp_path / name, path="table")
    told = {
        column: np.asarray(table[column]).astype(str).tolist() for column in ("antennas", "dipole", "unit", "check")
    }
    dead = [k for k, check in enumerate(told["check"]) if check == "dead"]
    assert [(told["antennas"][k], told["dipole"][k], told["unit"][k]) for k in dead] == [("3", d, "dB") for d in "XY"]
    np.testing.assert_allclose(np.asarray(table["value"], dtype=float)[dead], -30.0, atol=1.0)
    others = np.setdiff1d(np.arange(len(table)), dead)
    sizes = np.ma.filled(np.ma.asarray(table["sigma"], dtype=float), np.nan)
    assert np.isnan(sizes[dead]).all()
    assert len(others) == len(audited.report.lines) - 2


def test_an_audit_has_a_row_a_line_and_shows_itself_in_a_notebook(audited: Audit) -> None:
    assert len(audited.table) == len(audited.report.lines)
    assert "antenna 3 X is dead" in audited._repr_html_()
    assert audited.table["value"].dtype == float


def test_what_is_doubtful_is_not_called_nothing_wrong() -> None:
    """One antenna in decibels or volts: its cable cannot be compared with another, and a fit would be off by three."""
    spectra = lbacal.simulate("lofar-superterp", events=120, antennas=1)
    in_db, in_volts = (
        lbacal.audit(replace(spectra, power=power), "lofar-superterp")
        for power in (10.0 * np.log10(spectra.power) + 60.0, spectra.power**0.5)
    )
    assert lbacal.audit(spectra, "lofar-superterp").title.endswith(": nothing wrong")
    assert in_volts.title.endswith(": nothing wrong for certain, but doubtful: unit")
    assert "the power is in decibels; or" in in_db.report.wrong[0].sentence
