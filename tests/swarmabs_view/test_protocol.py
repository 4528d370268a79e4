"""The messages between server and page, and their published schema."""

from typing import Any

import pytest
from pydantic import ValidationError

from swarmabs_view.protocol import CONTROL, FROM_PAGE, FROM_SERVER, VERSION, Pause, Play, Seek, Speed, Steer

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
        ('{"v": 2, "type": "play"}', Play(v=2, type="play")),
        ('{"v": 2, "type": "pause"}', Pause(v=2, type="pause")),
        ('{"v": 2, "type": "seek", "step": 7}', Seek(v=2, type="seek", step=7)),
        ('{"v": 2, "type": "speed", "speed": 2.5}', Speed(v=2, type="speed", speed=2.5)),
        (
            f'{{"v": 2, "type": "steer", "token": "{LONG}", "request": "{LONG}", "action": "kill", "agent": 65535}}',
            Steer(v=2, type="steer", token=LONG, request=LONG, action="kill", agent=65535),
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
        '{"v": 2, "type": "kill"}',
        '{"v": 2, "type": "hello"}',
        '{"v": 2, "type": "play", "more": 1}',
        *(f'{{"v": {version}, "type": "play"}}' for version in ("1", "true", "2.0", '"2"')),
        *(f'{{"v": 2, "type": "seek", "step": {step}}}' for step in ("true", '"7"', -1, 9223372036854775808, 1.5)),
        *(f'{{"v": 2, "type": "speed", "speed": {speed}}}' for speed in ("true", '"2"', 0, 1e9, "NaN")),
        '{"v": 2, "type": "steer", "token": "t", "request": "r", "action": "status"}',
        '{"v": 2, "type": "steer", "request": "r", "action": "kill", "agent": 3}',
        f'{{"v": 2, "type": "steer", "token": "{LONG}x", "request": "r", "action": "kill", "agent": 3}}',
        f'{{"v": 2, "type": "steer", "token": "t", "request": "{LONG}x", "action": "kill", "agent": 3}}',
        '{"v": 2, "type": "steer", "token": "t", "request": "", "action": "kill", "agent": 3}',
        '{"v": 2, "type": "steer", "token": "t", "request": "r", "action": "kill", "agent": 0}',
        '{"v": 2, "type": "steer", "token": "t", "request": "r", "action": "kill", "agent": 65536}',
        '{"v": 2, "type": "steer", "token": "t", "request": "r", "action": "reference", "value": Infinity}',
    ],
)
def test_what_is_no_wish_is_refused(text: str) -> None:
    with pytest.raises(ValidationError):
        CONTROL.validate_json(text)
