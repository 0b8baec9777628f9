"""The site of the documentation: built whole, its notebooks run, every page in its menu, nothing from another host."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ASKED = re.compile(r"<(?:script|link|img|iframe)[^>]+(?:src|href)=[\"']?https?://(?!localhost)[^\"'>\s]+")
"""What a browser would fetch by itself from another host."""


@pytest.fixture(scope="module")
def site(repository: Path) -> Path:
    """The site, by the command that makes it; a link that leads nowhere ends it."""
    builder = repository / "validation/scripts/build_site.py"
    built = subprocess.run([sys.executable, builder], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return repository / "var/site/html"


@pytest.mark.long
def test_notebooks_are_on_the_site_with_what_they_give(site: Path, repository: Path) -> None:
    notebooks = sorted((repository / "docs/notebooks").glob("*.ipynb"))
    assert len(notebooks) == 5
    for notebook in notebooks:
        page = (site / f"notebooks/{notebook.stem}.html").read_text(encoding="utf-8")
        assert re.search(r'<img alt="png" src="[a-z-]+_\d+_\d+\.png"', page), f"{notebook.stem} draws nothing"
        assert "Traceback" not in page
        assert (site / f"notebooks/{notebook.stem}.ipynb").exists()


@pytest.mark.long
def test_every_page_can_be_found_and_none_asks_another_host(site: Path, repository: Path) -> None:
    for page in (repository / "docs").rglob("*.md"):
        name = "index" if page.name == "README.md" else page.stem
        made = (site / page.relative_to(repository / "docs")).with_name(f"{name}.html").read_text(encoding="utf-8")
        assert not ASKED.findall(made), page
    reference = (site / "reference.html").read_text(encoding="utf-8")
    assert 'id="lbacal.analysis.fit.fit"' in reference
    index = (site / "search/search_index.json").read_text(encoding="utf-8")
    assert "zenith_weighting" in index
