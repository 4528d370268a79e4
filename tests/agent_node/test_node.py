"""The adapter of a robot."""

from __future__ import annotations

from math import inf

import pytest
from tests.swarmabs_ros.nodes import settings_from

from agent_node.node import PARAMETERS, make
from swarmabs_config.graph import LOCKSTEP, ROBOT
from swarmabs_core.behaviours import Agent, AgentConfig, LifeSpan, Limits
from swarmabs_core.errors import InputError
from swarmabs_core.faults import InjectedFault, LieFault, LossFault
from swarmabs_core.membership import ChangeKind
from swarmabs_core.messages import AGENT_STATE, BROADCASTS, EVENTS, PLANE_STATE, Kind
from swarmabs_core.parameters import Value
from swarmabs_core.sensing import RobotSensor
from swarmabs_core.swarm_law import SwarmGains
from swarmabs_ros.status import StatusChannel

CHANNEL = StatusChannel("agent_node")


def test_every_parameter_reaches_the_configuration() -> None:
    settings = settings_from(
        PARAMETERS,
        period_ns=5_000_000,
        last_step=77,
        agent_id=12,
        kind="double_integrator",
        mass=0.7,
        damping=0.8,
        position=-0.2,
        velocity=0.1,
        gravity=1.62,
        plane_length=1.4,
        gains__k=(1.0, 2.0),
        gains__kp=(3.0, 4.0),
        gains__kd=(5.0, 6.0),
        gains__ksd=7.0,
        limits__velocity=8.0,
        limits__force=9.0,
        first_step=3,
        end="freeze",
        end_step=30,
        faults=("loss 0 -1 0.25", "lie 3 9 0.1 1.0 2.0"),
        seed=99,
        feels_gravity=True,
        sensor__noise=(0.1, 0.2),
        sensor__resolution=(0.3, 0.4),
        actuator_lag=0.9,
    )
    assert settings.made(AgentConfig) == AgentConfig(
        agent_id=12,
        kind=Kind.DOUBLE_INTEGRATOR,
        mass=0.7,
        position=-0.2,
        velocity=0.1,
        gains=SwarmGains((1.0, 2.0), (3.0, 4.0), (5.0, 6.0), 7.0),
        period_ns=5_000_000,
        gravity=1.62,
        plane_length=1.4,
        damping=0.8,
        limits=Limits(8.0, 9.0),
        life=LifeSpan(3, ChangeKind.FREEZE, 30),
        faults=(
            InjectedFault(LossFault(probability=0.25)),
            InjectedFault(LieFault(position_offset=0.1, mass_factor=2.0), 3, 9),
        ),
        seed=99,
        feels_gravity=True,
        last_step=77,
        sensor=RobotSensor((0.1, 0.2), (0.3, 0.4)),
        actuator_lag=0.9,
    )


def test_no_limit_and_no_end_by_default() -> None:
    found = settings_from(PARAMETERS).made(AgentConfig)
    assert found.limits == Limits(inf, inf)
    assert found.life == LifeSpan(0, None, None)
    assert found.last_step is None


@pytest.mark.parametrize("values", [{"damping": 0.5}, {"velocity": -0.1}])
def test_a_single_integrator_has_neither_damping_nor_velocity(values: dict[str, Value]) -> None:
    (name,) = values
    with pytest.raises(InputError, match=rf"parameter {name}: a single integrator has none; leave it out"):
        make(settings_from(PARAMETERS, kind="single_integrator", **values), CHANNEL)


@pytest.mark.parametrize("kind", ["single_integrator", "double_integrator"])
def test_it_hears_the_three_broadcasts_and_nothing_else(kind: str) -> None:
    settings = settings_from(PARAMETERS, kind=kind)
    agent = make(settings, CHANNEL).behaviour
    assert isinstance(agent, Agent)
    ends = settings.endpoints(ROBOT, LOCKSTEP)
    assert set(ends.subscriptions) == set(BROADCASTS) == set(agent.needs)
    assert set(ends.publications) == {AGENT_STATE, EVENTS}


@pytest.mark.parametrize(("kind", "extra"), [("single_integrator", set()), ("double_integrator", {PLANE_STATE})])
def test_only_a_body_that_feels_its_tilt_reads_its_own_sensor(kind: str, extra: set[object]) -> None:
    settings = settings_from(PARAMETERS, kind=kind, feels_gravity=True)
    agent = make(settings, CHANNEL).behaviour
    assert isinstance(agent, Agent)
    assert set(settings.endpoints(ROBOT, LOCKSTEP).subscriptions) == {*BROADCASTS, *extra} == set(agent.needs)
