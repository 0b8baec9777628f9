from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal_core.instrument.instrument import Instrument
from lbacal_core.skypower.table import read_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.sky import LstOffset
from lbacal_twin.settings import TwinSettings
from service.app import make_app
from service.config import Settings
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.worker import Worker

ONE_YEAR = TwinSettings(stations=("CS002",), antennas=4, events_per_year=300, years=0.99)


@pytest.mark.long
@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_a_clock_that_is_off_passed_the_gate_and_only_a_report_said_so(
    database_url: str, sky_power_file: Path, superterp: Instrument, clock: Any
) -> None:
    sky, fault = read_sky_power(sky_power_file), LstOffset(size=0.4)
    factory = Factory(Settings(database_url=database_url, sky_power=sky_power_file, poll_s=0.01), clock)
    with factory.database.write() as stores:
        stores.spectra.add(simulate_campaign(ONE_YEAR, superterp, sky, np.random.default_rng(15), [fault]).spectra)
    _, key = factory.keys.create(("admin",))
    with TestClient(make_app(factory), headers={"Authorization": f"Bearer {key}"}) as http:
        look_for_due_work(factory)
        Worker(factory, "worker").run(threading.Event(), until_idle=True)
        assert {one["gate"] for one in http.get("/v1/calibrations").json()["calibrations"]} == {None}
        factory.alarms.look()
        (alarm,) = http.get("/v1/alarms", params={"kind": "named_cause"}).json()["alarms"]
        (year,) = alarm["content"]["years"]
        assert (alarm["station"], alarm["content"]["cause"]) == ("CS002", "lst_offset")
        assert year["fraction"] > year["statistical_error"] > 0.005
        assert alarm["sentence"].startswith("CS002 in 2014: In station CS002, ")
        assert "of its statistical errors: adopt it" in alarm["sentence"]
        assert "1 cause named and not adopted" in http.get("/v1/status").json()["alarms"]["line"]
        body = {"finding": year["finding"], "reason": "the clock is off", "promote": True}
        answer = http.post(f"/v1/investigations/{year['investigation']}/adoption", json=body)
        assert answer.status_code == 202, answer.text
        factory.alarms.look()
        assert http.get("/v1/alarms", params={"kind": "named_cause"}).json()["alarms"] == []
    factory.database.close()
