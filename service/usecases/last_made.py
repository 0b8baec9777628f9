"""What takes long to put together, kept in the process with the state of the database that it was made from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

Content = TypeVar("Content")


@dataclass(frozen=True)
class LastMade(Generic[Content]):
    """The content that was made last. Whoever asks in another state makes it anew: it is never stale."""

    kept: list[tuple[str, Content]] = field(default_factory=list)

    def get(self, state: str, make: Callable[[], Content]) -> Content:
        """The content of a state, read before it is made: what comes between makes it newer than its name."""
        for name, content in self.kept[:1]:
            if name == state:
                return content
        made = make()
        self.kept[:] = [(state, made)]
        return made
