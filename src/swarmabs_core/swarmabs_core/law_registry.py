"""Swarm laws by name: the paper's, and those that installed packages bring.

A law is chosen once for the whole swarm. Each robot binds it to its own constants when it is made; from then on it is a
function of its state and of the broadcasts of one step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from swarmabs_core.messages import AbstractState, AuxiliaryState, DesiredAbstractState, Kind
from swarmabs_core.parameters import Settings
from swarmabs_core.registry import Part, Registry
from swarmabs_core.swarm_law import SwarmGains, double_integrator_command, single_integrator_command

Command: TypeAlias = Callable[[float, float, AbstractState, AuxiliaryState, DesiredAbstractState], float]
"""Position (m), velocity (m/s) and the three broadcasts in, the command (m/s or N, by the robot's kind) out."""


@dataclass(frozen=True, slots=True)
class Robot:
    """What a law may know of its robot, besides position and velocity.

    Parameters
    ----------
    kind : Kind
        How it is driven: the command of a single integrator is a velocity, that of a double integrator a force.
    mass : float
        kg.
    damping : float
        N s/m; 0 of a single integrator.
    gains : SwarmGains
        The swarm's gains; the sums D that are broadcast contain their `ksd`.
    gravity : float
        m/s^2.
    period : float
        Control period for which a command is held, s.
    """

    kind: Kind
    mass: float
    damping: float
    gains: SwarmGains
    gravity: float
    period: float


class SwarmLaw(Part[Robot, Command]):
    """A swarm law, which makes the function of one robot; `name` is the value of ``swarm.law.type`` in a scenario."""


def _make_paper(settings: Settings, robot: Robot) -> Command:  # noqa: ARG001 - its gains are the swarm's
    kind, mass, damping, gains, gravity = robot.kind, robot.mass, robot.damping, robot.gains, robot.gravity

    def single(
        position: float,
        velocity: float,  # noqa: ARG001 - it is the command of the step before
        abstract: AbstractState,
        sums: AuxiliaryState,
        desired: DesiredAbstractState,
    ) -> float:
        return single_integrator_command(mass, position, gains, gravity, abstract, sums, desired)

    def double(
        position: float,
        velocity: float,
        abstract: AbstractState,
        sums: AuxiliaryState,
        desired: DesiredAbstractState,
    ) -> float:
        return double_integrator_command(mass, damping, position, velocity, gains, gravity, abstract, sums, desired)

    return single if kind is Kind.SINGLE_INTEGRATOR else double


PAPER = SwarmLaw("paper", (), _make_paper, "the paper's laws, each robot by its kind")
"""The laws of `swarmabs_core.swarm_law`, each robot by its kind."""

LAWS = Registry("swarm law", "swarmabs.swarm_laws", SwarmLaw, (PAPER,), ("__call__",))
