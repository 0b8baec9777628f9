"""Nothing in the core knows one instrument's letters, band or channels but what says that it does."""

from __future__ import annotations

import ast
from pathlib import Path

FOR_LOFAR = {
    "data/": "numbers with their citations, and what is LOFAR's",
    "traces/": "LOFAR's traces",
    "antenna/lofar.py": "the antenna model of LOFAR, and its resonance",
    "sky/antenna_of.py": "LOFAR's antenna for an instrument that stands among its stations",
    "sky/differences.py": "the models that there are of LOFAR's antenna",
    "readers/statistics.py": "LOFAR's station statistics",
    "readers/visibilities.py": "the letters of pyuvdata's polarisations",
    "readers/correlator.py": "the letters of the correlator's polarisations",
    "lstcurve/": "the columns x_db and y_db of an LST curve, the published one and its band",
    "discovery/curve_": "the same",
    "drift/follow.py": "the stored label of a small station whose dipoles are followed together",
}
"""What may name LOFAR, its letters or its band, and why."""
PIVOTS = {
    "causes/chain.py": "the slope of N_LNA is about 55 MHz by its definition",
    "instrument/chain.py": "the slope of N_LNA is about 55 MHz by its definition",
    "causes/cause.py": "levels at 55 MHz by the definition of their causes",
    "causes/sky.py": "levels at 55 MHz, tau at 30 MHz by their definitions",
    "sky/sky_terms.py": "an error that is stated from 50 to 30 MHz",
    "sky/maps.py": "nodes of a power law",
    "instrument/instrument.py": "a longitude",
    "drift/model.py": "months",
    "audit/sky_match.py": "degrees",
    "antenna/names.py": "a permittivity",
    "antenna/varied.py": "degrees",
}
"""Files in which 30, 55 or 80 stand, and what they are there."""
LETTERS, BAND = {"X", "Y", "XY", "YX"}, {30.0, 55.0, 80.0}


def core_files(tracked: list[Path]) -> list[Path]:
    return [path for path in tracked if path.suffix == ".py" and path.parts[0] == "lbacal_core"]


def literals(repository: Path, path: Path) -> list[object]:
    """Constants in the code of a file, docstrings left out."""
    tree = ast.parse((repository / path).read_text())
    words = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in words]


def test_no_letter_of_a_dipole_and_no_name_of_lofar_stands_in_the_core(repository: Path, tracked: list[Path]) -> None:
    found = []
    for path in core_files(tracked):
        name = str(Path(*path.parts[1:]))
        if name.startswith(tuple(FOR_LOFAR)):
            continue
        text = (repository / path).read_text()
        words = [value for value in literals(repository, path) if isinstance(value, str)]
        if any(word in LETTERS or "superterp" in word for word in words) or "data.lofar" in text:
            found.append(name)
    assert found == []


def test_no_band_of_30_to_80_mhz_stands_in_the_core(repository: Path, tracked: list[Path]) -> None:
    found = []
    for path in core_files(tracked):
        name = str(Path(*path.parts[1:]))
        if name.startswith(tuple(FOR_LOFAR)) or name in PIVOTS:
            continue
        if BAND & {value for value in literals(repository, path) if isinstance(value, float)}:
            found.append(name)
    assert found == []


def test_what_may_know_lofar_still_does(tracked: list[Path]) -> None:
    names = [str(Path(*path.parts[1:])) for path in core_files(tracked)]
    for allowed in (*FOR_LOFAR, *PIVOTS):
        assert any(name.startswith(allowed) for name in names), allowed
