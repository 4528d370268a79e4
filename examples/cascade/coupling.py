"""The coupling of two layers: a robot driven by a lower plane, and a plane that follows a robot's command.

It needs no new message. The state of the lower plane goes up; the state of the robot, whose field `command` is the
velocity requested by its law, goes down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_core.behaviours.base import StepAheadError, refuse_conflict
from swarmabs_core.desired_state import CommandFilter
from swarmabs_core.elementary import cos, exp
from swarmabs_core.messages import (
    DESIRED_ABSTRACT_STATE,
    PLANE_STATE,
    AgentState,
    Message,
    Messages,
    PlaneState,
    Topic,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.behaviours import Agent, Behaviour, Controller
    from swarmabs_core.controllers import ParentContext, ParentController


class TiltDrive:
    """Moves a robot at a speed proportional to the tilt of its lower plane: p' = ratio th.

    Between two steps th is the cubic with the plane's angles and rates at both ends; it is integrated exactly.

    Parameters
    ----------
    ratio : float
        Speed by tilt, m/(s rad).
    period : float
        Control period, s.
    angle, angular_velocity : float
        Initial state of the lower plane, rad and rad/s.
    """

    def __init__(self, ratio: float, period: float, angle: float, angular_velocity: float) -> None:
        self._ratio = ratio
        self._period = period
        self._before = self._after = (angle, angular_velocity)

    def hear(self, plane: PlaneState) -> None:
        """Process the state of the lower plane at the end of the period."""
        self._after = (plane.angle, plane.angular_velocity)

    def advance(self, position: float, velocity: float, command: float) -> tuple[float, float]:  # noqa: ARG002
        """Return position (m) and velocity (m/s) at the end of the period; the command acts on the lower plane."""
        (angle, rate), (next_angle, next_rate), dt = self._before, self._after, self._period
        self._before = self._after
        integral = 0.5 * dt * (angle + next_angle) + dt * dt / 12.0 * (rate - next_rate)
        return position + self._ratio * integral, self._ratio * next_angle


class Following:
    """Lets a parent controller that regulates to 0 follow the command of an upper robot.

    The desired tilt, command/ratio, passes three equal lags, 1/(s/bandwidth + 1) each, the last two as one filter whose
    state (r, r') is the reference, so neither r'' nor the torque jumps. The regulator receives the plane's state
    relative to the reference; the inertia and friction torques of the reference motion are fed forward.

    Parameters
    ----------
    regulator : ParentController
        A law that regulates to 0.
    context : ParentContext
        The known properties of the plane.
    ratio : float
        Speed of the upper robot by tilt, m/(s rad).
    bandwidth : float
        Bandwidth of the filter, rad/s.
    angle, angular_velocity : float
        Initial state of the plane and of the reference, rad and rad/s.
    """

    def __init__(
        self,
        regulator: ParentController,
        context: ParentContext,
        ratio: float,
        bandwidth: float,
        angle: float,
        angular_velocity: float,
    ) -> None:
        self._regulator = regulator
        self._context = context
        self._ratio = ratio
        self._decay = exp(-bandwidth * context.period)
        self._filter = CommandFilter(context.period, bandwidth)
        self._desired = self._smoothed = angle
        self._state = (angle, angular_velocity)

    def hear(self, robot: AgentState) -> None:
        """Process the state of the upper robot."""
        self._desired = robot.command / self._ratio

    def reference(self, time: float) -> float:  # noqa: ARG002
        """Return the reference at the next step, rad."""
        return self._state[0]

    def torque(self, time: float, plane: PlaneState) -> float:
        """Return tau_raw, N m, and advance the reference by one period."""
        context, (angle, rate) = self._context, self._state
        self._smoothed = self._desired + self._decay * (self._smoothed - self._desired)
        self._state = self._filter.advance(angle, rate, self._smoothed)
        next_rate = self._state[1]
        inertia = context.inertia + context.manifold.offset
        friction: float = context.friction.torque(0.5 * (rate + next_rate))
        moving = inertia * (next_rate - rate) / context.period + friction
        error = plane._replace(angle=plane.angle - angle, angular_velocity=plane.angular_velocity - rate)
        return self._regulator.torque(time, error) - moving / cos(plane.angle)


@dataclass(frozen=True, slots=True)
class Link:
    """The subscription of a behaviour in the other layer.

    Parameters
    ----------
    topic : Topic
        A topic of the other layer, with its absolute name.
    lead : int
        The step of the required message, relative to the step of the behaviour.
    sender : int, optional
        The robot whose states are required.
    """

    topic: Topic
    lead: int
    sender: int | None = None


class Coupled:
    """A behaviour that finishes a step only with a message of the other layer.

    It withholds one message that the behaviour needs to finish its step until that of the other layer has arrived.

    Parameters
    ----------
    inner : Behaviour
        The behaviour whose steps are coupled.
    gate : Topic
        Topic of the message that is withheld.
    link : Link
        The message that must arrive first.
    hear : callable
        Receives the message of the other layer; called again when it is repeated.
    last_step : int
        Last step of the run; no message of later steps is required.
    """

    def __init__(
        self, inner: Behaviour, gate: Topic, link: Link, hear: Callable[[Message], None], last_step: int
    ) -> None:
        self._inner = inner
        self._gate = gate
        self._link = link
        self._hear = hear
        self._last_step = last_step
        self._heard: Message | None = None
        self._kept: Message | None = None

    def start(self) -> Messages:
        """Return the first messages of the behaviour."""
        return self._inner.start()

    def handle(self, message: Message) -> Messages:
        """Process a message of either layer."""
        if isinstance(message, self._link.topic.message):
            return self._couple(message)
        if isinstance(message, self._gate.message) and message.step == self._step() and not self._coupled():
            if self._kept is not None and self._kept.step == message.step:
                refuse_conflict(self._kept, message, self._gate.name)
            self._kept = message
            return ()
        return self._inner.handle(message)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the other layer first."""
        topics = self._inner.awaits()
        return topics if not topics or self._coupled() else (self._link.topic,)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the messages that it lacks."""
        step, names = self._inner.missing()
        return step, names if self._coupled() else (*names, self._link.topic.name)

    def _step(self) -> int:
        return self._inner.missing()[0]

    def _needed(self) -> int:
        return self._step() + self._link.lead

    def _coupled(self) -> bool:
        needed = self._needed()
        return needed > self._last_step or (self._heard is not None and self._heard.step == needed)

    def _couple(self, message: Message) -> Messages:
        sender, needed = self._link.sender, self._needed()
        if (sender is not None and isinstance(message, AgentState) and message.agent_id != sender) or (
            message.step < needed
        ):
            return ()
        if message.step > needed:
            raise StepAheadError(self._link.topic.name, got=message.step, expected=needed)
        if self._coupled() and self._heard is not None:
            refuse_conflict(self._heard, message, self._link.topic.name)
            return ()
        self._heard = message
        self._hear(message)
        kept, self._kept = self._kept, None
        return self._inner.handle(kept) if kept is not None else ()


def carried(agent: Agent, drive: TiltDrive, plane: Topic, last_step: int) -> Coupled:
    """Return a robot whose drive is a lower plane: to move from step k to k+1 it needs that plane's state k+1.

    Parameters
    ----------
    agent : Agent
        A robot with this drive.
    drive : TiltDrive
        Its drive.
    plane : Topic
        The state of the lower plane.
    last_step : int
        Last step of the run.
    """

    def hear(message: Message) -> None:
        assert isinstance(message, PlaneState)  # noqa: S101 - the message of the topic
        drive.hear(message)

    return Coupled(agent, DESIRED_ABSTRACT_STATE, Link(plane, lead=1), hear, last_step)


def led(controller: Controller, law: Following, robots: Topic, robot: int, last_step: int) -> Coupled:
    """Return a controller that follows an upper robot: to answer step k it needs that robot's state k.

    Parameters
    ----------
    controller : Controller
        A controller with this law.
    law : Following
        Its law.
    robots : Topic
        The states of the upper robots.
    robot : int
        Id of the robot to follow.
    last_step : int
        Last step of the run.
    """

    def hear(message: Message) -> None:
        assert isinstance(message, AgentState)  # noqa: S101 - the message of the topic
        law.hear(message)

    return Coupled(controller, PLANE_STATE, Link(robots, lead=0, sender=robot), hear, last_step)
