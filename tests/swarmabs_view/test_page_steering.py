"""Steering from the page: pauses, pushes by dragging on the picture, the next run, and a panel that does not move."""

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect
from tests.swarmabs_view.conftest import PageServer
from tests.swarmabs_view.test_page import STEERED, ask, opened
from tests.swarmabs_view.test_systems import open_page

from swarmabs_view.protocol import Answer, State

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

Point = tuple[float, float]
Drag = Callable[[Page, Point, Point], Callable[[], None]]
"""Drags from a point of the window to another one, and returns what releases it."""


def by_mouse(page: Page, begin: Point, end: Point) -> Callable[[], None]:
    page.mouse.move(*begin)
    page.mouse.down()
    page.mouse.move(*end, steps=3)
    return page.mouse.up


def by_finger(page: Page, begin: Point, end: Point) -> Callable[[], None]:
    devtools = page.context.new_cdp_session(page)

    def touch(kind: str, *points: Point) -> None:
        given = [{"x": x, "y": y} for x, y in points]
        devtools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": given})

    touch("touchStart", begin)
    touch("touchMove", ((begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2))
    touch("touchMove", end)
    page.evaluate("() => new Promise(requestAnimationFrame)")  # the browser tells of moves once per frame
    return partial(touch, "touchEnd")


def place(picture: Locator, across: float, down: float) -> Point:
    """Return a point of the window by its place in the picture, as fractions of its size."""
    box = picture.bounding_box()
    assert box is not None
    return box["x"] + across * box["width"], box["y"] + down * box["height"]


def pushes(server: PageServer) -> list[float]:
    return [wish["value"] for wish in server.heard("steer") if wish["action"] == "push"]


@pytest.mark.parametrize("drag", [by_mouse, by_finger])
@pytest.mark.parametrize(
    ("begin", "end", "value", "said"),
    [
        # Full is the lever from the axis, at the middle, to 0.36 of the width, times 0.3 of the height: 1.6 N m.
        ((0.68, 0.52), (0.68, 0.67), 0.4, "Push 0.40 N m, right side down"),
        ((0.32, 0.52), (0.32, 0.67), -0.4, "Push 0.40 N m, left side down"),
        ((0.32, 0.67), (0.32, 0.52), 0.4, "Push 0.40 N m, right side down"),
        ((0.95, 0.3), (0.95, 0.9), 1.6, "Push 1.6 N m, right side down"),
        ((0.5, 0.3), (0.5, 0.7), None, "No push"),
    ],
)
def test_a_drag_on_the_picture_is_a_push(
    page: Page,
    page_server: PageServer,
    drag: Drag,
    begin: Point,
    end: Point,
    value: float | None,
    said: str,
) -> None:
    opened(page, page_server)
    picture, arrow, label = page.locator("#plane"), page.locator("#push"), page.locator("#pushed")
    expect(picture).to_have_css("touch-action", "none")
    expect(arrow).to_be_hidden()
    release = drag(page, place(picture, *begin), place(picture, *end))
    expect(label).to_have_text(said)
    tip = arrow.locator("path").bounding_box()
    assert tip is not None
    x, y = place(picture, *end)
    assert tip["x"] - 1 <= x <= tip["x"] + tip["width"] + 1
    assert tip["y"] - 1 <= y <= tip["y"] + tip["height"] + 1
    page.keyboard.press("Escape")
    expect(arrow).to_be_hidden()
    release()
    assert pushes(page_server) == []
    drag(page, place(picture, *begin), place(picture, *end))()
    expect(arrow).to_be_hidden()
    assert pushes(page_server) == ([] if value is None else [pytest.approx(value, rel=0.02)])


def test_the_strength_of_a_push_is_typed_and_buttons_push_without_a_mouse(page: Page, page_server: PageServer) -> None:
    opened(page, page_server)
    strength, wrong = page.get_by_label("Push, N m"), page.locator("#wrong-push")
    expect(strength).to_have_value("1.6")
    for typed, why in (
        ("3", "3.00 N m is more than 2.00"),
        ("-1", '"-1" is not a positive number'),
        ("x", '"x" is not a pos'),
    ):
        strength.fill(typed)
        expect(wrong).to_contain_text(why)
        page.get_by_role("button", name="Push left").press("Enter")
    assert pushes(page_server) == []
    strength.fill("0,5")
    expect(wrong).to_be_empty()
    for side in ("left", "right"):
        page.get_by_role("button", name=f"Push {side}").press("Enter")
    expect(page.locator("#steered")).to_have_text("push 0.50: requested")
    assert pushes(page_server) == [-0.5, 0.5]


@pytest.mark.usefixtures("systems")
@pytest.mark.parametrize("disturbed", [False, True])
def test_another_system_is_pushed_to_the_sides_if_it_takes_disturbances(
    page: Page, page_server: PageServer, *, disturbed: bool
) -> None:
    limits = {"largest_disturbance": 1e12 if disturbed else 0.0, "largest_reference": 0.0}
    opened(page, page_server)
    open_page(page_server, "sheet")
    page_server.send(STEERED.model_copy(update=limits))
    expect(page.locator("#steering")).to_be_visible()
    expect(page.locator("#steer-push")).to_be_visible(visible=disturbed)
    picture = page.locator("#plane")
    if disturbed:
        expect(page.get_by_label("Push", exact=True)).to_have_value("1.0")
        page.get_by_label("Push", exact=True).fill("20")
    release = by_mouse(page, place(picture, 0.6, 0.5), place(picture, 0.45, 0.5))
    expect(page.locator("#pushed")).to_have_text("Push 10, to the left" if disturbed else "")
    release()
    assert pushes(page_server) == ([-10.0] if disturbed else [])


def test_who_has_no_token_or_no_connection_pushes_nothing(page: Page, page_server: PageServer) -> None:
    opened(page, page_server, hash_="")
    picture = page.locator("#plane")
    expect(picture).to_have_css("touch-action", "auto")
    by_mouse(page, place(picture, 0.7, 0.5), place(picture, 0.7, 0.8))()
    page.keyboard.press(" ")
    expect(page.locator("#push")).to_be_hidden()
    assert page_server.heard("steer") == []


def test_the_run_is_paused_by_its_button_and_by_the_space_bar(page: Page, page_server: PageServer) -> None:
    opened(page, page_server)
    page.get_by_role("button", name="Pause").click()
    page_server.send(STEERED.model_copy(update={"paused": True}))
    page_server.send(State(phase="paused", text="at step 3"))
    expect(page.locator("#pause")).to_have_text("Resume")
    expect(page.locator("#state")).to_have_text("paused: at step 3")
    page.locator("#steer-reference-value").press(" ")  # is typed
    page.locator("#plane-panel").press(" ")
    assert [wish["action"] for wish in page_server.heard("steer")] == ["pause", "resume"]


@pytest.mark.parametrize("width", [390, 1280])
def test_the_panel_keeps_its_height_whatever_it_says(page: Page, page_server: PageServer, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    opened(page, page_server)
    panel = page.locator("#steering")

    def size() -> tuple[float, float]:
        box = panel.bounding_box()  # its place depends on how far the page is scrolled
        assert box is not None
        return box["width"], box["height"]

    before = size()

    def said(text: str, **answer: Any) -> None:
        ask(page)
        wish = page_server.heard("steer")[-1]
        page_server.send(Answer(**{"request": wish["request"], "ok": False, "text": text, **answer}))
        expect(page.locator("#steered")).to_contain_text(text)
        assert size() == before

    said("from step 7 on, 0.07 s", ok=True)
    said(f"robot 9 does not take part in step 123456; those that do are {', '.join(map(str, range(900, 940)))}")
    for typed in ("abc " * 30, "-7.123456"):
        ask(page, typed)
        expect(page.locator("#wrong-reference")).not_to_be_empty()
        assert size() == before
    ask(page, "0.9")
    for name in ("Yes, set it", "Cancel"):
        expect(page.get_by_role("button", name=name)).to_be_in_viewport(ratio=1.0)
    assert size() == before
    page.get_by_role("button", name="Cancel").click()
    page.get_by_label("Push, N m").fill("no number at all, and a long text")
    page_server.send(STEERED.model_copy(update={"paused": True, "disturbance": -1.23456789, "members": [1]}))
    expect(page.locator("#pause")).to_have_text("Resume")
    assert size() == before


def test_a_robot_keeps_its_place_in_the_lists(page: Page, page_server: PageServer) -> None:
    opened(page, page_server)
    member, absent = page.locator("#member"), page.locator("#steer-absent")
    expect(absent).to_be_hidden()
    member.select_option("robot 2")
    page_server.send(STEERED.model_copy(update={"members": [1]}))  # its frame says that it is dead
    expect(member.locator("option")).to_have_text(["robot 1", "robot 2: dead"])
    expect(member).to_have_value("2")
    expect(member.locator("option").nth(1)).to_be_disabled()
    page_server.send(STEERED.model_copy(update={"members": [1], "absent": [2]}))
    expect(absent).to_be_visible()
    expect(member.locator("option")).to_have_text(["robot 1"])
    page_server.send(STEERED)
    expect(member.locator("option")).to_have_text(["robot 1", "robot 2"])
    expect(page.locator("#absent option")).to_have_text(["robot 2: dead"])
    expect(absent).to_be_visible()


def test_the_page_waits_for_the_next_run_in_its_place(page: Page, page_server: PageServer) -> None:
    opened(page, page_server)
    expect(page.get_by_role("button", name=re.compile("^Start"))).to_have_count(0)
    page_server.send(STEERED.model_copy(update={"restarts": True}))
    page.get_by_role("button", name="Start beside the curve").click()
    wish = page_server.heard("steer")[-1]
    assert wish["action"] == "restart_beside"
    page_server.send(Answer(request=wish["request"], ok=True, restarts=True, text="the next one starts"))
    expect(page.locator("#steered")).to_contain_text("the next one starts")
    page_server.send(STEERED.model_copy(update={"open": False}))
    expect(page.get_by_role("button", name="Pause")).to_be_disabled()
    page_server.first = (*page_server.first[:1], STEERED.model_copy(update={"paused": True, "restarts": True}))
    page_server.close(1001)
    expect(page.locator("#state")).to_have_text("waiting: the next run is starting")
    expect(page.get_by_role("alert")).to_be_hidden()
    expect(page.locator("#steering")).to_be_visible()
    expect(page.locator("#steered")).to_have_text("The next run waits at its first step: resume it.", timeout=10_000)
    expect(page.get_by_role("button", name="Resume")).to_be_enabled()
    page_server.close()
    expect(page.get_by_role("alert")).to_contain_text("Connection lost")


def test_a_page_whose_next_run_does_not_come_says_that_the_connection_is_lost(
    page: Page, page_server: PageServer
) -> None:
    page.add_init_script("const wait = setTimeout; window.setTimeout = (work, ms) => wait(work, ms / 60);")
    opened(page, page_server)
    page_server.send(STEERED.model_copy(update={"restarts": True}))
    page.get_by_role("button", name="Start again").click()
    wish = page_server.heard("steer")[-1]
    page_server.send(Answer(request=wish["request"], ok=True, restarts=True, text="the next one starts"))
    expect(page.locator("#steered")).to_contain_text("the next one starts")
    page_server.refusing = 1011
    page_server.close(1001)
    expect(page.get_by_role("alert")).to_contain_text("Connection lost", timeout=10_000)


def test_nothing_of_the_run_before_is_drawn_before_the_first_step_of_the_next(
    page: Page, page_server: PageServer
) -> None:
    opened(page, page_server)
    drawn = page.locator("#plane, #abstract, .uplot canvas")
    expect(drawn.filter(visible=True)).to_have_count(7)
    hello, *_, step, _ = page_server.first
    page_server.first = (hello.model_copy(update={"place": "there"}), State(phase="paused", text=""))
    page_server.close(1001)
    expect(page.locator("#place")).to_have_text("there", timeout=10_000)
    expect(drawn.filter(visible=True)).to_have_count(0)
    page_server.send(step)
    expect(drawn.filter(visible=True)).to_have_count(7)
