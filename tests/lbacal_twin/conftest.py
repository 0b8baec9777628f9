from __future__ import annotations

import pytest

from lbacal_core.instrument.instrument import Instrument
from lbacal_twin.view import View


@pytest.fixture(scope="session")
def view(low_band: Instrument) -> View:
    return View(low_band)
