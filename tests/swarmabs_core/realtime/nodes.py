"""Single nodes in real time, their clock, and messages for them."""

from collections.abc import Iterable

from tests.swarmabs_core.helpers import builtin

from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_config.scenario import Scenario
from swarmabs_core import messages as msg
from swarmabs_core.abstraction import Weight, abstraction, damping_sums, second_moments
from swarmabs_core.realtime.agent import RealtimeAgent
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_core.realtime.drives import Measurement
from swarmabs_core.realtime.observer import RealtimeObserver
from swarmabs_core.realtime.plane import RealtimePlane

PERIOD = 10_000_000
EPOCH = 1_000_000_000
CLOCK = Schedule(PERIOD, EPOCH)


def scenario(*overrides: str) -> Scenario:
    return builtin("pd_het_4", *overrides).resolved()


class Body:
    """A drive of which a test says what it measures."""

    def __init__(self) -> None:
        self.position, self.velocity = 0.1, 0.0
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


def robot(*overrides: str) -> tuple[Body, RealtimeAgent]:
    """Return robot 3 of the scenario, a double integrator, with its body."""
    body = Body()
    config = next(c for c in configure.agent_configs(scenario(*overrides), CLOCK) if c.agent_id == 3)
    return body, RealtimeAgent(config, body)


def broadcasts(step: int, mode: msg.Mode = msg.Mode.RUN, torque: float = 0.5) -> tuple[msg.Message, ...]:
    robots = [(0.5, 0.1), (0.5, -0.1), (0.6762, 0.1)]
    weights = [Weight(m, p, 0.0) for m, p in robots]
    *sums, q = abstraction(weights, 9.81)
    spread = second_moments(robots)
    damping = damping_sums([(0.6762, 0.1, 0.65)], 1.0)
    return (
        msg.AbstractState(0, step, 3, *sums),
        msg.AuxiliaryState(0, step, *spread, *damping, q),
        msg.DesiredAbstractState(0, step, mode, torque, 0.03, *(0.0,) * 6),
    )


def at(step: float) -> int:
    return EPOCH + round(step * PERIOD)


def tell(node: RealtimeAgent, messages: Iterable[msg.Message], step: float) -> None:
    for message in messages:
        node.hear(message, at(step))


def follow(
    node: RealtimeAgent, step: int, mode: msg.Mode = msg.Mode.RUN, torque: float = 0.5
) -> tuple[msg.Message, ...]:
    """Tell a robot the broadcasts of a step, and let the next step begin."""
    tell(node, broadcasts(step, mode, torque), step + 0.6)
    return node.tick(at(step + 1))


def state_of(answer: tuple[msg.Message, ...]) -> msg.AgentState:
    (state,) = [m for m in answer if isinstance(m, msg.AgentState)]
    return state


def kinds(answer: Iterable[msg.Message]) -> list[int]:
    return [m.kind for m in answer if isinstance(m, msg.SwarmEvent)]


def observer(*overrides: str) -> RealtimeObserver:
    return RealtimeObserver(configure.observer_config(scenario(*overrides), CLOCK))


def states(step: int, **changes: object) -> list[msg.AgentState]:
    return [
        msg.AgentState(0, step, msg.NEVER, i, kind, 1, 0.2 + 0.1 * i, 0.1 * (kind == 2), p, 0.01 * i, 0.0)._replace(
            **changes
        )
        for i, kind, p in ((1, 1, 0.1), (2, 1, -0.12), (3, 2, 0.13), (4, 2, -0.1))
    ]


def hear(node: RealtimeObserver | RealtimePlane, heard: Iterable[msg.AgentState], step: int) -> msg.Messages:
    """Let a node hear robots in a step and then tick; return what it says to both."""
    told = [answer for state in heard for answer in node.hear(state, at(step + 0.2))]
    return (*told, *node.tick(at(step + 0.5)))


def sums_in(answer: Iterable[msg.Message]) -> bool:
    return any(isinstance(message, msg.AbstractState) for message in answer)


def sums(answer: tuple[msg.Message, ...]) -> tuple[msg.AbstractState, msg.AuxiliaryState]:
    abstract, auxiliary, divided = answer[-3:]
    assert isinstance(divided, msg.StandingState)
    assert isinstance(abstract, msg.AbstractState)
    assert isinstance(auxiliary, msg.AuxiliaryState)
    return abstract, auxiliary


def controller(mode: msg.Mode = msg.Mode.RUN, overrides: Iterable[str] = ()) -> RealtimeController:
    loaded = scenario(*overrides)
    config = configure.controller_config(loaded, CLOCK, mode)
    node = RealtimeController(config, lambda: lockstep.parent_controller(loaded))
    node.hear(broadcasts(0)[0], at(0.6))
    return node


def desired(answer: tuple[msg.Message, ...]) -> msg.DesiredAbstractState:
    (message,) = [m for m in answer if isinstance(m, msg.DesiredAbstractState)]
    return message
