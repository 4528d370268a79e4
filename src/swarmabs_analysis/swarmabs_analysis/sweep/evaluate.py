"""One case of a sweep, as workers run it: scenario text and overrides in, one line of JSON with plain numbers out."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from swarmabs_bag.figures import RunFigures
from swarmabs_config import configure
from swarmabs_config.scenario import parse_scenario
from swarmabs_config.theory import setting
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.theory.state_feedback import estimate
from swarmabs_run.simulation import simulated_steps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_config.scenario import Scenario

OUTCOMES = ("settled", "unsettled", "off_plane", "failed", "refused")
"""How a case can end, from good to bad."""
LONGEST_REASON = 300


def evaluate(text: str, index: int, overrides: Sequence[str], angle_max: float) -> str:
    """Run one case.

    Parameters
    ----------
    text : str
        The scenario in YAML.
    index : int
        Number of the case.
    overrides : sequence of str
        Overrides ``a.b=v`` of the scenario.
    angle_max : float
        Bound of the angle for the estimates of the region of attraction, rad.

    Returns
    -------
    str
        The row of the case: ``case``, ``status`` (ok, failed, refused), ``reason``, ``outcome``, ``digest`` and the
        results, in JSON without line breaks. A case that fails has the figures up to there; one that is refused
        because its scenario is invalid has none.
    """
    row: dict[str, Any] = {"case": index, "status": "ok", "reason": None}
    try:
        scenario = parse_scenario(text, overrides=overrides)
    except InputError as error:
        row.update(status="refused", reason=str(error), outcome="refused")
    else:
        row.update(_run(scenario))
        row.update(_estimates(scenario, angle_max))
    if row["reason"] is not None:
        row["reason"] = row["reason"][:LONGEST_REASON]
    return json.dumps(row, allow_nan=False)


def lost(index: int, reason: str) -> str:
    """Return the row of a case that no worker has survived."""
    return json.dumps({"case": index, "status": "failed", "reason": reason, "outcome": "failed"})


def _run(scenario: Scenario) -> dict[str, Any]:
    """Simulate, and return figures, status and outcome."""
    status, reason = "ok", None
    run = RunFigures(configure.reference(scenario))
    max_abs_angle: float | None = None
    try:
        for step in simulated_steps(scenario):
            run.add(step)
            if run.latest is not None:
                max_abs_angle = max(max_abs_angle or 0.0, abs(run.latest.angle))
    except RunError as error:
        status, reason = "failed", str(error)
    except Exception as error:  # noqa: BLE001 - a bug that one case shows shall not cost the others
        status, reason = "failed", f"{type(error).__name__}: {error}"
    figures = run.figures()
    reached = figures["max_abs_position"]
    if status != "ok":
        outcome = "failed"
    elif reached is None or reached > 0.5 * scenario.plane.length:
        outcome = "off_plane"
    else:
        outcome = "unsettled" if figures["settled_at"] is None else "settled"
    return {
        **figures,
        "max_abs_angle": max_abs_angle,
        "digest": run.summary()["digest"],
        "status": status,
        "reason": reason,
        "outcome": outcome,
    }


def _estimates(scenario: Scenario, angle_max: float) -> dict[str, Any]:
    """Say whether the initial state is in the estimates of the region of attraction."""
    found = estimate(setting(scenario, angle_max))
    if found is None:
        return {}
    squared = found.error_squared(scenario.plane.angle, scenario.plane.angular_velocity)
    return {
        "initial_error_squared": squared,
        "in_printed_estimate": squared <= found.printed,
        "in_corrected_estimate": squared <= found.corrected,
    }
