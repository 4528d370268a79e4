"""Verification of bags of real runs: right ones, and one in which a robot's process has parameters of its own."""

from __future__ import annotations

import json
import signal
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.processes import until
from tests.system.helpers import (
    lockstep,
    seconds,
    signal_process,
    started_swarm,
    summary_of,
    swarm,
    until_stepping,
)

from swarmabs_bag.reader import open_bag
from swarmabs_core.messages import EVENTS
from swarmabs_run.orchestration.plan import ProcessPlan

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]
FAULTS = (
    *("at: 0.2, kind: join, agent: 4", "at: 0.4, kind: kill, agent: 1", "at: 0.8, kind: leave, agent: 4"),
    *("kind: loss, probability: 0.1", "kind: delay, steps: 1"),
)
WORLD = (
    f"faults=[{', '.join('{' + fault + '}' for fault in FAULTS)}]",
    "swarm.sensor.noise=[1.0e-4, 1.0e-3]",
    "plane.sensor.noise=[1.0e-4, 1.0e-3]",
)


def verified(folder: Path, code: int) -> dict[str, Any]:
    done = swarm("verify", folder, "--json")
    assert done.code == code, done.err
    found = json.loads(done.out)
    assert isinstance(found, dict)
    return found


def test_a_run_with_faults_is_right(folder: Path) -> None:
    outcome = lockstep(folder, "pd_het_4", seconds(1.5), *WORLD)
    found = verified(folder, 0)
    assert found["complete"]
    assert found["digest"] == outcome.figures["digest"]
    assert found["messages"] == outcome.figures["messages"]


def test_a_robot_with_another_law_is_named(folder: Path) -> None:
    def arrange(plans: Sequence[ProcessPlan]) -> list[ProcessPlan]:
        """Let robot 3 follow a gain of its own."""
        return [
            replace(plan, parameters={**plan.parameters, "gains.kp": (10.0, 10.001)})
            if plan.name == "agent_003"
            else plan
            for plan in plans
        ]

    assert lockstep(folder, "pd_het_4", seconds(0.5), arrange=arrange).status == "ok"
    difference = verified(folder, 1)["first_difference"]
    assert [difference[key] for key in ("topic", "step", "agent", "field")] == ["swarm/agent_state", 1, 3, "command"]


def test_a_robot_that_was_dropped_and_an_interrupted_run_are_understood(folder: Path, mark: str) -> None:
    drop = "lockstep={on_stall: drop, stall_timeout: 0.5}"
    words = ("run", "pd_het_4", "--set", drop, "--duration", 3000, "-o", folder, "--json")
    with started_swarm(*words) as command:
        until_stepping(folder)
        signal_process(mark, "agent_003", signal.SIGSTOP)
        until(lambda: list(open_bag(folder, damaged=True).messages((EVENTS,))), "the robot is dropped, and recorded so")
        command.process.send_signal(signal.SIGINT)
        done = command.wait()
    assert done.code == 1
    found = verified(folder, 0)
    assert (found["ok"], found["complete"]) == (True, False)
    assert found["digest"] == summary_of(folder)["digest"]
    assert found["ended_early"]
