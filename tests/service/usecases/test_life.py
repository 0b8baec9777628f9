from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lbacal_core.spectra.spectra import Spectra
from service.factory import Factory
from service.usecases.life import list_bad
from tests.service.conftest import add_spectra, instant, night


@pytest.mark.long
def test_paths_were_silent_by_the_date_at_which_their_data_came(
    make_service: Callable[..., Factory], campaign: Spectra
) -> None:
    """One that was dead for months was listed for the year after it, one whose data came late for no time at all."""

    def is_between(since: str, until: str) -> NDArray[np.bool_]:
        return (campaign.time_unix >= instant(since) / 1e6) & (campaign.time_unix < instant(until) / 1e6)

    power, is_gone = campaign.power.copy(), (campaign.antenna == 1) & is_between("2015-02-01", "2015-06-01")
    power[(campaign.antenna == 0) & is_between("2014-07-01", "2014-11-01")] *= 1e-3
    spectra = replace(campaign, power=power)
    factory = make_service(spectra.select(~is_gone & is_between("2014-01-01", "2015-06-01")), cut_windows=False)
    night(factory)
    factory.alarms.look()
    add_spectra(factory, spectra.select(is_between("2015-06-01", "2016-01-01")))
    night(factory)
    factory.alarms.look()

    def tell(at: str) -> list[str]:
        found, _ = list_bad(factory.database, factory.instrument, instant(at), "CS002")
        return [f"{one.path.key} {one.sentence}" for one in found if one.kind == "silent"]

    assert tell("2014-06-01") == tell("2014-12-01") == tell("2015-07-01") == tell("2015-12-01") == []
    for at, antenna, since, until in (("2014-09-01", 0, "2014-0", "2014-11"), ("2015-03-15", 1, "2015-0", "2015-06")):
        for told, dipole in zip(tell(at), "XY", strict=True):
            assert told.startswith(f"CS002/{antenna}/{dipole} no spectrum that sees the sky since {since}")
            assert f" until {until}" in told
