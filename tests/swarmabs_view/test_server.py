"""The server as its clients find it: real requests to a real process."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import signal
import socket
import struct
import subprocess
from pathlib import Path
from typing import Any

import psutil
import pytest
from aiohttp import ClientSession, WSCloseCode, WSMsgType, WSServerHandshakeError
from tests.swarmabs_view.conftest import COMMAND, Served, serving

from swarmabs_core.errors import InputError
from swarmabs_view.ports import bound
from swarmabs_view.protocol import FROM_SERVER
from swarmabs_view.server import MOST_PAGES, load_files

pytestmark = pytest.mark.timeout(60)


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


def test_licence_of_what_others_have_written_is_shipped() -> None:
    import swarmabs_view  # noqa: PLC0415

    folder = Path(swarmabs_view.__file__).parent / "third_party" / "uplot"
    assert "MIT License" in (folder / "LICENSE").read_text(encoding="utf-8")
    assert {path.name for path in folder.iterdir()} == {"LICENSE", "uPlot.iife.min.js", "uPlot.min.css"}


@pytest.mark.parametrize(
    "path",
    [
        "/../../../../../../etc/passwd",
        "/..%2f..%2f..%2f..%2fetc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/static/../server.py",
        "//etc/passwd",
        "/index.html/../server.py",
        "/LICENSE",
        "/server.py",
        "/main.js%00.html",
        "/bag_0.mcap",
    ],
)
def test_no_request_reaches_other_files(served: Served, path: str) -> None:
    status, _, body = answer(served, path)
    assert (status, body) == (404, b"not found\n")


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:{port}"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
    ],
)
@pytest.mark.parametrize("path", ["/", "/main.js", "/socket", "/nothing"])
def test_other_hosts_and_origins_are_refused(served: Served, path: str, headers: dict[str, str]) -> None:
    given = {name: text.format(port=served.port) for name, text in headers.items()}
    status, _, body = answer(served, path, **given)
    assert status == 403
    assert b"<" not in body


def test_only_loopback_listens(served: Served) -> None:
    listening = [c.laddr for c in psutil.Process(served.process.pid).net_connections() if c.status == "LISTEN"]
    assert [(address.ip, address.port) for address in listening] == [("127.0.0.1", served.port)]


def test_a_port_that_is_taken_is_refused_and_named(served: Served) -> None:
    with pytest.raises(InputError, match=f"port {served.port} of 127.0.0.1: .*in use; choose another"):
        bound(served.port)


async def hear(
    served: Served, *wishes: str | bytes, origin: str | None = None, until: str = "frame"
) -> list[dict[str, Any]]:
    """Connect, say something, and return what comes up to the first message of a type."""
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
            if found[-1]["type"] == until:
                break
        if not found or found[-1]["type"] != until:
            found.append({"type": "closed", "code": page.close_code})
    return found


def test_what_comes_first_is_valid_and_complete(served: Served) -> None:
    models = {model.__name__.lower(): model for model in FROM_SERVER}
    found = asyncio.run(hear(served))
    assert [message["type"] for message in found] == ["hello", "curves", "events", "frame"]
    for message in found:
        models[message["type"]].model_validate(message)
    assert found[0]["title"] == "pd_het_4"
    assert [event["kind"] for event in found[2]["events"]] == ["DEAD", "LEFT"]


def test_connections_of_other_pages_are_refused(served: Served) -> None:
    with pytest.raises(WSServerHandshakeError) as caught:
        asyncio.run(hear(served, origin="http://evil.example"))
    assert caught.value.status == 403


@pytest.mark.parametrize(
    "wish",
    [
        *("", "x" * 5000, '{"v": 1, "type": "steer"}', '{"v": 9, "type": "play"}', '{"v": true, "type": "play"}'),
        *(b"", b'{"v": 1, "type": "play"}', b"\xff" * 100),
    ],
    ids=repr,
)
def test_who_says_what_is_no_message_is_shown_out_and_others_stay(served: Served, wish: str | bytes) -> None:
    found = asyncio.run(hear(served, wish, until="never"))
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


def test_a_page_that_does_not_read_gets_less_and_costs_no_memory(served: Served) -> None:
    """However much it asks for: what waits for it is bounded by the buffers of its connection."""
    request = (
        f"GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\nOrigin: http://127.0.0.1:{served.port}\r\n"
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )
    with socket.socket() as page:
        page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        page.connect(("127.0.0.1", served.port))
        page.sendall(request.encode())
        process = psutil.Process(served.process.pid)
        before = process.memory_info().rss
        for number in range(3000):
            wish = json.dumps({"v": 1, "type": "seek", "step": number % 400}).encode()
            page.sendall(struct.pack("!BB4x", 0x81, 0x80 | len(wish)) + wish)  # masked with zeros
        assert asyncio.run(hear(served))[-1]["type"] == "frame"  # others are served meanwhile
        assert process.memory_info().rss - before < 20e6


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ends_in_order_while_pages_look(run: Path, number: signal.Signals, nothing_survives: str) -> None:
    async def look(view: Served) -> int | None:
        headers = {"Origin": view.url.rstrip("/")}
        async with ClientSession() as session, session.ws_connect(f"{view.url}socket", headers=headers) as page:
            await page.receive()
            view.process.send_signal(number)
            while (await page.receive()).type is WSMsgType.TEXT:
                pass
            return page.close_code

    with serving(run) as view:
        assert asyncio.run(look(view)) == 1001
        assert view.process.wait(20) == 0
    assert nothing_survives


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "Name a bag, or a swarm by --live."),
        (["x", "--live", "/"], "Name a bag, or a swarm by --live."),
        (["/nowhere"], "/nowhere"),
        (["--live", "no such thing"], "neither the folder of a run nor a namespace"),
        (["--live", "/", "--namespace", "/x"], "give --live the namespace itself"),
    ],
)
def test_refusals(arguments: list[str], text: str, nothing_survives: str) -> None:
    done = subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, check=False, timeout=50)
    assert done.returncode == 2
    assert text in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""
    assert nothing_survives
