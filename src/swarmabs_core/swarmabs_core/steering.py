"""Step changes for a whole run: an offset of the reference, and a torque that disturbs the plane.

Both are piecewise constant. They come from the scenario or, in a steered run, from outside; their effect is the same.
"""

from __future__ import annotations

from bisect import bisect_right
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_core.errors import InputError, InStep
from swarmabs_core.events import EventCode, code_of
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import Action

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from swarmabs_core.messages import Steering, SwarmEvent

STEERER = "steering"
"""Name of the node that publishes changes from outside."""
REFERENCE = EventCode.REFERENCE.text
"""The offset (rad) of the plane's reference, as a setting that changes during a run."""
DISTURBANCE = EventCode.DISTURBANCE.text
"""The constant torque (N m) that disturbs the plane, as such a setting."""


ENDS = {Action.KILL: ChangeKind.KILL, Action.FREEZE: ChangeKind.FREEZE, Action.REMOVE: ChangeKind.REMOVE}
"""The actions that end a robot, and the kind of change that each one causes."""


def change_of(order: Steering) -> Change | None:
    """Return the membership change that an order requests; None if it requests something else."""
    if order.action == Action.ADD:
        return Change(order.step, order.agent_id, ChangeKind.JOIN)
    kind = ENDS.get(Action(order.action))
    return None if kind is None else Change(order.step - 1, order.agent_id, kind)


class StepChange(NamedTuple):
    """A value that takes effect at a step."""

    step: int
    value: float

    def __str__(self) -> str:
        return f"{self.step} {self.value!r}"

    @classmethod
    def parse(cls, text: str) -> StepChange:
        """Read ``STEP VALUE``, such as ``500 0.1``.

        Raises
        ------
        InputError
            If the text is not of this form.
        """
        try:
            step, value = text.split()
            change = cls(int(step), float(value))
        except ValueError:
            change = cls(-1, 0.0)
        if change.step < 0 or not isfinite(change.value):
            raise InputError(f"{text!r} is not of the form 'STEP VALUE', such as '500 0.1'")
        return change


class StepSchedule:
    """A piecewise constant value: 0 until the first change, at most one change per step."""

    def __init__(self, changes: Iterable[StepChange] = ()) -> None:
        self._value = dict(changes)
        self._steps = sorted(self._value)

    def __bool__(self) -> bool:
        return bool(self._steps)

    @property
    def steps(self) -> tuple[int, ...]:
        """The steps at which the value is set, ascending."""
        return tuple(self._steps)

    def at(self, step: int) -> float:
        """Return the value in a step."""
        place = bisect_right(self._steps, step)
        return self._value[self._steps[place - 1]] if place else 0.0

    def changing(self, step: int) -> float | None:
        """Return the value that is set at a step, None if there is no change."""
        return self._value.get(step)

    def set(self, step: int, value: float) -> None:
        """Set the value that takes effect at a step."""
        self._value[step] = value
        self._steps = sorted(self._value)


class OffsetReference:
    """The reference of a run: that of a law at a time (s) plus the offset of that step, both in rad.

    For another parent system, the references of all that it tracks; the offset is added to each of them. The control
    period (ns) determines the step of a time.
    """

    def __init__(self, reference: Callable[[float], Any], offsets: StepSchedule, period_ns: int) -> None:
        self._reference = reference
        self._offsets = offsets
        self._period_ns = period_ns

    def __call__(self, time: float) -> Any:
        """Return the reference angle (rad), or a tuple of references, at the time (s) of a step."""
        step = round(time * 1e9 / self._period_ns) if isfinite(time) else 0
        with InStep(step):
            reference = self._reference(time)
        if not self._offsets or not isfinite(time):
            return reference
        offset = self._offsets.at(step)
        return tuple(value + offset for value in reference) if isinstance(reference, tuple) else reference + offset

    def shift(self, step: int, offset: float) -> None:
        """Set the offset (rad) that takes effect at a step."""
        self._offsets.set(step, offset)

    def hear(self, event: SwarmEvent) -> None:
        """Apply the offset that an event announces; other events are ignored."""
        if code_of(event) is EventCode.REFERENCE:
            self.shift(event.step, event.value)
