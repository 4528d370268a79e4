"""Steering of a run: what orders for each step what is changed from it on, and the nodes that obey.

None of them goes into a step before it knows what is ordered for it.
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
    PLANE_STATE,
    STEERING,
    Action,
    PlaneState,
    RecordingProgress,
    Steering,
    SwarmEvent,
)
from swarmabs_core.steering import ENDS, STEERER, StepChange, StepSchedule, change_of

if TYPE_CHECKING:
    from swarmabs_core.messages import Message, Messages, Topic

MOST_WAITING = 100
"""Most requests in the queue: each is executed in a separate step."""
OVER = "the run is over"


class Request(NamedTuple):
    """What somebody wants: an action, the robot that it concerns (0: none), and its value."""

    action: Action
    agent_id: int = 0
    value: float = 0.0


class Decision(NamedTuple):
    """What became of a request: the first step at which it holds, or why it was refused."""

    number: int
    request: Request
    step: int | None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class SteeringConfig:
    """Configuration of what steers a run, with all that is scheduled.

    The control period is in ns, offsets of the reference are in rad, torques on the plane in N m. The largest ones are
    bounds of what may be asked for, 0 for an offset if the law knows none.
    """

    members: tuple[int, ...]
    period_ns: int
    last_step: int
    schedule: tuple[Change, ...] = ()
    offsets: tuple[StepChange, ...] = ()
    torques: tuple[StepChange, ...] = ()
    largest_offset: float = 0.0
    largest_torque: float = 0.0


class SteeringController:
    """Orders one step ahead of the plane: with the plane's state of a step comes the order of the next.

    So every request gets the earliest step that no node has begun, and each step has one order at most.
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
        self._number = 0
        self._waiting: deque[tuple[int, Request]] = deque()
        self._decisions: list[Decision] = []

    @property
    def step(self) -> int:
        """The last step for which an order was given."""
        return self._step

    @property
    def members(self) -> tuple[int, ...]:
        """Ids of the robots that take part in that step."""
        return self._membership.publishing(self._step)

    @property
    def absent(self) -> tuple[int, ...]:
        """Ids of the robots that may be added."""
        return tuple(i for i in self._config.members if self._membership.span(i).first == UNPLANNED)

    def setting(self, action: Action) -> float:
        """Return what is set in that step: the offset (rad) of `REFERENCE`, the torque (N m) of `DISTURBANCE`."""
        return self._settings[action].at(self._step)

    def ask(self, request: Request) -> int:
        """Take a request; return its number, under which `decisions` tells what has become of it.

        Raises `InputError` if the request is refused at once.
        """
        if self._over:
            raise InputError(OVER)
        if len(self._waiting) >= MOST_WAITING:
            raise InputError(f"{MOST_WAITING} requests wait for their step already; ask again later")
        problem = self._problem(request, self._step + 1)
        if problem:
            raise InputError(problem)
        self._number += 1
        self._waiting.append((self._number, request))
        return self._number

    def decisions(self) -> list[Decision]:
        """Return what has become of requests since this was asked for the last time."""
        found, self._decisions = self._decisions, []
        return found

    def start(self) -> Messages:
        """Order nothing for the first step."""
        return (self._order(0, Request(Action.NONE)),)

    def handle(self, message: Message) -> Messages:
        """Take a state of the plane or an event; answer the order of the next step."""
        if isinstance(message, SwarmEvent):
            self._membership.apply(message.kind, message.agent_id, message.step, message.detail)
            return ()
        if not isinstance(message, PlaneState):
            raise UnexpectedMessageError("steering", message)
        if message.step > self._step:
            raise StepAheadError("plane", got=message.step, expected=self._step)
        if message.step < self._step or self._over:
            return ()
        if self._step == self._last:
            self._over = True
            self._decisions += [Decision(number, request, None, OVER) for number, request in self._waiting]
            self._waiting.clear()
            return ()
        self._step += 1
        return (self._decide(),)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the plane, and for news of robots that are out."""
        return () if self._over else (EVENTS, PLANE_STATE)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and who is waited for."""
        return self._step, ("plane_sim",)

    def _decide(self) -> Steering:
        """Return the order of the current step."""
        step = self._step
        while self._waiting and not self._must_wait(self._waiting[0][1]):
            number, request = self._waiting.popleft()
            problem = self._problem(request, step)
            self._decisions.append(Decision(number, request, None if problem else step, problem))
            if not problem:
                order = self._order(number, request)
                if (change := change_of(order)) is not None:
                    self._membership.plan(change)
                else:
                    self._settings[request.action].set(step, request.value)
                return order
        return self._order(0, Request(Action.NONE))

    def _order(self, number: int, request: Request) -> Steering:
        return Steering(self._step * self._config.period_ns, self._step, number, *request)

    def _must_wait(self, request: Request) -> bool:
        """Tell whether a request has to wait for the next step: where the scenario sets the same, and after a join."""
        if request.action in ENDS:
            return 0 < self._membership.span(request.agent_id).first == self._step - 1
        return request.action in self._settings and self._settings[request.action].changing(self._step) is not None

    def _problem(self, request: Request, step: int) -> str:
        """Say why a request cannot hold from a step on; empty if it can."""
        if step > self._last:
            return OVER
        if request.action in (Action.REFERENCE, Action.DISTURBANCE):
            return self._problem_of_value(request)
        agent_id = request.agent_id
        if agent_id not in self._membership:
            return f"there is no robot {agent_id}; there are {_listed(self._config.members)}"
        if request.action == Action.ADD:
            if agent_id in self.absent:
                return ""
            absent = self.absent
            others = f"those that can be added are {_listed(absent)}" if absent else "there is none that can be added"
            return f"robot {agent_id} is there by the scenario, or was added before; {others}"
        there = self._membership.publishing(step)
        if agent_id not in there or self._membership.span(agent_id).first >= step:
            return f"robot {agent_id} does not take part at step {step}; those that do are {_listed(there)}"
        # Robots may end later by plan, and leave this one alone.
        steps = {step, *(change.step + 1 for change in self._config.schedule if step <= change.step < self._last)}
        alone = [at for at in sorted(steps) if self._membership.publishing(at) == (agent_id,)]
        if alone:
            return f"at step {alone[0]} robot {agent_id} is the last that takes part, and without any there is no run"
        return ""

    def _problem_of_value(self, request: Request) -> str:
        config = self._config
        largest, unit, what = (
            (config.largest_offset, "rad", "an offset of the reference")
            if request.action == Action.REFERENCE
            else (config.largest_torque, "N m", "a disturbance")
        )
        if not largest:
            return "the parent controller's law knows no offset of its reference (it has no method offset_torque)"
        if not isfinite(request.value) or abs(request.value) > largest:
            return f"{request.value!r} {unit} is out of range; {what} is at most {largest:g} {unit} in magnitude"
        return ""


def _listed(ids: tuple[int, ...]) -> str:
    return ", ".join(map(str, ids[:20])) + (" ..." if len(ids) > 20 else "")


class Steerable(Behaviour, Protocol):
    """A behaviour that takes orders."""

    def steer(self, order: Steering) -> None:
        """Take over what is ordered for a step that has not begun; what does not concern this node is ignored."""
        ...


class Orders:
    """Orders as they arrive; they are known up to a step when that of every step before is known, too.

    Attributes
    ----------
    known : int
        The last step of which the order is known, and those of all steps before; -1 for none.
    """

    def __init__(self) -> None:
        self.known = -1
        self._latest: Steering | None = None
        self._early: dict[int, Steering] = {}

    def add(self, order: Steering) -> list[Steering]:
        """Take an order; return those that are known with it.

        Raises
        ------
        ConflictError, StepAheadError
            If it differs from the order that is known, or is of a step that cannot be the next.
        """
        if order.step <= self.known:
            if self._latest is not None and order.step == self.known:
                refuse_conflict(self._latest, order, STEERING.name)
            return []
        refuse_conflict(self._early.setdefault(order.step, order), order, STEERING.name)
        found = []
        while (latest := self._early.pop(self.known + 1, None)) is not None:
            self.known += 1
            self._latest = latest
            found.append(latest)
        return found


class Steered:
    """A node whose steps begin with what is ordered for them.

    What comes of a step before its order is kept until then. So it does not depend on the order of arrival from which
    step on something holds: it is the step that the order names, in every node.

    Parameters
    ----------
    behaviour : Steerable
        The node.
    """

    def __init__(self, behaviour: Steerable) -> None:
        self._behaviour = behaviour
        self._orders = Orders()
        self._early: list[Message] = []

    @property
    def open(self) -> bool:
        """Whether the order of the current step is known."""
        return self._behaviour.missing()[0] <= self._orders.known

    def start(self) -> Messages:
        """Start the node."""
        return self._behaviour.start()

    def handle(self, message: Message) -> Messages:
        """Take an order, or hand a message to the node."""
        if isinstance(message, Steering):
            return self._obey(message)
        if message.step <= self._orders.known or isinstance(message, (SwarmEvent, RecordingProgress)):
            return self._behaviour.handle(message)
        if message.step > self._orders.known + 1:
            raise StepAheadError(type(message).__name__, got=message.step, expected=self._orders.known + 1)
        self._early.append(message)
        return ()

    def _obey(self, order: Steering) -> Messages:
        answers: Messages = ()
        if order.step > self._orders.known + 2:  # what orders is a step ahead at most, also where one was lost
            raise StepAheadError(STEERING.name, got=order.step, expected=self._orders.known + 1)
        for known in self._orders.add(order):
            self._behaviour.steer(known)
        early, self._early = self._early, []
        for message in early:
            answers = (*answers, *self.handle(message))
        return answers

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the order of the step, then for what the node waits for."""
        topics = self._behaviour.awaits()
        return topics if not topics or self.open else (STEERING,)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and what is missing for it."""
        step, missing = self._behaviour.missing()
        return step, missing if self.open else (STEERER,)
