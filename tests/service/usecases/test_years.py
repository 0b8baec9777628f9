"""C in effect on every date through the life of a path: a step that the night finds, and what people do with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal.instants import parse_instant
from lbacal_core.curves.validity import Scope
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.table import read_sky_power
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.settings import TwinSettings
from service.factory import Factory
from tests.service.conftest import add_spectra, night, refit, served, work

pytestmark = pytest.mark.long

STEPPED = (2, "X")
STEADY = (4, "Y")
POWER = 0.85
"""The power of the stepped path after 2015-05-20 over that before."""
BEFORE, JUST, AFTER, NEXT = "2014-06-15", "2015-02-15", "2015-09-15", "2016-06-15"
LATE = "2016-12"


@pytest.fixture(scope="module")
def truth(superterp: Instrument, sky_power_file: Path) -> Campaign:
    """Three years of six antennas of CS002, 250 events each."""
    settings = TwinSettings(stations=("CS002",), antennas=6, years=2.99, events_per_year=250)
    step = GainStep(size=POWER - 1.0, date="2015-05-20", where=Where(antennas=(2,), dipoles=("X",)))
    sky = read_sky_power(sky_power_file)
    return simulate_campaign(settings, superterp, sky, np.random.default_rng(7), [step])


@dataclass(frozen=True)
class Answers:
    """What the service answers, against the truth."""

    factory: Factory
    http: TestClient
    truth: Campaign

    def c(self, at: str, path: tuple[int, str]) -> tuple[Floats, Floats, str]:
        """C over the true C before any step, its statistical error, and the version."""
        asked = {"station": "CS002", "antenna": path[0], "dipole": path[1], "at": at}
        (curve,) = self.http.get("/v1/calibrations/effective", params=asked).json()["curves"]
        assert curve["answered_by"] == "antenna", (at, path)
        c = np.array(curve["c"])
        true = self.truth.truth.stations[0].c[path[0], "XY".index(path[1])]
        return c / true, np.array(curve["c_sigma_stat"]) / c, curve["calibration"]

    def require_right(self, *, is_stepped: bool = True) -> None:
        """C is right before and after the step; or one mean of the year in which somebody denies it."""
        for at, path, power in (
            (BEFORE, STEPPED, 1.0), (JUST, STEPPED, 1.0), (AFTER, STEPPED, POWER), (NEXT, STEPPED, POWER),
            (BEFORE, STEADY, 1.0), (AFTER, STEADY, 1.0), (NEXT, STEADY, 1.0),
        ):  # fmt: skip
            if not is_stepped and path == STEPPED:
                continue
            ratio, sigma, _ = self.c(at, path)
            pull = np.log(ratio * power**0.5) / np.hypot(sigma, 0.002)
            assert np.sqrt(np.mean(pull**2)) < 3.0, (at, path, np.mean(ratio))
        # what is steady does not move, though its years were fitted apart by 2 %
        steady = np.log(self.c(NEXT, STEADY)[0] / self.c(BEFORE, STEADY)[0])
        assert abs(np.mean(steady)) < 0.006

    def station(self, at: str) -> tuple[Floats, Floats]:
        """C of the reference chain of the station, X, and its error."""
        with self.factory.database.read() as stores:
            scope, instant = Scope("CS002"), parse_instant("", at)
            version = stores.versions.get(str(stores.ledger.decisive([scope], instant, None)[scope].calibration))
        (curve,) = [one for one in version.curves if one.dipole == "X"]
        assert curve.c is not None
        assert curve.c_sigma_stat is not None
        return curve.c, curve.c_sigma_stat

    def ids(self) -> list[str]:
        return [self.c(at, path)[2] for at in (BEFORE, JUST, AFTER, NEXT) for path in (STEPPED, STEADY)]


def test_c_is_right_on_both_sides_of_a_step_after_every_night_and_decision(
    make_service: Callable[..., Factory], truth: Campaign
) -> None:
    """Adopting the step that the night found put C of before it into effect for the year, 7 % off behind it."""
    late = np.char.startswith(np.datetime_as_string((truth.spectra.time_unix * 1e6).astype("datetime64[us]")), LATE)
    factory = make_service(truth.spectra.select(~late), lease_s=60.0, gate_change=0.9)
    with served(factory) as http:
        told = Answers(factory, http, truth)

        def decide(decision: str) -> None:
            (change,) = http.get("/v1/changes").json()["changes"]
            body = {"decision": decision, "reason": "test"}
            assert http.post(f"/v1/changes/{change['id']}/decision", json=body).status_code == 201

        night(factory)
        told.require_right()
        first = told.ids()
        night(factory)
        told.require_right()
        assert told.ids() == first, "a second night finds nothing to do"

        (c, sigma), (later, _) = told.station(BEFORE), told.station(NEXT)
        assert np.max(np.abs(np.log(later / c)) / (sigma / c)) < 0.3, "one antenna's step does not move the mean"

        investigation = {"since": "2015-01-01", "until": "2016-01-01", "station": "CS002", "reason": "test"}
        job = http.post("/v1/investigations", json=investigation).json()["job"]
        work(factory)
        (name,) = http.get(f"/v1/jobs/{job}").json()["results"]
        finding = http.get(f"/v1/investigations/{name}").json()["report"]["findings"][0]
        assert finding["cause"] == "gain_step"
        refused = http.post(
            f"/v1/investigations/{name}/adoption", json={"finding": 0, "reason": "test", "promote": True}
        )
        assert refused.status_code == 422
        assert "changes" in refused.json()["detail"], "it says where the step is"
        (change,) = http.get("/v1/changes").json()["changes"]
        assert {one["from"] for one in change["evidence"]} == {"drift", "investigation"}, (
            "one row, two kinds of evidence"
        )
        night(factory)
        told.require_right()

        decide("dismissed")
        night(factory)
        told.require_right(is_stepped=False)
        assert told.c(JUST, STEPPED)[2] == told.c(AFTER, STEPPED)[2], "one C for the year in which nothing happened"
        decide("in_force")
        night(factory)
        told.require_right()
        assert told.ids() == first, "the versions of before answer again"

        add_spectra(factory, truth.spectra.select(late))
        night(factory)
        told.require_right()
        life = http.get("/v1/paths/CS002/2/X/life").json()
        assert [one["because"] for one in life["epochs"]] == [None, change["id"]]

        job = refit(factory, "antenna", since="2014-01-01", until="2015-01-01", fit="year", promote=False)
        alone = [http.get(f"/v1/calibrations/{name}").json()["curves"][0] for name in job.results[0]["calibrations"]]
        assert all("repeated" not in curve for curve in alone), "the year by itself stays available"
        night(factory)
        told.require_right()


@pytest.mark.parametrize("database_url", ["sqlite", "postgresql"], indirect=True)
def test_what_a_whole_station_did_at_a_date_cuts_its_paths_and_its_mean(
    make_service: Callable[..., Factory], superterp: Instrument, sky_power_file: Path
) -> None:
    """One antenna's step is taken out of the mean; that of all of them is the mean's."""
    settings = TwinSettings(stations=("CS002",), antennas=4, years=1.99, events_per_year=200)
    step = GainStep(size=POWER - 1.0, date="2014-09-01")
    sky = read_sky_power(sky_power_file)
    campaign = simulate_campaign(settings, superterp, sky, np.random.default_rng(11), [step])
    factory = make_service(campaign.spectra, lease_s=60.0, gate_change=0.9, gate_error=0.5)
    with served(factory) as http:
        told = Answers(factory, http, campaign)
        night(factory)
        body = {"station": "CS002", "at": {"value": "2014-09-01", "sigma_days": 1}, "reason": "another attenuator"}
        assert http.post("/v1/changes", json=body).json()["cuts_windows"]
        night(factory)
        assert http.get("/v1/changes").json()["changes"][0]["refitted"]
        for at, power in (("2014-06-15", 1.0), ("2014-11-15", POWER), ("2015-06-15", POWER)):
            for path in ((0, "X"), (3, "Y")):
                ratio, sigma, _ = told.c(at, path)
                pull = np.log(ratio * power**0.5) / np.hypot(sigma, 0.002)
                assert np.sqrt(np.mean(pull**2)) < 3.0, (at, path, np.mean(ratio))
        (c, sigma), (later, error) = told.station("2014-06-15"), told.station("2015-06-15")
        off = np.log(later / c) + 0.5 * np.log(POWER)
        assert np.sqrt(np.mean((off / np.hypot(sigma / c, error / later)) ** 2)) < 3.0, "the mean is cut there too"
        assert told.station("2014-11-15")[0] == pytest.approx(later, rel=0.02)
        assert http.get("/v1/stations/CS002/life").json()["epochs"][1]["from"][:10] == "2014-09-01"
