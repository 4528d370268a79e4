"""Which robots count for a majority: never two sides of a partition, however it was reached."""

from random import Random

import pytest

from swarmabs_core.realtime.electorate import Electorate

SETTLING = 5


def test_half_of_the_robots_go_on_with_the_lowest_id() -> None:
    one, other = Electorate(range(1, 5), SETTLING), Electorate(range(1, 5), SETTLING)
    assert one.hears_majority({1, 4}, 0)
    assert not other.hears_majority({2, 3}, 0)


def test_those_that_a_majority_has_not_heard_for_long_do_not_count() -> None:
    electorate = Electorate(range(1, 9), SETTLING)
    step = 0
    for left in ({1, 2, 3, 4, 5}, {3, 4, 5}, {4, 5}):
        assert electorate.hears_majority(left, step)
        assert not Electorate(range(1, 9), SETTLING).hears_majority({4, 5}, step)
        for _ in range(SETTLING):
            step += 1
            electorate.hears_majority(left, step)
        assert electorate.counted == left


def test_a_minority_adopts_what_a_majority_has_decided_and_comes_back_only_with_it() -> None:
    majority, minority = Electorate(range(1, 6), SETTLING), Electorate(range(1, 6), SETTLING)
    for step in range(SETTLING + 1):
        assert majority.hears_majority({1, 2, 3}, step)
        assert not minority.hears_majority({4, 5}, step)
    minority.learn(majority.since, majority.counted)
    assert not minority.hears_majority({3, 4, 5}, 10), "4 and 5 do not count any more"
    assert minority.hears_majority({2, 3, 4, 5}, 11)


def test_one_that_restarts_among_a_minority_does_not_make_it_a_majority() -> None:
    whole = Electorate(range(1, 6), SETTLING)
    whole.begin(range(1, 6))
    anew = Electorate(range(1, 6), SETTLING)
    anew.learn(whole.since, whole.counted)
    anew.begin({4, 5})
    assert not anew.hears_majority({4, 5}, 100)


def test_one_that_restarts_hears_others_for_long_before_it_makes_them_count() -> None:
    anew = Electorate(range(1, 6), SETTLING)
    anew.learn(50, {1, 2, 3})
    anew.begin(range(1, 6))
    for step in range(100, 100 + SETTLING):
        assert anew.hears_majority(range(1, 6), step)
        assert anew.since == 50
    assert anew.hears_majority(range(1, 6), 100 + SETTLING)
    assert anew.since == 100 + SETTLING


@pytest.mark.parametrize("seed", range(40))
def test_no_two_sides_ever_count_as_a_majority(seed: int) -> None:
    """Robots split and meet again at random, each time for longer than it takes to settle and to tell each other."""
    draw = Random(f"electorate:{seed}")
    robots = range(1, draw.randint(4, 9))
    electorates = {robot: Electorate(robots, SETTLING) for robot in robots}
    step = 0
    for _ in range(30):
        side = {robot: draw.randrange(draw.choice((1, 2, 3))) for robot in robots}
        sides = [{robot for robot in robots if side[robot] == number} for number in range(3)]
        for _ in range(SETTLING + draw.randint(2, 6)):
            step += 1
            going = set()
            for there in filter(None, sides):
                for robot in there:
                    for other in there:
                        electorates[robot].learn(electorates[other].since, electorates[other].counted)
                going |= {min(there) for robot in there if electorates[robot].hears_majority(there, step)}
            assert len(going) <= 1
