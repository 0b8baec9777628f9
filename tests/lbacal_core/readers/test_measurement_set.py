"""Measurement sets, written by pyuvdata in an environment that has python-casacore."""

import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from lbacal_core.errors import MissingExtraError
from lbacal_core.readers.open import open_source
from lbacal_core.spectra.spectra import read_spectra

CASACORE = "python-casacore>=3.6"
"""114 MB that our environment has not."""


def test_a_measurement_set_without_the_extra_says_what_to_install(tmp_path):
    (tmp_path / "a.ms").mkdir()
    (tmp_path / "a.ms" / "table.dat").write_bytes(b"")
    with pytest.raises(
        MissingExtraError, match=r"measurement set a\.ms needs the extra casa: pip install 'lbacal\[casa"
    ):
        open_source(tmp_path / "a.ms")


@pytest.mark.long
def test_autocorrelations_of_a_measurement_set_are_read_with_their_flags_and_arms(tmp_path, request):
    environment, uv = tmp_path / "venv", str(Path(sys.executable).with_name("uv"))
    python = str(environment / "bin/python")
    subprocess.run([uv, "venv", "--python", sys.executable, str(environment)], check=True, capture_output=True)
    install = [uv, "pip", "install", "--no-deps", "--python", python, CASACORE]
    installed = subprocess.run(install, check=False, capture_output=True, text=True)
    if installed.returncode:
        pytest.skip(f"no package index gives python-casacore: {installed.stderr[-200:]}")
    purelib = next(environment.glob("lib/python*/site-packages"))
    (purelib / "libraries.pth").write_text(f"{request.config.rootpath}\n{sysconfig.get_path('purelib')}\n")
    script = Path(__file__).with_name("measurement_set.py")
    ran = subprocess.run([python, str(script), str(tmp_path)], check=False, capture_output=True, text=True, timeout=300)
    assert ran.returncode == 0, ran.stderr
    spectra = read_spectra(tmp_path / "S.h5")
    assert spectra.arms_deg == {"X": 90.0, "Y": 0.0}
    assert len(set(spectra.event_id.tolist())) == 4
    levels = {(int(a), str(d)): p[0] for a, d, p in zip(spectra.antenna, spectra.dipole, spectra.power, strict=True)}
    expected = {(a, d): (2.0 + a) * (10.0 if d == "Y" else 1.0) for a in range(3) for d in "XY" if (a, d) != (1, "X")}
    assert levels == pytest.approx(expected)
