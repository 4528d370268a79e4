"""A robot whose sensors err and whose drive lags."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.behaviours.agent import Agent
from swarmabs_core.behaviours.faulty import with_faults
from swarmabs_core.drive import Lag
from swarmabs_core.messages import Kind

if TYPE_CHECKING:
    from swarmabs_core.behaviours.agent import AgentConfig
    from swarmabs_core.behaviours.packing import Listener
    from swarmabs_core.messages import Message, Messages


class ImperfectAgent(Agent):
    """A robot that decides by what it measures and moves as its drive lets it; its state is the truth."""

    def __init__(self, config: AgentConfig) -> None:
        super().__init__(config)
        self._sensor = config.sensor
        self._lag: Lag | None = None
        self._actual = 0.0
        if config.actuator_lag:
            period = config.period_ns / 1e9
            self._lag = (
                Lag.of_velocity(config.actuator_lag, period)
                if config.kind is Kind.SINGLE_INTEGRATOR
                else Lag.of_force(config.actuator_lag, period, config.mass, config.damping)
            )

    def _decide(self) -> Messages:
        """Decide by the measured position and velocity."""
        true = self._position, self._velocity
        draw = f"{self._config.seed}:{self._step}:{self._config.agent_id}"
        self._position, self._velocity = self._sensor.measure(*true, draw)
        events = super()._decide()
        self._position, self._velocity = true
        return events

    def _move(self, plane: Message | None) -> None:
        """Move as without lag, and add what the drive's lag makes of it."""
        super()._move(plane)
        if self._lag is not None:
            gap = self._actual - self._command
            self._position += self._lag.gap_to_position * gap
            self._velocity += self._lag.gap_to_velocity * gap
            self._actual = self._command + self._lag.decay * gap


def make_agent(config: AgentConfig) -> Listener:
    """Return the state machine of a robot: the plain one if it is perfect and nothing is injected."""
    imperfect = config.actuator_lag or not config.sensor.perfect
    robot = ImperfectAgent(config) if imperfect else Agent(config)
    return with_faults(robot, config)
