"""The messages between server and page, and their published schema."""

from typing import Any

import pytest
from pydantic import ValidationError

from swarmabs_bag.shown.swarm_state import Abstract as ShownAbstract, Instant, ShownRobot
from swarmabs_view.protocol import CONTROL, FROM_PAGE, FROM_SERVER, VERSION, Frame, Pause, Play, Seek, Speed, Steer

LONG = "x" * 100


@pytest.mark.parametrize("model", [*FROM_SERVER, *FROM_PAGE])
def test_every_message_carries_version_and_type_and_nothing_unknown(model: type[Any]) -> None:
    schema = model.model_json_schema()
    assert schema["properties"]["v"]["const"] == VERSION
    assert schema["properties"]["type"]["const"] == model.__name__.lower()
    assert schema["additionalProperties"] is False


@pytest.mark.parametrize(
    ("text", "wish"),
    [
        ('{"v": 1, "type": "play"}', Play(v=1, type="play")),
        ('{"v": 1, "type": "pause"}', Pause(v=1, type="pause")),
        ('{"v": 1, "type": "seek", "step": 7}', Seek(v=1, type="seek", step=7)),
        ('{"v": 1, "type": "speed", "speed": 2.5}', Speed(v=1, type="speed", speed=2.5)),
        (
            f'{{"v": 1, "type": "steer", "token": "{LONG}", "request": "{LONG}", "action": "kill", "agent": 65535}}',
            Steer(v=1, type="steer", token=LONG, request=LONG, action="kill", agent=65535),
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
        '{"type": "play"}',
        '{"v": 1, "type": "kill"}',
        '{"v": 1, "type": "hello"}',
        '{"v": 1, "type": "play", "more": 1}',
        *(f'{{"v": {version}, "type": "play"}}' for version in ("2", "true", "1.0", '"1"')),
        *(f'{{"v": 1, "type": "seek", "step": {step}}}' for step in ("true", '"7"', -1, 9223372036854775808, 1.5)),
        *(f'{{"v": 1, "type": "speed", "speed": {speed}}}' for speed in ("true", '"2"', 0, 1e9, "NaN")),
        '{"v": 1, "type": "steer", "token": "t", "request": "r", "action": "status"}',
        '{"v": 1, "type": "steer", "request": "r", "action": "kill", "agent": 3}',
        f'{{"v": 1, "type": "steer", "token": "{LONG}x", "request": "r", "action": "kill", "agent": 3}}',
        f'{{"v": 1, "type": "steer", "token": "t", "request": "{LONG}x", "action": "kill", "agent": 3}}',
        '{"v": 1, "type": "steer", "token": "t", "request": "", "action": "kill", "agent": 3}',
        '{"v": 1, "type": "steer", "token": "t", "request": "r", "action": "kill", "agent": 0}',
        '{"v": 1, "type": "steer", "token": "t", "request": "r", "action": "kill", "agent": 65536}',
        '{"v": 1, "type": "steer", "token": "t", "request": "r", "action": "reference", "value": Infinity}',
    ],
)
def test_what_is_no_wish_is_refused(text: str) -> None:
    with pytest.raises(ValidationError):
        CONTROL.validate_json(text)


def test_a_frame_has_all_that_is_shown_but_the_stamp() -> None:
    instant = Instant(7, 70_000_000, 0.07, 0.1, -0.2, None, ShownAbstract(1.0, None), ShownAbstract(2.0, 0.5))
    assert set(Instant._fields) - set(Frame.model_fields) == {"stamp"}
    frame = Frame.of(instant, [ShownRobot(0.5, 0.0, None, "dead"), ShownRobot()], 250.0)
    robots = {"position": [0.5, None], "velocity": [0.0, None], "command": [None, None], "status": ["dead", None]}
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
        "robots": robots,
        "step_rate": 250.0,
    }
