"""Steps per second of complete runs and baselines; runs compute and record, with one process per robot."""

from __future__ import annotations

import sys
from dataclasses import asdict
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

from benchmarks.baseline_programs import BARE_RCLPY, BASELINES, measure_baseline
from benchmarks.common import Settings, measure_run, program, spread, tell

from swarmabs_core.errors import RunError

if TYPE_CHECKING:
    from collections.abc import Callable

PRODUCT, PACKED = "product", "packed"
_PART = 0.75
"""Assumed speed of the product relative to the baseline, from which the length of its runs follows."""
_FEWEST_STEPS = 20
ATTEMPTS = 2
"""How often a measurement is tried that fails."""
FAILED = "failed"
"""The reason for which a measurement failed, in place of its numbers."""


def measure(settings: Settings) -> dict[str, Any]:
    """Measure product and baselines in turn, so that changes of the machine affect all of them."""
    rows = []
    for robots in settings.robots:
        repeats = [_repeat(robots, number, settings) for number in range(settings.repeat)]
        rows.append({"robots": robots, "summary": summary(repeats), "repeats": repeats})
    return {"product": rows}


def _repeat(robots: int, number: int, settings: Settings) -> dict[str, Any]:
    results: dict[str, Any] = {}

    def note(name: str, measure: Callable[[], Any]) -> None:
        """Measure twice at most: a machine that is busy for a moment must not cost all other measurements."""
        for attempt in range(ATTEMPTS):
            tell(f"{robots} robots, repeat {number + 1} of {settings.repeat}: {name}")
            try:
                result = measure()
            except RunError as error:
                tell(f"  failed: {error}" + ("; once more" if attempt + 1 < ATTEMPTS else ""))
                results[name] = {FAILED: str(error)}
            else:
                tell(f"  {result.steps_per_second:.1f} steps/s")
                results[name] = asdict(result)
                return

    for name in BASELINES:
        note(name, partial(measure_baseline, name, robots, warm_up=settings.warm_up, window=settings.window))
    fastest = max(results[name].get("steps_per_second", 0.0) for name in BARE_RCLPY)
    steps = max(_FEWEST_STEPS, round(_PART * fastest * (settings.warm_up + settings.window)))
    for name in (PRODUCT, PACKED):
        note(name, partial(measure_run, robots, steps, settings.warm_up, packed=name == PACKED))
    return results


def summary(repeats: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the spreads of speeds and ratios; a ratio compares two measurements of the same repeat.

    Parameters
    ----------
    repeats : list of dict
        Results by name: of each baseline, and of the product without and with packed broadcasts. A measurement that
        failed has `FAILED` instead of numbers.
    """
    names = (*BASELINES, PRODUCT, PACKED)
    speeds = {name: [repeat[name].get("steps_per_second") for repeat in repeats] for name in names}
    known = {name: [speed for speed in values if speed is not None] for name, values in speeds.items()}
    best = max(BARE_RCLPY, key=lambda name: median(known[name] or [0.0]))

    def ratio(baseline: str, product: str = PRODUCT) -> dict[str, float] | None:
        pairs = zip(speeds[product], speeds[baseline], strict=True)
        return spread(mine / other for mine, other in pairs if mine is not None and other is not None)

    return {
        "floor": best,
        "steps_per_second": {name: spread(values) for name, values in known.items()},
        "ratio_to_floor": ratio(best),
        "ratio_to_zeromq": ratio("zeromq"),
        "packed_ratio_to_floor": ratio(best, PACKED),
        "packed_ratio_to_zeromq": ratio("zeromq", PACKED),
    }


if __name__ == "__main__":
    sys.exit(program(measure))
