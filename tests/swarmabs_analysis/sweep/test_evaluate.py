"""One case: what its row says of a run that settles, does not, loses a robot, fails, or is no valid scenario."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from swarmabs_analysis.sweep import evaluate as module
from swarmabs_analysis.sweep.evaluate import LONGEST_REASON, Task, evaluate, lost
from swarmabs_bag.recording import Digest
from swarmabs_config.scenario import parse_scenario
from swarmabs_config.scenarios import builtin_scenarios
from swarmabs_run.simulation import Simulation, simulate

TEXT = builtin_scenarios()["pd_het_4"].read_text()


def row(*overrides: str) -> Any:
    line = evaluate(Task(TEXT, 5, overrides, 0.2))
    assert "\n" not in line
    return json.loads(line)


def test_row_of_a_run_that_ends_well() -> None:
    scenario = parse_scenario(TEXT, overrides=["duration=5"])
    digest = Digest()
    for step in Simulation(scenario).steps():
        digest.update(step)
    run = simulate(scenario)
    found = row("duration=5")
    assert found == {
        "case": 5,
        "status": "ok",
        "outcome": "settled",
        "reason": None,
        "digest": digest.hexdigest(),
        "settled_at": 4.06,
        "final_error": -run.angle[-1],
        "rms_error": pytest.approx(float((run.angle**2).mean() ** 0.5), rel=1e-12),
        "max_abs_position": float(np.max(np.abs(run.agents.position))),
        "max_abs_angle": 0.1,
        "messages": 8 * 501,
        "initial_error_squared": pytest.approx(0.01233, abs=1e-5),
        "in_printed_estimate": True,
        "in_corrected_estimate": True,
    }


def test_row_of_a_run_that_is_too_short() -> None:
    found = row("duration=1")
    assert (found["outcome"], found["settled_at"]) == ("unsettled", None)


def test_row_of_a_run_in_which_a_robot_leaves_the_plane() -> None:
    found = row("duration=5", "plane.angular_velocity=2")
    assert (found["status"], found["outcome"]) == ("ok", "off_plane")
    assert found["max_abs_position"] > 0.5
    assert found["in_corrected_estimate"] is False


def test_row_of_a_run_that_fails_has_the_figures_up_to_there() -> None:
    found = row("plane.angular_velocity=40")
    assert (found["status"], found["outcome"]) == ("failed", "failed")
    assert "the plane's angle is" in found["reason"]
    assert 0.1 < found["max_abs_angle"] < 1.5
    assert found["digest"] and found["messages"] > 0


def test_row_of_an_invalid_scenario() -> None:
    found = row("plane.angle=7")
    assert found["reason"].startswith("--set plane.angle=7: plane.angle: 7 is out of range")
    assert {key: found[key] for key in ("case", "status", "outcome")} == {
        "case": 5,
        "status": "refused",
        "outcome": "refused",
    }
    assert len(found) == 4


def test_no_estimates_without_state_feedback() -> None:
    assert "in_printed_estimate" not in row("controller={type: arise}", "duration=0.1")


def test_bug_that_a_case_shows_does_not_end_the_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: object) -> None:
        raise ZeroDivisionError("x" * 1000)

    monkeypatch.setattr(module, "simulated_steps", broken)
    found = row()
    assert (found["status"], found["digest"]) == ("failed", None)
    assert found["reason"].startswith("ZeroDivisionError: xxx")
    assert len(found["reason"]) == LONGEST_REASON


def test_row_of_a_case_that_kills_its_workers() -> None:
    assert json.loads(lost(3, "why")) == {"case": 3, "status": "failed", "outcome": "failed", "reason": "why"}
