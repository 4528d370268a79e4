"""A quantity that a sensor measures again and again: what is plausible is kept, what is not is refused and counted."""

from __future__ import annotations

from dataclasses import dataclass
from math import expm1
from typing import NamedTuple

from swarmabs_core.realtime.readings import RefusedReadingError, check_finite


class Sample(NamedTuple):
    """Time (ns since 1970), value and rate of change (per s)."""

    stamp: int
    value: float
    rate: float


@dataclass(frozen=True, slots=True)
class Plausible:
    """What is believed.

    Parameters
    ----------
    rate : float
        Largest rate of change, per s.
    jump : float
        By how much two values may differ beyond that, because of noise.
    clock_tolerance_ns : int
        How far a stamp may lie in the future, ns.
    """

    rate: float
    jump: float
    clock_tolerance_ns: int


SETTLING = 5.0
"""Time constants after which a differentiated rate is believed: less than 1 % of its first error is left."""


class Track:
    r"""The newest plausible sample.

    A value further away than rate and jump allow is refused, but the longer the last good one is ago, the further it
    may be: what has really been moved is believed again after a while.

    Parameters
    ----------
    plausible : Plausible
        What is believed.
    bandwidth : float
        Where a reading brings no rate, it is differentiated: :math:`\dot r = \omega (\dot x - r)` with this
        :math:`\omega` in rad/s, solved exactly for values that lie on straight lines between readings. It begins with 0
        and is believed when that is forgotten.
    """

    def __init__(self, plausible: Plausible, bandwidth: float) -> None:
        self._plausible = plausible
        self._bandwidth = bandwidth
        self._last: Sample | None = None
        self._believed_from = 0
        self._moved = False

    @property
    def newest(self) -> Sample | None:
        """The newest sample; None before the first, and while its rate is not yet known."""
        last = self._last
        return None if last is None or last.stamp < self._believed_from else last

    def offer(self, stamp: int, value: float, rate: float | None, now: int) -> None:
        """Take over a reading; rate None if the sensor brings none.

        Raises
        ------
        RefusedReadingError
            If it is not plausible; then the newest sample stays.
        """
        limits = self._plausible
        check_finite(value, 0.0 if rate is None else rate)
        latest = now + limits.clock_tolerance_ns
        if stamp <= 0:
            raise RefusedReadingError("no stamp", "the message has no time stamp")
        if stamp > latest:
            raise RefusedReadingError("future", f"{(stamp - now) / 1e9:.3f} s from the future")
        last = self._last
        if last is not None and last.stamp > latest:  # the clock was set back: what came before tells nothing now
            last = None
        if last is not None:
            if stamp <= last.stamp:
                raise RefusedReadingError("order", f"{(last.stamp - stamp) / 1e9:.6f} s older than the last one")
            if abs(value - last.value) > limits.rate * (stamp - last.stamp) / 1e9 + limits.jump:
                self._moved = True
                raise RefusedReadingError("jump", f"from {last.value:.4g} to {value:.4g}")
        believed_from = 0
        if rate is None:
            if last is None or self._moved:
                rate, believed_from = 0.0, stamp + round(SETTLING / self._bandwidth * 1e9)
            else:
                rate, believed_from = self._differentiate(last, stamp, value), self._believed_from
        if abs(rate) > limits.rate:
            raise RefusedReadingError("speed", f"rate {rate:.4g}, at most {limits.rate:.4g} is plausible")
        self._last, self._believed_from, self._moved = Sample(stamp, value, rate), believed_from, False

    def _differentiate(self, last: Sample, stamp: int, value: float) -> float:
        elapsed = (stamp - last.stamp) / 1e9
        return last.rate - expm1(-self._bandwidth * elapsed) * ((value - last.value) / elapsed - last.rate)


class RefusedReadings:
    """How often readings were refused, by reason, and the last of them."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.last = ""

    def add(self, error: RefusedReadingError) -> None:
        """Count a refusal."""
        self.counts[error.reason] = self.counts.get(error.reason, 0) + 1
        self.last = str(error)

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the counts as figures of a state of health."""
        counts = tuple((f"readings refused, {reason}", str(count)) for reason, count in sorted(self.counts.items()))
        return (*counts, ("last reading refused", self.last)) if self.last else counts
