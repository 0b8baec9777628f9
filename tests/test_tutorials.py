"""The tutorials run as they are printed, in ten lines each."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from lbacal_core.curves.curves import OK

TUTORIALS = sorted(path for path in (Path(__file__).parent.parent / "docs/tutorials").glob("*.md"))
CODE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def code_of(page: Path) -> str:
    return "\n".join(CODE.findall(page.read_text()))


@pytest.mark.long
@pytest.mark.parametrize("page", [page for page in TUTORIALS if page.name != "README.md"], ids=lambda page: page.stem)
def test_a_tutorial_runs_and_ends_in_a_figure(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = code_of(page)
    lines = [line for line in code.splitlines() if line.strip()]
    assert 5 <= len(lines) <= 10
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(code, str(page), "exec"), names)  # noqa: S102 - the page is ours
    assert isinstance(names["figure"], Figure)
    curves = names["found"].report.curves
    assert {curve.status for curve in curves} == {"converged"}
    for said in (repr(names["found"]), names["figure"].axes[0].get_ylabel()):
        assert ("by 1 m²" in said) == ("lofar" not in page.name), "C without an antenna gain is relative"
    assert {flag for curve in curves for flag in curve.flags} == {OK}


def test_the_list_of_tutorials_names_each() -> None:
    listed = set(re.findall(r"\]\(([a-z-]+\.md)\)", (TUTORIALS[0].parent / "README.md").read_text()))
    assert listed == {page.name for page in TUTORIALS} - {"README.md"}
