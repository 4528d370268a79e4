"""Node ``agent_node``: one robot; the three broadcasts in, its own state out."""

from __future__ import annotations

import sys
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

from swarmabs_config.configure import KINDS
from swarmabs_config.graph import ROBOT
from swarmabs_core.behaviours import AgentConfig, LifeSpan, Limits, Listener, Unpacking, make_newcomer
from swarmabs_core.errors import InputError
from swarmabs_core.faults import RobotFault
from swarmabs_core.law_registry import LAWS, PAPER
from swarmabs_core.membership import ChangeKind
from swarmabs_core.messages import Kind
from swarmabs_core.parameters import Parameter
from swarmabs_core.sensing import Sensor
from swarmabs_core.swarm_law import SwarmGains
from swarmabs_ros.parameters import given_values
from swarmabs_ros.runner import GRAVITY, PACKED, STEERED, NodeSpec, Settings, run_node
from swarmabs_ros.status import StatusChannel

if TYPE_CHECKING:
    from rclpy.node import Node

LAW = Parameter("law.type", PAPER.name, "law of the swarm", choices=tuple(LAWS.built_in))
PARAMETERS = (
    Parameter("agent_id", 1, "id of the robot", minimum=1, maximum=65535),
    Parameter("kind", "single_integrator", "dynamics of the robot", choices=tuple(KINDS)),
    Parameter("mass", 0.5, "mass, kg", above=0.0),
    Parameter("damping", 0.0, "damping of a double integrator, N s/m", minimum=0.0),
    Parameter("position", 0.0, "initial position, m"),
    Parameter("velocity", 0.0, "initial velocity of a double integrator, m/s"),
    GRAVITY,
    Parameter("plane_length", 1.0, "length of the plane, m", above=0.0),
    Parameter("gains.k", (10.0, 10.0), "gains of the single integrators' law, 1/s", above=0.0, length=2),
    Parameter("gains.kp", (10.0, 10.0), "position gains of the double integrators' law, 1/s^2", above=0.0, length=2),
    Parameter("gains.kd", (5.0, 5.0), "velocity gains of the double integrators' law, 1/s", above=0.0, length=2),
    Parameter("gains.ksd", 1.0, "damping that the double integrators' law adds, N s/m", minimum=0.0),
    Parameter("limits.velocity", 0.0, "largest speed, m/s; 0: no limit", minimum=0.0),
    Parameter("limits.force", 0.0, "largest force, N; 0: no limit", minimum=0.0),
    Parameter("first_step", 0, "step at which the robot joins", minimum=0),
    Parameter("end", "none", "how the robot ends by plan", choices=("none", "kill", "freeze", "leave", "remove")),
    Parameter("end_step", 0, "step of the planned end", minimum=0),
    Parameter("faults", (), "injected faults, each 'KIND FIRST END VALUE...', such as 'loss 0 -1 0.2'"),
    Parameter("seed", 1, "seed of what is drawn of the faults and of the sensor's noise", minimum=0),
    Parameter("feels_gravity", default=False, description="whether the plane's tilt acts on a double integrator"),
    PACKED,
    STEERED,
    LAW,
    Parameter(
        "sensor.noise",
        (0.0, 0.0),
        "standard deviations of white noise on its own position, m, and velocity, m/s",
        minimum=0.0,
        length=2,
    ),
    Parameter(
        "sensor.resolution",
        (0.0, 0.0),
        "steps to which its own position, m, and velocity, m/s, are rounded; 0: none",
        minimum=0.0,
        length=2,
    ),
    Parameter("actuator_lag", 0.0, "time constant with which the drive follows the command, s", minimum=0.0),
)


def with_law(node: Node, parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """Return a node's parameters, among them those of the law that is asked for."""
    law = LAWS.find(str(given_values(node).get(LAW.name, LAW.default)))
    chosen = replace(LAW, choices=tuple(dict.fromkeys((*LAWS.built_in, law.name))))
    own = (chosen if parameter is LAW else parameter for parameter in parameters)
    return (*own, *(replace(setting, name=f"law.{setting.name}") for setting in law.settings))


def table(node: Node) -> tuple[Parameter, ...]:
    """Return the node's parameters."""
    return with_law(node, PARAMETERS)


def kind_of(settings: Settings) -> Kind:
    """Return the robot's dynamics.

    Raises
    ------
    InputError
        If parameters contradict it.
    """
    kind = KINDS[settings.text("kind")]
    if kind is Kind.SINGLE_INTEGRATOR and (settings.number("damping") or settings.number("velocity")):
        raise InputError("parameters damping and velocity: a single integrator has neither; leave them out")
    return kind


def gains_of(settings: Settings) -> SwarmGains:
    """Return the gains of the swarm's law."""
    k, kp, kd = (settings.pair(f"gains.{name}") for name in ("k", "kp", "kd"))
    return SwarmGains(k, kp, kd, settings.number("gains.ksd"))


def config(settings: Settings) -> AgentConfig:
    """Return the behaviour's configuration.

    Raises
    ------
    InputError
        If parameters contradict each other.
    """
    end = settings.text("end")
    law = settings.within("law.")
    return AgentConfig(
        agent_id=settings.integer("agent_id"),
        kind=kind_of(settings),
        mass=settings.number("mass"),
        position=settings.number("position"),
        velocity=settings.number("velocity"),
        gains=gains_of(settings),
        period_ns=settings.integer("period_ns"),
        gravity=settings.number("gravity"),
        plane_length=settings.number("plane_length"),
        damping=settings.number("damping"),
        limits=Limits(settings.number("limits.velocity") or inf, settings.number("limits.force") or inf),
        life=LifeSpan(
            settings.integer("first_step"),
            None if end == "none" else ChangeKind(end),
            None if end == "none" else settings.integer("end_step"),
        ),
        faults=tuple(map(RobotFault.parse, settings.texts("faults"))),
        seed=settings.integer("seed"),
        feels_gravity=settings.flag("feels_gravity"),
        law=str(law.pop("type")),
        law_settings=law,
        last_step=settings.last_step(),
        sensor=Sensor(settings.pair("sensor.noise"), settings.pair("sensor.resolution")),
        actuator_lag=settings.number("actuator_lag"),
    )


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour."""
    agent: Listener = make_newcomer(config(settings), steered=settings.flag(STEERED.name))
    if settings.flag(PACKED.name):
        agent = Unpacking(agent)
    return NodeSpec(agent)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(ROBOT, table, make, args)


if __name__ == "__main__":
    sys.exit(main())
