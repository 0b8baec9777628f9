"""Records keep what was measured, and what was quoted was measured on data sets that nobody had seen."""

from __future__ import annotations

from validation.machinery.claims import Asked, decide, rate_of
from validation.machinery.ledger import DEBUG_BELOW, Block, joined, read_ledger
from validation.machinery.parts import parts_of, proof_names
from validation.machinery.records import Record, asked_of, path_of, read_history, read_record, read_records


def test_a_record_is_read_as_it_was_written(tmp_path, monkeypatch):
    monkeypatch.setattr("validation.machinery.records.RECORDS", tmp_path)
    claims = decide([rate_of("good", 9, 10)], {"good": Asked("Nine of ten are good", at_least=0.8)})
    rows = tuple({"seed": seed, "is_good": seed % 10 > 0} for seed in range(10))
    record = Record("some", "tenth", "1234567", "2027-01-01T00:00:00Z", "abc", 2, (Block(0, 10),), 0.5, claims, rows)
    path = record.write()
    assert path.name == "some-tenth.json"
    assert read_record(path) == record
    assert len(path.read_text().splitlines()) > len(record.rows)  # a trial is a line


def test_stored_records_are_what_the_ledger_and_the_claims_say():
    entries = read_ledger()
    assert len(entries) == len(set(entries))
    for record in read_records():
        name, part = record.name, parts_of(record.proof)[record.part]
        own = [one for one in entries if (one.proof, one.part) == (record.proof, record.part)]
        assert record.proof in proof_names(), name
        assert path_of(record.proof, record.part).is_file(), name
        assert all(any(one.is_held([block], {record.commit}) for one in own) for block in record.blocks), name
        assert all(block.first >= DEBUG_BELOW for block in record.blocks) == part.has_chance, name
        assert record.look <= (len(own) if part.has_chance else 1), name
        asked = {claim.key: claim.asked for claim in record.claims}
        assert set(asked) <= set(asked_of(record.proof, record.part)), name
        if record.rows:
            seeds = [seed for block in record.blocks for seed in range(block.first, block.end)]
            assert [row["seed"] for row in record.rows] == seeds, name
            assert decide(part.judge(record.rows), asked, record.look) == record.claims, name


def test_no_seed_is_in_two_results():
    blocks: dict[tuple[str, str], list[Block]] = {}
    for record in [*read_records(), *read_history()]:
        fresh = [block for block in record.blocks if block.first >= DEBUG_BELOW]
        blocks.setdefault((record.proof, record.part), []).extend(fresh)
    for own in blocks.values():
        joined(own)
