"""The commands of the server, which the entry point `lbacal.commands` adds to those of the client."""

from __future__ import annotations

from lbacal.cli.main import app
from service.cli.database import db, keys
from service.cli.processes import scheduler, worker
from service.cli.serve import serve

for command in (serve, scheduler, worker):
    app.command()(command)
app.add_typer(db, name="db")
app.add_typer(keys, name="keys")
