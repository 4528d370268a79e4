"""The messages between server and page, and their published schema."""

from __future__ import annotations

import importlib.util
import json
from math import inf, nan
from typing import Any

import pytest
from pydantic import ValidationError
from tests.docs.pages import ROOT

from swarmabs_bag.swarm_state import Abstract as ShownAbstract, Instant, ShownRobot, finite
from swarmabs_view.protocol import (
    CONTROL,
    FROM_PAGE,
    FROM_SERVER,
    VERSION,
    Abstract,
    Frame,
    Pause,
    Play,
    RobotStates,
    Seek,
    Speed,
    Steer,
    json_schema,
)

SCHEMA = ROOT / "docs" / "view_messages.schema.json"


def definitions() -> dict[str, Any]:
    found = json.loads(SCHEMA.read_text(encoding="utf-8"))["$defs"]
    assert isinstance(found, dict)
    return found


def test_published_schema_is_that_of_the_models() -> None:
    spec = importlib.util.spec_from_file_location("docs_tables", ROOT / "docs" / "tables.py")
    assert spec is not None
    assert spec.loader is not None
    tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tables)
    assert SCHEMA.read_text(encoding="utf-8") == tables.view_schema(), "run: python docs/tables.py"


@pytest.mark.parametrize("model", [*FROM_SERVER, *FROM_PAGE])
def test_every_message_carries_version_and_type_and_nothing_unknown(model: type[Any]) -> None:
    schema = definitions()[model.__name__]
    assert schema["properties"]["v"]["const"] == VERSION
    assert schema["properties"]["type"]["const"] == model.__name__.lower()
    assert schema["additionalProperties"] is False


def test_schema_says_who_sends_what() -> None:
    found = {name: {ref["$ref"].split("/")[-1] for ref in definitions()[name]["oneOf"]} for name in FROM}
    assert found == FROM
    assert json_schema()["title"] == "swarmabs view messages, version 1"


FROM = {
    "from_server": {"Hello", "Frame", "Sets", "Curves", "Events", "Health", "State", "Steering", "Answer"},
    "from_page": {"Play", "Pause", "Seek", "Speed", "Steer"},
}


def test_numbers_keep_every_bit_and_what_is_not_finite_is_null() -> None:
    values = [0.1 + 0.2, 5e-324, 1.7976931348623157e308, -0.0, 1 / 3]
    states = RobotStates(position=[*values, finite(nan)], velocity=[finite(inf)], command=[], status=["active", None])
    pair = Abstract(torque=1 / 7, inertia=None)
    frame = Frame(
        step=2**63 - 1,
        time=0.01,
        angle=None,
        angular_velocity=None,
        reference=None,
        abstract=pair,
        desired=pair,
        robots=states,
        step_rate=None,
    )
    read = json.loads(frame.model_dump_json())
    assert read["robots"]["position"] == [*values, None]
    assert str(read["robots"]["position"][3]) == "-0.0"
    assert read["robots"]["velocity"] == [None]
    assert read["abstract"] == {"torque": 1 / 7, "inertia": None}
    assert read["step"] == 2**63 - 1


@pytest.mark.parametrize(
    ("text", "wish"),
    [
        ('{"v": 1, "type": "play"}', Play(v=1, type="play")),
        ('{"v": 1, "type": "pause"}', Pause(v=1, type="pause")),
        ('{"v": 1, "type": "seek", "step": 7}', Seek(v=1, type="seek", step=7)),
        ('{"v": 1, "type": "speed", "speed": 2.5}', Speed(v=1, type="speed", speed=2.5)),
        (
            '{"v": 1, "type": "steer", "token": "t", "request": "r", "action": "kill", "agent": 3}',
            Steer(v=1, type="steer", token="t", request="r", action="kill", agent=3),
        ),
    ],
)
def test_wishes_of_a_page(text: str, wish: object) -> None:
    assert CONTROL.validate_json(text) == wish


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"v": 2, "type": "play"}',
        '{"v": true, "type": "play"}',
        '{"v": 1.0, "type": "play"}',
        '{"v": "1", "type": "play"}',
        '{"v": 1, "type": "seek", "step": true}',
        '{"v": 1, "type": "seek", "step": "7"}',
        '{"v": 1, "type": "speed", "speed": "2"}',
        '{"v": 1, "type": "speed", "speed": true}',
        '{"type": "play"}',
        '{"v": 1, "type": "kill"}',
        '{"v": 1, "type": "play", "more": 1}',
        '{"v": 1, "type": "seek", "step": -1}',
        '{"v": 1, "type": "seek", "step": 9223372036854775808}',
        '{"v": 1, "type": "seek", "step": 1.5}',
        '{"v": 1, "type": "speed", "speed": 0}',
        '{"v": 1, "type": "speed", "speed": 1e9}',
        '{"v": 1, "type": "speed", "speed": NaN}',
        '{"v": 1, "type": "hello"}',
        '{"v": 1, "type": "steer", "token": "t", "request": "r", "action": "status"}',
        '{"v": 1, "type": "steer", "request": "r", "action": "kill", "agent": 3}',
        '{"v": 1, "type": "steer", "token": "t", "request": "r", "action": "reference", "value": Infinity}',
    ],
)
def test_what_is_no_wish_is_refused(text: str) -> None:
    with pytest.raises(ValidationError):
        CONTROL.validate_json(text)


INSTANT = Instant(7, 70_000_000, 0.07, 0.1, -0.2, None, ShownAbstract(1.0, None), ShownAbstract(2.0, 0.5))


def test_a_frame_has_all_that_is_shown_but_the_stamp() -> None:
    assert set(Instant._fields) - set(Frame.model_fields) == {"stamp"}
    frame = Frame.of(INSTANT, [ShownRobot(0.5, 0.0, None, "dead"), ShownRobot()], 250.0)
    assert frame.model_dump() == {
        "v": 1,
        "type": "frame",
        "step": 7,
        "time": 0.07,
        "angle": 0.1,
        "angular_velocity": -0.2,
        "reference": None,
        "abstract": {"torque": 1.0, "inertia": None},
        "desired": {"torque": 2.0, "inertia": 0.5},
        "robots": {
            "position": [0.5, None],
            "velocity": [0.0, None],
            "command": [None, None],
            "status": ["dead", None],
        },
        "step_rate": 250.0,
    }
