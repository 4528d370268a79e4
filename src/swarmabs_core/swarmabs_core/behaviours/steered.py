"""Nodes in a run that is steered: none goes into a step before it knows what is ordered for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from swarmabs_core.behaviours.base import Behaviour, StepAheadError, refuse_conflict
from swarmabs_core.messages import STEERING, RecordingProgress, Steering, SwarmEvent
from swarmabs_core.steering import STEERER

if TYPE_CHECKING:
    from swarmabs_core.messages import Message, Messages, Topic


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
