"""The revisions of the schema: those that this code knows, and the newest, which it needs."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from service.errors import UnavailableError


@cache
def known_revisions() -> tuple[str, ...]:
    """List the revisions that this code knows, oldest first: the numbers with which their files begin."""
    names = (one.name for one in files("migrations").joinpath("versions").iterdir())
    return tuple(sorted(name.partition("_")[0] for name in names if name.endswith(".py")))


def require_known(revision: str | None) -> None:
    """Refuse a schema that a newer version made, or one from before the first that was released."""
    first, newest = known_revisions()[0], known_revisions()[-1]
    if revision is not None and revision not in known_revisions():
        what = f"older than the first that was released ({first}): start a new database"
        if revision > newest:
            what = f"newer than this version of lbacal knows ({newest}): install the newer one"
        raise UnavailableError(f"the database schema is {revision}, {what}")


def require_newest(revision: str | None) -> None:
    """Refuse a schema that is not the one this code needs, and name the cure."""
    needed = known_revisions()[-1]
    if revision != needed:
        require_known(revision)
        raise UnavailableError(
            f"the database schema is {revision or 'empty'}, {needed} is needed: run `lbacal db upgrade`"
        )
