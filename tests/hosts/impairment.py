"""What a bad network does to the frames of one direction of one cable: a pure state machine, time is an argument."""

from __future__ import annotations

from dataclasses import dataclass, fields
from random import Random


@dataclass(frozen=True)
class Impairment:
    """Delay and jitter in s (uniform in delay ± jitter), the others as probabilities per frame.

    The order is kept, however large the jitter, unless `reorder` asks otherwise: such a frame skips the delay, as in
    netem, so it overtakes those that wait.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            limit = 1.0 if field.name in {"loss", "duplicate", "reorder"} else 60.0
            if not 0.0 <= value <= limit:
                raise ValueError(f"{field.name} = {value} is not within 0 and {limit:g}")
        if self.jitter > self.delay:
            raise ValueError(f"jitter {self.jitter} s is more than the delay, {self.delay} s")
        if self.reorder and not self.delay:
            raise ValueError("a frame can only overtake others where these are delayed")


PERFECT = Impairment()


class Channel:
    """One direction of one cable. The fate of the n-th frame depends on the seed and on n only."""

    def __init__(self, seed: str) -> None:
        self.impairment = PERFECT
        self._draw = Random(seed).random
        self._last = 0.0

    def departures(self, now: float) -> tuple[float, ...]:
        """Return when a frame that arrives now leaves, s: not at all if it is lost, twice if it is duplicated."""
        how = self.impairment
        lost, doubled, overtakes, where = (self._draw() for _ in range(4))
        if lost < how.loss:
            return ()
        if overtakes < how.reorder:
            due = now
        else:
            due = now + how.delay + (2.0 * where - 1.0) * how.jitter
            # Also when the delay has just been shortened.
            due = self._last = max(due, self._last)
        return (due, due) if doubled < how.duplicate else (due,)
