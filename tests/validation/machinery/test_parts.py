from __future__ import annotations

import pickle

import pytest

from validation.machinery.parts import parts_of, proof_names


@pytest.mark.parametrize("proof", proof_names())
def test_every_part_of_a_proof_can_be_sent_to_other_processes(proof: str):
    parts = parts_of(proof)
    assert parts
    for name, part in parts.items():
        assert part.name == name
        assert part.count > 0
        assert pickle.loads(pickle.dumps(part)).name == name  # noqa: S301  (our own)


def test_a_module_without_parts_is_no_proof():
    assert "__main__" not in proof_names()
    assert "discovery" in proof_names()
