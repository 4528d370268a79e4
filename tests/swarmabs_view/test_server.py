"""Who gets an answer from the server, and what: also by real requests, to a server in a thread of this process."""

import asyncio
import http.client
import json
import os
import re
import signal
import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

import pytest
from aiohttp import ClientSession, WSCloseCode, WSMsgType, WSServerHandshakeError
from tests.processes import until

from swarmabs_view.playback import PlaybackSession, open_recording
from swarmabs_view.ports import bound, url_of
from swarmabs_view.protocol import FROM_SERVER, Message, State
from swarmabs_view.server import (
    MOST_CONNECTIONS,
    MOST_PAGES,
    PATIENCE,
    ViewServer,
    load_files,
    refusal,
    response_headers,
    serve,
)

PAUSE = '{"v": 2, "type": "pause"}'


OWN = {"Host": "127.0.0.1:8000"}


@pytest.mark.parametrize(
    "headers",
    [
        OWN,
        {"Host": "localhost:8000"},
        {"Host": "LocalHost:8000", "Origin": "http://localhost:8000"},
        {**OWN, "Origin": "http://127.0.0.1:8000"},
        {**OWN, "Origin": "http://127.0.0.1:8000", "Sec-Fetch-Site": "same-origin"},
        {**OWN, "Sec-Fetch-Site": "none"},
    ],
)
def test_the_own_page_is_served_and_a_socket_needs_an_origin(headers: dict[str, str]) -> None:
    assert refusal(headers, 8000, websocket=False) is None
    assert (refusal(headers, 8000, websocket=True) is None) == ("Origin" in headers)


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Host": "evil.example:8000"},
        {"Host": "127.0.0.1"},
        {"Host": "127.0.0.1:8001"},
        {"Host": "127.0.0.1:8000.evil.example"},
        {"Host": "[::1]:8000"},
        {**OWN, "Origin": "http://evil.example"},
        {**OWN, "Origin": "null"},
        {**OWN, "Origin": ""},
        {**OWN, "Origin": "https://127.0.0.1:8000"},
        {**OWN, "Origin": "http://127.0.0.1:8001"},
        {**OWN, "Origin": "http://127.0.0.1:8000.evil.example"},
        {**OWN, "Sec-Fetch-Site": "cross-site"},
        {**OWN, "Sec-Fetch-Site": "same-site"},
    ],
)
@pytest.mark.parametrize("websocket", [False, True])
def test_others_are_refused(headers: dict[str, str], *, websocket: bool) -> None:
    assert refusal(headers, 8000, websocket=websocket)


def test_pages_may_run_what_the_server_delivers_and_nothing_inline() -> None:
    policy = response_headers(8000)["Content-Security-Policy"]
    assert "unsafe" not in policy
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["script-src"] == rules["style-src"] == "'self'"
    assert rules["connect-src"] == "'self' ws://127.0.0.1:8000 ws://localhost:8000"
    assert rules["frame-ancestors"] == "'none'"


class Served(NamedTuple):
    """A view that is served."""

    url: str
    port: int


@contextmanager
def serving(session: Any, patience: float = PATIENCE) -> Iterator[Served]:
    """Serve sessions to the end of the block."""
    with bound(0) as listener:
        loop, ended = asyncio.new_event_loop(), asyncio.Event()
        server = ViewServer(listener, session, patience=patience)
        thread = Thread(target=lambda: loop.run_until_complete(server.run(ended.wait())))
        thread.start()
        try:
            yield Served(url_of(listener), listener.getsockname()[1])
        finally:
            loop.call_soon_threadsafe(ended.set)
            thread.join()
            loop.close()


@pytest.fixture(scope="module")
def served(run: Path) -> Iterator[Served]:
    recording = open_recording(run)
    with serving(lambda: PlaybackSession(recording)) as view:
        yield view


def answer(served: Served, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    """Ask for a path as it stands, without a library that would tidy it up."""
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=20)
    try:
        connection.putrequest("GET", path, skip_host="Host" in headers)
        for name, text in headers.items():
            connection.putheader(name.replace("_", "-"), text)
        connection.endheaders()
        found = connection.getresponse()
        return found.status, dict(found.getheaders()), found.read()
    finally:
        connection.close()


def test_all_files_are_served_with_their_type_and_policy(served: Served) -> None:
    for path, (content_type, content) in load_files().items():
        status, headers, body = answer(served, path)
        assert (status, body) == (200, content)
        assert headers["Content-Type"].startswith(content_type)
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"


def test_the_page_refers_to_nothing_that_is_not_served() -> None:
    files = load_files()
    page = files["/"][1].decode()
    named = re.findall(r'(?:src|href)="([^"#]+)"', page)
    for content_type, text in files.values():
        if "script" in content_type:
            named += re.findall(r'from "\./([^"]+)"', text.decode())
    assert len(named) > 10
    assert {f"/{name}" for name in named} <= set(files)
    assert "style=" not in page
    assert not re.search(r"\son[a-z]+=", page)
    own = [text for path, (_, text) in files.items() if "uPlot" not in path]
    assert not any(re.search(rb"https?://(?!www\.w3\.org/2000/svg)", text) for text in own)
    assert not any(b"innerHTML" in text or b"insertAdjacentHTML" in text for text in own)


def test_no_request_reaches_other_files(served: Served) -> None:
    for path in (
        *("/../../../../../../etc/passwd", "/..%2f..%2f..%2f..%2fetc/passwd", "/%2e%2e/%2e%2e/etc/passwd"),
        *("/static/../server.py", "//etc/passwd", "/index.html/../server.py", "/main.js%00.html"),
        *("/LICENSE", "/server.py", "/bag_0.mcap"),
    ):
        assert answer(served, path)[::2] == (404, b"not found\n"), path


def test_other_hosts_and_origins_are_refused_everywhere(served: Served) -> None:
    for path in ("/", "/main.js", "/socket", "/nothing"):
        for headers in ({"Host": f"evil.example:{served.port}"}, {"Origin": "null"}, {"Sec_Fetch_Site": "cross-site"}):
            status, _, body = answer(served, path, **headers)
            assert status == 403
            assert b"<" not in body
    assert answer(served, "/socket", Origin=served.url.rstrip("/"))[::2] == (400, b"this address is a WebSocket\n")
    with pytest.raises(WSServerHandshakeError) as caught:
        asyncio.run(hear(served, origin="http://evil.example"))
    assert caught.value.status == 403


async def hear(
    served: Served, *wishes: str | bytes, origin: str | None = None, last: str = "frame", count: int = 1
) -> list[dict[str, Any]]:
    """Connect, say something, and return what comes up to so many messages of a type."""
    url = served.url
    headers = {"Origin": url.rstrip("/") if origin is None else origin}
    found: list[dict[str, Any]] = []
    async with ClientSession() as session, session.ws_connect(f"{url}socket", headers=headers) as page:
        for wish in wishes:
            await (page.send_str(wish) if isinstance(wish, str) else page.send_bytes(wish))
        async for message in page:
            if message.type is not WSMsgType.TEXT:
                break
            found.append(json.loads(message.data))
            count -= found[-1]["type"] == last
            if not count:
                break
        if count:
            found.append({"type": "closed", "code": page.close_code})
    return found


def test_what_comes_first_is_valid_and_complete(served: Served) -> None:
    """Also for a page that says as much as it may."""
    models = {model.__name__.lower(): model for model in FROM_SERVER}
    found = asyncio.run(hear(served, PAUSE.ljust(4095)))
    assert [message["type"] for message in found] == ["hello", "curves", "positions", "events", "frame"]
    for message in found:
        models[message["type"]].model_validate(message)
    assert found[0]["title"] == "pd_het_4"
    assert [event["kind"] for event in found[3]["events"]] == ["DEAD", "LEFT"]


@pytest.mark.parametrize(
    "wish",
    [
        *("", PAUSE.ljust(4096), '{"v": 2, "type": "steer"}', '{"v": 9, "type": "play"}'),
        *(b"", b'{"v": 2, "type": "play"}', b"\xff" * 100),
    ],
)
def test_who_says_what_is_no_message_is_shown_out_and_others_stay(served: Served, wish: str | bytes) -> None:
    found = asyncio.run(hear(served, wish, last="never"))
    assert found[-1]["code"] in {1008, 1009}
    assert asyncio.run(hear(served))[-1]["type"] == "frame"


def test_more_pages_than_allowed_are_refused(served: Served) -> None:
    async def crowd() -> int | None:
        headers = {"Origin": served.url.rstrip("/")}
        async with ClientSession() as session:
            pages = [await session.ws_connect(f"{served.url}socket", headers=headers) for _ in range(MOST_PAGES)]
            one_more = await session.ws_connect(f"{served.url}socket", headers=headers)
            assert (await one_more.receive()).type is WSMsgType.CLOSE
            for page in pages:
                await page.close()
            return one_more.close_code

    assert asyncio.run(crowd()) == WSCloseCode.TRY_AGAIN_LATER


class Flood:
    """Has always more to say than a connection holds; it counts what it says, and is asked for."""

    def __init__(self) -> None:
        self.said = 0
        self.asked = 0

    def poll(self, now: float) -> list[Message]:
        self.said += 1
        return [State(phase="recorded", text=f"{now}" + "x" * 1_000_000)]

    def control(self, request: object) -> None:
        self.asked += 1


@contextmanager
def unread_page(port: int) -> Iterator[socket.socket]:
    """Open the connection of a page that reads nothing and has room for little."""
    with socket.socket() as page:
        page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        page.connect(("127.0.0.1", port))
        page.sendall(
            f"GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n"
            "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
        )
        yield page


def test_a_page_that_does_not_read_gets_less_and_others_are_served_meanwhile() -> None:
    """However much it asks for: nothing more is made for it than the buffers of its connection hold."""
    sessions: list[Flood] = []

    def session() -> Flood:
        sessions.append(Flood())
        return sessions[-1]

    with serving(session) as view, unread_page(view.port) as page:
        wish = b'{"v": 2, "type": "seek", "step": 3}'
        for _ in range(3000):
            page.sendall(struct.pack("!BB4x", 0x81, 0x80 | len(wish)) + wish)  # masked with zeros
        heard = asyncio.run(hear(view, wish.decode(), last="state", count=20))
        assert len(heard) == 20
        until(lambda: sessions[0].asked == 3000, "all that the page asks for is heard")
        assert sessions[0].said < 10 < sessions[1].said


@pytest.mark.parametrize("said", [b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"])
def test_a_connection_without_a_whole_request_is_closed(said: bytes) -> None:
    with serving(Flood, patience=0.2) as view, socket.create_connection(("127.0.0.1", view.port), 20) as client:
        client.sendall(said)
        with suppress(ConnectionResetError):
            assert client.recv(1) == b""
        assert answer(view, "/")[0] == 200


def test_a_page_that_never_reads_is_closed_and_a_loaded_one_stays() -> None:
    with serving(Flood, patience=0.2) as view, unread_page(view.port) as page:
        heard = asyncio.run(hear(view, PAUSE, last="state", count=80))
        assert len(heard) == 80, "longer than the patience"
        page.settimeout(20.0)
        with suppress(ConnectionResetError):
            while page.recv(2**20):  # what has arrived before is read first
                pass


def test_more_connections_than_allowed_are_closed() -> None:
    with serving(Flood, patience=5.0) as view, ExitStack() as stack:
        clients = [
            stack.enter_context(socket.create_connection(("127.0.0.1", view.port), 20))
            for _ in range(MOST_CONNECTIONS + 4)
        ]
        for client in clients[MOST_CONNECTIONS:]:
            with suppress(ConnectionResetError):
                assert client.recv(1) == b""
        clients[0].sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n" % view.port)
        assert clients[0].recv(12) == b"HTTP/1.1 200"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_in_order_while_pages_look(number: signal.Signals) -> None:
    """As `serve` does in the main thread: pages are told, and the handlers are those that were there before."""
    handlers = {each: signal.getsignal(each) for each in signal.Signals if each not in {signal.SIGKILL, signal.SIGSTOP}}
    codes: list[int | None] = []

    async def look(url: str) -> None:
        headers = {"Origin": url.rstrip("/")}
        async with ClientSession() as client, client.ws_connect(f"{url}socket", headers=headers) as page:
            await page.receive()
            os.kill(os.getpid(), number)
            while (await page.receive()).type is WSMsgType.TEXT:
                pass
            codes.append(page.close_code)

    clients: list[Thread] = []

    def ready(url: str) -> None:
        clients.append(Thread(target=lambda: asyncio.run(look(url))))
        clients[0].start()

    with bound(0) as listener:
        serve(listener, Flood, ready=ready)
    clients[0].join()
    assert codes == [WSCloseCode.GOING_AWAY]
    assert {each: signal.getsignal(each) for each in handlers} == handlers
