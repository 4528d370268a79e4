"""Common parts of all nodes in real time, where the clock determines the steps."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol

from swarmabs_core.declaration import same, setting
from swarmabs_core.messages import Message, Messages
from swarmabs_core.parameters import SettingError
from swarmabs_core.settings import Run

FEWEST = 2
"""Smallest number of robots in a swarm: with fewer, S3 vanishes."""


class Level(IntEnum):
    """Severity of a health status, with the numbers of ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2


class Health(NamedTuple):
    """Health of a node: level, one readable line, and values as (name, text)."""

    level: Level
    text: str
    values: tuple[tuple[str, str], ...] = ()


class Sender(NamedTuple):
    """Who sent a message, as far as its receiver knows.

    Attributes
    ----------
    standby : bool
        Whether it came on the topic of a standby coordinator.
    writer : bytes
        GID of the writer; empty if unknown.
    """

    standby: bool = False
    writer: bytes = b""


UNKNOWN = Sender()
"""A sender on the usual topic of which nothing else is known."""


class RealtimeBehaviour(Protocol):
    """A node as a state machine. Its driver publishes the returned messages in order.

    `now` is the time of the swarm's clock, in ns since 1970; it is an argument so that tests can simulate the clock.
    """

    def hear(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Messages:
        """Take a message that has arrived; invalid messages never raise an error."""
        ...

    def tick(self, now: int) -> Messages:
        """Do the work of one period."""
        ...

    def halt(self) -> None:
        """Enter a safe state, because ticks are suspended; repeated calls have no effect."""
        ...

    def health(self, now: int) -> Health:
        """Return the health of the node."""
        ...


@dataclass(frozen=True, slots=True)
class Realtime:
    """Settings for runs in real time, where the clock determines the steps: on robots, and with `run --realtime`."""

    broadcast_age_limit: float = setting(
        0.1, "age of the newest complete broadcasts above which a robot stops", unit="s", above=0.0
    )
    state_age_limit: float = setting(
        0.1, "age of a robot's state above which the robot is assumed to be at rest", unit="s", above=0.0
    )
    plane_age_limit: float = setting(
        0.1, "age of the plane's state above which the parent controller publishes nothing", unit="s", above=0.0
    )
    clock_tolerance: float = setting(
        0.02, "how far in the future a message may be by the receiver's clock", unit="s", minimum=0.0
    )
    takeover_after: float = setting(
        0.04,
        "silence of a coordinator after which its standby takes over, {unit}; only in fleets with standbys",
        unit="s",
        above=0.0,
    )
    lane_margin: float = setting(0.02, "distance that a robot keeps from the ends of the plane", unit="m", minimum=0.0)
    start: str = setting(
        "wait",
        "robots that must be heard before the swarm moves: wait: all; quorum: the number `quorum`; proceed: two",
        choices=("wait", "quorum", "proceed"),
    )
    quorum: int | None = setting(
        None, "number of robots that must be heard with start: quorum", minimum=FEWEST, maximum=65535, unset=0
    )

    def __post_init__(self) -> None:
        """Reject start: quorum without a number, and a number without start: quorum."""
        if self.start == "quorum" and self.quorum is None:
            problem = "start is 'quorum', but 'quorum' has no value"
            raise SettingError("", problem, "set 'quorum' to the number of robots that must be heard")
        if self.start != "quorum" and self.quorum is not None:
            problem = f"'quorum' has no effect with start: {self.start}"
            raise SettingError("", problem, "remove it, or use start: quorum")


@dataclass(frozen=True, slots=True)
class Schedule:
    """The mapping of time to steps: step k is the k-th period since an epoch that all nodes know.

    A node that starts late or restarts derives the step from its clock, so no other node has to restart.
    """

    period_ns: int = same(Run, "period_ns")
    epoch_ns: int = setting(0, "time at which step 0 starts, ns since 1970", minimum=0)

    @property
    def period(self) -> float:
        """Control period, s."""
        return self.period_ns / 1e9

    def step(self, now: int) -> int:
        """Return the step at a time (ns); negative before the epoch."""
        return (now - self.epoch_ns) // self.period_ns

    def begin(self, step: int, phase: float = 0.0) -> int:
        """Return the time (ns) at which a step starts, or at which this fraction of it has passed."""
        return self.epoch_ns + step * self.period_ns + round(phase * self.period_ns)

    def ahead(self, tolerance: float) -> int:
        """Return how many steps ahead a message may be if the clocks agree within a tolerance (s)."""
        return -(-round(tolerance * 1e9) // self.period_ns)

    def steps(self, seconds: float) -> int:
        """Return the number of whole periods in a time span (s), at least one."""
        return max(1, round(seconds * 1e9) // self.period_ns)


class StepCounter:
    """Yields each step once, regardless of clock changes.

    Attributes
    ----------
    last : int or None
        The last step yielded, None before the first and after the clock was set back.
    """

    def __init__(self, schedule: Schedule) -> None:
        self._schedule = schedule
        self.last: int | None = None

    def next(self, now: int) -> int | None:
        """Return the step at a time (ns) if it is due now, else None.

        If the clock was set back by at most `MOST_BACK` steps, the counter waits for it. Otherwise it restarts: `last`
        becomes None, and data stored for later steps is void.
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
"""Largest number of steps by which a clock may be set back without a restart of the count."""
AGENT_PHASE = 0.0
PLANE_PHASE = OBSERVER_PHASE = 0.5
CONTROLLER_PHASE = 0.75
"""Fractions of a period after which the nodes tick: robots first, then the nodes that gather their states. The parent
controller answers each state of the plane at once; its tick only monitors the plane."""
