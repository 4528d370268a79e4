"""Steering from the page: forwards requests with the right token to the run's socket, and returns the answers."""

from __future__ import annotations

import asyncio
import hmac
import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from swarmabs_run.steering.client import LONGEST_ANSWER, RESTARTS, SOCKET, STATUS, short_path
from swarmabs_view.live import LiveSession
from swarmabs_view.protocol import Answer, Steer, Steering, Unlock

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping
    from pathlib import Path

    from swarmabs_view.live import LiveView
    from swarmabs_view.protocol import Control, Message
    from swarmabs_view.session import Session

STATUS_INTERVAL = 0.5
"""Time between two queries of the current settings, s."""
MOST_WAITING = 32
"""Most requests of a page that wait for an answer."""

_HELD = tuple(name for name in Steering.model_fields if name not in {"v", "type", "open"})

WRONG = "the token is wrong; use the one printed in the terminal of the run"
_WORDS = {
    "pause": "at step {step}, {time:.2f} s",
    **dict.fromkeys(RESTARTS, "the run ends at step {step}, and the next one starts"),
}
"""What is said of the actions whose answer is no first step."""
OVER = "the run accepts no requests: it has not begun or has ended"


async def pause() -> None:
    """Wait until the next query."""
    await asyncio.sleep(STATUS_INTERVAL)


class SteeringBridge:
    """Steers a run on behalf of all pages that know the token.

    `status` holds the current settings; `pause` waits between two queries.
    """

    def __init__(self, folder: Path, token: str, pause: Callable[[], Awaitable[None]] = pause) -> None:
        self._folder = folder
        self._token = token.encode()
        self._pause = pause
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._turn = asyncio.Lock()
        self.status = Steering(open=False)

    async def follow(self) -> None:
        """Keep the status up to date, beginning before the run; never returns."""
        while self._streams is None:
            with suppress(OSError):
                await self._connect()
            await self._pause()
        _, writer = self._streams
        try:
            while (answer := await self._exchange({"action": STATUS})) is not None:
                self.status = Steering(open=True, **{name: answer[name] for name in _HELD})
                await self._pause()
        finally:
            writer.close()
        self.status = Steering(open=False)
        await asyncio.Event().wait()

    def knows(self, token: str) -> bool:
        """Return whether a token is that of the run."""
        return hmac.compare_digest(token.encode(), self._token)

    async def ask(self, request: Steer) -> Answer:
        """Send a request to the run; it is answered when decided, some steps later."""
        if not self.knows(request.token):
            return Answer(request=request.request, ok=False, known=False, text=WRONG)
        asked = request.model_dump(include={"action", "value", "agent", "request"}, exclude_none=True)
        answer = await self._exchange(asked)
        if answer is None:
            return Answer(request=request.request, ok=False, text=OVER)
        if not answer["ok"]:
            return Answer(request=request.request, ok=False, text=str(answer["reason"]))
        text = _WORDS.get(request.action, "from step {step} on, {time:.2f} s").format_map(answer)
        return Answer(request=request.request, ok=True, restarts=request.action in RESTARTS, text=text)

    async def _connect(self) -> None:
        with short_path(self._folder) as place:
            self._streams = await asyncio.open_unix_connection(place / SOCKET, limit=LONGEST_ANSWER)

    async def _exchange(self, asked: Mapping[str, object]) -> dict[str, Any] | None:
        """Return the run's answer, or None if it accepts no requests."""
        async with self._turn:
            if self._streams is None:
                return None
            reader, writer = self._streams
            line = b""
            with suppress(ConnectionError):
                writer.write(json.dumps(asked).encode() + b"\n")
                await writer.drain()
                line = await reader.readline()
            if not line.endswith(b"\n"):
                return None
            answer: dict[str, Any] = json.loads(line)
            return answer


class SteeredSession(LiveSession):
    """The session of a page that shows a steerable run: also sends the settings and the answers to requests."""

    def __init__(self, live: LiveView, after: Callable[[], Session | None], bridge: SteeringBridge) -> None:
        super().__init__(live, after)
        self._bridge = bridge
        self._waiting: set[asyncio.Task[Answer]] = set()
        self._answers: list[Message] = []

    def poll(self, now: float) -> list[Message]:
        """Return the new messages at a time (s) of the clock."""
        messages = super().poll(now)
        if self.over:  # the messages are those of another session
            messages += self._changed(now, (self._bridge.status,))
        messages += self._answers
        self._answers.clear()
        return messages

    def latest(self, now: float) -> Iterable[Message | None]:
        """Return the messages that hold at a time (s)."""
        return (*super().latest(now), self._bridge.status)

    def control(self, request: Control) -> None:
        """Handle a request of the page."""
        if isinstance(request, Unlock):
            if not self._bridge.knows(request.token) and len(self._answers) < MOST_WAITING:
                self._answers.append(Answer(request="", ok=False, known=False, text=WRONG))
        elif not isinstance(request, Steer):
            super().control(request)
        elif len(self._waiting) >= MOST_WAITING:
            self._answers.append(Answer(request=request.request, ok=False, text="too many requests waiting; try again"))
        else:
            task = asyncio.ensure_future(self._bridge.ask(request))
            self._waiting.add(task)
            task.add_done_callback(self._answered)

    def _answered(self, task: asyncio.Task[Answer]) -> None:
        self._waiting.discard(task)
        if not task.cancelled():
            self._answers.append(task.result())
