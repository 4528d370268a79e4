"""Whom a robot hears that sums up the swarm by itself, as its diagnostics say it."""

import pytest

from swarmabs_core.hearing import Hearing

VALUES = {
    "hears robots": "1 10",
    "neighbours": "3",
    "ages of states, steps": "1:2 2:0 10:7 300:4000",
    "lacks robots": "300",
    "hears a majority": "no",
}


def test_what_is_told_is_what_is_read() -> None:
    hearing = Hearing((1, 10), 3, {1: 2, 2: 0, 10: 7, 300: 4000}, (300,), majority=False)
    assert dict(hearing.values()) == VALUES
    assert Hearing.read({"status": "ACTIVE", **VALUES}) == hearing
    alone = Hearing((), 0, {}, (), majority=True)
    assert Hearing.read(dict(alone.values())) == alone


@pytest.mark.parametrize(
    ("name", "text"),
    [
        *(
            ("hears robots", text)
            for text in ("x", "1 ", "1  2", "-1", "1.0", "01", "0", "2 1", "1 1", "65536", "\u0661")
        ),
        ("hears robots", "1 2 3 4"),  # of 3 neighbours
        ("hears robots", "9" * 5000),
        ("hears robots", " ".join(map(str, range(1, 3000)))),
        *(("neighbours", text) for text in ("", "x", "1 2", "1000000")),
        *(("ages of states, steps", text) for text in ("1", "1:", "1:x", "1:-2", "2:1 1:1", "1:1 1:1", "0:1", "1:2:3")),
        ("lacks robots", "2,3"),
        *(("hears a majority", text) for text in ("", "Yes", "true")),
    ],
)
def test_nonsense_is_ignored(name: str, text: str) -> None:
    assert Hearing.read(VALUES | {name: text}) is None


@pytest.mark.parametrize("name", VALUES)
def test_each_value_is_needed(name: str) -> None:
    assert Hearing.read({key: text for key, text in VALUES.items() if key != name}) is None


@pytest.mark.parametrize(
    ("hearing", "words"),
    [
        (Hearing((1, 2, 3, 4, 5, 6, 7), 7, {1: 0, 2: 3, 8: 0}, (), majority=True), "hears 7 of 7, oldest 3 steps"),
        (Hearing((1,), 2, {1: 1, 3: 900}, (2, 3), majority=True), "hears 1 of 2, oldest 1 step, lacks 2 3"),
        (Hearing((), 2, {}, (1, 2), majority=False), "hears 0 of 2, lacks 1 2, a minority"),
    ],
)
def test_a_state_that_is_too_old_is_not_the_oldest_that_is_used(hearing: Hearing, words: str) -> None:
    assert hearing.words() == words
