"""Four robots agree on whom they drop from a step, whatever each of them has heard: all courses are tried."""

from typing import Any

import pytest
from tests.swarmabs_core.agreement_search import ALL, DisagreementError, Search

from swarmabs_core.agreement import Agreement, Vote

EACH_OTHER = tuple(ALL & ~(1 << robot) for robot in range(4))
RING = (0b1010, 0b0101, 0b1010, 0b0101)
CHAIN = (0b0010, 0b0101, 0b1010, 0b0100)
STAR = (0b1110, 0b0001, 0b0001, 0b0001)
LAST, FIRST = ((0, 3), (1, 3), (2, 3)), ((1, 0), (2, 0), (3, 0))
"""The others tell of a robot that it is silent."""
BOTH = (*LAST, (0, 2), (1, 2))
HALVES = ((0, 1), (1, 0), (2, 3), (3, 2))
"""Two links of a ring fail, and each end tells of the other one."""
KNOWN = (ALL,) * 4

COURSES = [
    pytest.param(EACH_OTHER, LAST, KNOWN, id="a robot ends when all hold its state"),
    pytest.param(EACH_OTHER, LAST, (7, 7, 15, 15), id="when one of the others holds it"),
    pytest.param(EACH_OTHER, FIRST, (14, 14, 15, 15), id="the one that speaks for all"),
    pytest.param(CHAIN, ((0, 1), (2, 1), (3, 2)), KNOWN, id="a chain breaks"),
    pytest.param(STAR, FIRST, KNOWN, id="a star loses its centre"),
    pytest.param(RING, HALVES, KNOWN, id="a ring breaks in halves"),
]
MORE = [
    pytest.param(EACH_OTHER, LAST, (7, 7, 7, 8), id="nobody else holds its state"),
    pytest.param(RING, HALVES, (9, 6, 6, 9), id="a ring breaks in halves that know only their own states"),
    pytest.param(EACH_OTHER, BOTH, KNOWN, id="two robots end"),
]


def everybody_agrees(links: tuple[int, ...], silences: Any, held: tuple[int, ...]) -> None:
    search = Search(links, silences, held)
    search.run()
    moved = {state.moved for state in search.seen if any(state.done)}
    assert ALL in moved, "silence was wrong, and all go on"
    majorities = {kept for kept in moved if kept.bit_count() > 2 or (kept.bit_count() == 2 and kept & 1)}
    assert moved == majorities


@pytest.mark.parametrize(("links", "silences", "held"), COURSES)
def test_no_course_makes_robots_complete_a_step_with_different_ones(
    links: tuple[int, ...], silences: Any, held: tuple[int, ...]
) -> None:
    everybody_agrees(links, silences, held)


@pytest.mark.full
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("links", "silences", "held"), MORE)
def test_nor_does_any_of_many_more(links: tuple[int, ...], silences: Any, held: tuple[int, ...]) -> None:
    everybody_agrees(links, silences, held)


def test_if_the_plane_answers_too_late_it_notices() -> None:
    """Then robots may drop one with whose state the plane has moved; the plane is told of it, and fails."""
    search = Search(EACH_OTHER, LAST, KNOWN, timely=False)
    search.run()
    assert any(state.clash for state in search.seen)


def test_the_search_finds_what_a_wrong_rule_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Robots that complete a step before the others have voted, or of which half goes on, whichever it is."""
    with monkeypatch.context() as patch:
        patch.setattr(Agreement, "alike", True)
        patch.setattr(Agreement, "settled", True)
        with pytest.raises(DisagreementError):
            Search(EACH_OTHER, LAST, KNOWN).run()
    monkeypatch.setattr(Agreement, "outnumbered", False)
    with pytest.raises(DisagreementError):
        Search(CHAIN, ((1, 2), (2, 1)), (3, 3, 12, 12)).run()


def test_votes_only_grow_in_any_order() -> None:
    votes = {0: Vote(0b1000, 0, 0, 0), 1: Vote(0b1000, 0, 3, 0), 3: Vote(0b0001, 0b0001, 7, 1)}
    found = set()
    for order in ((0, 1, 3), (3, 1, 0), (1, 3, 0, 1, 3)):
        agreement = Agreement(2, EACH_OTHER, ALL, ALL)
        for rank in order:
            agreement.take({rank: votes[rank]}, 15)
        assert not agreement.take(votes, 15), "that is no news"
        found.add((agreement.out, agreement.inside, tuple(sorted(agreement.votes.items()))))
    assert len(found) == 1
    assert agreement.out == 0, "robot 4 is still heard by robot 3"
    assert agreement.tell(0b1000, 15) and agreement.out == 0b1000


def test_an_answer_shows_what_one_that_is_not_reached_any_more_has_decided() -> None:
    """Robot 4 ends; all wait in vain, robot 1 as the last, which decides, tells the plane, and ends."""
    last, both = 0b1000, 0b1001
    votes = {rank: Vote(last, both if rank else last, ALL, last if rank else 0) for rank in range(3)}
    agreement = Agreement(1, EACH_OTHER, ALL, ALL)
    agreement.take(votes | {2: Vote(both, both, ALL, last)}, ALL)
    assert not agreement.settled, "the plane may lack the state of robot 1, too"
    agreement.answer()
    assert agreement.settled
    assert agreement.dropped == last
    agreement.take({2: Vote(waited=both)}, ALL)
    assert not agreement.settled, "robot 3 has waited longer, so the answer may be that to robots 2 and 3"
