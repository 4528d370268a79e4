"""What several test modules use: built-in scenarios, runs taken apart, derivatives by Cauchy's integral."""

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from swarmabs_bag.run.digest import Digest
from swarmabs_bag.run.step import Step
from swarmabs_config.scenario import Scenario, load_scenario
from swarmabs_core import messages as msg
from swarmabs_run.simulation import Simulation

Array = NDArray[np.float64]

SCENARIOS = Path(__file__).parents[2] / "src" / "swarmabs_bringup" / "scenarios"
FOUR_ROBOT_SCENARIOS = ("pd_si_4", "pd_di_4", "pd_het_4", "arise_si_4", "arise_di_4", "arise_het_4")
PERIOD_NS = 10_000_000

M = TypeVar("M", bound=msg.Message)


def builtin(name: str, *overrides: str) -> Scenario:
    return load_scenario(SCENARIOS / f"{name}.yaml", overrides)


class Run:
    """All messages of a simulated scenario, by class, step and robot."""

    def __init__(self, scenario: Scenario) -> None:
        self.steps: list[Step] = singly(Simulation(scenario).steps())
        self._messages = [[record.message for record in step.records] for step in self.steps]

    def of(self, kind: type[M]) -> list[M]:
        return [message for messages in self._messages for message in messages if isinstance(message, kind)]

    def column(self, kind: type[msg.Message], field: str) -> Array:
        return np.array([getattr(message, field) for message in self.of(kind)])

    def agent(self, agent_id: int) -> dict[int, msg.AgentState]:
        """Return a robot's states by step."""
        return {state.step: state for state in self.of(msg.AgentState) if state.agent_id == agent_id}

    def states(self, step: int) -> list[msg.AgentState]:
        return [message for message in self._messages[step] if isinstance(message, msg.AgentState)]

    def one(self, kind: type[M], step: int) -> M:
        (message,) = [message for message in self._messages[step] if isinstance(message, kind)]
        return message

    def events(self) -> list[msg.SwarmEvent]:
        return self.of(msg.SwarmEvent)

    def digest(self) -> str:
        return digest(self.steps)


def singly(steps: Iterable[Step]) -> list[Step]:
    """Return steps one by one."""
    return [single for step in steps for single in step.singly()]


def together(steps: list[Step], sizes: Iterable[int]) -> Iterator[Step]:
    """Yield single steps, so many at once as far as they are of the same robots, and only the last has events."""
    for size in sizes:
        most, steps = steps[:size], steps[size:]
        while most:
            joined, *most = most
            while most and not joined.told and joined.step + 1 == most[0].step and joined.alike(most[0]):
                joined = joined.joined(most.pop(0))
            yield joined


def digest(steps: Iterable[Step]) -> str:
    total = Digest()
    for step in steps:
        total.update(step)
    return total.hexdigest()


def agent_state(agent_id: int, step: int = 0, **changes: Any) -> msg.AgentState:
    """Return a robot's state; by default robots of 0.5 kg rest on alternating sides of the axis."""
    position = 0.1 if agent_id % 2 else -0.1
    head = (step * PERIOD_NS, step, step, agent_id, msg.Kind.SINGLE_INTEGRATOR, msg.Status.ACTIVE)
    return msg.AgentState(*head, 0.5, 0.0, position, 0.0, 0.0)._replace(**changes)


def broadcasts(
    step: int = 0, *, torque: float = 0.1, s3: float = 0.01, mode: int = msg.Mode.RUN, desired: float = 0.2
) -> tuple[msg.AbstractState, msg.AuxiliaryState, msg.DesiredAbstractState]:
    """Return a complete set of plausible broadcasts of one step."""
    stamp = step * PERIOD_NS
    return (
        msg.AbstractState(stamp, step, 4, torque, 0.03, 0.01, 0.002),
        msg.AuxiliaryState(stamp, step, 0.9, 0.02, 0.012, s3, 2.0, 0.01, 0.03, 0.001),
        msg.DesiredAbstractState(stamp, step, mode, desired, 0.026, 0.02, 0.001, 0.03, 0.002, 0.04, 0.003),
    )


def taylor(function: Callable[[complex], complex], at: float, order: int, radius: float = 0.2) -> list[float]:
    """Return a real analytic function and its derivatives up to an order, by Cauchy's integral formula."""
    count = 64
    points = radius * np.exp(2j * np.pi * np.arange(count) / count)
    coefficients = np.fft.fft([function(at + z) for z in points]) / count
    return [float((coefficients[n] / radius**n).real) * math.factorial(n) for n in range(order + 1)]
