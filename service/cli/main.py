"""The commands of the server, added to those of the client when this module is imported.

`lbacal` finds it through the entry point `lbacal.commands`; `python -m service.cli.main` is the same command.
"""

from __future__ import annotations

from lbacal.cli.main import app
from lbacal.cli.main import run as main
from service.cli.database import db, keys
from service.cli.processes import scheduler, worker
from service.cli.serve import serve

__all__ = ["app", "main"]

for command in (serve, scheduler, worker):
    app.command()(command)
app.add_typer(db, name="db")
app.add_typer(keys, name="keys")


if __name__ == "__main__":
    main()
