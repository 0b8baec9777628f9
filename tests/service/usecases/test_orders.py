"""Requests that are done once, and in which inputs two processes differ."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lbacal_core.errors import BadInputError
from service.errors import ConflictError
from service.factory import Factory
from service.usecases.orders import LONGEST_NAME, Inputs, do_once, explain_difference, recall_answer


def test_a_request_under_a_name_is_done_once_for_each_caller_and_recalled(factory: Factory) -> None:
    database, done = factory.database, list[str]()

    def ask(by: str, name: str | None, request: bytes = b"promote") -> bytes:
        def act() -> bytes:
            done.append(by)
            return f"answer {len(done)}".encode()

        return do_once(database, factory.clock(), by, name, request, act)

    assert recall_answer(database, "key 1", "mine", b"promote") is None
    assert [ask("key 1", "mine"), ask("key 1", "mine"), ask("key 2", "mine")] == [b"answer 1", b"answer 1", b"answer 2"]
    assert recall_answer(database, "key 1", "mine", b"promote") == b"answer 1"
    assert recall_answer(database, "key 1", None, b"promote") is None
    assert [ask("key 1", None), ask("key 1", None)] == [b"answer 3", b"answer 4"]
    for again in (ask, lambda *asked: recall_answer(database, *asked)):
        with pytest.raises(ConflictError, match="something else was asked under the Idempotency-Key 'mine'"):
            again("key 1", "mine", b"withdraw")
    assert done == ["key 1", "key 2", "key 1", "key 1"]


@pytest.mark.parametrize("name", ["", "x" * (LONGEST_NAME + 1), "a\nb"])
def test_a_name_that_cannot_be_one_is_refused(factory: Factory, name: str) -> None:
    with pytest.raises(BadInputError, match="Idempotency-Key: expected 1 to 200 printable characters"):
        do_once(factory.database, 1, "key 1", name, b"", lambda: b"")
    with pytest.raises(BadInputError, match="Idempotency-Key"):
        recall_answer(factory.database, "key 1", name, b"")


def test_the_shortest_and_the_longest_name_are_names(factory: Factory) -> None:
    for name in ("x", "x" * LONGEST_NAME):
        assert do_once(factory.database, 1, "key 1", name, b"", lambda: b"done") == b"done"


def test_inputs_that_differ_are_named_by_their_first_digits() -> None:
    needed = Inputs("a" * 64, "b" * 64, 7)
    other = replace(needed, sky_power="c" * 64, model_version=8)
    assert explain_difference(needed.text, needed.text) == ""
    said = explain_difference(needed.text, other.text)
    assert said == "model version 7 (here 8), sky power bbbbbbbbbbbb (here cccccccccccc)"
