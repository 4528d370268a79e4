"""Steering of a run: the steering controller, which publishes one order per step, and the nodes that apply it.

No node concerned starts a step before it knows the order for it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple, Protocol

from swarmabs_core.behaviours.base import Behaviour, StepAheadError, UnexpectedMessageError, refuse_conflict
from swarmabs_core.errors import InputError
from swarmabs_core.membership import UNPLANNED, Change, Membership
from swarmabs_core.messages import (
    EVENTS,
    PARENT_STATES,
    PLANE_FAMILY,
    STEERING,
    Action,
    Family,
    RecordingProgress,
    Steering,
    SwarmEvent,
)
from swarmabs_core.steering import STEERER, StepChange, StepSchedule, change_of

if TYPE_CHECKING:
    from swarmabs_core.messages import Message, Messages, Topic

MOST_WAITING = 100
"""Most requests in the queue: each is executed in a separate step."""
OVER = "the run is over"


class Request(NamedTuple):
    """A request from outside: an action, the robot that it concerns (0: none), and its value.

    With `steps`, a disturbance is a push: the value (N m) is added to the disturbance for so many steps.
    """

    action: Action
    agent_id: int = 0
    value: float = 0.0
    steps: int = 0


class Decision(NamedTuple):
    """The result of a request: the first step at which it holds, or the reason for its rejection."""

    number: int
    request: Request
    step: int | None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class SteeringConfig:
    """Configuration of the steering controller, with all scheduled changes.

    The control period is in ns, offsets of the reference are in rad, torques on the plane in N m. `largest_offset` and
    `largest_torque` bound the values of requests; 0 if they are not supported.
    """

    members: tuple[int, ...]
    period_ns: int
    last_step: int
    schedule: tuple[Change, ...] = ()
    offsets: tuple[StepChange, ...] = ()
    torques: tuple[StepChange, ...] = ()
    largest_offset: float = 0.0
    largest_torque: float = 0.0
    family: Family = PLANE_FAMILY


class SteeringController:
    """Publishes orders one step ahead of the plane: it answers the plane's state of a step with the next step's order.

    Every request thus gets the earliest step that no node has started, and each step has at most one order. A push is
    two orders, which change the disturbance and change it back.

    A paused controller holds the next order back, and with it the run, until it is resumed or a request needs the step.
    """

    def __init__(self, config: SteeringConfig) -> None:
        self._config = config
        self._membership = Membership(config.members, config.schedule)
        self._settings = {
            Action.REFERENCE: StepSchedule(config.offsets),
            Action.DISTURBANCE: StepSchedule(config.torques),
        }
        self._last = config.last_step
        self._step = 0
        self._over = False
        self._paused = False
        self._held = False
        self._push_end: tuple[int, int, float] | None = None
        self._number = 0
        self._waiting: deque[tuple[int, Request]] = deque()
        self._decisions: list[Decision] = []

    @property
    def step(self) -> int:
        """The last step with a published order."""
        return self._step

    @property
    def paused(self) -> bool:
        """Whether the run is paused."""
        return self._paused

    @property
    def members(self) -> tuple[int, ...]:
        """Ids of the robots that take part in that step."""
        return self._membership.publishing(self._step)

    @property
    def absent(self) -> tuple[int, ...]:
        """Ids of the robots that may be added."""
        return tuple(i for i in self._config.members if self._membership.span(i).first == UNPLANNED)

    def setting(self, action: Action) -> float:
        """Return the value set in that step: the offset (rad) for `REFERENCE`, the torque (N m) for `DISTURBANCE`."""
        return self._settings[action].at(self._step)

    def ask(self, request: Request) -> int:
        """Take a request; return its number, under which `decisions` reports the result.

        Raises `InputError` if the request is rejected at once.
        """
        if self._over:
            raise InputError(OVER)
        if len(self._waiting) >= MOST_WAITING:
            raise InputError(f"{MOST_WAITING} requests are already waiting", "try again later")
        problem = self._problem(request, self._step + 1)
        if problem:
            raise InputError(problem)
        self._number += 1
        self._waiting.append((self._number, request))
        return self._number

    def pause(self, *, paused: bool) -> None:
        """Pause the run, or resume it; raises `InputError` if it is over."""
        if self._over:
            raise InputError(OVER)
        self._paused = paused

    def release(self) -> Messages:
        """Return the order that was held back, if nothing holds it any more; call it after `ask` and `pause`."""
        if not self._held or self._holds():
            return ()
        self._held = False
        self._step += 1
        return (self._decide(),)

    def decisions(self) -> list[Decision]:
        """Return the results of requests since the last call."""
        decisions, self._decisions = self._decisions, []
        return decisions

    def start(self) -> Messages:
        """Publish an empty order for the first step."""
        return (self._order(0, Request(Action.NONE)),)

    def handle(self, message: Message) -> Messages:
        """Take a state of the plane or an event; return the order of the next step."""
        if isinstance(message, SwarmEvent):
            self._membership.apply(message.kind, message.agent_id, message.step, message.detail)
            return ()
        if not isinstance(message, PARENT_STATES):
            raise UnexpectedMessageError("steering", message)
        if message.step > self._step:
            raise StepAheadError(self._config.family.parent.name, got=message.step, expected=self._step)
        if message.step < self._step or self._over:
            return ()
        if self._step == self._last:
            self._over = True
            self._decisions += [Decision(number, request, None, OVER) for number, request in self._waiting]
            self._waiting.clear()
            return ()
        self._held = True
        return self.release()

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the plane, and for events about robots that have ended."""
        return () if self._over else (EVENTS, self._config.family.parent)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the awaited node."""
        return self._step, (self._config.family.node,)

    def _holds(self) -> bool:
        """Return whether the next order is held back: while paused, a step is taken only for a request."""
        return self._paused and not self._waiting

    def _decide(self) -> Steering:
        """Return the order of the current step."""
        step = self._step
        if self._push_end is not None and self._push_end[0] == step:
            _, number, value = self._push_end
            self._push_end = None
            return self._set(number, Request(Action.DISTURBANCE, value=value))
        while self._waiting and not self._must_wait(self._waiting[0][1]):
            number, request = self._waiting.popleft()
            problem = self._problem(request, step)
            self._decisions.append(Decision(number, request, None if problem else step, problem))
            if not problem:
                return self._carry_out(number, request)
        return self._order(0, Request(Action.NONE))

    def _carry_out(self, number: int, request: Request) -> Steering:
        """Return the order of a granted request."""
        if request.steps:
            before = self.setting(Action.DISTURBANCE)
            self._push_end = self._step + request.steps, number, before
            request = request._replace(value=before + request.value)
        if request.action in self._settings:
            return self._set(number, request)
        order = self._order(number, request)
        change = change_of(order)
        assert change is not None  # noqa: S101 - all other actions change who takes part
        self._membership.plan(change)
        return order

    def _set(self, number: int, request: Request) -> Steering:
        """Return the order that sets a value."""
        self._settings[request.action].set(self._step, request.value)
        return self._order(number, request)

    def _order(self, number: int, request: Request) -> Steering:
        action, agent_id, value, _ = request
        return Steering(self._step * self._config.period_ns, self._step, number, action, agent_id, value)

    def _must_wait(self, request: Request) -> bool:
        """Return whether a request must wait.

        It waits if the scenario sets its value in this step or during the push, and for the end of another push.
        """
        if request.action not in self._settings:
            return False
        if request.action == Action.DISTURBANCE and self._push_end is not None:
            return True
        setting = self._settings[request.action]
        return any(setting.changing(step) is not None for step in range(self._step, self._step + request.steps + 1))

    def _problem(self, request: Request, step: int) -> str:
        """Return why a request cannot take effect at a step; empty if it can."""
        if step > self._last:
            return OVER
        if request.action in (Action.REFERENCE, Action.DISTURBANCE):
            return self._problem_of_value(request)
        agent_id = request.agent_id
        if agent_id not in self._membership:
            return f"there is no robot {agent_id}; the robots are {_listed(self._config.members)}"
        if request.action == Action.ADD:
            if agent_id in self.absent:
                return ""
            absent = self.absent
            others = f"the robots that can be added are {_listed(absent)}" if absent else "no robot can be added"
            return f"robot {agent_id} {self._presence(agent_id, step)}; {others}"
        there = self._membership.publishing(step)
        if agent_id not in there or self._membership.span(agent_id).first >= step:
            return f"robot {agent_id} does not take part in step {step}; those that do are {_listed(there)}"
        # Others may have planned ends, which would leave no robot.
        steps = {step, *(change.step + 1 for change in self._config.schedule if step <= change.step < self._last)}
        alone = [at for at in sorted(steps) if self._membership.publishing(at) == (agent_id,)]
        if alone:
            return f"robot {agent_id} is the last one at step {alone[0]}, and a run needs at least one robot"
        return ""

    def _presence(self, agent_id: int, step: int) -> str:
        """Return why a robot cannot be added at a step."""
        span = self._membership.span(agent_id)
        if span.last is not None and span.last < step:
            why = f" ({span.reason})" if span.reason else ""
            return f"has taken part until step {span.last}{why}, and robots do not return"
        return "takes part already" if span.first < step else f"joins at step {span.first} anyway"

    def _problem_of_value(self, request: Request) -> str:
        config = self._config
        largest, unit, what = (
            (config.largest_offset, "rad", "an offset of the reference")
            if request.action == Action.REFERENCE
            else (config.largest_torque, "N m", "a disturbance")
        )
        if not largest and config.family is not PLANE_FAMILY:
            return f"the parent system does not support {what}"
        if not largest:
            return "the parent controller's law does not support an offset (it has no method offset_torque)"
        if not isfinite(request.value) or abs(request.value) > largest:
            return f"{request.value!r} {unit} is out of range; {what} is at most {largest:g} {unit} in magnitude"
        held = self.setting(Action.DISTURBANCE)
        if request.steps and self._push_end is None and abs(held + request.value) > largest:
            return (
                f"{request.value!r} {unit} and the disturbance of {held!r} {unit} are together out of range; "
                f"{what} is at most {largest:g} {unit} in magnitude"
            )
        return ""


def _listed(ids: tuple[int, ...]) -> str:
    return ", ".join(map(str, ids[:20])) + (" ..." if len(ids) > 20 else "")


class Steerable(Behaviour, Protocol):
    """A behaviour that applies orders."""

    def steer(self, order: Steering) -> None:
        """Apply an order for a step that has not started; orders that do not concern this node are ignored."""
        ...


class Orders:
    """Received orders, put in sequence: an order becomes known when those of all earlier steps are known.

    Attributes
    ----------
    known : int
        The last step up to which all orders are known; -1 for none.
    """

    def __init__(self) -> None:
        self.known = -1
        self._latest: Steering | None = None
        self._early: dict[int, Steering] = {}

    def add(self, order: Steering) -> list[Steering]:
        """Take an order; return the orders that become known.

        Raises
        ------
        ConflictError
            If it differs from a received order of the same step.
        """
        if order.step <= self.known:
            if self._latest is not None and order.step == self.known:
                refuse_conflict(self._latest, order, STEERING.name)
            return []
        refuse_conflict(self._early.setdefault(order.step, order), order, STEERING.name)
        orders = []
        while (latest := self._early.pop(self.known + 1, None)) is not None:
            self.known += 1
            self._latest = latest
            orders.append(latest)
        return orders


class Steered:
    """A node that starts each step with the order for it.

    Messages of a step that arrive before its order are held back. A change therefore takes effect at the step that the
    order names, in every node and regardless of the sequence of arrival.

    Parameters
    ----------
    behaviour : Steerable
        The behaviour of the node.
    ends : bool
        Whether an order may end it. The others do not wait for it from that step on, and may be far ahead of it before
        the order arrives.
    last_step : int, optional
        The last step that has an order: what the node has to say after it needs none.
    """

    def __init__(self, behaviour: Steerable, *, ends: bool = False, last_step: int | None = None) -> None:
        self._behaviour = behaviour
        self._ends = ends
        self._last_step = last_step
        self._orders = Orders()
        self._early: list[Message] = []

    @property
    def open(self) -> bool:
        """Whether the order of the current step is known."""
        return self._behaviour.missing()[0] <= self._ordered

    @property
    def _ordered(self) -> int:
        """The last step that may begin."""
        known = self._orders.known
        return known + 1 if known == self._last_step else known

    def start(self) -> Messages:
        """Start the node."""
        return self._behaviour.start()

    def handle(self, message: Message) -> Messages:
        """Take an order, or pass a message to the node."""
        if isinstance(message, Steering):
            return self._obey(message)
        if message.step <= self._ordered or isinstance(message, (SwarmEvent, RecordingProgress)):
            return self._behaviour.handle(message)
        if message.step > self._ordered + 1:
            if self._ends:
                return ()
            raise StepAheadError(type(message).__name__, got=message.step, expected=self._ordered + 1)
        self._early.append(message)
        return ()

    def _obey(self, order: Steering) -> Messages:
        answers: Messages = ()
        if order.step > self._orders.known + 2:  # orders are at most one step ahead, even if one was lost
            raise StepAheadError(STEERING.name, got=order.step, expected=self._orders.known + 1)
        for following in self._orders.add(order):
            self._behaviour.steer(following)
        early, self._early = self._early, []
        for message in early:
            answers = (*answers, *self.handle(message))
        return answers

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the order of the step, then for what the node awaits, and for the next order if others have it."""
        topics = self._behaviour.awaits()
        if not topics:
            return ()
        if not self.open:
            return (STEERING,)
        return (STEERING, *topics) if self._early else topics

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and what is missing for it."""
        step, missing = self._behaviour.missing()
        return step, missing if self.open else (STEERER,)
