"""The web server of the view: a fixed set of files, and one WebSocket per page.

It answers only pages that it has delivered itself, on this machine. Listening on 127.0.0.1 is not enough to exclude web
pages in the same browser: they can address 127.0.0.1, or a name of their own that resolves to it (DNS rebinding). So
the host name of a request and the origin of the requesting page must be those of the server.
"""

from __future__ import annotations

import asyncio
import signal
from contextlib import suppress
from importlib.resources import files
from typing import TYPE_CHECKING, Protocol
from weakref import WeakSet

from aiohttp import WSCloseCode, WSMsgType, web
from pydantic import ValidationError

from swarmabs_run.ending import TERMINATION, no_more_interrupts
from swarmabs_view.ports import url_of
from swarmabs_view.protocol import CONTROL

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Coroutine, Mapping
    from socket import socket

    from swarmabs_view.protocol import Control, Message

INTERVAL = 1.0 / 40.0
"""Shortest time between two frames for a page, s."""
MOST_PAGES = 16
"""Most pages connected at the same time."""
LONGEST_REQUEST = 4096
"""Largest request of a page, bytes."""
PING = 20.0
"""Interval of the pings that detect a dead page, s."""
MOST_CONNECTIONS = 64
"""Most connections at the same time: those of the pages, and those over which they load files."""
PATIENCE = 10.0
"""Time, s, for a connection to send its first request, to take an answer, and to stay without another request."""
END_SECONDS = 2.0
"""Time that open connections have to close at the end, s."""


class PageSession(Protocol):
    """The messages for one page."""

    def poll(self, now: float) -> list[Message]:
        """Return the new messages at a time (s) of the clock, at first everything that a page needs."""
        ...

    def control(self, request: Control) -> None:
        """Handle a request of the page."""
        ...


_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_FOLDERS = ("static", "third_party/uplot")


def hosts(port: int) -> frozenset[str]:
    """Return the values of the header ``Host`` by which the server may be addressed."""
    return frozenset(f"{name}:{port}" for name in ("127.0.0.1", "localhost"))


def refusal(headers: Mapping[str, str], port: int, *, websocket: bool) -> str | None:
    """Return why a request to this port is rejected, or None.

    For a `websocket`, which carries the data, browsers always send the origin.
    """
    allowed = hosts(port)
    if headers.get("Host", "").lower() not in allowed:
        return "address this server as 127.0.0.1 or localhost"
    origin = headers.get("Origin")
    if origin is None and websocket:
        return "a WebSocket request must have an Origin header"
    if origin is not None and origin.lower() not in {f"http://{host}" for host in allowed}:
        return "requests from pages of other origins are rejected"
    if headers.get("Sec-Fetch-Site", "none") not in {"none", "same-origin"}:
        return "requests from pages of other sites are rejected"
    return None


def response_headers(port: int) -> dict[str, str]:
    """Return the headers of all responses: no external or inline content, no framing, no caching."""
    sockets = " ".join(f"ws://{host}" for host in sorted(hosts(port)))
    return {
        "Content-Security-Policy": (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
            f"connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        ),
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cache-Control": "no-store",
    }


def load_files() -> dict[str, tuple[str, bytes]]:
    """Return all files that the server delivers, type and content by path, so that no request names a file on disk."""
    package = files("swarmabs_view")
    delivered = {}
    for folder in _FOLDERS:
        for item in package.joinpath(folder).iterdir():
            suffix = item.name[item.name.rfind(".") :]
            if suffix in _TYPES:
                delivered[f"/{item.name}"] = (_TYPES[suffix], item.read_bytes())
    delivered["/"] = delivered.pop("/index.html")
    return delivered


class ViewServer:
    """Serves pages on a socket of 127.0.0.1 until it is stopped; `session` creates the session of a new page.

    A connection that sends no request, or does not take the answer, is closed after `patience` s.
    """

    def __init__(self, listener: socket, session: Callable[[], PageSession], *, patience: float = PATIENCE) -> None:
        self._listener = listener
        self._patience = patience
        self._heard: WeakSet[asyncio.BaseTransport] = WeakSet()
        self._port: int = listener.getsockname()[1]
        self._session = session
        self._files = load_files()
        self._headers = response_headers(self._port)
        self._pages: set[web.WebSocketResponse] = set()

    async def run(self, ended: Awaitable[object], *tasks: Awaitable[object]) -> None:
        """Serve until one of the awaitables is done."""
        app = web.Application(middlewares=[self._guarded], client_max_size=LONGEST_REQUEST)
        app.router.add_get("/socket", self._socket)
        app.router.add_get("/{path:.*}", self._file)
        app.on_shutdown.append(self._close)
        runner = web.AppRunner(
            app, access_log=None, shutdown_timeout=END_SECONDS, keepalive_timeout=self._patience, lingering_time=0.0
        )
        await runner.setup()
        assert runner.server is not None  # noqa: S101 - it is set up
        running = [asyncio.ensure_future(one) for one in (*tasks, self._close_idle(runner.server))]
        try:
            await web.SockSite(runner, self._listener).start()
            done, _ = await asyncio.wait([asyncio.ensure_future(ended), *running], return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in running:
                task.cancel()
            await runner.cleanup()

    async def _close_idle(self, server: web.Server) -> None:
        """Close connections without a request, or whose answer is not taken, and those beyond the limit."""
        clock, waiting = asyncio.get_running_loop().time, dict[asyncio.Transport, tuple[int, float]]()
        while True:
            open_ = [c.transport for c in server.connections if isinstance(c.transport, asyncio.Transport)]
            now, before = clock(), waiting
            waiting = {}
            for number, transport in enumerate(open_):
                unsent = transport.get_write_buffer_size()
                if transport in self._heard and not unsent:
                    continue
                size, since = before.get(transport, (unsent, now))
                waiting[transport] = unsent, since if unsent >= size else now
                if now - since >= self._patience or number >= MOST_CONNECTIONS:
                    transport.abort()
            await asyncio.sleep(self._patience / 10.0)

    @web.middleware
    async def _guarded(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        if request.transport is not None:
            self._heard.add(request.transport)
        why = refusal(request.headers, self._port, websocket=request.path == "/socket")
        if why is not None:
            return web.Response(status=403, text=why + "\n", headers=self._headers)
        return await handler(request)

    async def _file(self, request: web.Request) -> web.StreamResponse:
        if request.path not in self._files:
            return web.Response(status=404, text="not found\n", headers=self._headers)
        content_type, content = self._files[request.path]
        return web.Response(body=content, content_type=content_type, charset="utf-8", headers=self._headers)

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        full = len(self._pages) >= MOST_PAGES
        page = web.WebSocketResponse(timeout=END_SECONDS, heartbeat=PING, max_msg_size=LONGEST_REQUEST)
        if not page.can_prepare(request).ok:
            return web.Response(status=400, text="this address is a WebSocket\n", headers=self._headers)
        if full:
            # Scripts cannot read why a connection is rejected, but they can read why one is closed.
            await page.prepare(request)
            await page.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many pages are connected")
            return page
        self._pages.add(page)
        try:
            await page.prepare(request)
            session = self._session()
            sender = asyncio.ensure_future(_send(page, session))
            try:
                await _hear(page, session)
            finally:
                sender.cancel()
                with suppress(asyncio.CancelledError, ConnectionError):
                    await sender
        finally:
            self._pages.discard(page)
        return page

    async def _close(self, _: web.Application) -> None:
        for page in list(self._pages):
            await page.close(code=WSCloseCode.GOING_AWAY)


async def _send(page: web.WebSocketResponse, session: PageSession) -> None:
    """Send new messages to a page. A slow page gets fewer: the next are created only when the last have been sent."""
    clock = asyncio.get_running_loop().time
    while not page.closed:
        begun = clock()
        for message in session.poll(begun):
            await page.send_str(message.model_dump_json())
        await asyncio.sleep(max(0.0, begun + INTERVAL - clock()))


async def _hear(page: web.WebSocketResponse, session: PageSession) -> None:
    """Handle the requests of a page until it disconnects; close the connection on an invalid message."""
    async for heard in page:
        try:
            request = CONTROL.validate_json(heard.data) if heard.type is WSMsgType.TEXT else None
        except ValidationError:
            request = None
        if request is None:
            await page.close(code=WSCloseCode.POLICY_VIOLATION, message=b"not a message of version 2")
            return
        session.control(request)


def serve(
    listener: socket,
    session: Callable[[], PageSession],
    *tasks: Callable[[], Coroutine[None, None, None]],
    ready: Callable[[str], None] | None = None,
) -> None:
    """Serve pages until a signal arrives or one of the tasks is done.

    The tasks are coroutines that run concurrently; `ready` receives the address of the page once it is served.
    """

    async def main() -> None:
        loop = asyncio.get_running_loop()
        asked = asyncio.Event()
        previous = {number: signal.getsignal(number) for number in TERMINATION}
        for number in previous:
            try:
                loop.add_signal_handler(number, asked.set)
            except NotImplementedError:  # on Windows
                signal.signal(number, lambda *_: loop.call_soon_threadsafe(asked.set))
        try:
            if ready is not None:
                ready(url_of(listener))
            await ViewServer(listener, session).run(asked.wait(), *(task() for task in tasks))
        finally:
            for number, handler in previous.items():
                with suppress(NotImplementedError):
                    loop.remove_signal_handler(number)
                signal.signal(number, handler)
            if asked.is_set():  # a terminal and ros2 launch both send the signal
                no_more_interrupts()

    with suppress(KeyboardInterrupt):
        asyncio.run(main())
