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
    print(f"alarms: {state['alarms']['line']}")
    for one in state["investigations"]:
        print_news(one)
    for sentence in state["not_refitted"]:
        print(sentence)
    for sentence in state["stopped_paying"]:
        print(f"no longer pays: {sentence}")
    for sentence in state["stuck"]:
        print(f"stuck: {sentence}")
    for failure in state["failures"]:
        request = failure["request"]
        what = " ".join(str(request[name]) for name in ("scope", "station") if request.get(name))
        again = f"; again after {failure['again_after']}" if failure["again_after"] else ""
        print(f"failed: job {failure['job']} ({failure['kind']} {what}): {failure['error']}{again}")


def print_news(news: dict[str, Any]) -> None:
    """Print the newest investigation of a station in one line, and below it what the one before did not say."""
    causes = f" ({', '.join(news['findings'])})" if news["findings"] else ""
    window = f"{news['since'][:10]} to {news['until'][:10]}"
    has_news = news["before"] is not None and (news["new"] or news["stronger"] or news["gone"])
    told = "" if news["before"] is None or has_news else ", as before"
    print(f"{news['station']}, {window}: {news['verdict']}{causes}{told}; investigation {news['id'][:12]}")
    for name, kind in (("new", "new"), ("stronger", "stronger"), ("gone", "no longer")):
        for sentence in news[name]:
            print(f"  {kind}: {sentence}")
