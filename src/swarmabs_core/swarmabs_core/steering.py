"""What is set for a whole run at a step: an offset of the reference, a torque that disturbs the plane.

Both are constant from one step to another. They come from a scenario, or, in a run that is steered, from outside; where
they come from changes nothing in what follows from them.
"""

from __future__ import annotations

from bisect import bisect_right
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.errors import InputError
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import Action, EventKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from swarmabs_core.messages import Steering, SwarmEvent

STEERER = "steering"
"""Name of the node that orders what is changed from outside."""
REFERENCE = "reference"
"""`SwarmEvent.detail` where the offset (rad) of the plane's reference changes."""
DISTURBANCE = "disturbance"
"""`SwarmEvent.detail` where the constant torque (N m) that disturbs the plane changes."""


ENDS = {Action.KILL: ChangeKind.KILL, Action.FREEZE: ChangeKind.FREEZE, Action.REMOVE: ChangeKind.REMOVE}
"""The actions that end a robot, and as what each is planned."""


def change_of(order: Steering) -> Change | None:
    """Return the change of the membership that is ordered from outside; None if it is something else."""
    if order.action == Action.ADD:
        return Change(order.step, order.agent_id, ChangeKind.JOIN)
    kind = ENDS.get(Action(order.action))
    return None if kind is None else Change(order.step - 1, order.agent_id, kind)


class StepChange(NamedTuple):
    """A number that holds from a step on."""

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
            found = cls(int(step), float(value))
        except ValueError:
            found = cls(-1, 0.0)
        if found.step < 0 or not isfinite(found.value):
            raise InputError(f"{text!r} is not of the form 'STEP VALUE', such as '500 0.1'")
        return found


class StepSchedule:
    """A number that changes at steps, at each at most once, and is 0 before the first."""

    def __init__(self, changes: Iterable[StepChange] = ()) -> None:
        self._value = dict(changes)
        self._steps = sorted(self._value)

    def __bool__(self) -> bool:
        return bool(self._steps)

    def at(self, step: int) -> float:
        """Return what holds in a step."""
        place = bisect_right(self._steps, step)
        return self._value[self._steps[place - 1]] if place else 0.0

    def changing(self, step: int) -> float | None:
        """Return what holds from a step on, if it is set there."""
        return self._value.get(step)

    def set(self, step: int, value: float) -> None:
        """Let a value hold from a step on."""
        self._value[step] = value
        self._steps = sorted(self._value)


class OffsetReference:
    """The angle wanted: what a law wants by itself at a time (s) and the offset of the step, both in rad.

    The step of a time follows from the control period (ns).
    """

    def __init__(self, reference: Callable[[float], float], offsets: StepSchedule, period_ns: int) -> None:
        self._reference = reference
        self._offsets = offsets
        self._period_ns = period_ns

    def __call__(self, time: float) -> float:
        """Return the angle wanted at a time (s) that is that of a step, rad."""
        wanted = self._reference(time)
        if not self._offsets or not isfinite(time):
            return wanted
        return wanted + self._offsets.at(round(time * 1e9 / self._period_ns))

    def shift(self, step: int, offset: float) -> None:
        """Let an offset (rad) hold from a step on."""
        self._offsets.set(step, offset)

    def hear(self, event: SwarmEvent) -> None:
        """Let an offset hold that an event announces; other events change nothing."""
        if event.kind == EventKind.STEERING and event.detail == REFERENCE:
            self.shift(event.step, event.value)
