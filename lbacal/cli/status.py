"""`lbacal status`: whether the service can serve, who lives, what waits and what failed."""

from __future__ import annotations

from typing import Any

import typer

from lbacal.client import Client


def status() -> None:
    """Show whether the service is ready, which processes live, what waits, and what failed and when it is tried again.

    Example: lbacal status

    It exits with 0 if the service is ready, else with 1.
    """
    with Client(tries=1) as client:
        state = client.get("/v1/status")
    print_state(state)
    if not state["ready"]:
        raise typer.Exit(1)


def print_state(state: dict[str, Any]) -> None:
    """Print the answer of `GET /v1/status`, one line a fact."""
    print("ready" if state["ready"] else f"not ready: {state['problem']}")
    for process in state["processes"]:
        said = "lives" if process["alive"] else "is silent"
        print(f"{process['kind']} {process['name']} {said}, seen {process['silent_s']:.0f} s ago")
    parts = ", ".join(f"{count} {name}" for name, count in state["parts"].items())
    print(f"parts of jobs: {parts}")
    newest = state["newest_event"] or "none"
    print(f"{state['events']} events, the newest of {newest}; {state['gated']} versions wait for a human")
    for sentence in state["stuck"]:
        print(f"stuck: {sentence}")
    for failure in state["failures"]:
        request = failure["request"]
        what = " ".join(str(request[name]) for name in ("scope", "station") if request.get(name))
        again = f"; again after {failure['again_after']}" if failure["again_after"] else ""
        print(f"failed: job {failure['job']} ({failure['kind']} {what}): {failure['error']}{again}")
