"""Time per call of the correctly rounded functions, compared with those of the machine's mathematical library."""

from __future__ import annotations

import math
import random
import sys
import time
from collections.abc import Callable
from functools import partial
from statistics import NormalDist
from typing import Any

from benchmarks.common import Settings, program, spread, tell

from swarmabs_core import elementary

Function = Callable[[float], float]
_NUMBERS = 500
_MACHINE = {"normal_quantile": NormalDist().inv_cdf}
"""What Python has outside `math`."""
_RANGES = {
    "tanh": ((-1.0, 1.0), (-10.0, 10.0)),
    "cos": ((-1.0, 1.0), (-100.0, 100.0)),
    "sin": ((-1.0, 1.0), (-100.0, 100.0)),
    "exp": ((-1.0, 1.0), (-100.0, 100.0)),
    "expm1": ((-1.0, 1.0), (-30.0, 30.0)),
    "log": ((0.0, 1.0), (0.0, 100.0)),
    "normal_quantile": ((0.0, 1.0),),
}
"""Where the arguments of each function are drawn."""


def measure(settings: Settings) -> dict[str, Any]:
    """Measure every function in turn with that of the machine."""
    rows = []
    for name, ranges in _RANGES.items():
        tell(f"{name}: nanoseconds per call")
        for low, high in ranges:
            draw = partial(random.Random(name).uniform, low, high)
            numbers = [draw() for _ in range(_NUMBERS)]
            rows.append(_row(name, f"{low:g} to {high:g}", numbers, settings))
    return {"functions": rows}


def _row(name: str, between: str, numbers: list[float], settings: Settings) -> dict[str, Any]:
    ours, machine = getattr(elementary, name), _MACHINE.get(name) or getattr(math, name)
    _nanoseconds(ours, numbers, 0.0)  # finds the nodes
    window = settings.window / 100.0
    pairs = [[_nanoseconds(function, numbers, window) for function in (ours, machine)] for _ in range(settings.repeat)]
    summary = {
        "nanoseconds": spread(mine for mine, _ in pairs),
        "machine_nanoseconds": spread(other for _, other in pairs),
        "ratio": spread(mine / other for mine, other in pairs),
    }
    return {"function": name, "between": between, "summary": summary, "repeats": pairs}


def _nanoseconds(function: Function, numbers: list[float], window: float) -> float:
    """Return the time of a call, ns, in the fastest of the passes over the numbers within a window, s."""
    fastest, end = math.inf, time.monotonic() + window
    while True:
        begun = time.perf_counter_ns()
        for x in numbers:
            function(x)
        fastest = min(fastest, (time.perf_counter_ns() - begun) / len(numbers))
        if time.monotonic() >= end:
            return fastest


if __name__ == "__main__":
    sys.exit(program(measure))
