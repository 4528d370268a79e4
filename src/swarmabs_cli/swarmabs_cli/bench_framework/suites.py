"""The suites: what is measured, in which order, and the document that comes of it."""

from __future__ import annotations

import importlib.util
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from statistics import median
from typing import TYPE_CHECKING, Any, Literal, get_args

from swarmabs_cli.bench_framework.busy import busy_machine, busy_processes
from swarmabs_cli.bench_framework.floors import BARE_RCLPY, FLOORS, floors_folder, measure_floor
from swarmabs_cli.bench_framework.large import LargeResult, measure_large
from swarmabs_cli.bench_framework.launching import LaunchResult, measure_launch
from swarmabs_cli.bench_framework.machine import machine_facts
from swarmabs_cli.bench_framework.product import measure_product
from swarmabs_cli.bench_framework.reading import measure_reading
from swarmabs_cli.bench_framework.recording import measure_recorder
from swarmabs_cli.bench_framework.simulating import SOLVER, measure_against_solver, measure_simulate
from swarmabs_cli.bench_framework.tables import PACKED, PRODUCT
from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

Suite = Literal["product", "start", "memory", "large", "simulate", "recorder", "reading"]
SUITES: tuple[Suite, ...] = get_args(Suite)
SCHEMA = 1
"""Version of the document."""

_SOLVED_SECONDS = 30.0
_PART = 0.75
"""Speed of the product in parts of the floor's for which the length of its runs is made."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What to measure.

    Parameters
    ----------
    suites : tuple
        Names of suites.
    robots : tuple of int
        Numbers of robots, at least two each.
    repeat : int
        How often each measurement is made.
    window, warm_up : float
        Length of a measurement and of the time before it that does not count, s.
    starts : int, optional
        How often a run is started and ended for the suites start and memory; None for `repeat` times.
    busy : bool
        Whether other processes keep the machine busy meanwhile.
    large : tuple of int
        Numbers of robots in the suite large.
    agents_per_process : int
        How many of them share a process.
    """

    suites: tuple[Suite, ...] = SUITES
    robots: tuple[int, ...] = (4, 20, 64, 200)
    repeat: int = 3
    window: float = 6.0
    warm_up: float = 2.0
    starts: int | None = None
    busy: bool = False
    large: tuple[int, ...] = (200, 500, 1000, 2000)
    agents_per_process: int = 50


@dataclass(frozen=True, slots=True)
class Spread:
    """Median, smallest and largest of repeated measurements."""

    median: float
    smallest: float
    largest: float


def spread(values: Iterable[float]) -> dict[str, float] | None:
    """Return median, smallest and largest of what there is."""
    found = list(values)
    return asdict(Spread(median(found), min(found), max(found))) if found else None


def check_prerequisites(settings: Settings) -> None:
    """Make sure that the floors can be measured, if they shall be.

    Raises
    ------
    InputError
        If the floor programs or what they need is missing.
    """
    if PRODUCT in settings.suites:
        floors_folder()
        if importlib.util.find_spec("zmq") is None:
            raise InputError("pyzmq is missing, with which the product is compared; start with ./scripts/swarm bench")


def run_suites(settings: Settings, tell: Callable[[str], None]) -> dict[str, Any]:
    """Measure, and return the document.

    Parameters
    ----------
    settings : Settings
        What to measure.
    tell : callable
        Told in a line what is being measured, and what was.

    Raises
    ------
    KeyboardInterrupt
        If it was interrupted; nothing that was started is left then.
    RunError
        If something that was measured failed.
    """
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "machine": machine_facts(),
        "settings": asdict(settings),
    }
    if PRODUCT in settings.suites:
        document["product"] = _product(settings, tell)
    if {"start", "memory"} & set(settings.suites):
        with busy_machine() if settings.busy else nullcontext():
            document |= _launch(settings, tell)
    if "large" in settings.suites:
        document["large"] = _large(settings, tell)
    if "simulate" in settings.suites:
        document |= _simulate(settings, tell)
    if "recorder" in settings.suites:
        document["recorder"] = _recorder(settings, tell)
    if "reading" in settings.suites:
        document["reading"] = _reading(settings, tell)
    return document


def _product(settings: Settings, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Measure product and floors in turn: what changes on the machine meanwhile meets them all."""
    found = []
    for robots in settings.robots:
        repeats = []
        for number in range(settings.repeat):
            results: dict[str, Any] = {}
            for name in FLOORS:
                tell(f"{robots} robots, repeat {number + 1} of {settings.repeat}: {name}")
                result = measure_floor(name, robots, warm_up=settings.warm_up, window=settings.window)
                tell(f"  {result.steps_per_second:.1f} steps/s")
                results[name] = asdict(result)
            fastest = max(results[name]["steps_per_second"] for name in BARE_RCLPY)
            steps = max(20, round(_PART * fastest * (settings.warm_up + settings.window)))
            for name in (PRODUCT, PACKED):
                tell(f"{robots} robots, repeat {number + 1} of {settings.repeat}: {name}")
                measured = measure_product(robots, steps, warm_up=settings.warm_up, packed=name == PACKED)
                tell(f"  {measured.steps_per_second:.1f} steps/s")
                results[name] = asdict(measured)
            repeats.append(results)
        found.append({"robots": robots, "summary": product_summary(repeats), "repeats": repeats})
    return found


def product_summary(repeats: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the spreads of speeds and ratios; a ratio is that of two measurements of the same repeat.

    Parameters
    ----------
    repeats : list of dict
        Results by name of floor, and the product's without and with packed broadcasts.
    """
    names = (*FLOORS, PRODUCT, PACKED)
    speeds = {name: [repeat[name]["steps_per_second"] for repeat in repeats] for name in names}
    best = max(BARE_RCLPY, key=lambda name: median(speeds[name]))

    def ratio(floor: str, product: str = PRODUCT) -> dict[str, float] | None:
        return spread(mine / other for mine, other in zip(speeds[product], speeds[floor], strict=True))

    return {
        "floor": best,
        "steps_per_second": {name: spread(values) for name, values in speeds.items()},
        "ratio_to_floor": ratio(best),
        "ratio_to_zeromq": ratio("zeromq"),
        "packed_ratio_to_floor": ratio(best, PACKED),
        "packed_ratio_to_zeromq": ratio("zeromq", PACKED),
    }


def _launch(settings: Settings, tell: Callable[[str], None]) -> dict[str, list[dict[str, Any]]]:
    """Measure start, memory and end in the same runs."""
    start, memory = [], []
    starts = settings.starts or settings.repeat
    for robots in settings.robots:
        results: list[LaunchResult] = []
        failures: list[str] = []
        for number in range(starts):
            tell(f"{robots} robots, start {number + 1} of {starts}: start, memory and end")
            try:
                result = measure_launch(robots, warm_up=settings.warm_up)
            except RunError as error:  # how many starts are clean is what is measured
                failures.append(str(error))
                tell(f"  {error}")
                continue
            size = result.memory.agent_median / 2**20
            tell(
                f"  first step after {result.start_seconds:.1f} s, {size:.1f} MiB per robot, ended after"
                f" {result.shut_down_seconds:.1f} s"
            )
            results.append(result)
        start.append(start_row(robots, results, failures, settings))
        summary = {
            "agent_bytes": spread(result.memory.agent_median for result in results),
            "total_bytes": spread(result.memory.total for result in results),
        }
        memory.append({"robots": robots, "summary": summary, "repeats": [asdict(result.memory) for result in results]})
    found = {"start": start, "memory": memory}
    return {name: rows for name, rows in found.items() if name in settings.suites}


def start_row(
    robots: int, results: Sequence[LaunchResult], failures: Sequence[str], settings: Settings
) -> dict[str, Any]:
    """Sum up the starts of a swarm: in a clean one all processes have met, and the first step was made."""
    return {
        "robots": robots,
        "starts": len(results) + len(failures),
        "clean": len(results),
        "retried": sum(result.retried for result in results),
        "busy_processes": busy_processes() if settings.busy else 0,
        "failures": list(failures),
        "summary": {
            "start_seconds": spread(result.start_seconds for result in results),
            "shut_down_seconds": spread(result.shut_down_seconds for result in results),
        },
        "repeats": [
            {name: getattr(result, name) for name in ("start_seconds", "shut_down_seconds", "retried")}
            for result in results
        ],
    }


def _large(settings: Settings, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    rows = []
    for robots in settings.large:
        results: list[LargeResult] = []
        failures: list[str] = []
        for number in range(settings.repeat):
            tell(
                f"{robots} robots, {settings.agents_per_process} in a process, repeat {number + 1} of {settings.repeat}"
            )
            try:
                result = measure_large(
                    robots, settings.agents_per_process, warm_up=settings.warm_up, window=settings.window
                )
            except RunError as error:  # whether so many robots run at all is a result too
                failures.append(str(error))
                tell(f"  {error}")
                continue
            tell(f"  first step after {result.start_seconds:.1f} s, {result.steps_per_second:.1f} steps/s")
            results.append(result)
        summary = {
            "start_seconds": spread(result.start_seconds for result in results),
            "steps_per_second": spread(result.steps_per_second for result in results),
            "total_bytes": spread(result.memory.total for result in results if result.memory is not None),
            "cpu_ms_per_step": spread(result.load.cpu_ms_per_step for result in results if result.load is not None),
        }
        rows.append(
            {
                "robots": robots,
                "agents_per_process": settings.agents_per_process,
                "failures": failures,
                "summary": summary,
                "repeats": [asdict(result) for result in results],
            }
        )
    return rows


def _simulate(settings: Settings, tell: Callable[[str], None]) -> dict[str, Any]:
    rows = []
    for robots in settings.robots:
        tell(f"{robots} robots: simulate with and without a bag")
        results = [measure_simulate(robots, window=settings.window) for _ in range(settings.repeat)]
        summary = {
            "real_time_factor": spread(result.real_time_factor for result in results),
            "real_time_factor_without_bag": spread(result.real_time_factor_without_bag for result in results),
        }
        rows.append({"robots": robots, "summary": summary})
    tell(f"simulate against {SOLVER}")
    solved = [measure_against_solver(seconds=_SOLVED_SECONDS) for _ in range(settings.repeat)]
    against = {
        "solver": SOLVER,
        "problem": "four single integrators under the PD controller, continuous time",
        "ratio": spread(result.ratio for result in solved),
        "repeats": [asdict(result) for result in solved],
    }
    return {"simulate": rows, "solver": against}


def _recorder(settings: Settings, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    rows = []
    for robots in settings.robots:
        results = []
        for number in range(settings.repeat):
            tell(f"{robots} robots, repeat {number + 1} of {settings.repeat}: recorder")
            results.append(measure_recorder(robots, warm_up=min(0.5, settings.warm_up), window=settings.window))
        summary = {
            "messages_per_second": spread(result.messages_per_second for result in results),
            "core_share": spread(result.core_share for result in results if result.core_share is not None),
            "messages_per_core_second": spread(
                result.messages_per_core_second for result in results if result.messages_per_core_second is not None
            ),
        }
        rows.append({"robots": robots, "summary": summary, "repeats": [asdict(result) for result in results]})
    return rows


def _reading(settings: Settings, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    rows = []
    for robots in settings.robots:
        results = []
        for number in range(settings.repeat):
            tell(f"{robots} robots, repeat {number + 1} of {settings.repeat}: reading")
            results.append(measure_reading(robots, window=settings.window))
        summary = {
            "bag_bytes": spread(result.bag_bytes for result in results),
            "arrays_bytes_per_second": spread(result.bag_bytes / result.arrays_seconds for result in results),
            "ratio_to_iteration": spread(result.ratio for result in results),
        }
        rows.append({"robots": robots, "summary": summary, "repeats": [asdict(result) for result in results]})
    return rows
