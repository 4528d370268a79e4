"""Evaluation of one case on a worker: scenario text and overrides in, one line of JSON out."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from swarmabs_bag.run.figures import RunFigures, tracking_of
from swarmabs_config import configure
from swarmabs_config.scenario import parse_scenario
from swarmabs_config.theory import attraction
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.simulation import simulated_steps

if TYPE_CHECKING:
    from swarmabs_config.scenario import Scenario

Row: TypeAlias = "dict[str, float | int | str | bool | None]"
"""Results of a case by name."""
OUTCOMES = ("settled", "unsettled", "off_plane", "failed", "refused")
"""Possible outcomes of a case, from best to worst."""
LONGEST_REASON = 300


class Task(NamedTuple):
    """A case as sent to a worker: the scenario in YAML and its overrides ``a.b=v``."""

    scenario: str
    case: int
    overrides: tuple[str, ...]
    angle_max: float
    """Bound of the angle for the estimates of the region of attraction, rad."""


def evaluate(task: Task) -> str:
    """Run one case and return its row in JSON without line breaks.

    The row holds ``case``, ``status`` (ok, failed, refused), ``reason``, ``outcome``, ``digest`` and the results. A
    case that fails has the figures up to its failure; one with an invalid scenario (``refused``) has none.
    """
    row: Row = {"case": task.case, "status": "ok", "reason": None}
    try:
        scenario = parse_scenario(task.scenario, overrides=task.overrides)
    except InputError as error:
        row.update(status="refused", reason=str(error)[:LONGEST_REASON], outcome="refused")
    else:
        row.update(_run(scenario))
        row.update(_estimates(scenario, task.angle_max))
    return json.dumps(row, allow_nan=False)


def lost(index: int, reason: str) -> str:
    """Return the row of a case that killed every worker that tried it."""
    return json.dumps({"case": index, "status": "failed", "reason": reason, "outcome": "failed"})


def _run(scenario: Scenario) -> Row:
    """Simulate a scenario, and return figures, status and outcome."""
    reason = None
    run = RunFigures(configure.reference(scenario), tracking_of(scenario))
    try:
        for step in simulated_steps(scenario):
            run.add(step)
    except RunError as error:
        reason = str(error)
    except Exception as error:  # noqa: BLE001 - a bug in one case must not end the sweep
        reason = f"{type(error).__name__}: {error}"
    figures = run.figures()
    if reason is not None:
        outcome = "failed"
    elif figures["max_abs_position"] is None or run.strays.all:
        outcome = "off_plane"
    else:
        outcome = "unsettled" if figures["settled_at"] is None else "settled"
    return {
        **figures,
        "max_abs_angle": run.max_abs_shown,
        "digest": run.summary()["digest"],
        "status": "ok" if reason is None else "failed",
        "reason": None if reason is None else reason[:LONGEST_REASON],
        "outcome": outcome,
    }


def _estimates(scenario: Scenario, angle_max: float) -> Row:
    """Return whether the initial state is in the estimates of the region of attraction."""
    region = attraction(scenario, angle_max)
    if region is None:
        return {}
    plane = region.setting.plane
    squared = region.error_squared(plane.angle, plane.angular_velocity)
    return {
        "initial_error_squared": squared,
        "in_printed_estimate": squared <= region.printed,
        "in_corrected_estimate": squared <= region.corrected,
    }
