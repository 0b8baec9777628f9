"""What a path is told by a curve of its station or of the array: its own cable, in every format."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.table import Table
from fastapi.testclient import TestClient

from lbacal.cli.client import print_curve
from lbacal.client import make_table
from lbacal.instants import format_instant, parse_instant
from lbacal_core.curves.covariance import parse_budget
from lbacal_core.curves.reference_chain import CableTable, ReferenceChain
from lbacal_core.curves.validity import Scope
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import hash_content
from lbacal_twin.campaign import Campaign
from service.app import make_app
from service.factory import Factory
from service.usecases.calibrations import select_paths
from service.usecases.status import look_over
from service.wire.answers import to_json
from tests.service.conftest import like, served, work

ANTENNAS = 12
AT = "2014-06-01"


@pytest.fixture
def service(make_service: Callable[..., Factory], three_cables: Campaign) -> Factory:
    return make_service(three_cables.spectra)


@pytest.fixture
def http(service: Factory) -> Iterator[TestClient]:
    """A server whose curves of a station and of the array are in effect, and of no path by itself."""
    with served(service) as made:
        for scope in ("station", "array"):
            refit(made, service, scope)
        yield made


def refit(http: TestClient, service: Factory, scope: str, **more: Any) -> Any:
    body = {"scope": scope, "since": "2014-01-01", "until": "2015-01-01", "reason": "test", "promote": True, **more}
    number = http.post("/v1/refits", json=body).json()["job"]
    work(service)
    return http.get(f"/v1/jobs/{number}").json()


def ask(http: TestClient, **params: Any) -> Any:
    answer = http.get("/v1/calibrations/effective", params={"at": AT, **params})
    assert answer.status_code == 200, answer.text
    return answer.json() if params.get("format", "json") == "json" else answer.text


def total_error(curve: dict[str, Any]) -> Any:
    """The error that the twin draws: it has the sky and the antenna of the fit, so the shared terms are not in it."""
    own = np.sum(np.square(curve["covariance"]["systematic"]["own"]), axis=0)
    assert np.all(np.array(curve["c_sigma_sys"]) > np.array(curve["c"]) * np.sqrt(own))
    return np.hypot(curve["c_sigma_stat"], curve["c"] * np.sqrt(own))


def test_a_station_answers_each_path_through_the_paths_own_cable(
    http: TestClient, three_cables: Campaign, superterp: Instrument
) -> None:
    curves = [c for c in ask(http, station="CS002")["curves"] if c["antenna"] < ANTENNAS]
    assert {c["reference"]["cable"] for c in curves} == {"50", "80", "115"}
    pulls = []
    for curve in curves:
        assert (curve["answered_by"], curve["flag"], curve["flag_reason"]) == ("station", ["ok"] * 51, None)
        truth = three_cables.truth.curve(curve["dipole"], "CS002", curve["antenna"])
        assert np.max(np.abs(curve["c"] / truth - 1)) < 0.15, "another cable's curve is off by 0.25 to 0.57"
        pulls.append((curve["c"] - truth) / total_error(curve))
        version = http.get(f"/v1/calibrations/{curve['calibration']}").json()
        chain = version["reference"][curve["dipole"]]
        stored = next(c for c in version["curves"] if c["dipole"] == curve["dipole"])
        loss = superterp.cables[curve["reference"]["cable"]]
        np.testing.assert_allclose(curve["factor"], np.sqrt(np.array(chain["mean_cable_loss"]) / loss))
        np.testing.assert_allclose(curve["c"], np.array(stored["c"]) * curve["factor"])
        assert curve["parameters"] == stored["parameters"]
        assert version["payload_sha256"] == hash_content(version["curves"])
        assert chain["members"] == [["CS002", antenna] for antenna in range(ANTENNAS)]
    # 24 paths, errors common along frequency: a root mean square pull of 1 is known to 15 %
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.5


def test_a_path_with_a_bad_channel_at_80_mhz_has_a_curve_of_its_own_all_the_same(
    http: TestClient, service: Factory, three_cables: Campaign
) -> None:
    """The weakest paths, those with 115 m, lost all 51 channels to one and were answered by their station."""
    job = refit(http, service, "antenna", station="CS002")
    assert not job["gated"]
    curves = [c for c in ask(http, station="CS002")["curves"] if c["antenna"] < ANTENNAS]
    assert {c["answered_by"] for c in curves} == {"antenna"}
    flags = np.array([c["flag"] for c in curves])
    assert not np.all(flags[:, -1] == "ok"), "of 200 events some paths do not know C at 80 MHz to a half"
    assert np.all(flags[:, :40] == "ok")
    for curve in curves:
        truth = three_cables.truth.curve(curve["dipole"], "CS002", curve["antenna"])
        c, sigma = (np.array(curve[name], dtype=float) for name in ("c", "c_sigma_stat"))
        assert np.nanmax(np.abs((c - truth) / sigma)) < 5
        assert np.array_equal(np.isnan(c), np.array(curve["flag"]) == "outside")


def test_the_budget_that_curves_name_stands_once_in_the_answer_and_at_its_own_address(http: TestClient) -> None:
    answer = ask(http, station="CS002")
    names = {curve["covariance"]["systematic"]["budget"] for curve in answer["curves"]}
    assert set(answer["budgets"]) == names
    for name in names:
        content = http.get(f"/v1/budgets/{name}").json()
        assert content == answer["budgets"][name]
        assert parse_budget(content).digest == name
        assert parse_budget(content).variance("X")[25] > 0.07**2
    assert http.get(f"/v1/budgets/{'0' * 64}").status_code == 404


def test_every_way_out_gives_the_same_numbers_and_the_same_flag(
    http: TestClient, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (
        {"station": "CS002", "antenna": 10, "dipole": "X"},
        {"station": "CS003", "antenna": 10, "dipole": "X"},
    ):
        content = ask(http, **path)
        (curve,) = content["curves"]
        if path["station"] == "CS003":  # there are no data of it
            assert (curve["answered_by"], set(curve["flag"]), curve["c_sigma_sys"]) == ("array", {"uncertain"}, None)
            assert curve["flag_reason"].startswith("there are no data of CS003")
        rows = list(csv.DictReader(io.StringIO(ask(http, **path, format="csv"))))
        assert [float(row["c"]) for row in rows] == curve["c"]
        assert [float(row["factor"]) for row in rows] == curve["factor"]
        assert [row["flag"] for row in rows] == curve["flag"]
        assert {row["flag_reason"] for row in rows} == {curve["flag_reason"] or ""}
        ecsv = Table.read(ask(http, **path, format="ecsv"), format="ascii.ecsv")
        client = make_table(content)
        for table in (ecsv, client):
            np.testing.assert_array_equal(np.asarray(table["c"]), curve["c"])
            expected = curve["c_sigma_sys"] or [np.nan] * 51
            np.testing.assert_array_equal(np.ma.filled(np.asarray(table["c_sigma_sys"]), np.nan), expected)
            assert list(table["flag"]) == curve["flag"]
            np.testing.assert_array_equal(np.asarray(table["c_over_h"]), curve["c_over_h"])
            np.testing.assert_array_equal(np.asarray(table["antenna_gain"]), curve["antenna_gain"])
        # through the cable of the path, as C is
        np.testing.assert_allclose(curve["c_over_h"], curve["c"] / np.sqrt(curve["antenna_gain"]), rtol=1e-12)
        assert [float(row["c_over_h"]) for row in rows] == curve["c_over_h"]
        text = ask(http, **path, format="nuradio")
        np.testing.assert_array_equal(np.loadtxt(io.StringIO(text))[30:81], curve["c"])
        assert f"answered by {curve['answered_by']}, carried through its own cable 50" in text
        assert f"C belongs to the antenna gain {curve['antenna_gain_sha256'][:12]}" in text
        print_curve(curve)
        printed = capsys.readouterr().out
        assert f"{curve['c'][0]:.6g}" in printed
        assert "through its own cable 50" in printed
        for out in (text, printed):
            assert ("uncertain: there are no data of CS003" in out) == (path["station"] == "CS003")


def test_nuradio_gives_the_reference_chain_of_the_array_and_says_that_it_is_nobodys_cable(
    http: TestClient, capsys: pytest.CaptureFixture[str]
) -> None:
    text = ask(http, scope="array", dipole="Y", format="nuradio")
    (curve,) = ask(http, scope="array", dipole="Y")["curves"]
    assert "array Y: reference chain, the mean of its paths: nobody's cable" in text
    np.testing.assert_array_equal(np.loadtxt(io.StringIO(text))[30:81], curve["c"])
    stored = http.get(f"/v1/calibrations/{curve['calibration']}").json()["curves"]
    assert curve["c"] == next(c["c"] for c in stored if c["dipole"] == "Y")
    assert (curve["station"], curve["antenna"], set(curve["factor"])) == (None, None, {1.0})
    table = make_table(ask(http, scope="array"))
    assert ({*table["station"]}, {*table["antenna"]}, {*table["dipole"]}) == ({""}, {-1}, {"X", "Y"})
    print_curve(curve)
    assert "array Y, reference chain: nobody's cable: version " in capsys.readouterr().out
    refused = [{"scope": "array", "format": "nuradio"}, {"scope": "array", "station": "CS002"}, {"scope": "station"}]
    for params in refused:
        assert http.get("/v1/calibrations/effective", params={"at": AT, **params}).status_code == 422


def test_a_pinned_answer_stays_whatever_the_servers_instrument_file_says_later(
    http: TestClient, service: Factory, clock: Any, tmp_path: Path
) -> None:
    pinned = {"at": AT, "station": "CS002", "as_of": format_instant(clock())}
    before = http.get("/v1/calibrations/effective", params=pinned).content
    content = service.instrument.as_dict()
    content["cables"] = {name: [0.5 * loss for loss in losses] for name, losses in content["cables"].items()}
    (tmp_path / "other.json").write_text(json.dumps(content))
    with like(service, instrument=str(tmp_path / "other.json")) as other, TestClient(make_app(other)) as changed:
        assert changed.get("/v1/calibrations/effective", params=pinned).content == before


def test_the_overview_counts_only_what_has_data(http: TestClient, service: Factory) -> None:
    assert "24 of 576 paths calibrated at the last event by data of their own" in http.get("/").text
    others, own_mean, own = "served the mean of others", "by a mean that holds their data", "by their own version"

    def count(station: int) -> dict[str, int]:
        """How many paths of a station the figure shows, each kind with those of the following ones."""
        told = csv.reader(io.StringIO(http.get("/?csv=coverage").text))
        return {row[0]: int(row[1]) for row in told if row[2] == str(station)}

    assert count(0) == {others: 96, own_mean: 24, own: 0}
    assert count(1) == {others: 96, own_mean: 0, own: 0}
    # one measured path was divided by itself: a step of 0 at no date, and the page answered 500
    refit(http, service, "antenna", antenna=0, dipole="X", station="CS002")
    assert count(0) == {others: 96, own_mean: 24, own: 1}
    assert http.get("/v1/drift", params={"station": "CS002"}).json()["steps"] == []


def test_the_overview_counts_no_path_whose_record_has_ended(factory: Factory) -> None:
    first, *others = factory.instrument.antennas
    ended = replace(factory.instrument, antennas=(replace(first, until=0.0), *others))
    whole, left = (look_over(factory.database, one, factory.clock).paths for one in (factory.instrument, ended))
    assert left == whole - 2


def test_a_promotion_and_a_comparison_quote_what_the_path_is_told(http: TestClient, service: Factory) -> None:
    job = refit(http, service, "antenna", station="CS002", antenna=10, dipole="X", promote=False)
    (own,) = job["calibrations"]
    (told,) = ask(http, station="CS002", antenna=10, dipole="X")["curves"]
    body = {"calibration": own, "valid_from": "2014-01-01", "valid_to": "2015-01-01", "reason": "test"}
    (change,) = http.post("/v1/promotions?dry_run=true", json=body).json()["changes"]
    fitted = np.array(http.get(f"/v1/calibrations/{own}").json()["curves"][0]["c"])
    fraction = fitted / np.array(told["c"]) - 1.0
    assert change["max_fraction"] == pytest.approx(np.max(np.abs(fraction)))
    assert change["max_sigma"] < 5, "in units of the whole error, spread between paths included"
    diff = http.get(f"/v1/calibrations/{told['calibration']}/diff/{own}").json()["curves"]
    assert [one["dipole"] for one in diff] == ["X"]
    assert diff[0]["fraction"] == pytest.approx(fraction)


def test_the_cable_at_the_date_is_used_when_it_was_exchanged(
    http: TestClient, service: Factory, superterp: Instrument
) -> None:
    (before,) = ask(http, station="CS002", antenna=10, dipole="X")["curves"]
    with service.database.read() as stores:
        version = stores.versions.get(before["calibration"])
    change = 1_405_000_000.0  # 2014-07-10
    others = tuple(r for r in superterp.antennas if (r.station, r.antenna) != ("CS002", 10))
    exchanged = (AntennaRecord("CS002", 10, "50", None, change), AntennaRecord("CS002", 10, "115", change, None))
    table = CableTable(superterp.cables, (*others, *exchanged))
    chains = {dipole: replace(chain, cables=table) for dipole, chain in version.chains.items()}
    later = replace(version, inputs={**version.inputs, "note": "exchanged"}, chains=chains)
    with service.database.write() as stores:
        stores.versions.add([later])
    body = {"calibration": later.id, "valid_from": "2014-01-01", "valid_to": "2015-01-01", "reason": "test"}
    changes = http.post("/v1/promotions", json=body).json()["changes"]
    assert max(change["max_fraction"] for change in changes) < 1e-9, "nothing is different until the exchange"
    told = [
        http.get(
            "/v1/calibrations/effective", params={"at": at, "station": "CS002", "antenna": 10, "dipole": "X"}
        ).json()
        for at in ("2014-07-01", "2014-08-01")
    ]
    assert [one["curves"][0]["reference"]["cable"] for one in told] == ["50", "115"]
    ratio = np.array(told[1]["curves"][0]["c"]) / np.array(told[0]["curves"][0]["c"])
    np.testing.assert_allclose(ratio**2, superterp.cables["50"] / superterp.cables["115"])
    # the epoch said that nothing changed, and that the window was cut there was not said
    then = "2014-07-10T13:46:40Z"
    assert [tuple(one["curves"][0]["epoch"].values()) for one in told] == [(None, then, None), (then, None, None)]
    assert "a record of the instrument of 2014-07-10 begins its epoch" in told[1]["curves"][0]["why"]


def test_what_a_mean_is_of_is_stored_with_it_shown_and_compared_through_one_cable(
    http: TestClient, service: Factory
) -> None:
    with service.database.read() as stores:
        versions = {version.scope: version for version in stores.versions.search(None, None, "", 10)}
    assert set(versions) == {Scope(), Scope("CS002")}
    chains: list[ReferenceChain] = [chain for version in versions.values() for chain in version.chains.values()]
    assert len({chain.cables.digest for chain in chains}) == 1, "shared parts are stored once"
    assert all(chain.spreads is not None and set(chain.spreads.by_cable) == {"80", "115"} for chain in chains)
    of_array, of_station = versions[Scope()].id, versions[Scope("CS002")].id
    page = http.get(f"/calibrations/{of_station}").text
    assert "Reference chain" in page
    assert "mean of 12 paths" in page
    diff = http.get(f"/v1/calibrations/{of_array}/diff/{of_station}").json()
    # the array is this one station, so the two are the same mean
    assert all(one["max_fraction"] < 1e-9 for one in diff["curves"])


@pytest.mark.long
def test_what_is_answered_from_memory_is_what_was_told_first_in_all_cables_and_as_of_any_instant(
    http: TestClient, service: Factory
) -> None:
    """The text of a curve is kept, and told again where path, cable, promotion and question are the same."""
    questions: list[dict[str, str]] = [
        {"at": AT}, {"at": "2014-09-01"}, {"at": AT, "station": "CS002", "antenna": "3", "dipole": "Y"},
        {"at": AT, "scope": "array"}, {"at": AT, "scope": "array", "dipole": "X"}, {"at": "2030-01-01", "gap": "hold"},
    ]  # fmt: skip
    for _ in range(2):
        for question in questions:
            with like(service) as fresh:
                first = TestClient(make_app(fresh)).get("/v1/calibrations/effective", params=question)
            found = http.get("/v1/calibrations/effective", params=question)
            assert (found.status_code, found.content) == (200, first.content)
            body = found.json()
            assert found.content == to_json(body), "the same bytes as those of the object"
            named = {curve["covariance"]["systematic"]["budget"] for curve in body["curves"] if "covariance" in curve}
            assert set(body["budgets"]) == named - {None}


@pytest.mark.usefixtures("http")
def test_the_curves_of_all_paths_are_read_and_written_once(service: Factory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond 1,200 paths a cache that was swept from end to end held none, and an answer was four times as dear."""
    monkeypatch.setattr("service.usecases.calibrations.FEWEST_REMEMBERED", 1)
    use = replace(service.calibrations)
    paths = select_paths(service.instrument, None, None, None)
    written: list[Any] = []
    for _ in range(2):
        found = use.in_effect(parse_instant("at", AT), paths)
        use.write(found.curves, lambda curve: written.append(curve) or curve)
    assert len(found.curves) == len(paths) == len(written) > 1
