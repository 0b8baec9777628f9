"""What Prometheus reads: counts and times of the requests to this process, and the state of the service."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

from lbacal_core.curves.validity import Instant
from service.storage.alarms import ACKNOWLEDGED, KINDS, OPEN
from service.storage.processes import API, SCHEDULER, WORKER
from service.usecases.status import State

_SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60)


class Traffic:
    """Counts of requests and their times."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self._requests = Counter(
            "lbacal_requests", "Requests answered.", ["method", "route", "status"], registry=registry
        )
        self._seconds = Histogram(
            "lbacal_request_seconds", "Time from the request to its answer, s.", ["method", "route"],
            buckets=_SECONDS, registry=registry,
        )  # fmt: skip

    def count(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one request."""
        self._requests.labels(method, route, str(status)).inc()
        self._seconds.labels(method, route).observe(seconds)


def describe_state(state: State, now: Instant) -> CollectorRegistry:
    """The state of the service as gauges."""
    registry = CollectorRegistry()

    def tell(name: str, meaning: str, value: float) -> None:
        Gauge(f"lbacal_{name}", meaning, registry=registry).set(value)

    tell("ready", "1 if the service can do its work.", float(state.problem is None))
    tell("events", "Events stored.", state.events)
    tell("gated_versions", "Versions that the gate kept back and nobody promoted.", state.gated)
    tell("failed_jobs", "Jobs that failed in 30 days and that nothing made up for.", len(state.failures))
    tell("stuck_parts", "Kinds of parts that no worker may begin.", len(state.stuck))
    if state.newest_event is not None:
        tell("newest_event_age_seconds", "Time since the newest event, s.", (now - state.newest_event) / 1e6)
    parts = Gauge("lbacal_parts", "Parts of jobs by state, ended ones of 30 days.", ["state"], registry=registry)
    for name, count in state.parts.items():
        parts.labels(name).set(count)
    alarms = Gauge("lbacal_alarms", "Alarms that last.", ["kind", "state"], registry=registry)
    for kind in KINDS:
        alarms.labels(kind, OPEN).set(state.alarms.open.get(kind, 0))
        alarms.labels(kind, ACKNOWLEDGED).set(state.alarms.acknowledged.get(kind, 0))
    processes = Gauge("lbacal_processes_alive", "Processes seen within a minute.", ["kind"], registry=registry)
    for kind in (API, SCHEDULER, WORKER):
        processes.labels(kind).set(sum(one.is_alive for one in state.processes if one.kind == kind))
    return registry
