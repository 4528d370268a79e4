"""The parent controller: plane state in, desired abstract state out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.behaviours.base import UnexpectedMessageError, is_new, packed_broadcasts, refuse_other_system
from swarmabs_core.errors import InputError, InStep
from swarmabs_core.events import EventCode
from swarmabs_core.membership import Membership
from swarmabs_core.messages import (
    NEVER,
    OBSERVER_NODE,
    PARENT_STATES,
    RECORDER_NODE,
    RECORDING_PROGRESS,
    STANDING,
    TOPIC_OF,
    Action,
    AnyParentState,
    Message,
    Messages,
    RecordingProgress,
    StandingState,
    Topic,
)
from swarmabs_core.steering import StepSchedule, change_of

if TYPE_CHECKING:
    from swarmabs_core.messages import Steering
    from swarmabs_core.model import ControllerConfig, DesiredStates


class Controller:
    """Answers each state of the parent with the desired abstract state of the step.

    Parameters
    ----------
    config : ControllerConfig
        Configuration, which determines the parent system.
    desired : DesiredStates, optional
        What generates the desired abstract state, by default the configured law.
    packed : bool
        Whether it also receives the observer's broadcasts and publishes the three of a step as one message.

    Raises
    ------
    InputError
        If the reference is to be offset, and the law does not support it.
    """

    def __init__(
        self,
        config: ControllerConfig,
        desired: DesiredStates | None = None,
        *,
        packed: bool = False,
    ) -> None:
        self._config = config
        self._system = config.system_hash
        self._family = config.family
        self._packed = packed
        self._parts: dict[Topic, Message] = {}
        self._generator: DesiredStates = desired or config.desired_states()
        if config.offsets and self._generator.no_offset:
            raise InputError(f"parameter offsets: {self._generator.no_offset}", "omit the parameter")
        self._offsets = StepSchedule(config.offsets)
        self._step = 0
        self._parent: AnyParentState | None = None
        self._membership = Membership(config.members, config.schedule)
        self._divided: StandingState | None = None
        self._written = -1

    def start(self) -> Messages:
        """Publish nothing: the plane starts."""
        return ()

    def handle(self, message: Message) -> Messages:
        """Take a state of the parent or the recorder's progress; return the desired abstract state of the step.

        With packed broadcasts, also take those of the observer, and return the packed one once all three are known.
        """
        refuse_other_system(message, self._system)
        if isinstance(message, PARENT_STATES):
            if is_new(message, self._parent, self._step, self._family.parent.name):
                self._parent = message
        elif isinstance(message, StandingState):
            if is_new(message, self._divided, self._step, STANDING.name):
                self._divided = message
        elif isinstance(message, RecordingProgress):
            if message.written_step != NEVER:
                self._written = max(self._written, message.written_step)
        elif self._packed and (topic := TOPIC_OF[type(message)]) in {self._family.abstract, self._family.auxiliary}:
            if is_new(message, self._parts.get(topic), self._packing_step, topic.name):
                self._parts[topic] = message
        else:
            raise UnexpectedMessageError("parent controller", message)
        ready = self._parent is not None and not self._lacks_division and self._credit()
        answer = self._finish() if ready else ()
        return (*answer, *self._pack())

    def steer(self, order: Steering) -> None:
        """Apply an ordered offset of the reference, or note an ordered change of the membership."""
        if (change := change_of(order)) is not None:
            self._membership.plan(change)
        if order.action == Action.REFERENCE:
            self._offsets.set(order.step, order.value)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the plane, then, if the recorder is too far behind, for the recorder."""
        if self._answered:  # the broadcasts of the observer for the same step
            abstract = self._family.abstract
            return (abstract,) if abstract not in self._parts else (self._family.auxiliary,)
        last = self._config.last_step
        if last is not None and self._step > last:
            return ()
        if self._parent is None:
            return (self._family.parent,)
        return (STANDING,) if self._lacks_division else (RECORDING_PROGRESS,)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the awaited node."""
        if self._answered:
            return self._packing_step, (OBSERVER_NODE,)
        if self._parent is None:
            return self._step, (self._family.node,)
        return self._step, (OBSERVER_NODE,) if self._lacks_division else (RECORDER_NODE,)

    @property
    def _lacks_division(self) -> bool:
        """Whether the observer has yet to tell how the abstract state divides at the current step."""
        return self._divided is None and self._membership.divides(self._step, self._config.division)

    @property
    def _answered(self) -> bool:
        """Whether the desired state of a step waits to be packed with the observer's broadcasts."""
        return self._family.desired in self._parts

    @property
    def _packing_step(self) -> int:
        return self._step - self._answered

    def _credit(self) -> bool:
        window = self._config.recording_window
        return not window or self._step - window <= self._written

    def _finish(self) -> Messages:
        step, parent, self._parent = self._step, self._parent, None
        assert parent is not None  # noqa: S101 - what is ready has a state of the parent
        divided, self._divided = self._divided, None
        if divided is not None:
            self._generator.divide(divided)
        stamp = step * self._config.period_ns
        with InStep(step):
            events, desired = self._generator.advance(stamp, parent, offset=self._offsets.at(step))
        self._step += 1
        if (offset := self._offsets.changing(step)) is not None:
            events = (EventCode.REFERENCE.event(stamp, step, offset), *events)
        if self._packed:
            self._parts[self._family.desired] = desired
        return (*events, desired)

    def _pack(self) -> Messages:
        if len(self._parts) < len(self._family.broadcasts):
            return ()
        return (packed_broadcasts(self._family, self._parts.pop),)
