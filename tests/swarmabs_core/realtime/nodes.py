"""Single nodes in real time, their clock, and messages for them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.swarmabs_core.helpers import SCENARIOS

from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_config.scenario import load_scenario
from swarmabs_core.abstraction import Weight, abstraction, damping_sums, second_moments
from swarmabs_core.messages import (
    NEVER,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    Mode,
    SwarmEvent,
)
from swarmabs_core.realtime.agent import RealtimeAgent
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_core.realtime.drives import Measurement
from swarmabs_core.realtime.observer import RealtimeObserver

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Message

PERIOD = 10_000_000
EPOCH = 1_000_000_000
CLOCK = Schedule(PERIOD, EPOCH)


def scenario(*overrides: str) -> Scenario:
    return load_scenario(SCENARIOS / "pd_het_4.yaml", overrides).resolved()


class Body:
    """A drive of which a test says what it measures."""

    def __init__(self, position: float = 0.1, velocity: float = 0.0) -> None:
        self.position, self.velocity = position, velocity
        self.stamp: int | None = None
        self.blind = False
        self.commands: list[float] = []
        self.stops = 0

    def read(self, now: int) -> Measurement | None:
        return None if self.blind else Measurement(self.stamp or now, self.position, self.velocity)

    def write(self, command: float, now: int) -> None:
        self.commands.append(command)

    def stop(self) -> None:
        self.stops += 1


def robot(body: Body, agent_id: int = 3) -> RealtimeAgent:
    """Return robot 3 of the scenario, a double integrator."""
    config = next(c for c in configure.agent_configs(scenario(), CLOCK) if c.agent_id == agent_id)
    return RealtimeAgent(config, body)


def broadcasts(step: int, mode: Mode = Mode.RUN, torque: float = 0.5) -> tuple[Message, ...]:
    robots = [(0.5, 0.1), (0.5, -0.1), (0.6762, 0.1)]
    weights = [Weight(m, p, 0.0) for m, p in robots]
    *sums, q = abstraction(weights, 9.81)
    spread = second_moments(robots)
    damping = damping_sums([(0.6762, 0.1, 0.65)], 1.0)
    return (
        AbstractState(0, step, 3, *sums),
        AuxiliaryState(0, step, *spread, *damping, q),
        DesiredAbstractState(0, step, mode, torque, 0.03, *(0.0,) * 6),
    )


def at(step: float) -> int:
    return EPOCH + round(step * PERIOD)


def tell(node: RealtimeAgent, messages: Iterable[Message], step: float) -> None:
    for message in messages:
        node.hear(message, at(step))


def state_of(answer: tuple[Message, ...]) -> AgentState:
    (state,) = [m for m in answer if isinstance(m, AgentState)]
    return state


def kinds(answer: tuple[Message, ...]) -> list[int]:
    return [m.kind for m in answer if isinstance(m, SwarmEvent)]


def observer(*overrides: str) -> RealtimeObserver:
    return RealtimeObserver(configure.observer_config(scenario(*overrides), CLOCK))


def states(step: int, **changes: object) -> list[AgentState]:
    return [
        AgentState(0, step, NEVER, i, kind, 1, 0.2 + 0.1 * i, 0.1 * (kind == 2), p, 0.01 * i, 0.0)._replace(**changes)
        for i, kind, p in ((1, 1, 0.1), (2, 1, -0.12), (3, 2, 0.13), (4, 2, -0.1))
    ]


def sums(answer: tuple[Message, ...]) -> tuple[AbstractState, AuxiliaryState]:
    abstract, auxiliary = answer[-2:]
    assert isinstance(abstract, AbstractState)
    assert isinstance(auxiliary, AuxiliaryState)
    return abstract, auxiliary


def controller(mode: Mode = Mode.RUN) -> RealtimeController:
    made = scenario()
    config = configure.controller_config(made, CLOCK, mode)
    node = RealtimeController(config, lambda: lockstep.parent_controller(made))
    node.hear(broadcasts(0)[0], at(0.6))
    return node


def desired(answer: tuple[Message, ...]) -> DesiredAbstractState:
    (found,) = [m for m in answer if isinstance(m, DesiredAbstractState)]
    return found
