"""Robots on parent systems, as a scenario gives them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from tests.swarmabs_core.helpers import Array

from swarmabs_core.messages import Kind, Mode, RobotState, SwarmBroadcast, SwarmDesired
from swarmabs_core.systems.check import initial_states
from swarmabs_core.systems.interface import NamedSystem
from swarmabs_core.systems.law import RobotLaw, SystemGains
from swarmabs_core.systems.swarm import observed

PERIOD = 0.01


@dataclass(frozen=True)
class Robot:
    id: int
    coordinates: tuple[float, ...]
    constants: dict[str, float] = field(default_factory=lambda: {"mass": 0.5})
    kind: str = "single_integrator"
    velocities: tuple[float, ...] = ()


def robots(
    *coordinates: Sequence[float], masses: Sequence[float] = (0.3, 0.5, 0.7), kind: str = "single_integrator"
) -> list[Robot]:
    """Return robots with the given coordinates; their masses repeat."""
    return [Robot(n + 1, tuple(q), {"mass": masses[n % len(masses)]}, kind=kind) for n, q in enumerate(coordinates)]


def rotors(*places: float) -> list[Robot]:
    """Return rotors with lags on a lift."""
    return [
        Robot(n + 1, (1.0 + 0.1 * n,), {"place": place, "time_constant": 0.03 + 0.01 * n}, kind="first_order_lag")
        for n, place in enumerate(places)
    ]


def random_states(system: NamedSystem, count: int, kind: str, seed: int = 1) -> list[RobotState]:
    """Return moving robots at random coordinates."""
    draw = np.random.default_rng(seed)
    d = len(system.instance.robot)
    names = [row.name for row in system.instance.constants]
    given = [
        Robot(
            n + 1,
            tuple(draw.uniform(-0.4, 0.4, d).tolist()),
            {name: draw.uniform(0.2, 0.9) for name in names},
            kind,
            tuple(draw.uniform(-0.5, 0.5, d).tolist()),
        )
        for n in range(count)
    ]
    return initial_states(system, given)


def desired(system: NamedSystem, seed: int = 2, step: int = 0) -> SwarmDesired:
    """Return a random request."""
    draw = np.random.default_rng(seed)
    vectors = [tuple(draw.normal(0.0, 0.3, len(system.instance.abstract)).tolist()) for _ in range(5)]
    return SwarmDesired(step * 10_000_000, step, system.hash, Mode.RUN, *vectors)


def heard(system: NamedSystem, states: Sequence[RobotState], seed: int = 2) -> SwarmBroadcast:
    """Return the broadcasts of a swarm with a random request."""
    return SwarmBroadcast(0, 0, *observed(system, 0, 0, states, curvature=True), desired(system, seed))


def law(system: NamedSystem, state: RobotState, gains: SystemGains, **options: Any) -> RobotLaw:
    return RobotLaw(system, Kind(state.kind), state.constants, gains, PERIOD, **options)


def rates(
    system: NamedSystem, states: Sequence[RobotState], broadcast: SwarmBroadcast, gains: SystemGains, **options: Any
) -> Array:
    """Return what the laws of all robots prescribe, (N, d)."""
    found = [law(system, s, gains, **options).rate(s.coordinates, s.velocities, broadcast) for s in states]
    assert None not in found
    return np.array(found)


def jacobians(system: NamedSystem, states: Sequence[RobotState]) -> Array:
    """Return the Jacobians of all robots, (N, k, d)."""
    return np.array([system.instance.jacobian(s.coordinates, s.constants) for s in states])


def weights(system: NamedSystem, states: Sequence[RobotState]) -> Array:
    return np.array([system.instance.weight(s.constants) for s in states])
