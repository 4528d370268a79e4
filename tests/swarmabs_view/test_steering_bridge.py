"""Steering on behalf of pages: the token, the way to the socket of a run, and what is said when there is none."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from tests.swarmabs_view.test_live import HELLO

from swarmabs_bag.swarm_state import SwarmState
from swarmabs_run.steering.client import SOCKET
from swarmabs_view import steering_bridge as module
from swarmabs_view.live import LiveSession, LiveView
from swarmabs_view.protocol import Answer, Message, Steer, Steering
from swarmabs_view.steering_bridge import MOST_WAITING, OVER, WRONG, SteeredSession, SteeringBridge

TOKEN = "secret"
STATUS = {
    "ok": True,
    "step": 7,
    "time": 0.07,
    "steps": 100,
    "step_time": 0.01,
    "reference": 0.1,
    "disturbance": 0.0,
    "largest_reference": 1.0,
    "largest_disturbance": 2.0,
    "members": [1, 3],
    "absent": [7],
}
HELD = Steering(open=True, reference=0.1, largest_reference=1.0, largest_disturbance=2.0, members=[1, 3], absent=[7])


def steer(token: str = TOKEN, **fields: Any) -> Steer:
    return Steer(v=1, type="steer", token=token, **{"request": "r", "action": "kill", "agent": 3, **fields})


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LOOK_INTERVAL", 0.001)


def with_run(
    folder: Path, work: Callable[[SteeringBridge, list[Any]], Awaitable[None]], *, answers: int | None = None
) -> None:
    """Have somebody at the other end of the socket, who ends after so many answers, and a bridge that follows."""
    heard: list[Any] = []

    async def run(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        left = answers
        while left != 0 and (line := await reader.readline()):
            asked = json.loads(line)
            if asked["action"] == "status":
                answer: dict[str, Any] = STATUS
            else:
                heard.append(asked)
                answer = {"ok": True, "request": 1, "step": 12, "time": 0.12}
                if asked.get("agent") == 9:
                    answer = {"ok": False, "reason": "there is no robot 9"}
            writer.write(json.dumps(answer).encode() + b"\n")
            left = None if left is None else left - 1
        writer.close()

    async def main() -> None:
        bridge = SteeringBridge(folder, TOKEN)
        following = asyncio.ensure_future(bridge.follow())
        server = await asyncio.start_unix_server(run, folder / SOCKET)
        try:
            await work(bridge, heard)
        finally:
            following.cancel()
            await asyncio.wait([following])
            server.close()

    asyncio.run(main())


async def until(condition: Callable[[], object]) -> None:
    while not condition():  # noqa: ASYNC110 - what it waits for has no event
        await asyncio.sleep(0.001)


def test_what_is_asked_with_the_token_reaches_the_run(tmp_path: Path) -> None:
    async def work(bridge: SteeringBridge, heard: list[Any]) -> None:
        await until(lambda: bridge.status == HELD)
        done = Answer(request="r", ok=True, text="from step 12 on, 0.12 s")
        assert await bridge.ask(steer()) == done
        assert await bridge.ask(steer(action="reference", agent=None, value=-0.5)) == done
        assert await bridge.ask(steer(agent=9)) == Answer(request="r", ok=False, text="there is no robot 9")
        assert heard == [
            {"action": "kill", "agent": 3, "request": "r"},
            {"action": "reference", "value": -0.5, "request": "r"},
            {"action": "kill", "agent": 9, "request": "r"},
        ]

    with_run(tmp_path, work)


@pytest.mark.parametrize("token", ["", "Secret", "secret ", "sécret", "\0"])
def test_without_the_token_nothing_is_asked(tmp_path: Path, token: str) -> None:
    async def work(bridge: SteeringBridge, heard: list[Any]) -> None:
        await until(lambda: bridge.status == HELD)
        assert await bridge.ask(steer(token)) == Answer(request="r", ok=False, known=False, text=WRONG)
        assert heard == []

    with_run(tmp_path, work)


def test_before_and_after_a_run_nothing_can_be_asked(tmp_path: Path) -> None:
    async def work(bridge: SteeringBridge, _heard: list[Any]) -> None:
        refused = Answer(request="r", ok=False, text=OVER)
        assert bridge.status == Steering(open=False)
        assert await bridge.ask(steer()) == refused
        await until(lambda: bridge.status.open)
        await until(lambda: not bridge.status.open)
        assert await bridge.ask(steer()) == refused

    with_run(tmp_path, work, answers=2)


def test_a_page_hears_what_holds_and_its_answers_and_no_other(tmp_path: Path) -> None:
    async def work(bridge: SteeringBridge, _heard: list[Any]) -> None:
        live = LiveView(HELLO, SwarmState())
        one, other = (SteeredSession(LiveSession(live), bridge) for _ in range(2))

        def new(page: SteeredSession) -> list[Message]:
            return [message for message in page.poll(0.0) if isinstance(message, (Steering, Answer))]

        assert one.hello()[-1] == other.hello()[-1] == Steering(open=False)
        assert new(one) == []
        await until(lambda: bridge.status == HELD)
        assert new(one) == new(other) == [HELD]
        assert new(one) == new(other) == []
        for number in range(MOST_WAITING + 1):
            one.control(steer(request=str(number)))
        found: list[Message] = []
        while len(found) <= MOST_WAITING:
            found += new(one)
            await asyncio.sleep(0.001)
        texts = {answer.request: answer.text for answer in found if isinstance(answer, Answer)}
        assert texts.pop(str(MOST_WAITING)) == "too many requests wait already"
        assert texts == {str(number): "from step 12 on, 0.12 s" for number in range(MOST_WAITING)}
        assert new(other) == []
        live.learn(HELLO, SwarmState())  # the page begins anew, and needs what holds once more
        assert new(one) == [HELD]

    with_run(tmp_path, work)
