from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal_core.curves.curves import Parameter
from lbacal_core.curves.reference_chain import CableTable, ReferenceChain
from lbacal_core.curves.validity import Scope
from service.app import make_app
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.versions import Version
from service.usecases.drift import explain_version, tell_story
from tests.service.test_worker import work


def _made(new_version: Callable[..., Version], name: str, antennas: range, n_lna: float) -> Version:
    version = new_version(Scope("CS001"), name)
    chain = ReferenceChain(tuple(("CS001", a) for a in antennas), np.ones(4), CableTable({}, ()), None)
    curves = tuple(replace(one, parameters={"n_lna": Parameter(n_lna, 0.03 * n_lna)}) for one in version.curves)
    return replace(version, chains={"X": chain, "Y": chain}, curves=curves)


def test_other_antennas_and_noise_constants_are_told(new_version: Callable[..., Version]) -> None:
    """A version stood 2 to 4 % beside a flat monthly line, and nothing said why."""
    first = _made(new_version, "first", range(4), 1.0)
    assert explain_version(first, first, "X") == "the first"
    same = _made(new_version, "same", range(4), 1.05)
    assert explain_version(same, first, "X") == "the same antennas, noise constants within their errors"
    other = _made(new_version, "other", range(1, 6), 1.3)
    assert explain_version(other, first, "X") == "other antennas (1 left out, 2 more), N_LNA +30% ± 4%"


def test_the_cables_of_other_antennas_are_told_with_what_they_do(new_version: Callable[..., Version]) -> None:
    """A version that had one antenna more stood 8 % beside its line, and only the number of antennas was told."""
    first = _made(new_version, "first", range(4), 1.0)
    other = _made(new_version, "other", range(5), 1.0)
    longer = {d: replace(chain, mean_loss=np.full(4, 0.81)) for d, chain in other.chains.items()}
    curves = tuple(replace(one, c=one.c / 0.9) for one in other.curves if one.c is not None)
    told = tell_story(replace(other, chains=longer, curves=curves), first, "X")
    assert told.words == "other antennas (0 left out, 1 more), whose cables change C by +11.1 %"
    assert told.change == pytest.approx(0.0, abs=1e-12), "which is taken out of what is told and plotted"


def test_the_page_of_the_drift_says_why_a_version_differs(station: Factory) -> None:
    look_for_due_work(station)
    work(station)
    with TestClient(make_app(station)) as client:
        page = client.get("/drift").text
    assert "what else is another" in page
    assert '<td class="wrap">the first</td>' in page
