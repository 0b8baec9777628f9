from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lbacal.settings import CLIENT_SETTINGS, SERVER_SETTINGS
from service.config import Settings

LBACAL = Path(sys.executable).with_name("lbacal")


def test_the_client_knows_the_names_of_all_settings_of_the_server() -> None:
    assert tuple(f"LBACAL_{name.upper()}" for name in Settings.model_fields) == SERVER_SETTINGS
    assert not set(SERVER_SETTINGS) & set(CLIENT_SETTINGS)


@pytest.mark.parametrize("arguments", [["status"], ["effective", "--station", "CS002"], ["fit", "S.h5"]])
@pytest.mark.parametrize(("name", "near"), [("FOO", "docs/settings.md"), ("ULR", "LBACAL_URL")])
def test_a_setting_that_nobody_reads_was_accepted_by_client_commands(
    name: str, near: str, arguments: list[str]
) -> None:
    done = subprocess.run(
        [LBACAL, *arguments], env=os.environ | {f"LBACAL_{name}": "1"}, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"lbacal: LBACAL_{name}: expected a name")
    assert near in done.stderr
    assert done.stderr.count("\n") == 1
