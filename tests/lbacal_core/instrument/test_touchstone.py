from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import LbacalError
from lbacal_core.instrument.touchstone import read_touchstone

S11 = 0.5 * np.exp(1j * np.radians(-30.0))


@pytest.mark.parametrize(
    ("options", "frequency", "numbers"),
    [
        ("# MHz S MA R 50", "55", "0.5 -30"),
        ("#hz s ri r 50.0", "55e6", f"{S11.real} {S11.imag}"),
        ("# R 50 dB kHz", "55000", f"{20 * np.log10(0.5)} -30 ! two spaces"),
        ("#", "0.055", "0.5 -30"),  # GHz, MA and 50 ohm where nothing is said
    ],
)
def test_a_reflection_is_the_same_in_every_unit_and_form(
    options: str, frequency: str, numbers: str, tmp_path: Path
) -> None:
    (tmp_path / "a.S1P").write_text(f"! an antenna\n\n{options}\n  {frequency}\t{numbers}\n")
    nu, s, reference = read_touchstone(tmp_path / "a.S1P")
    np.testing.assert_allclose(nu, [55.0])
    np.testing.assert_allclose(s, [[[S11]]])
    assert reference == 50.0


def test_of_two_ports_s21_stands_before_s12_and_noise_parameters_behind_are_left_out(tmp_path: Path) -> None:
    rows = "40 11 0 21 0 12 0 22 0\n90 11 0 21 0 12 0 22 0\n40 1.2 0.3 20 0.2\n90 1.2 0.3 20 0.2\n"
    (tmp_path / "lna.s2p").write_text(f"# MHz S RI R 75\n{rows}")
    nu, s, reference = read_touchstone(tmp_path / "lna.s2p")
    np.testing.assert_array_equal(nu, [40.0, 90.0])
    np.testing.assert_array_equal(s[1], [[11, 12], [21, 22]])
    assert reference == 75.0


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.s1p", "", "a line such as # MHz S RI R 50), found none"),
        ("a.s1p", "40 0.5 0\n", "a line such as # MHz S RI R 50), found none"),
        ("a.s1p", "# MHz S MA R 50\n", "rows of finite numbers, their frequencies rising, found 0 rows"),
        ("a.s1p", "# MHz Y MA R 50\n40 0.5 0\n", "by Hz, kHz, MHz or GHz as RI, MA or DB, found Y"),
        ("a.s1p", "# MHz S MA R fifty\n40 0.5 0\n", "a.s1p: R: expected the reference impedance in ohm, found 'FIFTY'"),
        ("a.s1p", "# MHz S MA R\n40 0.5 0\n", "expected the reference impedance in ohm, found ''"),
        ("a.s1p", "# MHz S MA R 50\n40 nan 0\n", "rows of finite numbers"),
        ("a.s1p", "# MHz S MA R 50\n50 0.5 0\n40 0.5 0\n", "their frequencies rising"),
        ("a.s1p", "# MHz S MA R 50\n40 0,5 0\n", "rows of 3 numbers, 1 port(s)"),
        ("a.s1p", "# MHz S MA R 50\n40 .5 0 .5 0 .5 0 .5 0\n", "rows of 3 numbers, 1 port(s)"),
        ("a.s2p", "# MHz S MA R 50\n40 .5 0\n", "rows of 9 numbers, 2 port(s)"),
        ("a.csv", "frequency_mhz,gain\n40,0.5\n", "one port (.s1p) or two (.s2p), found '.csv'"),
    ],
)
def test_what_is_no_such_file_is_refused_in_one_sentence(name: str, content: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(LbacalError) as caught:
        read_touchstone(tmp_path / name)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_pickle_of_that_name_is_read_as_text_and_refused(tmp_path: Path) -> None:
    (tmp_path / "a.s1p").write_bytes(b"\x80\x04\x95\n\x00#")
    with pytest.raises(LbacalError, match="expected a Touchstone file"):
        read_touchstone(tmp_path / "a.s1p")
