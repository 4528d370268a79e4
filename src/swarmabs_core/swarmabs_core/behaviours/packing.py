"""The three broadcasts of a step in one message: fewer wake-ups of many robots, and nothing more for them to know.

Neither the parent controller nor a robot knows of it: each is wrapped into a behaviour that packs or unpacks.
"""

from __future__ import annotations

from typing import Protocol

from swarmabs_core.behaviours.base import Behaviour, StepAheadError, UnexpectedMessageError, refuse_conflict
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AUXILIARY_STATE,
    BROADCAST,
    BROADCASTS,
    AbstractState,
    AuxiliaryState,
    Broadcast,
    DesiredAbstractState,
    Message,
    Messages,
    Topic,
)


class Listener(Behaviour, Protocol):
    """A behaviour that says which topics it needs: a robot, or several of them."""

    @property
    def needs(self) -> tuple[Topic, ...]:
        """The topics to which it listens."""
        ...


class PackingController:
    """A parent controller that, once it and the observer have broadcast, sends the three broadcasts as one message.

    Parameters
    ----------
    controller : Behaviour
        The parent controller.
    """

    def __init__(self, controller: Behaviour) -> None:
        self._controller = controller
        self._step = 0
        self._abstract: AbstractState | None = None
        self._auxiliary: AuxiliaryState | None = None
        self._desired: DesiredAbstractState | None = None

    def start(self) -> Messages:
        """Start the controller."""
        return self._controller.start()

    def handle(self, message: Message) -> Messages:
        """Take a broadcast of the observer, or a message for the controller; answer with the last one of the step."""
        answer: Messages = ()
        if isinstance(message, AbstractState):
            if self._current(message, ABSTRACT_STATE, self._abstract):
                self._abstract = message
        elif isinstance(message, AuxiliaryState):
            if self._current(message, AUXILIARY_STATE, self._auxiliary):
                self._auxiliary = message
        else:
            answer = self._controller.handle(message)
            for made in answer:
                if isinstance(made, DesiredAbstractState):
                    self._desired = made
        return (*answer, *self._pack())

    def _current(self, message: AbstractState | AuxiliaryState, topic: Topic, known: Message | None) -> bool:
        """Tell whether a broadcast is of the current step; older ones are repetitions."""
        if message.step > self._step:
            raise StepAheadError(topic.name, got=message.step, expected=self._step)
        if message.step == self._step and known is not None:
            refuse_conflict(known, message, topic.name)
        return message.step == self._step

    def _pack(self) -> Messages:
        abstract, auxiliary, desired = self._abstract, self._auxiliary, self._desired
        if abstract is None or auxiliary is None or desired is None:
            return ()
        self._abstract = self._auxiliary = self._desired = None
        self._step += 1
        return (Broadcast(desired.stamp, desired.step, abstract, auxiliary, desired),)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for what the controller waits for, then for what the observer has broadcast meanwhile."""
        if self._desired is None:
            return self._controller.awaits()
        return (ABSTRACT_STATE,) if self._abstract is None else (AUXILIARY_STATE,)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and who is waited for."""
        return self._controller.missing() if self._desired is None else (self._step, ("abstraction_observer",))


class Unpacking:
    """A robot, or several, that hear the three broadcasts of a step as one message.

    Parameters
    ----------
    listener : Listener
        The robot.

    Attributes
    ----------
    needs : tuple of Topic
        The topics to listen to instead of those of the robot.
    """

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self.needs = _packed(listener.needs)

    def start(self) -> Messages:
        """Start the robot."""
        return self._listener.start()

    def handle(self, message: Message) -> Messages:
        """Hand the parts of a packed broadcast to the robot, and what else it listens to as it is."""
        if isinstance(message, Broadcast):
            hear = self._listener.handle
            return (*hear(message.abstract), *hear(message.auxiliary), *hear(message.desired))
        if isinstance(message, (AbstractState, AuxiliaryState, DesiredAbstractState)):
            raise UnexpectedMessageError("robot with packed broadcasts", message)
        return self._listener.handle(message)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for what the robot waits for."""
        return _packed(self._listener.awaits())

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the topics not yet heard."""
        return self._listener.missing()


def _packed(topics: tuple[Topic, ...]) -> tuple[Topic, ...]:
    """Return the topics with that of the packed broadcast instead of the three."""
    return tuple(dict.fromkeys(BROADCAST if topic in BROADCASTS else topic for topic in topics))
