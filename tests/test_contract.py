"""Every surface that scripts of users rely on is there under its exact name: commands with options, verbs, routes."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer.main
from typer.core import TyperGroup

import lbacal
from lbacal.cli.main import add_commands, app
from service.app import make_app
from service.config import Settings
from service.factory import Factory

COMMANDS = {
    "spectra": "--output --blocks --event-id",
    "sky-power": "--instrument --sky --antenna --output",
    "fit": "--instrument --sky-power --scope --output --report --with",
    "lst-curve": "--sky-power --instrument --band --report --plot",
    "investigate": "--instrument --sky-power --report --html --lst-curve --band --with",
    "budget": "--instrument",
    "audit": "--instrument",
    "import": "--output",
    "predict": "--station --antenna --dipole --at --temperature --realisations --output --simulation",
    "life": "",
    "changes": "",
    "changes decide": "--in-force --dismiss --reason",
    "paper": "--output",
    "serve": "--host --port --all-in-one --api-only",
    "scheduler": "--once",
    "worker": "",
    "db upgrade": "",
    "db check": "",
    "keys create": "--scope --expires",
    "keys list": "",
    "keys revoke": "",
    "ingest": "",
    "refit": "--scope --since --until --reason --promote",
    "promote": "--reason --dry-run",
    "jobs": "",
    "status": "",
    "sync": "",
    "effective": "--station --antenna --dipole --at --as-of --tag --gap --format --why",
}
VERBS = [
    "read", "import_data", "fit", "budget", "audit", "investigate", "lst_curve", "predict", "life", "effective",
    "simulate", "ingest", "refit",
]  # fmt: skip
ROUTES = """
POST /v1/spectra; GET /v1/events; POST /v1/events/{event_id}/flag; GET /v1/calibrations/effective; GET /v1/calibrations
GET /v1/calibrations/{version_id}; GET /v1/calibrations/{first}/diff/{second}; POST /v1/promotions; GET /v1/tags
PUT /v1/tags/{name}; POST /v1/refits; GET /v1/jobs; GET /v1/jobs/{number}; POST /v1/jobs/{number}/cancel; GET /v1/drift
GET /v1/alarms; POST /v1/alarms/{number}/acknowledgement; POST /v1/investigations; GET /v1/investigations
GET /v1/investigations/{name}; POST /v1/investigations/{name}/adoption; GET /v1/changes; POST /v1/changes
POST /v1/changes/{number}/decision; GET /v1/paths/{station}/{antenna}/{dipole}/life; GET /v1/stations/{station}/life
GET /v1/life; GET /v1/antennas/bad; GET /v1/predictions
GET /v1/models; POST /v1/models/{name}/withdrawal; GET /v1/budgets/{digest}
GET /healthz; GET /readyz; GET /metrics
"""


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_has_its_options(name: str) -> None:
    add_commands()
    found = typer.main.get_command(app)
    for word in name.split():
        assert isinstance(found, TyperGroup)
        found = found.commands[word]
    options = {option for one in found.params for option in (*one.opts, *one.secondary_opts)}
    assert set(COMMANDS[name].split()) <= options


@pytest.mark.parametrize("name", VERBS)
def test_a_verb_can_be_called(name: str) -> None:
    assert callable(getattr(lbacal, name))


def test_the_routes_are_those_of_the_contract_whatever_their_parameters_are_called(tmp_path: Path) -> None:
    def plain(route: str) -> str:
        return "/".join("{}" if part.startswith("{") else part for part in route.split("/"))

    factory = Factory(Settings(database_url=str(tmp_path / "lbacal.sqlite")))
    paths = make_app(factory).openapi()["paths"]
    factory.database.close()
    served = {plain(f"{method.upper()} {path}") for path, methods in paths.items() for method in methods}
    asked = {plain(route.strip()) for line in ROUTES.strip().splitlines() for route in line.split(";")}
    assert asked - served == set()
