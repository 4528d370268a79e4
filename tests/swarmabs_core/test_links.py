"""Links of robots: their graphs by the eigenvalues of matrices, and what they lose."""

from math import sqrt

import numpy as np
import pytest

from swarmabs_core.errors import InputError
from swarmabs_core.links import Link, Links, LinkSettings


def adjacency(links: Links, ids: list[int]) -> np.ndarray:
    return np.array([[other in links.of(one) for other in ids] for one in ids], float)


@pytest.mark.parametrize("count", [4, 7, 20, 50, 200])
@pytest.mark.parametrize(
    "settings", [LinkSettings(), LinkSettings("ring"), LinkSettings("random", 6), LinkSettings("random", 6, seed=9)]
)
def test_everybody_hears_as_many_as_asked_and_is_reached(settings: LinkSettings, count: int) -> None:
    ids = list(range(3, 3 + count))
    matrix = adjacency(Links(settings, ids), ids)
    degree = {"all": count - 1, "ring": 2, "random": min(6, count - 1)}[settings.type]
    assert (matrix.sum(axis=0) == degree).all() and (matrix == matrix.T).all() and not matrix.trace()
    # A graph is connected if the second smallest eigenvalue of its Laplacian is positive.
    assert np.linalg.eigvalsh(np.diag(matrix.sum(axis=0)) - matrix)[1] > 1e-6


def test_random_links_follow_the_seed_and_are_no_circle() -> None:
    ids = range(1, 51)
    one, same, other = (Links(LinkSettings("random", 6, seed=seed), ids) for seed in (1, 1, 2))
    heard = [[links.of(robot) for robot in ids] for links in (one, same, other)]
    assert heard[0] == heard[1] != heard[2]
    far = sum(min(abs(near - robot), 50 - abs(near - robot)) > 3 for robot in ids for near in one.of(robot))
    assert far > 200  # of 300, if most links are random


def test_links_that_leave_robots_apart_or_do_not_exist_are_refused() -> None:
    pairs = (Link.parse("1 2"), Link.parse("4 3"))
    assert pairs[1] == (3, 4)
    with pytest.raises(InputError, match="robot 3 hears robot 1 on no way"):
        Links(LinkSettings("listed", pairs=pairs), range(1, 5))
    assert Links(LinkSettings("listed", pairs=(*pairs, Link(2, 3))), range(1, 5)).of(2) == (1, 3)
    for settings, problem in (
        (LinkSettings("listed", pairs=(Link(1, 9),)), "there is no robot 9"),
        (LinkSettings("random", 3), "5 robots cannot each hear 3 others"),
        (LinkSettings(sensing=(2, 8)), "links.sensing: there is no robot 8"),
    ):
        with pytest.raises(InputError, match=problem):
            Links(settings, range(1, 6))
    for text in ("1", "1 1", "a b"):
        with pytest.raises(InputError, match="link"):
            Link.parse(text)


def test_the_rest_of_a_ring_is_cut_apart_by_two_ends() -> None:
    ring = Links(LinkSettings("ring"), range(1, 9))
    assert ring.apart([1, 2, 3, 4, 5, 6, 8]) == ()
    assert ring.apart([1, 2, 4, 5, 6, 8]) == (4, 5, 6)


def test_each_message_is_lost_by_its_own_draw() -> None:
    links = Links(LinkSettings("ring", loss=0.3, seed=5), range(1, 11))
    keys = [(step, turn, 1, 2) for step in range(100) for turn in range(40)]
    lost = [links.loses(*key) for key in keys]
    assert abs(sum(lost) - 0.3 * len(keys)) < 5.0 * sqrt(0.21 * len(keys))
    assert lost == [links.loses(*key) for key in keys]
    assert lost != [links.loses(step, turn, 2, 1) for step, turn, *_ in keys]
    assert not any(Links(LinkSettings("ring"), range(1, 11)).loses(*key) for key in keys)
