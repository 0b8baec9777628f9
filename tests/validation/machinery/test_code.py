"""What counts as the code of a proof."""

from __future__ import annotations

from functools import partial

from validation.hidden.nothing import PARTS
from validation.machinery import code

TRIAL = PARTS[0].trial


def test_a_proof_of_discovery_counts_the_search_and_not_the_years_nor_the_service():
    files = code.imported_by(TRIAL)
    assert {"lbacal_core/discovery/scan.py", "lbacal_twin/__init__.py", "validation/hidden/nothing.py"} <= files
    assert not [name for name in files if name.startswith(("lbacal_core/drift", "lbacal_core/audit", "service"))]


def test_what_a_trial_imports_is_found_behind_its_arguments():
    assert code.imported_by(partial(TRIAL, 1)) == code.imported_by(TRIAL)


def test_words_change_no_result_and_numbers_do():
    plain = "def f(x):\n    return x + 1\n"
    told = '"""A module."""\ndef f(x):\n    """Add one."""\n    return x + 1  # one\n'
    assert code.without_words(plain) == code.without_words(told)
    assert code.without_words(plain) != code.without_words(plain.replace("1", "2"))
