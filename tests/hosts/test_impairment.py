"""What happens to frames, without any network: the fates of a seeded channel."""

from __future__ import annotations

from itertools import pairwise
from math import sqrt
from typing import Any

import pytest
from tests.hosts.impairment import Channel, Impairment

COUNT = 20_000
SPACING = 1e-4


def fates(how: Impairment, seed: str = "seed") -> list[tuple[float, ...]]:
    channel = Channel(seed)
    channel.impairment = how
    return [channel.departures(frame * SPACING) for frame in range(COUNT)]


def near(found: int, probability: float) -> bool:
    """Whether a number of events is within five standard deviations of what is expected."""
    return abs(found - COUNT * probability) < 5.0 * sqrt(COUNT * probability * (1.0 - probability))


def test_a_perfect_channel_changes_nothing() -> None:
    assert fates(Impairment()) == [(frame * SPACING,) for frame in range(COUNT)]


def test_losses_and_duplicates_are_as_frequent_as_asked() -> None:
    found = fates(Impairment(loss=0.2, duplicate=0.1))
    assert near(sum(fate == () for fate in found), 0.2)
    assert near(sum(len(fate) == 2 for fate in found), 0.8 * 0.1)
    # Losses are independent: a loss follows a loss as often as anything else.
    assert near(sum(a == b == () for a, b in pairwise(found)), 0.04)


def test_jitter_keeps_the_order_and_delays_within_its_bounds() -> None:
    found = fates(Impairment(delay=0.02, jitter=0.01))
    departures = [fate[0] for fate in found]
    assert departures == sorted(departures)
    delays = [due - frame * SPACING for frame, due in enumerate(departures)]
    assert min(delays) >= 0.01 and max(delays) <= 0.03
    assert max(delays) - min(delays) > 0.005


def test_order_is_changed_as_often_as_asked() -> None:
    found = fates(Impairment(delay=0.02, reorder=0.05))
    assert near(sum(fate[0] == frame * SPACING for frame, fate in enumerate(found)), 0.05)


def test_a_shorter_delay_does_not_let_frames_overtake() -> None:
    channel = Channel("seed")
    channel.impairment = Impairment(delay=1.0)
    (first,) = channel.departures(0.0)
    channel.impairment = Impairment()
    assert channel.departures(0.5) == (first,) == (1.0,)
    assert channel.departures(1.5) == (1.5,)


def test_the_seed_decides() -> None:
    how = Impairment(delay=0.02, jitter=0.01, loss=0.2)
    assert fates(how) == fates(how) != fates(how, "another seed")


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"loss": 1.1}, "loss = 1.1 is not within 0 and 1"),
        ({"delay": -1.0}, "delay = -1.0 is not within 0 and 60"),
        ({"delay": float("nan")}, "delay = nan is not"),
        ({"delay": 0.01, "jitter": 0.02}, "jitter 0.02 s is more than the delay, 0.01 s"),
        ({"reorder": 0.1}, "can only overtake"),
    ],
)
def test_nonsense_is_refused(settings: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Impairment(**settings)
