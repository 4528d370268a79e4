"""Distributed equals monolithic, bit for bit, over DDS, of which `tests/transport` tries many more."""

import random
import signal
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.system import helpers as runs

from swarmabs_core.messages import EventKind
from swarmabs_run.orchestration.plan import ProcessPlan

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]


def same_as_simulated(
    folder: Path, scenario: str, *overrides: str, coordination: tuple[str, ...] = (), **options: Any
) -> None:
    """Run a scenario as processes, and prove that its digest is that of the simulation and of its bag.

    The simulation has the usual coordination, whatever that of the run.
    """
    outcome = runs.lockstep(folder, scenario, *overrides, *coordination, **options)
    assert outcome.status == "ok", outcome.reason
    assert outcome.figures["digest"] == runs.simulated_digest(scenario, *overrides)
    assert outcome.figures["digest"] == runs.bag_digest(runs.bag_messages(folder))


def shuffled(processes: Sequence[ProcessPlan]) -> Sequence[ProcessPlan]:
    """Start the processes in another order."""
    return random.Random(5).sample(processes, len(processes))


IMPERFECT = (
    *("plane.sensor={noise: [1e-4, 1e-3], resolution: [1e-5, 0]}", "plane.end_stop=0.1005", "swarm.actuator_lag=0.02"),
    *("swarm.sensor={noise: [1e-3, 1e-3]}", "plane.angular_velocity=0.2", "controller.trajectory={type: quintic}"),
    "observer={type: parent_response}",
)


@pytest.mark.parametrize(
    ("scenario", "overrides", "options"),
    [
        pytest.param("arise_het_4", IMPERFECT, {"arrange": shuffled}, id="an imperfect world, in another order"),
        pytest.param("arise_het_200", (), {}, id="200", marks=[pytest.mark.full, pytest.mark.timeout(900)]),
    ],
)
def test_run_is_simulation(folder: Path, scenario: str, overrides: tuple[str, ...], options: dict[str, Any]) -> None:
    same_as_simulated(folder, scenario, runs.seconds(2.0), *overrides, **options)


FAULTS = {
    "at: 0.2, kind: join, agent: 7": (20, 7, EventKind.JOINED),
    "at: 0.4, kind: kill, agent: 1": (41, 1, EventKind.DEAD),
    "at: 0.5, kind: freeze, agent: 2": (51, 2, EventKind.DEAD),
    "at: 0.6, kind: leave, agent: 3": (61, 3, EventKind.LEFT),
    "at: 0.7, kind: remove, agent: 4": (71, 4, EventKind.LEFT),
    "at: 0.3, kind: reference, offset: 0.05": None,
    "at: 0.5, kind: disturbance, torque: -0.2, until: 0.9": None,
    "kind: loss, probability: 0.1": None,
    "kind: delay, steps: 1": None,
    "kind: duplication, probability: 0.2, from: 0.1": None,
    "kind: reordering, probability: 0.1, steps: 2, to: 1": None,
    "kind: clock_offset, agent: 5, offset: 3.5": None,
    "kind: lie, agent: 6, position_factor: 1.1, to: 0.3": None,
}
"""Every kind, with the event that is recorded of those that change the membership."""
SEVEN = ("swarm.agents=null", "swarm.generate={single_integrator: 3, double_integrator: 4}")
NOISE = ("swarm.sensor.noise=[1.0e-4, 1.0e-3]", "plane.sensor.noise=[1.0e-4, 1.0e-3]")


EACH_ROBOT = ("coordination=each_robot", "links={type: random, degree: 4, loss: 0.3, sensing: [5, 6]}")


@pytest.mark.parametrize("options", [{}, {"coordination": EACH_ROBOT, "agents_per_process": 3}], ids=str)
def test_all_kinds_of_faults_together_change_what_was_planned_and_verify(folder: Path, options: dict[str, Any]) -> None:
    planned = f"faults=[{', '.join('{' + fault + '}' for fault in FAULTS)}]"
    swarm = (runs.seconds(1.5), *SEVEN, *NOISE, planned)
    same_as_simulated(folder, "pd_het_4", *swarm, **options)
    membership = {EventKind.JOINED, EventKind.DEAD, EventKind.LEFT}
    recorded = [(event.step, event.agent_id, event.kind) for event in runs.events(folder) if event.kind in membership]
    assert recorded == sorted(filter(None, FAULTS.values()))
    done = runs.swarm("verify", folder, "--json")
    assert (done.code, done.summary()["complete"]) == (0, True), done.out
    assert done.summary()["messages"] == len(runs.bag_messages(folder))


def test_a_dropped_robot_is_verified_and_simulated(folder: Path, tmp_path: Path, mark: str) -> None:
    drop = "lockstep={on_stall: drop, stall_timeout: 0.5}"
    kill = partial(runs.signal_process, mark, "agent_003", signal.SIGKILL)
    outcome = runs.lockstep(folder, "pd_het_4", runs.seconds(10.0), drop, on_progress=runs.at({1: kill}))
    assert outcome.status == "ok", outcome.reason
    ((step, robot),) = {(event.step, event.agent_id) for event in runs.events(folder) if event.kind == EventKind.DEAD}
    messages = runs.bag_messages(folder)
    recorded = Counter(message.agent_id for message in messages if message.topic == "swarm/agent_state")
    assert (robot, recorded) == (3, {1: 1001, 2: 1001, 3: step, 4: 1001})
    assert runs.swarm("verify", folder, "--json").summary()["complete"]
    again = runs.swarm("verify", folder, "--node", "observer", "--node", "agent:3", "--json")
    assert again.summary()["digest"] == outcome.figures["digest"] == runs.bag_digest(messages), again.err
    simulated = runs.swarm("simulate", folder, "-o", tmp_path / "again", "--json")
    assert simulated.summary()["rerun_of"]["same"] is True
    assert "robot 3 fell silent" in simulated.err
