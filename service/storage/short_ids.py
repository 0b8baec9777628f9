"""Ids by their first digits, where no other id begins with them."""

from __future__ import annotations

import re

from sqlalchemy import Column, Connection, select

from lbacal_core.errors import BadInputError

ID_DIGITS = 64
_SHORT_ID = re.compile(r"[0-9a-f]{6,63}")


def complete_id(connection: Connection, column: Column[str], beginning: str, noun: str) -> str:
    """The one id of a column that begins with some digits; what none begins with is returned as it is.

    Raises
    ------
    BadInputError
        Where several begin with them.
    """
    if len(beginning) == ID_DIGITS or not _SHORT_ID.fullmatch(beginning):
        return beginning
    is_meant = column.between(beginning, beginning.ljust(ID_DIGITS, "f"))
    found = list(connection.execute(select(column).where(is_meant).limit(2)).scalars())
    if len(found) > 1:
        raise BadInputError("id", f"more digits of the id of one {noun}", f"{beginning}, which several have")
    return str(found[0]) if found else beginning
