"""What several test modules use: built-in scenarios, runs taken apart, derivatives by Cauchy's integral."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from swarmabs_bag.recording import Digest
from swarmabs_config.scenario import load_scenario
from swarmabs_core.messages import (
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    Kind,
    Message,
    Mode,
    Status,
    SwarmEvent,
)
from swarmabs_run.simulation import Simulation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from swarmabs_bag.recording import RecordedStep
    from swarmabs_config.scenario import Scenario

    Array = NDArray[np.float64]

SCENARIOS = Path(__file__).parents[2] / "src" / "swarmabs_bringup" / "scenarios"
FOUR_ROBOT_SCENARIOS = ("pd_si_4", "pd_di_4", "pd_het_4", "arise_si_4", "arise_di_4", "arise_het_4")
PERIOD_NS = 10_000_000

M = TypeVar("M", bound=Message)


def builtin(name: str, *overrides: str) -> Scenario:
    """Load a built-in scenario with overrides as of ``--set``."""
    return load_scenario(SCENARIOS / f"{name}.yaml", overrides)


class Run:
    """All messages of a simulated scenario, by class, step and robot."""

    def __init__(self, scenario: Scenario) -> None:
        self.steps: list[RecordedStep] = list(Simulation(scenario).steps())

    def of(self, kind: type[M]) -> list[M]:
        return [r.message for step in self.steps for r in step.records if isinstance(r.message, kind)]

    def column(self, kind: type[Message], field: str) -> Array:
        return np.array([getattr(message, field) for message in self.of(kind)])

    def agent(self, agent_id: int) -> dict[int, AgentState]:
        """Return a robot's states by step."""
        return {state.step: state for state in self.of(AgentState) if state.agent_id == agent_id}

    def states(self, step: int) -> list[AgentState]:
        return [r.message for r in self.steps[step].records if isinstance(r.message, AgentState)]

    def one(self, kind: type[M], step: int) -> M:
        (message,) = [r.message for r in self.steps[step].records if isinstance(r.message, kind)]
        return message

    def events(self) -> list[SwarmEvent]:
        return self.of(SwarmEvent)

    def digest(self) -> str:
        return digest(self.steps)


def digest(steps: Iterable[RecordedStep]) -> str:
    total = Digest()
    for step in steps:
        total.update(step)
    return total.hexdigest()


def agent_state(
    agent_id: int,
    step: int = 0,
    *,
    kind: int = Kind.SINGLE_INTEGRATOR,
    status: int = Status.ACTIVE,
    mass: float = 0.5,
    damping: float = 0.0,
    position: float | None = None,
    velocity: float = 0.0,
) -> AgentState:
    """Return a robot's state; by default robots stand on alternating sides of the axis."""
    if position is None:
        position = 0.1 if agent_id % 2 else -0.1
    return AgentState(step * PERIOD_NS, step, step, agent_id, kind, status, mass, damping, position, velocity, 0.0)


def broadcasts(
    step: int = 0, *, torque: float = 0.1, s3: float = 0.01, mode: int = Mode.RUN, desired: float = 0.2
) -> tuple[AbstractState, AuxiliaryState, DesiredAbstractState]:
    """Return a complete set of plausible broadcasts of one step."""
    stamp = step * PERIOD_NS
    return (
        AbstractState(stamp, step, 4, torque, 0.03, 0.01, 0.002),
        AuxiliaryState(stamp, step, 0.9, 0.02, 0.012, s3, 2.0, 0.01, 0.03, 0.001),
        DesiredAbstractState(stamp, step, mode, desired, 0.026, 0.02, 0.001, 0.03, 0.002, 0.04, 0.003),
    )


def taylor(function: Callable[[complex], complex], at: float, order: int, radius: float = 0.2) -> list[float]:
    """Return a real analytic function and its derivatives up to an order, by Cauchy's integral formula."""
    count = 64
    points = radius * np.exp(2j * np.pi * np.arange(count) / count)
    coefficients = np.fft.fft([function(at + z) for z in points]) / count
    return [float((coefficients[n] / radius**n).real) * math.factorial(n) for n in range(order + 1)]
