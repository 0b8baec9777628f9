"""The examples in the docstrings of what Python users call run as they are printed."""

from __future__ import annotations

import doctest
from importlib import import_module

import pytest

from lbacal import ANALYSIS

MODULES = ["lbacal", "lbacal.client", "lbacal.curve_table", "lbacal.analysis"]
MODULES += sorted({f"lbacal.{module}" for module in ANALYSIS.values()})


@pytest.mark.long
@pytest.mark.parametrize("name", MODULES)
def test_the_examples_run(name: str) -> None:
    assert doctest.testmod(import_module(name)).failed == 0


@pytest.mark.parametrize("name", [name for name in ANALYSIS if name[0].islower()])
def test_every_verb_has_an_example(name: str) -> None:
    verb = getattr(import_module(f"lbacal.{ANALYSIS[name]}"), name)
    assert ">>> " in verb.__doc__
