"""Declarations: parameters, values and the way back, with texts of errors."""

from copy import copy
from dataclasses import dataclass, field
from enum import Enum
from math import inf, nan

import pytest

from swarmabs_core.declaration import choice, made_of, parameters_of, part, same, setting, tree_of, values_of
from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter, SettingError, Settings, Value, resolve
from swarmabs_core.registry import PluginError

RATIO = Parameter("ratio", 0.5, "a share", minimum=0.0, maximum=1.0)
MASS = Parameter("mass", 1.0, "mass, kg", above=0.0)
COUNT = Parameter("count", 3, "how many", minimum=1)
FLAG = Parameter("flag", False, "whether")
NAME = Parameter("name", "a", "which", choices=("a", "b"))
TEXT = Parameter("text", "", "any text")
PAIR = Parameter("pair", (1.0, 2.0), "two numbers", minimum=0.0, length=2)
IDS = Parameter("ids", (1, 2), "robots", minimum=1)
WORDS = Parameter("words", ("x",), "texts")
NONE_YET = Parameter("none_yet", (), "ids of which the default has none", minimum=1, item=0)
ANY_TEXTS = Parameter("any_texts", (), "texts")
ANGLE = Parameter("angle", 0.0, "an angle, rad", below=1.5)


def test_accepts() -> None:
    numbers = (RATIO, 0.0), (MASS, 5e-324), (COUNT, 1), (FLAG, True), (ANGLE, 1.4999)
    texts = (NAME, "b"), (TEXT, "anything"), (WORDS, ("a", "b")), (ANY_TEXTS, ("x",))
    several = (IDS, (7,)), (IDS, ()), (NONE_YET, (2, 1)), (NONE_YET, ())
    for parameter, given in (*numbers, *texts, *several):
        assert repr(parameter.check(given)) == repr(given)  # of the same type: 1 == 1.0 == True


@pytest.mark.parametrize(
    ("parameter", "values", "allowed"),
    [
        (RATIO, (-0.001,), "at least 0"),
        (RATIO, (1.001,), "at most 1"),
        (RATIO, (nan, inf), "a finite number"),
        (RATIO, ("0.5", (0.5,)), "a value of type float"),
        (RATIO, (True,), "not a boolean"),
        (MASS, (0.0,), "more than 0"),
        (COUNT, (0,), "at least 1"),
        (COUNT, (1.0,), "a value of type int"),
        (FLAG, (1, "yes"), "true or false"),
        (NAME, ("c", 1), "one of a, b"),
        (TEXT, (1.0,), "a text"),
        (PAIR, ((1.0,), 1.0), "2 elements"),
        (PAIR, ((1.0, -1.0),), "at least 0"),
        (PAIR, ((1.0, nan),), "a finite number"),
        (IDS, ((1, 0),), "at least 1"),
        (IDS, ((1, 2.0),), "a value of type int"),
        (WORDS, ((1,),), "a text"),
        (NONE_YET, ((0,),), "at least 1"),
        (NONE_YET, (("x",), (1.5,)), "a value of type int"),
        (ANGLE, (1.5,), "less than 1.5"),
    ],
)
def test_refuses(parameter: Parameter, values: tuple[Value, ...], allowed: str) -> None:
    for given in values:
        with pytest.raises(InputError) as refusal:
            parameter.check(given)
        text = str(refusal.value)
        assert text.startswith(f"parameter {parameter.name}: ")
        assert f"give {allowed} ({parameter.description})" in text
        assert "\n" not in text


def test_resolve_fills_in_defaults_converts_and_checks() -> None:
    table = (RATIO, PAIR, FLAG)
    assert resolve(table, {"pair": (3, 4)}, owner="node") == {"ratio": 0.5, "pair": (3.0, 4.0), "flag": False}
    with pytest.raises(InputError, match=r"parameter ratio: 2\.0"):
        resolve(table, {"ratio": 2.0}, owner="node")
    with pytest.raises(InputError, match=r"node has no parameter 'ratios'; it has ratio, pair, flag"):
        resolve(table, {"ratios": 1.0}, owner="node")
    found = [RATIO.check(1), PAIR.check((0, 3.5)), PAIR.check([1.0, 2])]
    assert repr(found) == "[1.0, (0.0, 3.5), (1.0, 2.0)]"


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Brush:
    """A brush."""

    width: float = setting(0.5, "width, m", above=0.0)
    limit: float = setting(inf, "largest force, N", above=0.0, unset=0.0)


@dataclass(frozen=True)
class Law:
    name: str
    settings: tuple[Parameter, ...]


LAWS = {"plain": Law("plain", ()), "wild": Law("wild", (Parameter("speed", 2.0, "speed, m/s", minimum=0.0),))}


def law(name: str) -> Law:
    if name not in LAWS:
        raise InputError(f"no law {name!r}")
    return LAWS[name]


@dataclass(frozen=True)
class Painter:
    """A painter."""

    period_ns: int = setting(10, "period, ns", minimum=1)
    colour: Colour = setting(Colour.RED, "colour", choices=("red", "blue"), make=Colour, say=lambda each: each.value)
    colours: tuple[Colour, ...] = setting((), "further ones", make=Colour, say=lambda each: each.value)
    last: int | None = setting(None, "last stroke", unset=-1)
    brush: Brush = part(Brush, "the brush")
    spare: Brush = part(Brush, "another one", name="", without=("limit",))
    broad: float = same(Brush, "width", name="broad.width")
    law: str = choice(law, {"plain": None}, "plain", "the law")
    law_settings: Settings = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.broad < self.brush.width:
            raise SettingError("broad.width", "the broad one is narrow", "widen it")


def test_parameters_have_names_defaults_and_bounds_of_the_fields_and_of_what_is_chosen() -> None:
    table = {each.name: each for each in parameters_of(Painter)}
    assert list(table) == [
        *("period_ns", "colour", "colours", "last", "brush.width", "brush.limit", "width", "broad.width", "law.type"),
    ]
    assert table["brush.width"] == Parameter("brush.width", 0.5, "width, m", above=0.0)
    assert table["broad.width"] == Parameter("broad.width", 0.5, "width, m", above=0.0)
    assert table["brush.limit"] == Parameter("brush.limit", 0.0, "largest force, N; 0: none", minimum=0.0)
    assert table["last"] == Parameter("last", -1, "last stroke; -1: none", minimum=-1)
    assert table["colour"] == Parameter("colour", "red", "colour", choices=("red", "blue"))
    assert table["law.type"] == Parameter("law.type", "plain", "the law", choices=("plain",))
    table = parameters_of(Painter, {"law.type": "wild"})
    assert table[-2].choices == ("plain", "wild")
    assert table[-1] == Parameter("law.speed", 2.0, "speed, m/s", minimum=0.0)
    with pytest.raises(InputError, match=r"^parameter law\.type: no law 'no'$"):
        parameters_of(Painter, {"law.type": "no"})


PAINTER = Painter(
    7, Colour.BLUE, (Colour.BLUE, Colour.RED), 3, Brush(0.2, 5.0), Brush(0.3), 0.9, "wild", {"speed": 4.0}
)


def test_values_are_those_of_parameters_and_lead_back_to_the_instance() -> None:
    values = values_of(PAINTER)
    assert list(values) == [each.name for each in parameters_of(Painter, values)]
    assert list(values.values()) == [7, "blue", ("blue", "red"), 3, 0.2, 5.0, 0.3, 0.9, "wild", 4.0]
    unset = values_of(Painter(), "x.")
    assert (unset["x.brush.limit"], list(unset)) == (0.0, [f"x.{each.name}" for each in parameters_of(Painter)])
    assert {each.name: each.check(values[each.name]) for each in parameters_of(Painter, values)} == values
    assert [made_of(Painter, values_of(painter)) for painter in (Painter(), PAINTER)] == [Painter(), PAINTER]
    assert tree_of(Brush()) == {"width": 0.5, "limit": None}, "a file says null for none"


def test_values_and_declarations_that_contradict_each_other_are_refused() -> None:
    values = {**values_of(Painter(), "x."), "x.broad.width": 0.1}
    with pytest.raises(SettingError, match=r"^x\.broad\.width: the broad one is narrow; widen it$"):
        made_of(Painter, values, "x.")
    with pytest.raises(TypeError, match=r"Painter\.brush is not a setting"):
        same(Painter, "brush")


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (InputError("a; b", "c; d"), "a; b; c; d"),
        (InputError("a; b"), "a; b"),
        (SettingError("k", "a; b", "c; d"), "k: a; b; c; d"),
        (PluginError("a;\n b", "c; d"), "a; b; c; d"),
    ],
)
def test_errors_keep_problem_and_remedy_apart_in_copies_too(error: InputError, text: str) -> None:
    for one in (error, copy(error)):  # as processes of a sweep exchange them
        assert (str(one), one.problem, one.remedy) == (text, "a; b", "c; d" if text.endswith("d") else "")
