from __future__ import annotations

import pytest
from tests.swarmabs_core.helpers import agent_state

from swarmabs_core.errors import InputError
from swarmabs_core.faults import (
    ClockOffsetFault,
    DelayFault,
    DuplicationFault,
    Falsification,
    InjectedFault,
    LieFault,
    LossFault,
    ReorderingFault,
    true_state,
)


def lost(probability: float, seed: int, step: int, agent_id: int) -> bool:
    return LossFault(probability=probability).loses(f"{seed}:{step}:{agent_id}")


def held_back(probability: float, steps: int, seed: int, step: int, agent_id: int) -> int:
    return ReorderingFault(probability=probability, steps=steps).late(f"{seed}:{step}:{agent_id}")


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


def test_draws_of_other_faults_are_frozen_too() -> None:
    late = [(step, held_back(0.3, 4, 1, step, 3)) for step in range(20)]
    assert [(step, by) for step, by in late if by] == [(3, 4), (5, 1), (7, 1), (8, 2), (13, 4), (15, 4), (17, 2)]
    twice = DuplicationFault(probability=0.3)
    assert [step for step in range(20) if twice.doubles(f"1:{step}:3:state")] == [0, 4, 6, 10, 12, 14, 15, 17, 18, 19]


def test_how_late_broadcasts_come_is_uniform() -> None:
    drawn = [held_back(0.5, 4, 7, step, agent) for step in range(2000) for agent in range(1, 6)]
    late = sum(map(bool, drawn))
    assert abs(late - 5000) < 200
    for steps in (1, 2, 3, 4):
        assert abs(drawn.count(steps) - late / 4) < 4.0 * (late * 3 / 16) ** 0.5


FAULTS = [
    InjectedFault(LossFault(probability=0.25)),
    InjectedFault(DelayFault(steps=2), 10),
    InjectedFault(ReorderingFault(probability=0.1, steps=3), 0, 20),
    InjectedFault(ClockOffsetFault(offset=-1e-9), 3, 4),
    InjectedFault(LieFault(position_offset=0.1, position_factor=-0.3333333333333333, mass_factor=1e-3), 3, 4),
]


@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_a_fault_as_a_parameter(fault: InjectedFault) -> None:
    assert InjectedFault.parse(str(fault)) == fault


@pytest.mark.parametrize(
    "text",
    ["", "loss", "loss 0 -1", "loss 0 -1 a", "loss 0 -1 nan", "loss -2 5 0.1", "loss 0 -1 0.1 0.2", "kill 0 -1 1"],
)
def test_what_is_no_fault_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="is not of the form"):
        InjectedFault.parse(text)


@pytest.mark.parametrize("text", ["3 loss 0 -1 0.1", "lie 0 -1 0 1 2", "3 lie 0 -1 0 0 1", "x lie 0 -1 0 1 2", ""])
def test_what_is_no_lie_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="is not of the form"):
        Falsification.parse(text)


def test_a_lie_is_undone_for_its_robot_while_it_lasts() -> None:
    lie = Falsification.parse("3 lie 10 20 0.05 2.0 0.5")
    assert Falsification.parse(str(lie)) == lie
    said = agent_state(3, 10, mass=0.25, position=0.25)
    assert true_state(said, [lie])[6:9] == (0.5, 0.0, pytest.approx(0.1, abs=1e-15))
    for other in (agent_state(3, 9), agent_state(3, 20), agent_state(2, 10)):
        assert true_state(other, [lie]) is other
