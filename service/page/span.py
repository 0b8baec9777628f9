"""The time range of an address (`?since=&until=`), which every page obeys and every link of a page keeps."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import urlencode

from lbacal.instants import SECOND_US, format_instant
from lbacal_core.curves.validity import Instant


@dataclass(frozen=True)
class Span:
    """A half-open range of time; None is open."""

    since: Instant | None = None
    until: Instant | None = None

    def has(self, instant: Instant) -> bool:
        """Whether an instant lies in it."""
        return (self.since is None or self.since <= instant) and (self.until is None or instant < self.until)

    @property
    def limits(self) -> tuple[float, float] | None:
        """Both ends in seconds, for an axis; None where one of them is open."""
        return None if self.since is None or self.until is None else (self.since / SECOND_US, self.until / SECOND_US)

    @property
    def days(self) -> dict[str, str]:
        """The ends of the range as dates, as the form of a page shows them; empty where open."""
        ends = {"since": self.since, "until": self.until}
        return {name: "" if at is None else format_instant(at)[:10] for name, at in ends.items()}

    @property
    def query(self) -> str:
        """The query by which the next page has the same range of time; empty where both ends are open."""
        return self.with_more()

    def with_more(self, **more: str) -> str:
        """Add further parameters."""
        given = {name: value for name, value in {**self.days, **more}.items() if value}
        return f"?{urlencode(given)}" if given else ""


EVERYTHING = Span()
