"""What every node has in common where the clock makes the steps."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol

from swarmabs_core.behaviours.base import Run
from swarmabs_core.declaration import same, setting
from swarmabs_core.messages import Message, Messages
from swarmabs_core.parameters import SettingError

FEWEST = 2
"""Robots without which a swarm has no spread."""


class Level(IntEnum):
    """How serious a state of health is, with the numbers of ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2


class Health(NamedTuple):
    """How a node is: level, one line for people, and figures as (name, text)."""

    level: Level
    text: str
    values: tuple[tuple[str, str], ...] = ()


class RealtimeBehaviour(Protocol):
    """A node as a state machine. Its driver publishes its answers, in that order.

    `now` is the time of the swarm's clock, in ns since 1970; it is an argument so that a test is its own clock.
    """

    def hear(self, message: Message, now: int) -> Messages:
        """Take a message that has arrived; none, however wrong, raises an error."""
        ...

    def tick(self, now: int) -> Messages:
        """Do what is done once per period."""
        ...

    def halt(self) -> None:
        """Leave everything safe, since no tick will follow for now; more than once does no harm."""
        ...

    def health(self, now: int) -> Health:
        """Return how the node is."""
        ...


@dataclass(frozen=True, slots=True)
class Realtime:
    """What holds where the clock and not the last message makes the steps: on robots, and with `run --realtime`."""

    broadcast_age_limit: float = setting(
        0.1, "age of the newest complete broadcasts from which on a robot stops, s", above=0.0
    )
    state_age_limit: float = setting(
        0.1, "age of a robot's state from which on it is taken to stand still, s", above=0.0
    )
    plane_age_limit: float = setting(
        0.1, "age of the plane's state from which on the parent controller asks for nothing, s", above=0.0
    )
    clock_tolerance: float = setting(
        0.02, "how far a message may come from the future by the receiver's clock, s", minimum=0.0
    )
    lane_margin: float = setting(
        0.02, "distance from the plane's ends at which a robot must have come to rest, m", minimum=0.0
    )
    start: str = setting(
        "wait",
        "wait: all robots must have been heard before the swarm moves; quorum: as many as `quorum` says; proceed: two",
        choices=("wait", "quorum", "proceed"),
    )
    quorum: int | None = setting(
        None, "robots that must have been heard with start: quorum", minimum=FEWEST, maximum=65535, unset=0
    )

    def __post_init__(self) -> None:
        """Refuse a quorum without its number, and a number without a quorum."""
        if self.start == "quorum" and self.quorum is None:
            problem = "start is 'quorum' and there is no number 'quorum'"
            raise SettingError("", problem, "say how many robots must be there")
        if self.start != "quorum" and self.quorum is not None:
            problem = f"'quorum' has no meaning with start: {self.start}"
            raise SettingError("", problem, "remove it, or use start: quorum")


@dataclass(frozen=True, slots=True)
class Schedule:
    """How time becomes steps: step k is the k-th period since an epoch that all nodes know.

    A node that starts late or restarts knows the step from its clock alone, so no other node has to restart with it.
    """

    period_ns: int = same(Run, "period_ns")
    epoch_ns: int = setting(0, "time at which step 0 begins, ns since 1970", minimum=0)

    @property
    def period(self) -> float:
        """Control period, s."""
        return self.period_ns / 1e9

    def step(self, now: int) -> int:
        """Return the step of a time; negative before the epoch."""
        return (now - self.epoch_ns) // self.period_ns

    def begin(self, step: int, phase: float = 0.0) -> int:
        """Return the time (ns) at which a step begins, or at which this share of it is over."""
        return self.epoch_ns + step * self.period_ns + round(phase * self.period_ns)

    def ahead(self, tolerance: float) -> int:
        """Return by how many steps a message may be from the future, if the clocks agree within a tolerance (s)."""
        return -(-round(tolerance * 1e9) // self.period_ns)

    def steps(self, seconds: float) -> int:
        """Return how many whole periods a span of time (s) has, one at least."""
        return max(1, round(seconds * 1e9) // self.period_ns)


class StepCounter:
    """Makes each step once, whatever the clock does.

    Attributes
    ----------
    last : int or None
        The last step made, None before the first and after the clock was set back.
    """

    def __init__(self, schedule: Schedule) -> None:
        self._schedule = schedule
        self.last: int | None = None

    def next(self, now: int) -> int | None:
        """Return the step of a time (ns) if it is to be made now, else None.

        A clock that was set back a little is waited for. If it is more than `MOST_BACK`, counting begins anew: then
        `last` is None, and whatever was kept of later steps is worthless.
        """
        step = self._schedule.step(now)
        if self.last is not None and step <= self.last:
            if self.last - step > MOST_BACK:
                self.last = None
            return None
        if step < 0:
            return None
        self.last = step
        return step


MOST_BACK = 2
"""Steps by which a clock may be set back and is waited for."""
AGENT_PHASE = 0.0
PLANE_PHASE = OBSERVER_PHASE = 0.5
CONTROLLER_PHASE = 0.75
"""Shares of a period after which the nodes tick: robots first, then who gathers their states. The parent controller
answers each state of the plane at once and ticks only to watch over it."""
