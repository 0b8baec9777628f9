"""The reference chains of versions: members and L_ref beside the version, cables and spreads once under their hash."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from sqlalchemy import Connection, select
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from lbacal_core.curves.reference_chain import CableTable, GainSpreads, ReferenceChain, parse_cable_table, parse_spreads
from lbacal_core.provenance import canonical_json
from service.schema.tables import chain_part

MANY_KEYS = 500
PARTS_REMEMBERED = 64
"""Tables of cables, and as many of spreads, that stay in memory; they never change, and there are few."""


def write_chains(connection: Connection, chains: Mapping[str, Mapping[str, ReferenceChain]]) -> dict[str, str | None]:
    """Store what the chains of versions share, and give each version's own part as canonical JSON."""
    parts: dict[str, str] = {}
    for chain in (chain for of_version in chains.values() for chain in of_version.values()):
        shared = (chain.cables,) if chain.spreads is None else (chain.cables, chain.spreads)
        for part in shared:
            if part.digest not in parts:
                parts[part.digest] = canonical_json(part.as_dict())
    if parts:
        insert: Any = sqlite_insert if connection.dialect.name == "sqlite" else postgresql_insert
        rows = [{"sha256": digest, "content": content} for digest, content in sorted(parts.items())]
        connection.execute(insert(chain_part).on_conflict_do_nothing(), rows)
    return {name: _describe(of_version) for name, of_version in chains.items()}


def _describe(chains: Mapping[str, ReferenceChain]) -> str | None:
    if not chains:
        return None
    return canonical_json(
        {
            dipole: {
                "members": [list(member) for member in chain.members],
                "mean_cable_loss": chain.mean_loss.tolist(),
                "cables": chain.cables.digest,
                "spreads": None if chain.spreads is None else chain.spreads.digest,
                "doubt": chain.doubt,
            }
            for dipole, chain in chains.items()
        }
    )


def read_chains(connection: Connection, references: Mapping[str, str | None]) -> dict[str, dict[str, ReferenceChain]]:
    """The chains of versions by dipole, from each version's own part."""
    own = {name: {} if text is None else json.loads(text) for name, text in references.items()}
    described = [chain for of_version in own.values() for chain in of_version.values()]
    tables = {chain["cables"] for chain in described}
    spreads = {chain["spreads"] for chain in described if chain["spreads"] is not None}
    contents = dict(_read_parts(connection, tables | spreads))
    table_of = {digest: _parse_cables(contents[digest]) for digest in tables}
    spreads_of = {digest: _parse_spreads(contents[digest]) for digest in spreads}
    return {
        name: {
            dipole: ReferenceChain(
                members=tuple((station, antenna) for station, antenna in chain["members"]),
                mean_loss=np.array(chain["mean_cable_loss"], dtype=float),
                cables=table_of[chain["cables"]],
                spreads=spreads_of.get(chain["spreads"]),
                doubt=chain["doubt"],
            )
            for dipole, chain in of_version.items()
        }
        for name, of_version in own.items()
    }


def read_cable_changes(connection: Connection) -> dict[str, set[float]]:
    """When antennas change cables, unix seconds by station, in any table that a version answers with."""
    found: dict[str, set[float]] = {}
    for row in connection.execute(select(chain_part)):
        for station, _, _, *instants in json.loads(row.content).get("antennas", ()):
            found.setdefault(station, set()).update(instant for instant in instants if instant is not None)
    return found


@lru_cache(PARTS_REMEMBERED)
def _parse_cables(text: str) -> CableTable:
    return parse_cable_table(json.loads(text))


@lru_cache(PARTS_REMEMBERED)
def _parse_spreads(text: str) -> GainSpreads:
    return parse_spreads(json.loads(text))


def _read_parts(connection: Connection, digests: Iterable[str]) -> Iterable[tuple[str, str]]:
    wanted = sorted(digests)
    for start in range(0, len(wanted), MANY_KEYS):
        of_keys = chain_part.c.sha256.in_(wanted[start : start + MANY_KEYS])
        for row in connection.execute(select(chain_part).where(of_keys)):
            yield row.sha256, row.content
