from __future__ import annotations

from math import inf, nan

import pytest

from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter, Value, resolve

RATIO = Parameter("ratio", 0.5, "a share", minimum=0.0, maximum=1.0)
MASS = Parameter("mass", 1.0, "mass, kg", above=0.0)
COUNT = Parameter("count", 3, "how many", minimum=1)
FLAG = Parameter("flag", False, "whether")
NAME = Parameter("name", "a", "which", choices=("a", "b"))
TEXT = Parameter("text", "", "any text")
PAIR = Parameter("pair", (1.0, 2.0), "two numbers", minimum=0.0, length=2)
IDS = Parameter("ids", (1, 2), "robots", minimum=1)
WORDS = Parameter("words", ("x",), "texts")


@pytest.mark.parametrize(
    ("parameter", "given", "expected"),
    [
        (RATIO, 0.0, 0.0),
        (RATIO, 1, 1.0),
        (MASS, 5e-324, 5e-324),
        (COUNT, 1, 1),
        (FLAG, True, True),
        (NAME, "b", "b"),
        (TEXT, "anything", "anything"),
        (PAIR, (0, 3.5), (0.0, 3.5)),
        (PAIR, [1.0, 2], (1.0, 2.0)),
        (IDS, (7,), (7,)),
        (IDS, (), ()),
        (WORDS, ("a", "b"), ("a", "b")),
    ],
)
def test_accepts(parameter: Parameter, given: Value, expected: Value) -> None:
    found = parameter.check(given)
    assert found == expected
    assert repr(found) == repr(expected)  # of the same type: 1 == 1.0 == True


@pytest.mark.parametrize(
    ("parameter", "given", "allowed"),
    [
        (RATIO, -0.001, "at least 0"),
        (RATIO, 1.001, "at most 1"),
        (RATIO, nan, "a finite number"),
        (RATIO, inf, "a finite number"),
        (RATIO, "0.5", "a value of type float"),
        (RATIO, True, "not a boolean"),
        (RATIO, (0.5,), "a value of type float"),
        (MASS, 0.0, "more than 0"),
        (COUNT, 0, "at least 1"),
        (COUNT, 1.0, "a value of type int"),
        (FLAG, 1, "true or false"),
        (FLAG, "yes", "true or false"),
        (NAME, "c", "one of a, b"),
        (NAME, 1, "one of a, b"),
        (TEXT, 1.0, "a text"),
        (PAIR, (1.0,), "2 elements"),
        (PAIR, 1.0, "2 elements"),
        (PAIR, (1.0, -1.0), "at least 0"),
        (PAIR, (1.0, nan), "a finite number"),
        (IDS, (1, 0), "at least 1"),
        (IDS, (1, 2.0), "a value of type int"),
        (WORDS, (1,), "a text"),
    ],
)
def test_refuses(parameter: Parameter, given: Value, allowed: str) -> None:
    with pytest.raises(InputError) as refusal:
        parameter.check(given)
    text = str(refusal.value)
    assert text.startswith(f"parameter {parameter.name}: ")
    assert f"give {allowed} ({parameter.description})" in text
    assert "\n" not in text


def test_resolve_fills_in_defaults_and_checks() -> None:
    table = (RATIO, PAIR, FLAG)
    assert resolve(table, {"pair": (3, 4)}, owner="node") == {"ratio": 0.5, "pair": (3.0, 4.0), "flag": False}
    with pytest.raises(InputError, match=r"parameter ratio: 2\.0"):
        resolve(table, {"ratio": 2.0}, owner="node")


def test_resolve_names_unknown_parameters() -> None:
    with pytest.raises(InputError, match=r"node has no parameter 'ratios'; it has ratio, pair"):
        resolve((RATIO, PAIR), {"ratios": 1.0}, owner="node")


def test_an_empty_array_says_what_its_items_are() -> None:
    numbers = Parameter("ids", (), "ids", minimum=1, item=0)
    assert numbers.check((2, 1)) == (2, 1)
    assert numbers.check(()) == ()
    for wrong in ((0,), ("x",), (1.5,)):
        with pytest.raises(InputError, match="parameter ids"):
            numbers.check(wrong)
    assert Parameter("words", (), "texts").check(("x",)) == ("x",)
