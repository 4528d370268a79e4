"""Declarations: parameters, values and the way back, with texts of errors."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from math import inf

import pytest

from swarmabs_core.declaration import choice, made_of, parameters_of, part, same, setting, tree_of, values_of
from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter, SettingError, Settings


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


def test_parameters_have_names_defaults_and_bounds_of_the_fields() -> None:
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


def test_what_is_chosen_brings_its_settings() -> None:
    table = parameters_of(Painter, {"law.type": "wild"})
    assert table[-2].choices == ("plain", "wild")
    assert table[-1] == Parameter("law.speed", 2.0, "speed, m/s", minimum=0.0)
    assert parameters_of(Painter, {})[-1].name == "law.type"
    with pytest.raises(InputError, match=r"^parameter law\.type: no law 'no'$"):
        parameters_of(Painter, {"law.type": "no"})


PAINTER = Painter(
    7, Colour.BLUE, (Colour.BLUE, Colour.RED), 3, Brush(0.2, 5.0), Brush(0.3), 0.9, "wild", {"speed": 4.0}
)


@pytest.mark.parametrize("painter", [Painter(), PAINTER])
def test_values_lead_back_to_the_instance(painter: Painter) -> None:
    assert made_of(Painter, values_of(painter)) == painter


def test_values_are_those_of_parameters() -> None:
    assert values_of(PAINTER) == {
        "period_ns": 7,
        "colour": "blue",
        "colours": ("blue", "red"),
        "last": 3,
        "brush.width": 0.2,
        "brush.limit": 5.0,
        "width": 0.3,
        "broad.width": 0.9,
        "law.type": "wild",
        "law.speed": 4.0,
    }
    assert values_of(Painter(), "x.")["x.brush.limit"] == 0.0
    for parameter in parameters_of(Painter, values_of(PAINTER)):
        assert parameter.check(values_of(PAINTER)[parameter.name]) == values_of(PAINTER)[parameter.name]


def test_values_that_contradict_each_other_are_refused() -> None:
    values = {**values_of(Painter(), "x."), "x.broad.width": 0.1}
    with pytest.raises(SettingError, match=r"^x\.broad\.width: the broad one is narrow; widen it$"):
        made_of(Painter, values, "x.")


def test_a_file_says_null_for_none() -> None:
    assert tree_of(Brush()) == {"width": 0.5, "limit": None}


def test_only_a_setting_can_be_declared_like_another() -> None:
    with pytest.raises(TypeError, match=r"Painter\.brush is no setting"):
        same(Painter, "brush")
