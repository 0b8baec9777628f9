from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lbacal_core.curves.validity import Promotion, Scope
from lbacal_core.spectra.spectra import Spectra
from service.factory import Factory
from service.storage.alarms import News
from service.usecases.life import list_bad
from tests.service.conftest import add_spectra, instant, new_version, night


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


def test_an_antenna_that_is_not_on_record_then_is_neither_bad_nor_calibrated(factory: Factory) -> None:
    """One whose record had ended was silent for ever after, and one that was not there yet counted as calibrated."""
    first, *others = (one for one in factory.instrument.antennas if one.station == "CS002")
    at, keys = instant("2014-06-01"), [f"CS002/{first.antenna}/{dipole}" for dipole in "XY"]
    array = Promotion(0, Scope(), instant("2014-01-01"), None, new_version(Scope(), "array").id, 0)
    with factory.database.write() as stores:
        news = News("lost_path", Scope("CS002"), "", "2 paths", {"paths": keys}, instant("2014-05-01"))
        stores.alarms.raise_alarm(news, factory.clock())
        stores.versions.add([new_version(Scope(), "array")])
        stores.ledger.append([array], factory.clock)
    for until, silent in ((None, keys), (at / 1e6 + 1.0, keys), (at / 1e6, [])):
        instrument = replace(factory.instrument, antennas=(replace(first, until=until), *others))
        bad, calibrated = list_bad(factory.database, instrument, at, "CS002")
        assert [one.path.key for one in bad] == silent
        assert calibrated == 2 * (len(others) + bool(silent))
