from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from tests.swarmabs_core.helpers import PERIOD_NS, Run, broadcasts, builtin

from swarmabs_config import configure
from swarmabs_core.behaviours import Agent, AgentConfig, Plane
from swarmabs_core.messages import AgentState, Kind, PlaneState
from swarmabs_core.sensing import Sensor, standard_normal
from swarmabs_core.swarm_law import SwarmGains, double_integrator_command, single_integrator_command

SI, DI = Kind.SINGLE_INTEGRATOR, Kind.DOUBLE_INTEGRATOR
GAINS = SwarmGains((10.0, 9.0), (8.0, 7.0), (5.0, 4.0), 1.0)
MASS, DAMPING, LAG, H = 0.4, 0.7, 0.03, PERIOD_NS / 1e9
kinds = pytest.mark.parametrize("kind", [SI, DI])


def config(kind: Kind, **settings: Any) -> AgentConfig:
    return AgentConfig(
        agent_id=3,
        kind=kind,
        mass=MASS,
        position=0.12,
        velocity=0.05 if kind is DI else 0.0,
        gains=GAINS,
        period_ns=PERIOD_NS,
        gravity=9.81,
        plane_length=1.0,
        damping=DAMPING if kind is DI else 0.0,
        **settings,
    )


def states(agent: Agent, count: int) -> list[AgentState]:
    """Return the states of a robot that hears the same wish for some steps."""
    found = list(agent.start())
    for step in range(count):
        for message in broadcasts(step):
            found.extend(agent.handle(message))
    return [message for message in found if isinstance(message, AgentState)]


@kinds
def test_decides_by_what_it_measures_and_moves_in_truth(kind: Kind) -> None:
    sensor = Sensor((0.02, 0.05), (0.003, 0.0))
    run = states(Agent(config(kind, sensor=sensor, seed=5)), 20)
    for step, (before, after) in enumerate(pairwise(run)):
        position, velocity = sensor.measure(before.position, before.velocity, f"5:{step}:3")
        if kind is SI:
            command = single_integrator_command(MASS, position, GAINS, 9.81, *broadcasts(step))
            moved = before.position + H * command
        else:
            known = (MASS, DAMPING, position, velocity, GAINS, 9.81)
            command = double_integrator_command(*known, *broadcasts(step))
            system = np.array([[0.0, 1.0, 0.0], [0.0, -DAMPING / MASS, 1.0 / MASS], [0.0, 0.0, 0.0]])
            moved = (expm(system * H) @ [before.position, before.velocity, command])[0]
        assert after.command == command
        assert after.position == pytest.approx(moved, rel=1e-12)


@kinds
def test_lag_delays_what_the_drive_does_and_not_what_it_is_told(kind: Kind) -> None:
    run = states(Agent(config(kind, actuator_lag=LAG)), 50)
    if kind is SI:
        system = np.array([[0, 1, 0], [0, -1 / LAG, 1 / LAG], [0, 0, 0]])
        state = np.array([0.12, 0.0])
    else:
        drag = DAMPING / MASS
        system = np.array([[0, 1, 0, 0], [0, -drag, 1 / MASS, 0], [0, 0, -1 / LAG, 1 / LAG], [0, 0, 0, 0]])
        state = np.array([0.12, 0.05, 0.0])
    for step, after in enumerate(run[1:]):
        wish = broadcasts(step)
        if kind is SI:
            command = single_integrator_command(MASS, state[0], GAINS, 9.81, *wish)
        else:
            command = double_integrator_command(MASS, DAMPING, state[0], state[1], GAINS, 9.81, *wish)
        state = (expm(system * H) @ [*state, command])[:-1]
        assert after.command == pytest.approx(command, rel=1e-9)
        assert (after.position, after.velocity) == pytest.approx(tuple(state[:2]), rel=1e-9)


def test_weight_acts_at_once_and_the_command_late() -> None:
    """On a steep plane a robot with a very slow drive slides as if it had none."""
    agent = Agent(config(DI, actuator_lag=1e9, feels_gravity=True))
    agent.start()
    for message in (*broadcasts(0), PlaneState(0, 0, 0.5, 0.0)):
        answer = agent.handle(message)
    system = np.array([[0.0, 1.0, 0.0], [0.0, -DAMPING / MASS, 1.0 / MASS], [0.0, 0.0, 0.0]])
    position, velocity, _ = expm(system * H) @ [0.12, 0.05, -MASS * 9.81 * np.sin(0.5)]
    assert isinstance(answer[0], AgentState)
    assert (answer[0].position, answer[0].velocity) == pytest.approx((position, velocity), rel=1e-7)


def test_noise_of_the_plane_can_be_taken_off_a_recording() -> None:
    """A second plane, that only hears the recorded robots, knows the truth."""
    run = Run(builtin("pd_het_4", "duration=1", "seed=9", "plane.sensor={noise: [0.01, 0.1]}"))
    plane = Plane(configure.plane_config(builtin("pd_het_4", "duration=1")))
    for recorded in run.of(PlaneState):
        (true,) = [answer for state in run.states(recorded.step) for answer in plane.handle(state)]
        assert isinstance(true, PlaneState)
        draw = f"9:{recorded.step}:plane"
        assert recorded.angle == true.angle + 0.01 * standard_normal(f"{draw}:value")
        assert recorded.angular_velocity == true.angular_velocity + 0.1 * standard_normal(f"{draw}:rate")


@pytest.mark.parametrize("name", ["pd_si_4", "pd_di_4"])
def test_a_vanishing_lag_is_none(name: str) -> None:
    sharp, lagging = (Run(builtin(name, "duration=2", f"swarm.actuator_lag={lag}")) for lag in ("0", "1e-7"))
    found, expected = (run.column(PlaneState, "angle") for run in (lagging, sharp))
    assert found == pytest.approx(expected, abs=1e-6)


def test_lag_of_the_swarm_costs_the_plane_little() -> None:
    """The four robots still level the plane with drives three times slower than the control period."""
    run = Run(builtin("pd_het_4", "duration=20", "swarm.actuator_lag=0.03"))
    assert abs(run.of(PlaneState)[-1].angle) < 2e-3
