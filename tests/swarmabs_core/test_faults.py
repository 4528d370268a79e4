from __future__ import annotations

import pytest

from swarmabs_core.faults import lost


def test_draws_are_frozen() -> None:
    """A recorded run with losses can be run again by every later version."""
    assert [step for step in range(40) if lost(0.2, 1, step, 3)] == [1, 2, 15, 17, 24, 26]


@pytest.mark.parametrize("probability", [0.05, 0.2, 0.5, 0.9])
def test_frequency(probability: float) -> None:
    count = sum(lost(probability, 7, step, agent) for step in range(2000) for agent in range(1, 6))
    deviation = (probability * (1.0 - probability) / 10_000) ** 0.5
    assert abs(count / 10_000 - probability) < 4.0 * deviation


def test_never_and_always() -> None:
    assert not any(lost(0.0, 1, step, 1) for step in range(1000))
    assert all(lost(1.0, 1, step, 1) for step in range(1000))


def test_more_probable_losses_contain_the_less_probable() -> None:
    seldom, often = ({s for s in range(500) if lost(p, 1, s, 2)} for p in (0.1, 0.3))
    assert seldom < often


def test_robots_steps_and_seeds_draw_independently() -> None:
    def draws(seed: int, agent: int) -> list[bool]:
        return [lost(0.5, seed, step, agent) for step in range(200)]

    for other in (draws(1, 2), draws(2, 1)):
        agreement = sum(a == b for a, b in zip(draws(1, 1), other, strict=True))
        assert 60 < agreement < 140
    # Seed, step and robot are told apart where their digits meet.
    assert [lost(0.5, 1, 11, a) for a in range(64)] != [lost(0.5, 11, 1, a) for a in range(64)]
