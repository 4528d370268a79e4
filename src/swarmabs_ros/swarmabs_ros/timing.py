"""Due times and lateness of a node's steps, and changes of the system clock; this module reads no clock itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.realtime.base import MOST_BACK

if TYPE_CHECKING:
    from swarmabs_core.realtime.base import Schedule

JUMP = 1_000_000
"""Change of the system clock relative to the steady one, ns, that is a jump; the kernel slews at most 0.5 us per ms."""
BINS = 32
"""Number of bins of a histogram: the last one starts at 2^30 us, about 18 minutes."""


class Reading(NamedTuple):
    """Two clocks at the same time: the system clock (ns since 1970) and a steady one (ns since an arbitrary time)."""

    system: int
    steady: int


class Lateness:
    """Histogram with a bin for every power of two: bin 0 is below 1 us, bin n from 2^(n-1) us to below 2^n us.

    `count` is the number of values, `longest` the largest, ns.
    """

    def __init__(self) -> None:
        self.count = 0
        self.longest = 0
        self._bins = [0] * BINS

    def add(self, nanoseconds: int) -> None:
        """Add a value, ns; a negative one counts as 0."""
        late = max(0, nanoseconds)
        self._bins[min((late // 1000).bit_length(), BINS - 1)] += 1
        self.count += 1
        self.longest = max(self.longest, late)

    def below(self, share: float) -> int:
        """Return an upper bound, us, of a fraction of the values: a bin's edge, or the longest; 0 without values."""
        seen = 0
        for number, inside in enumerate(self._bins):
            seen += inside
            if inside and seen >= share * self.count:
                return min(1 << number, -(-self.longest // 1000))
        return 0

    def bins(self) -> dict[int, int]:
        """Return the number of values by the upper edge of their bin, us, without empty bins."""
        return {1 << number: inside for number, inside in enumerate(self._bins) if inside}


class StepClock:
    """Determines which step is due, each once, even if the system clock is set.

    If the clock is set forward, the skipped steps are dropped. If it is set back slightly, the next step waits for it,
    because no step may be executed twice. If it is set back by more than `MOST_BACK` steps, it was wrong before: a step
    is due at once, so that the behaviour detects this and enters a safe state, and counting continues from there.

    Parameters
    ----------
    schedule : Schedule
        Maps time to steps.
    phase : float
        Fraction of the period after which a step is due.

    Attributes
    ----------
    lateness : Lateness
        Lateness of the executed steps.
    missed : int
        Number of periods without a step, except for those skipped by a jump of the clock.
    jumps : int
        Number of times that the system clock was set.
    largest_jump : int
        The change with the largest magnitude, ns.
    """

    def __init__(self, schedule: Schedule, phase: float) -> None:
        self._schedule = schedule
        self._phase = phase
        self._shift = schedule.begin(0, phase) - schedule.begin(0)
        self._made = -1
        self._next = 0
        self._offset: int | None = None
        self.lateness = Lateness()
        self.missed = 0
        self.jumps = 0
        self.largest_jump = 0

    def start(self, now: Reading) -> None:
        """Start with the next future step; steps that were executed before are not repeated."""
        self._notice(now)
        self._next = max(self._made, self._current(now)) + 1

    def due(self, now: Reading) -> int | None:
        """Return the step to execute now, None if none is due; it counts as executed."""
        self._notice(now)
        late = now.system - self._schedule.begin(self._next, self._phase)
        if late < 0:
            return None
        missed = late // self._schedule.period_ns
        self._made = self._next + missed
        self._next = max(0, self._made + 1)
        self.missed += missed
        self.lateness.add(late)
        return self._made

    def wait(self, now: Reading) -> int:
        """Return the time until the next step is due, ns."""
        return max(0, self._schedule.begin(self._next, self._phase) - now.system)

    def step(self, now: int) -> int:
        """Return the step at a time of the system clock, ns."""
        return self._schedule.step(now)

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the timing statistics in readable form."""
        late = self.lateness
        return (
            ("steps made", str(late.count)),
            ("periods missed", str(self.missed)),
            ("late, half below (us)", str(late.below(0.5))),
            ("late, 99.9 % below (us)", str(late.below(0.999))),
            ("late, longest (us)", str(late.longest // 1000)),
            ("clock jumps", str(self.jumps)),
            ("largest clock jump (ms)", f"{self.largest_jump / 1e6:.3f}"),
        )

    def report(self) -> dict[str, object]:
        """Return the timing statistics as a JSON document, with the histogram by the upper edges of its bins, us."""
        return {
            "steps": self.lateness.count,
            "missed": self.missed,
            "longest_us": self.lateness.longest // 1000,
            "lateness_us": {str(edge): count for edge, count in self.lateness.bins().items()},
            "clock_jumps": self.jumps,
            "largest_clock_jump_ns": self.largest_jump,
        }

    def _current(self, now: Reading) -> int:
        return self._schedule.step(now.system - self._shift)

    def _notice(self, now: Reading) -> None:
        """Detect whether the system clock was set since the last reading."""
        offset = now.system - now.steady
        jump = 0 if self._offset is None else offset - self._offset
        self._offset = offset
        if abs(jump) <= JUMP:
            return
        self.jumps += 1
        self.largest_jump = max(self.largest_jump, jump, key=abs)
        current = self._current(now)
        if jump > 0:
            self._next = max(self._next, current)
        elif self._made - current > MOST_BACK:
            self._next = current
        else:
            self._next = max(self._made, current) + 1
