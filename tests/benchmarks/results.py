"""A result made by hand, for the tests of what is done with results."""

from __future__ import annotations

from typing import Any

from benchmarks.common import spread
from benchmarks.floor_programs import FLOORS
from benchmarks.processes import Memory
from benchmarks.product import summary
from benchmarks.start import LaunchResult, start_row

LOAD = {
    "seconds": 2.0,
    "steps": 100,
    "cpu_share": {"plane": 0.1, "observer": 0.2, "controller": 0.05, "recorder": 0.3, "agents": 1.0},
    "cpu_ms_per_step": 16.5,
    "switches_per_agent_step": 4.2,
    "other_load": 0.1,
}


def repeat(product: float, **floors: float) -> dict[str, Any]:
    """Return the results of one repeat: speeds of the product and of the floors that are named; the others make 1."""
    speeds = {**dict.fromkeys(FLOORS, 1.0), "packed": product, **floors, "product": product}
    return {name: {"steps_per_second": speed, "load": LOAD} for name, speed in speeds.items()}


def document(*repeats: dict[str, Any], robots: int = 4) -> dict[str, Any]:
    """Return a result of the suite `product`."""
    return {
        "schema": 1,
        "created": "2026-01-01T00:00:00+00:00",
        "machine": {"usable_cores": 2, "cores": 2, "processor": "some", "kernel": "6.1", "load_before": 0.1},
        "settings": {"repeat": len(repeats), "window": 6.0},
        "product": [{"robots": robots, "summary": summary(list(repeats)), "repeats": list(repeats)}],
    }


def of_starts(*seconds: float, failures: tuple[str, ...] = (), retried: int = 0) -> dict[str, Any]:
    """Return a result of the suite `start`: clean starts of 200 robots that took these times, and failed ones."""
    memory = Memory(1, 1, {}, 1)
    results = [LaunchResult(second, 0.5, memory, retried) for second in seconds]
    return {**document(repeat(1.0)), "start": [start_row(200, results, failures, busy=True)]}


def of_large(speed: float | None) -> dict[str, Any]:
    """Return a result of the suite `large`: a run of 2,000 robots with this speed, or one that failed."""
    speeds = [] if speed is None else [speed]
    measures = ("start_seconds", "steps_per_second", "total_bytes", "cpu_ms_per_step")
    row = {
        "robots": 2000,
        "agents_per_process": 50,
        "failures": [] if speeds else ["it stalled"],
        "summary": {name: spread(speeds) for name in measures},
        "repeats": [],
    }
    return {**document(repeat(1.0)), "large": [row]}
