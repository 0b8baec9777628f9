"""The page on adoption, its commands run in their order on a service whose data contradict the model."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import httpx2

COMMAND = re.compile(r"^lbacal (.*)$", re.MULTILINE)


def run(service: Any, line: str, **names: str) -> str:
    """Run a command of the page with its placeholders filled in."""
    said = service.run(*(names.get(word, word) for word in shlex.split(line)))
    assert said.returncode == 0, said.stderr
    return str(said.stdout)


def in_effect(service: Any) -> list[Any]:
    """What the paths of the station are told; nothing where the gate held every fit back."""
    asked = {"station": "CS002", "at": "2014-06-01", "gap": "hold"}
    answer = httpx2.get(f"{service.url}/v1/calibrations/effective", params=asked)
    return [curve["c"] for curve in answer.json().get("curves", [])]


def test_the_commands_of_the_page_close_the_loop(faulty: Any, repository: Path) -> None:
    page = (repository / "docs/how-to/adopt-a-cause.md").read_text().replace("2015-", "2014-").replace("2016-", "2015-")
    status, investigate, dry_run, adopt, models, abandon = COMMAND.findall(page)
    told = run(faulty, status)
    assert "CS002, 2014-01-01 to 2015-01-01: explained (lst_offset" in told
    assert re.search(r"^alarms: .* misfits?\b", told, re.MULTILINE), "told in the night in which it was found"
    found = run(faulty, investigate)
    (name,) = re.findall(r"investigation ([0-9a-f]{12})", found)
    assert re.search(r"^  #0 .* sigma: In station CS002, .*sidereal", found, re.MULTILINE)
    tried = run(faulty, dry_run, INVESTIGATION=name)
    assert "would be adopted: In station CS002" in tried
    assert re.search(r"changes of what paths are told: \d+ \(dry run: nothing was written\)", tried)
    before = in_effect(faulty)
    made = run(faulty, adopt, INVESTIGATION=name)
    (model,) = re.findall(r"`lbacal abandon ([0-9a-f]{12})`", made)
    assert len(re.findall(r"^job \d+: refit .*, done \(100%\)", made, re.MULTILINE)) == 3
    assert len(in_effect(faulty)) == 96
    listed = run(faulty, models)
    assert f"model {model} of CS002, in effect" in listed
    gone = run(faulty, abandon, MODEL=model)
    assert len(re.findall(r"^job \d+: refit .*, done \(100%\)", gone, re.MULTILINE)) == 3
    assert in_effect(faulty) == before
    assert "withdrawn: In station CS002" in run(faulty, models)
    missing = faulty.run("adopt", "0" * 12, "--reason", "x")
    assert (missing.returncode, "no investigation" in missing.stderr) == (1, True)
