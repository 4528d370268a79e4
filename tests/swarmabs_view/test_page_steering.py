"""The panel with which a page steers a run, before a server that does what a test wants."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import Page, expect
from tests.swarmabs_view.conftest import PageServer

from swarmabs_view.protocol import Answer, Steering

pytestmark = pytest.mark.timeout(120)

STEERED = Steering(open=True, largest_reference=1.0, largest_disturbance=2.0, members=[1, 2], absent=[])
TOKEN = "x" * 43


def opened(page: Page, server: PageServer, hash_: str = f"#steer={TOKEN}") -> None:
    """Open the page of a run that is steered."""
    server.open(STEERED, hash_=hash_)
    expect(page.locator("#steering")).to_be_visible()


def ask(page: Page) -> None:
    page.get_by_label("Offset of the reference, rad").fill("0.1")
    page.get_by_role("button", name="Set reference").click()


def test_what_is_asked_when_the_connection_goes_gets_no_answer(page: Page, page_server: PageServer) -> None:
    opened(page, page_server)
    said = page.locator("#steered")
    ask(page)
    expect(said).to_have_text("reference 0.1: asked")
    page.get_by_role("button", name="Kill").click()
    page_server.refusing = True
    page_server.close()
    expect(said).to_contain_text("reference 0.1, kill robot 1: no answer: the connection was lost")
    for name in ("Set reference", "Set disturbance", "Kill", "Freeze", "Take off"):
        expect(page.get_by_role("button", name=name)).to_be_disabled()
    page_server.refusing = False
    expect(page.get_by_role("button", name="Kill")).to_be_enabled(timeout=10_000)
    expect(said).to_contain_text("no answer")
    ask(page)
    wish = page_server.heard("steer")[-1]
    page_server.send(Answer(request=wish["request"], ok=True, text="from step 7 on, 0.07 s"))
    expect(said).to_have_text("reference 0.1: from step 7 on, 0.07 s")
    assert wish["token"] == TOKEN


def test_what_is_asked_of_a_socket_that_is_closing_is_not_sent(page: Page, page_server: PageServer) -> None:
    """Between the end of a connection and the page's hearing of it."""
    opened(page, page_server)
    page.evaluate(
        "() => { window.WebSocket = class extends WebSocket {"
        " constructor(url) { super(url); window.latest = this; } }; }"
    )
    page_server.close()
    expect(page.get_by_role("alert")).to_be_visible()
    expect(page.get_by_role("alert")).to_be_hidden(timeout=10_000)
    page.evaluate("() => { Object.defineProperty(window.latest, 'readyState', { value: 2 }); }")
    ask(page)
    expect(page.locator("#steered")).to_have_text("reference 0.1: not sent: no connection")
    assert page_server.heard("steer") == []


@pytest.mark.parametrize(
    "pasted", [f" {TOKEN}\t", f"http://127.0.0.1:1/#steer={TOKEN}", f"view, to steer: http://x/#steer={TOKEN} "]
)
def test_a_token_is_found_in_what_is_pasted(page: Page, page_server: PageServer, pasted: str) -> None:
    opened(page, page_server, hash_="")
    expect(page.locator("#steer-controls")).to_be_hidden()
    page.get_by_label("Token, from the terminal of the run").fill(pasted)
    page.get_by_role("button", name="Use").click()
    ask(page)
    expect(page.locator("#steered")).to_have_text("reference 0.1: asked")
    assert page_server.heard("steer")[-1]["token"] == TOKEN


def test_what_is_no_token_is_refused_in_the_form(page: Page, page_server: PageServer) -> None:
    opened(page, page_server, hash_=f"#steer={'y' * 101}")
    for text, why in (
        ("y" * 101, "it has more than 100 characters"),
        (f"http://x/#steer={'y' * 5000}", "it has more than 100 characters"),
        ("http://127.0.0.1:1/#steer=", "there is none in it"),
        ("  ", "there is none in it"),
    ):
        page.get_by_label("Token, from the terminal of the run").fill(text)
        page.get_by_role("button", name="Use").click()
        expect(page.locator("#steered")).to_have_text(f"this is no token: {why}")
        expect(page.locator("#steer-token")).to_be_visible()
        expect(page.locator("#steer-controls")).to_be_hidden()
        assert page.evaluate("sessionStorage.getItem('swarmabs-steer')") is None
    assert page_server.heard("steer") == []


def test_a_request_that_the_server_closes_upon_brings_the_form_back(page: Page, page_server: PageServer) -> None:
    opened(page, page_server)
    ask(page)
    expect(page.locator("#steered")).to_have_text("reference 0.1: asked")
    page_server.close(1008)
    expect(page.locator("#steered")).to_have_text("reference 0.1: not done: the program has refused the request")
    expect(page.locator("#steer-token")).to_be_visible()
    assert page.evaluate("sessionStorage.getItem('swarmabs-steer')") is None
    expect(page.get_by_role("alert")).to_be_hidden(timeout=10_000)
    expect(page.locator("#steer-token")).to_be_visible()


def test_the_token_leaves_the_address(page: Page, page_server: PageServer) -> None:
    opened(page, page_server)
    assert not re.search("steer|x{5}", page.url)
