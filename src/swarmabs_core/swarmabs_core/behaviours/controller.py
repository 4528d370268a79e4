"""The parent controller: plane state in, desired abstract state out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_core.behaviours.base import Run, UnexpectedMessageError, is_new
from swarmabs_core.controllers import ParentLaw
from swarmabs_core.declaration import part, same, setting
from swarmabs_core.desired_state import DesiredStateGenerator
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AUXILIARY_STATE,
    BROADCASTS,
    DESIRED_ABSTRACT_STATE,
    NEVER,
    PLANE_STATE,
    RECORDING_PROGRESS,
    TOPIC_OF,
    AbstractState,
    Action,
    AuxiliaryState,
    Broadcast,
    EventKind,
    Message,
    Messages,
    PlaneState,
    RecordingProgress,
    SwarmEvent,
    Topic,
)
from swarmabs_core.steering import REFERENCE, StepChange, StepSchedule

if TYPE_CHECKING:
    from swarmabs_core.controllers import ParentController
    from swarmabs_core.messages import Steering


@dataclass(frozen=True, slots=True)
class ControllerConfig:
    """Configuration of the parent controller's node."""

    period_ns: int = same(Run, "period_ns")
    manifold: Manifold = part(Manifold)
    recording_window: int = setting(
        0, "number of steps that the run may be ahead of the recorder; 0: not recorded", minimum=0
    )
    last_step: int | None = same(Run, "last_step")
    offsets: tuple[StepChange, ...] = setting(
        (),
        "offsets of the law's reference, rad, each 'STEP VALUE' from a step on, such as '500 0.1'",
        make=StepChange.parse,
    )
    law: ParentLaw = part(ParentLaw, name="")


class Controller:
    """Answers each state of the plane with the desired abstract state of the step.

    Parameters
    ----------
    packed : bool
        Whether it also receives the observer's broadcasts and publishes the three of a step as one message.
    """

    def __init__(self, config: ControllerConfig, law: ParentController, *, packed: bool = False) -> None:
        self._config = config
        self._packed = packed
        self._parts: dict[Topic, Message] = {}
        self._generator = DesiredStateGenerator(config.period_ns, config.manifold, law)
        self._offsets = StepSchedule(config.offsets)
        self._step = 0
        self._plane: PlaneState | None = None
        self._written = -1

    def start(self) -> Messages:
        """Publish nothing: the plane starts."""
        return ()

    def handle(self, message: Message) -> Messages:
        """Take a plane state or the recorder's progress; return the desired abstract state of the step.

        With packed broadcasts, also take those of the observer, and return the packed one once all three are known.
        """
        if isinstance(message, PlaneState):
            if is_new(message, self._plane, self._step, PLANE_STATE.name):
                self._plane = message
        elif isinstance(message, RecordingProgress):
            if message.written_step != NEVER:
                self._written = max(self._written, message.written_step)
        elif self._packed and isinstance(message, (AbstractState, AuxiliaryState)):
            topic = TOPIC_OF[type(message)]
            if is_new(message, self._parts.get(topic), self._packing_step, topic.name):
                self._parts[topic] = message
        else:
            raise UnexpectedMessageError("parent controller", message)
        answer = self._finish() if self._plane is not None and self._credit() else ()
        return (*answer, *self._pack())

    def steer(self, order: Steering) -> None:
        """Apply an ordered offset of the reference."""
        if order.action == Action.REFERENCE:
            self._offsets.set(order.step, order.value)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the plane, then, if the recorder is too far behind, for the recorder."""
        if self._answered:  # the broadcasts of the observer for the same step
            return (ABSTRACT_STATE,) if ABSTRACT_STATE not in self._parts else (AUXILIARY_STATE,)
        last = self._config.last_step
        if last is not None and self._step > last:
            return ()
        return (PLANE_STATE,) if self._plane is None else (RECORDING_PROGRESS,)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the awaited node."""
        if self._answered:
            return self._packing_step, ("abstraction_observer",)
        return self._step, ("plane_sim",) if self._plane is None else ("recorder",)

    @property
    def _answered(self) -> bool:
        """Whether the desired state of a step waits to be packed with the observer's broadcasts."""
        return DESIRED_ABSTRACT_STATE in self._parts

    @property
    def _packing_step(self) -> int:
        return self._step - self._answered

    def _credit(self) -> bool:
        window = self._config.recording_window
        return not window or self._step - window <= self._written

    def _finish(self) -> Messages:
        plane = self._plane
        assert plane is not None  # noqa: S101 - `handle` has checked it
        step, self._plane = self._step, None
        stamp = step * self._config.period_ns
        events, desired = self._generator.advance(stamp, plane, offset=self._offsets.at(step))
        self._step += 1
        if (offset := self._offsets.changing(step)) is not None:
            events = (SwarmEvent(stamp, step, 0, EventKind.STEERING, offset, REFERENCE), *events)
        if self._packed:
            self._parts[DESIRED_ABSTRACT_STATE] = desired
        return (*events, desired)

    def _pack(self) -> Messages:
        if len(self._parts) < len(BROADCASTS):
            return ()
        abstract, auxiliary, desired = (self._parts.pop(topic) for topic in BROADCASTS)
        return (Broadcast(desired.stamp, desired.step, abstract, auxiliary, desired),)  # type: ignore[arg-type]
