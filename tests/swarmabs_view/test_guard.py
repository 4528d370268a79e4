"""Who gets an answer from the server, and what the answer allows."""

from __future__ import annotations

import pytest

from swarmabs_view.server import refusal, response_headers

OWN = {"Host": "127.0.0.1:8000"}


@pytest.mark.parametrize(
    "headers",
    [
        OWN,
        {"Host": "localhost:8000"},
        {"Host": "LocalHost:8000", "Origin": "http://localhost:8000"},
        {**OWN, "Origin": "http://127.0.0.1:8000", "Sec-Fetch-Site": "same-origin"},
        {**OWN, "Sec-Fetch-Site": "none"},
    ],
)
def test_the_own_page_is_served(headers: dict[str, str]) -> None:
    assert refusal(headers, 8000, websocket=False) is None


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


def test_a_socket_needs_an_origin() -> None:
    assert refusal(OWN, 8000, websocket=True)
    assert refusal({**OWN, "Origin": "http://127.0.0.1:8000"}, 8000, websocket=True) is None


def test_pages_may_run_what_the_server_delivers_and_nothing_inline() -> None:
    policy = response_headers(8000)["Content-Security-Policy"]
    assert "unsafe" not in policy
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["script-src"] == rules["style-src"] == "'self'"
    assert rules["connect-src"] == "'self' ws://127.0.0.1:8000 ws://localhost:8000"
    assert rules["frame-ancestors"] == "'none'"
