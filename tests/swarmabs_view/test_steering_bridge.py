"""Steering on behalf of pages: the token, the way to the socket of a run, and what is said when there is none."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from tests.swarmabs_view.conftest import HELLO

from swarmabs_bag.shown.swarm_state import SwarmState
from swarmabs_run.steering.client import SOCKET
from swarmabs_view.live import LiveView
from swarmabs_view.protocol import Answer, Message, Steer, Steering
from swarmabs_view.steering_bridge import MOST_WAITING, OVER, WRONG, SteeredSession, SteeringBridge

TOKEN = "secret"
HELD = Steering(open=True, reference=0.1, largest_reference=1.0, largest_disturbance=2.0, members=[1, 3], absent=[7])
STATUS = {
    "ok": True,
    "step": 7,
    "time": 0.07,
    "steps": 100,
    "step_time": 0.01,
    **HELD.model_dump(exclude={"v", "type", "open"}),
}


def steer(token: str = TOKEN, **fields: Any) -> Steer:
    return Steer(v=2, type="steer", token=token, **{"request": "r", "action": "kill", "agent": 3, **fields})


class Looks:
    """The bridge's looks, each of which a test asks for."""

    def __init__(self) -> None:
        self._pausing, self._next = asyncio.Event(), asyncio.Event()

    async def pause(self) -> None:
        self._pausing.set()
        await self._next.wait()
        self._next.clear()

    async def begin(self) -> None:
        """Let the bridge look once more, when it has come to its next pause."""
        await self._pausing.wait()
        self._pausing.clear()
        self._next.set()

    async def one(self) -> None:
        """Let the bridge look once more."""
        await self.begin()
        await self._pausing.wait()


Work = Callable[[SteeringBridge, list[Any], Looks], Awaitable[None]]


def with_run(folder: Path, work: Work, *, answers: int | None = None) -> None:
    """Have somebody at the other end of the socket, who ends after so many answers, and a bridge that is connected."""
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
        looks = Looks()
        bridge = SteeringBridge(folder, TOKEN, looks.pause)
        following = asyncio.ensure_future(bridge.follow())
        await looks.one()  # the run has not begun
        server = await asyncio.start_unix_server(run, folder / SOCKET)
        try:
            assert await bridge.ask(steer()) == Answer(request="r", ok=False, text=OVER)
            assert bridge.status == Steering(open=False)
            await looks.one()
            await work(bridge, heard, looks)
        finally:
            following.cancel()
            await asyncio.wait([following])
            server.close()

    asyncio.run(main())


def test_what_is_asked_with_the_token_reaches_the_run(tmp_path: Path) -> None:
    async def work(bridge: SteeringBridge, heard: list[Any], looks: Looks) -> None:
        await looks.one()
        assert bridge.status == HELD
        done = Answer(request="r", ok=True, text="from step 12 on, 0.12 s")
        assert await bridge.ask(steer()) == done
        assert await bridge.ask(steer(action="reference", agent=None, value=-0.5)) == done
        paused = Answer(request="r", ok=True, text="at step 12, 0.12 s")
        assert await bridge.ask(steer(action="pause", agent=None)) == paused
        last = Answer(request="r", ok=True, restarts=True, text="the run ends at step 12, and the next one starts")
        assert await bridge.ask(steer(action="restart", agent=None)) == last
        assert await bridge.ask(steer(agent=9)) == Answer(request="r", ok=False, text="there is no robot 9")
        asked = [
            {"action": "kill", "agent": 3, "request": "r"},
            {"action": "reference", "value": -0.5, "request": "r"},
            {"action": "pause", "request": "r"},
            {"action": "restart", "request": "r"},
            {"action": "kill", "agent": 9, "request": "r"},
        ]
        assert heard == asked
        for token in ("", "Secret", "secret ", "sécret", "\0"):
            assert await bridge.ask(steer(token)) == Answer(request="r", ok=False, known=False, text=WRONG)
            assert not bridge.knows(token)
        assert bridge.knows("secret")
        assert heard == asked

    with_run(tmp_path, work)


def test_after_a_run_nothing_can_be_asked(tmp_path: Path) -> None:
    async def work(bridge: SteeringBridge, heard: list[Any], looks: Looks) -> None:
        await looks.one()
        assert bridge.status == HELD
        await looks.begin()
        for _ in range(2):  # the bridge's own question is between them
            assert await bridge.ask(steer()) == Answer(request="r", ok=False, text=OVER)
        assert bridge.status == Steering(open=False)
        assert heard == []

    with_run(tmp_path, work, answers=1)


def test_a_page_hears_what_holds_and_its_answers_and_no_other(tmp_path: Path) -> None:
    async def work(bridge: SteeringBridge, _heard: list[Any], looks: Looks) -> None:
        live = LiveView(HELLO, SwarmState())
        one, other = (SteeredSession(live, lambda: None, bridge) for _ in range(2))

        def new(page: SteeredSession) -> list[Message]:
            return [message for message in page.poll(0.0) if isinstance(message, (Steering, Answer))]

        assert new(one) == new(other) == [Steering(open=False)]
        assert new(one) == []
        await looks.one()
        assert new(one) == new(other) == [HELD]
        assert new(one) == new(other) == []
        for number in range(MOST_WAITING + 1):
            one.control(steer(request=str(number)))
        assert new(one) == [Answer(request=str(MOST_WAITING), ok=False, text="too many requests waiting; try again")]
        await asyncio.sleep(0)  # they wait for their turns
        await bridge.ask(steer())  # whose turn is after theirs
        answers = [Answer(request=str(n), ok=True, text="from step 12 on, 0.12 s") for n in range(MOST_WAITING)]
        assert new(one) == answers
        assert new(other) == []
        one.control(steer(request="again"))
        assert new(one) == []
        live.learn(HELLO, SwarmState())  # the page begins anew, and needs what holds once more
        assert new(one) == [HELD]

    with_run(tmp_path, work)
