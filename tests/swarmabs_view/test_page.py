"""The page, driven in a real browser: what it shows is what the bag holds, and its controls do what they say."""

import re
import signal
from math import nan
from pathlib import Path
from typing import get_args

import pytest
from playwright.sync_api import Browser, FloatRect, Locator, Page, expect
from tests.swarmabs_analysis.figures.conftest import ReadBag
from tests.swarmabs_analysis.report.conftest import SCENARIO, messages, write
from tests.swarmabs_bag.sample_run import PERIOD
from tests.swarmabs_view.conftest import (
    HELLO,
    PRESENTER,
    PageServer,
    Served,
    curves,
    frame_of,
    load,
    number,
    seek,
    serving,
)

from swarmabs_core.events import EventCode
from swarmabs_core.messages import EventKind, SwarmEvent
from swarmabs_view.protocol import Answer, Event, Events, Phase, Row, State, Steering

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

MARKUP = "<img src=x onerror=document.title='broken'><script>document.title='broken'</script>"
TRY_AGAIN_LATER = 1013
NAME = "x<img src=q onerror=alert(1)>&amp;"


SHADED = """
const drawing = CanvasRenderingContext2D.prototype;
const { beginPath, lineTo, fill } = drawing;
let path = [];
window.shaded = [];
drawing.beginPath = function () { path = []; beginPath.call(this); };
drawing.lineTo = function (x, y) { path.push([x, y]); lineTo.call(this, x, y); };
drawing.fill = function () {
  if (this.canvas.id === "abstract" && path.length > 100) {
    window.shaded = [...window.shaded, path].slice(-2);
  }
  fill.call(this);
};
"""
"""Keeps what is shaded in the picture of the abstract state: the outlines of both sets."""


def test_pictures_say_what_they_show_and_what_is_shaded_follows_who_takes_part(page: Page, served: Served) -> None:
    page.add_init_script(SHADED)
    load(page, served)
    page.keyboard.press("z")  # the whole, in which nothing moves but what is shaded
    said = "The plane at 0 s: angle 0.1000 rad, which is 5.73 degrees; 4 robots, listed in the table of robots"
    expect(page.locator("#plane")).to_have_attribute("aria-label", said)
    assert " N m, desired" in (page.locator("#abstract").get_attribute("aria-label") or "")
    canvases = [page.locator(f"#{name}") for name in ("plane", "abstract")]
    before = [canvas.evaluate("(canvas) => canvas.toDataURL()") for canvas in canvases]
    expect(page.locator(".uplot canvas")).to_have_count(6)
    whole = page.evaluate("JSON.stringify(window.shaded)")
    assert whole.count("],[") > 200
    seek(page, 100)
    assert page.evaluate("JSON.stringify(window.shaded)") == whole
    seek(page, 101)  # robot 1 is dead
    page.wait_for_function("(whole) => JSON.stringify(window.shaded) !== whole", arg=whole)
    seek(page, 50)
    page.wait_for_function("(whole) => JSON.stringify(window.shaded) === whole", arg=whole)
    seek(page, 300)
    for canvas, drawn in zip(canvases, before, strict=True):
        page.wait_for_function(
            "([canvas, drawn]) => canvas.toDataURL() !== drawn", arg=[canvas.element_handle(), drawn]
        )


def test_numbers_are_those_in_the_bag_and_who_is_out_is_told_in_words(page: Page, served: Served) -> None:
    read = ReadBag(served.run)  # an independent reader
    topics = {"plane/state": "", "swarm/abstract_state": "", "swarm/desired_abstract_state": "desired_"}
    load(page, served)
    rows = page.locator("#robots tbody tr")
    expect(rows).to_have_count(4)
    for step in (57, 200, 399, 400, 0):
        seek(page, step)
        assert number(page, "error") == -number(page, "angle")
        for topic, prefix in topics.items():
            for field in ("angle", "angular_velocity") if topic == "plane/state" else ("torque", "inertia"):
                assert number(page, prefix + field) == read.column(f"/{topic}", field)[step], (topic, field)
        # What is to be read is the same number, rounded.
        assert float(page.locator("#parent-0").inner_text()) == pytest.approx(number(page, "angle"), rel=1e-4)
        columns = {"position": "coordinates-0", "velocity": "velocities-0", "command": "command-0"}
        dead, left = {"velocity": 0.0, "command": None}, dict.fromkeys(columns)
        for index, robot in enumerate((1, 2, 3, 4)):
            gone: dict[str, float | None] = dead if robot == 1 and step > 100 else {}
            gone = {**left} if robot == 2 and step >= 200 else gone
            for field, column in columns.items():
                recorded = read.column("/swarm/agent_state", field, robot)
                value = gone.get(field, recorded[min(step, len(recorded) - 1)])
                cell = rows.nth(index).locator(f"[data-field={column}]")
                # The table follows at most four times a second.
                page.wait_for_function(
                    "([cell, value]) => Object.is(parseFloat(cell.getAttribute('value') || 'nan'), value ?? NaN)",
                    arg=[cell.element_handle(), None if value is None else float(value)],
                )
    seek(page, 400)
    for index, word in enumerate(("dead", "left", "active", "active")):
        expect(rows.nth(index).locator("td").nth(1)).to_have_text(word)
    expect(page.locator("#following")).to_have_text("2 of 4")
    events = page.locator("#events li")
    expect(events).to_have_count(2)
    expect(events.nth(1)).to_contain_text("1.01 s, step 101: robot 1, dead")
    expect(page.locator("#events li.future")).to_have_count(0)
    seek(page, 150)
    expect(page.locator("#events li.future")).to_have_count(1)


def test_buttons_keys_and_slider_move_the_playback(page: Page, served: Served) -> None:
    load(page, served)
    step, slider, speed = page.locator("#step"), page.get_by_label("Step shown"), page.get_by_label("Speed")

    def expect_step(found: float) -> None:
        expect(step).to_have_attribute("value", f"{found:.0f}")

    for button, found in (("One step forward", 1), ("Last step", 400), ("One step back", 399)):
        page.get_by_role("button", name=button).click()
        expect_step(found)
    page.locator("h1").click()
    for key, found in (("Home", 0), ("ArrowRight", 1), ("Shift+ArrowRight", 101), ("ArrowLeft", 100), ("End", 400)):
        page.keyboard.press(key)
        expect_step(found)
    page.keyboard.press("Home")
    for key, count in (("ArrowRight", 67), ("ArrowLeft", 20)):  # in quick succession they all count
        for _ in range(count):
            page.keyboard.press(key)
    expect_step(47)
    expect(slider).to_have_value("47")
    slider.click()
    expect(slider).to_be_focused()
    expect(step).not_to_have_attribute("value", "47")
    begin = number(page, "step")
    for key, found in (("Shift+ArrowRight", begin + 100), ("ArrowLeft", begin + 99), ("Home", 0)):
        page.keyboard.press(key)
        expect_step(found)
    for key, value in (("+", "2"), ("-", "1"), *(("+", each) for each in ("2", "5", "10", "25", "50", "100", "100"))):
        page.keyboard.press(key)
        expect(speed).to_have_value(value)
    speed.select_option("0.1")
    slider.focus()
    page.keyboard.press("Space")
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
    expect(slider).to_be_focused()


def test_plays_pauses_changes_its_speed_and_goes_to_where_a_curve_is_clicked(page: Page, served: Served) -> None:
    load(page, served)
    play, pause = (page.get_by_role("button", name=name, exact=True) for name in ("Play", "Pause"))
    rate = page.locator("#step_rate")
    expect(rate).to_have_text("–")
    page.get_by_label("Speed").select_option("0.1")
    play.click()
    expect(rate).to_have_text("10")
    expect(page.locator("#step")).not_to_have_attribute("value", "0")
    pause.click()
    expect(play).to_be_visible()
    expect(rate).to_have_text("–")
    where = number(page, "step")  # frames come before the state that they lead to
    page.get_by_role("button", name="One step forward").click()
    expect(page.locator("#step")).to_have_attribute("value", f"{where + 1:.0f}")
    page.get_by_label("Speed").select_option("5")
    page.locator("h1").click()
    page.keyboard.press("Space")
    expect(page.locator("#step")).to_have_attribute("value", "400")  # it runs to the end and stops there
    expect(play).to_be_visible()
    page.locator("#chart-0 .u-over").click()  # in the middle of it
    expect(page.locator("#step")).not_to_have_attribute("value", "400")
    assert abs(number(page, "step") - 200) <= 3


def test_a_lost_connection_is_shown_and_the_page_goes_on_where_it_was(page: Page, run: Path, faults: list[str]) -> None:
    with serving(run) as first:
        port = first.port
        load(page, first)
        seek(page, 123)
        first.process.send_signal(signal.SIGKILL)
        lost = page.get_by_role("alert")
        expect(lost).to_be_visible()
        expect(lost).to_contain_text("Connection lost")
        expect(page.locator("#state")).to_have_attribute("data-phase", "lost")
    with serving(run, port):
        expect(lost).to_be_hidden(timeout=20_000)
        expect(page.locator("#state")).to_have_attribute("data-phase", "recorded")
        expect(page.locator("#step")).to_have_attribute("value", "123")
        page.get_by_role("button", name="One step forward").click()
        expect(page.locator("#step")).to_have_attribute("value", "124")
        page.close()  # or it would try again when this program ends
    assert all("net::ERR_CONNECTION_" in fault for fault in faults)  # of the end, and of the tries in between
    faults.clear()


def test_one_page_too_many_says_so_and_gets_its_turn(page: Page, page_server: PageServer) -> None:
    page_server.open()
    page_server.refusing = TRY_AGAIN_LATER
    page_server.close()
    lost = page.get_by_role("alert")
    expect(lost).to_contain_text("Too many pages")
    expect(page.locator("#state")).to_have_text("lost: too many pages")
    page_server.refusing = 0
    expect(lost).to_be_hidden(timeout=20_000)


def test_a_program_that_hangs_counts_as_lost_and_comes_back(page: Page, run: Path, faults: list[str]) -> None:
    with serving(run) as view:
        load(page, view)
        seek(page, 50)
        view.process.send_signal(signal.SIGSTOP)
        page.locator("h1").click()
        page.keyboard.press("Shift+ArrowRight")  # is on its way when the connection is given up
        expect(page.get_by_role("alert")).to_be_visible(timeout=20_000)
        expect(page.get_by_label("Step shown")).to_be_disabled()
        expect(page.get_by_role("button", name="Play", exact=True)).to_be_disabled()
        page.keyboard.press("End")  # nothing can be played meanwhile
        view.process.send_signal(signal.SIGCONT)
        expect(page.get_by_role("alert")).to_be_hidden(timeout=20_000)
        expect(page.get_by_label("Step shown")).to_be_enabled()
        expect(page.locator("#step")).to_have_attribute("value", "150")
        page.close()  # or it would try again when this program ends
    faults.clear()  # connections that were given up


def test_a_robot_that_is_pointed_to_says_who_it_is(page: Page, served: Served) -> None:
    load(page, served)
    seek(page, 150)  # robot 1 is dead
    box = page.locator("#plane").bounding_box()
    assert box is not None
    pointed = page.locator("#pointed")
    found = set()
    for x in range(0, int(box["width"]), 8):
        for part in (0.36, 0.44, 0.52, 0.6, 0.68):
            page.mouse.move(box["x"] + x, box["y"] + part * box["height"])
            if pointed.is_visible():
                found.add(pointed.inner_text())
    position = page.locator("#robots tbody tr").nth(0).locator("[data-field=coordinates-0]").get_attribute("value")
    assert {text.partition(",")[0] for text in found} == {
        *("robot 1: dead", "robot 2: active", "robot 3: active", "robot 4: active")
    }
    assert any(f"robot 1: dead, position {float(position or 'nan'):.4f}"[:29] in text for text in found)
    page.mouse.move(5, 5)
    expect(pointed).to_be_hidden()


def test_values_of_events_have_their_units(page: Page, page_server: PageServer) -> None:
    long = "a" * 199 + "b" * 500
    no_broadcasts, torque_limited = EventCode.NO_BROADCASTS.text, EventCode.TORQUE_LIMITED.text
    right_to_left = "\u05d0 text (1) that is written from right to left"
    cases: tuple[tuple[int, str, float | None, str, str], ...] = (
        (0, "STEERING", 0.1, "reference", "reference, 0.10000 rad"),
        (0, "STEERING", 0.0, "reference", "reference, 0 rad"),
        (0, "STEERING", 0.0, "disturbance", "disturbance, 0 N m"),
        (1, "DEAD", -0.25, "kill", "robot 1, dead, -0.25000 m – kill"),
        (1, "LIMIT_HIT", 0.5, "command limited", "robot 1, limit hit, 0.50000 m/s – command limited"),
        (1, "LIMIT_HIT", 0.5, "back in range: position", "robot 1, limit hit, 0.50000 m – back in range: position"),
        (0, "LIMIT_HIT", 2.5, torque_limited, f"limit hit, 2.5000 N m – {torque_limited}"),
        (2, "SAFE_STOP", 0.0, "", "robot 2, safe stop"),
        (2, "SAFE_STOP", 0.0, no_broadcasts, f"robot 2, waits to start – {no_broadcasts}"),
        (0, "LIMIT_HIT", None, torque_limited, f"limit hit – {torque_limited}"),
        (2, "REFUSED", 3.0, long, f"robot 2, refused, 3.0000 – {long[:200]}…"),
        (2, "REFUSED", 1.0, right_to_left, f"robot 2, refused, 1.0000 – {right_to_left}"),
    )
    events = [
        PRESENTER.event(event, 0.01 * event.step)
        for event in (
            SwarmEvent(0, step, agent, EventKind[kind], nan if value is None else value, detail)
            for step, (agent, kind, value, detail, _) in enumerate(cases)
        )
    ]
    page_server.open(Events(replace=True, events=events))
    shown = page.locator("#events li")
    texts = [f"{0.01 * step:.2f} s, step {step}: {text}" for step, (*_, text) in enumerate(cases)]
    expect(shown).to_have_text(texts[::-1])
    expect(shown.locator("bdi[title]")).to_have_count(1)
    expect(shown.locator("bdi").filter(has_text="aaa")).to_have_attribute("title", long)


def test_hostile_names_are_shown_as_text(page: Page, tmp_path: Path) -> None:
    event = SwarmEvent(3 * PERIOD, 3, 7, EventKind.REFUSED, 0.0, MARKUP + "\u202e&amp;")
    bag = write(tmp_path / "bag", [*messages(40), event], scenario=SCENARIO.replace("sample", f'"{NAME}"'))
    with serving(bag) as view:
        load(page, view)
        expect(page.locator("h1")).to_have_text(NAME)
        expect(page.locator("#events li").filter(has_text=MARKUP)).to_have_count(1)
        assert page.locator("img").count() == 0
        assert page.locator("script").count() == 3
        assert page.title() == f"{NAME} – swarmabs view"
        page.close()  # or it would try again when this program ends


def test_theme_follows_the_system_until_one_is_chosen(browser: Browser, served: Served) -> None:
    context = browser.new_context(color_scheme="dark")
    page = context.new_page()
    load(page, served)
    paper = "getComputedStyle(document.body).backgroundColor"
    light, dark = "rgb(255, 255, 255)", "rgb(22, 24, 28)"
    assert page.evaluate(paper) == dark
    page.keyboard.press("t")
    assert page.evaluate(paper) == light
    page.reload()
    expect(page.locator("#theme")).to_have_text("Theme: light")
    assert page.evaluate(paper) == light
    context.close()


def contrast(colours: list[str]) -> float:
    """Return the contrast of two colours of CSS by WCAG 2."""
    shades = []
    for colour in colours:
        red, green, blue = (int(part) / 255 for part in re.findall(r"\d+", colour)[:3])
        light = [one / 12.92 if one <= 0.04045 else ((one + 0.055) / 1.055) ** 2.4 for one in (red, green, blue)]
        shades.append(0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2] + 0.05)
    return max(shades) / min(shades)


PHASES: tuple[Phase, ...] = get_args(Phase)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_state_of_the_run_can_be_read_in_both_themes(page: Page, page_server: PageServer, theme: str) -> None:
    page_server.open()
    page.evaluate("(theme) => { document.documentElement.dataset.theme = theme; }", theme)
    state = page.locator("#state")
    for phase in PHASES:
        page_server.send(State(phase=phase, text=""))
        expect(state).to_have_text(phase)
        text = state.evaluate(
            "(badge) => [getComputedStyle(badge).color, getComputedStyle(document.body).backgroundColor]"
        )
        assert contrast(text) >= 4.5, (phase, text)


def test_everything_has_a_name_a_size_and_can_be_reached_by_keyboard(page: Page, served: Served) -> None:
    load(page, served)
    for width in (320, 390, 768):
        page.set_viewport_size({"width": width, "height": 800})
        page.wait_for_function("(width) => document.documentElement.scrollWidth <= width", arg=width)
    for role in ("button", "slider", "combobox", "table", "img"):
        for found in page.get_by_role(role).all():
            name = found.evaluate(
                "(node) => node.getAttribute('aria-label') || node.textContent.trim()"
                " || [...(node.labels || [])].map((label) => label.textContent).join('')"
            )
            assert name, found.evaluate("(node) => node.outerHTML")
    reached = []
    for _ in range(25):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.id || document.activeElement.className"))
    controls = ["theme", "layout", "help", "first", "back", "play", "on", "last", "scrub", "speed", "zoom"]
    assert [name for name in reached if name in controls][: len(controls)] == controls
    assert "skip" in reached[0]


def place(page: Page, name: str) -> FloatRect:
    """Return where a chart is, which is then to be seen."""
    over = page.locator(f"#chart-{name} .u-over")
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    assert box is not None
    return box


def drag(page: Page, name: str, begin: float, end: float) -> None:
    """Drag over parts of the width of a chart."""
    box = place(page, name)
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + begin * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + end * box["width"], y, steps=4)
    page.mouse.up()


def point(page: Page, name: str, part: float) -> Locator:
    """Point at a part of the width of a chart, and return what stands under it: the time, and each curve's value."""
    box = place(page, name)
    page.mouse.move(box["x"] + part * (box["width"] - 1), box["y"] + box["height"] / 2)
    return page.locator(f"#chart-{name} .u-value")


def expect_span(page: Page, name: str, begin: float, end: float, within: float) -> None:
    """The times at both ends of a chart become these, at most so far off."""
    for part, time in ((0.0, begin), (1.0, end)):
        values = point(page, name, part)
        page.wait_for_function(
            "([value, time, within]) => Math.abs(parseFloat(value.innerText) - time) <= within",
            arg=[values.first.element_handle(), time, within],
        )


def test_the_time_stands_in_the_address_and_an_address_leads_to_its_time(page: Page, served: Served) -> None:
    page.goto(f"{served.url}#t=1.23")
    expect(page.locator("#step")).to_have_attribute("value", "123")
    expect(page.locator("#clock")).to_have_text("1.23 of 4.00 s")
    page.get_by_role("button", name="One step forward").click()
    page.wait_for_url(re.compile("#t=1.24$"))
    page.evaluate("location.hash = '#t=9999'")
    expect(page.locator("#step")).to_have_attribute("value", "400")
    page.wait_for_url(re.compile("#t=4$"))
    page.get_by_label("Show", exact=True).select_option("2")
    expect_span(page, "positions", 2.0, 4.0, 0.02)
    seek(page, 350)
    expect_span(page, "0", 1.5, 3.5, 0.02)


@pytest.mark.parametrize("width", [1280, 375])
def test_parts_have_their_order_and_size_and_tables_tell_what_is_out_of_sight(
    page: Page, page_server: PageServer, width: int
) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    events = [
        Event(step=s, time=0.01 * s, agent=1, kind="REFUSED", words="refused", value=None, detail="x" * 60)
        for s in range(40)
    ]
    page_server.open(STEERED, Events(replace=True, events=events, left_out=7), hash_=f"#steer={TOKEN}")
    more = page.locator("#events + .more")
    expect(more).to_have_text("more rows below; 7 earlier events not listed")
    page.locator("#events").evaluate("(list) => { list.scrollTop = list.scrollHeight; }")
    expect(more).to_have_text("7 earlier events not listed")
    tops = page.locator("#plane-panel, #steering, #now-panel").evaluate_all(
        "(parts) => parts.map((part) => part.getBoundingClientRect().top)"
    )
    assert tops == sorted(tops) or width == 1280
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    if width == 375:
        small = """(parts) => parts.filter((part) => part.offsetParent && Math.min(
            part.getBoundingClientRect().height, part.getBoundingClientRect().width) < 44).map((part) => part.id)"""
        assert page.locator("button, select, input, summary").evaluate_all(small) == []


def test_numbers_of_further_topics_are_among_those_of_now_and_over_time(page: Page, page_server: PageServer) -> None:
    system = PRESENTER.system
    (robot,) = (place for place, row in enumerate(system.rows) if row.role == "robot")
    rows = [*system.rows[:robot], Row(role="further", name="effort_power", unit="W"), *system.rows[robot:]]
    frame, over_time = frame_of(4, 0.5, []), curves(0, 50)
    page_server.open()
    described = system.model_copy(update={"name": "beam", "rows": rows})
    page_server.send(HELLO.model_copy(update={"system": described}))
    page_server.send(over_time.model_copy(update={"values": [*over_time.values, over_time.time]}))
    page_server.send(frame.model_copy(update={"values": [*frame.values, 2.5]}))
    expect(page.locator("#numbers")).to_contain_text("effort power, W")
    expect(page.locator("#further-0")).to_have_text("2.5000")
    expect(page.locator(".u-title").filter(has_text="effort power, W")).to_be_visible()


def test_small_numbers_are_read_off_with_their_digits(page: Page, page_server: PageServer) -> None:
    page_server.open(curves(0, 50, 1.23456e-6))
    expect(point(page, "0", 1.0)).to_have_text(["4.9", "6.173e-7", "0"])
    expect(point(page, "3", 0.0)).to_have_text(["0", "6.173e-7", "0"])
    expect(page.locator(".u-value").filter(has_text="-0").filter(has_not_text=".")).to_have_count(0)


def test_a_zoom_holds_while_a_run_goes_on(page: Page, page_server: PageServer) -> None:
    page_server.open(curves(0, 100))
    expect_span(page, "0", 0.0, 9.9, 0.01)
    drag(page, "0", 0.5, 0.7)
    expect_span(page, "3", 5.0, 6.9, 0.2)  # in all charts
    for first in range(100, 160, 20):
        page_server.send(curves(first, first + 20))
    page.set_viewport_size({"width": 1000, "height": 900})
    page.keyboard.press("t")
    expect_span(page, "0", 5.0, 6.9, 0.2)
    page.locator("#chart-1 .u-over").dblclick()
    page_server.send(curves(160, 180))
    expect_span(page, "0", 0.0, 17.9, 0.2)


STEERED = Steering(open=True, largest_reference=1.0, largest_disturbance=2.0, members=[1, 2], absent=[])
TOKEN = "x" * 43


def opened(page: Page, server: PageServer, hash_: str = f"#steer={TOKEN}") -> None:
    """Open the page of a run that is steered."""
    server.open(STEERED, hash_=hash_)
    expect(page.locator("#steering")).to_be_visible()


def ask(page: Page, value: str = "0.1") -> None:
    page.get_by_label("Reference offset, rad").fill(value)
    page.get_by_role("button", name="Set reference").click()


@pytest.mark.parametrize(("typed", "value"), [("0,05", 0.05), ("0.05", 0.05), (" \u2212,1", -0.1), ("1e-3", 0.001)])
def test_numbers_are_taken_with_comma_or_point(page: Page, page_server: PageServer, typed: str, value: float) -> None:
    opened(page, page_server)
    expect(page.locator("#range-reference")).to_have_text("-1.00 to 1.00 rad")
    ask(page, typed)
    expect(page.locator("#steered")).to_have_text(re.compile("requested$"))
    assert [wish["value"] for wish in page_server.heard("steer")] == [value]


def test_what_is_no_number_or_too_large_is_refused_and_a_large_step_asked_back(
    page: Page, page_server: PageServer
) -> None:
    opened(page, page_server)
    wrong, sure = page.locator("#wrong-reference"), page.locator("#steer-sure")
    for typed, why in (
        *(
            (text, f'"{text}" is not a number: write 0.05 or 0,05')
            for text in ("1,000.5", "1.2.3", "0 05", "x", "Infinity")
        ),
        ("5", "5.0000 rad is out of range"),
    ):
        ask(page, typed)
        expect(wrong).to_have_text(why)
        expect(sure).to_be_hidden()
    ask(page, "0,5")
    expect(wrong).to_be_empty()
    expect(sure).to_contain_text("set the reference from 0 to 0.50000 rad?")
    page.get_by_role("button", name="Cancel").click()
    expect(sure).to_be_hidden()
    assert page_server.heard("steer") == []
    ask(page, "0,5")
    page.get_by_role("button", name="Yes, set it").click()
    expect(page.locator("#steered")).to_have_text("reference 0.5: requested")
    assert page_server.heard("steer")[-1]["value"] == 0.5


def test_a_wrong_token_shows_only_that(page: Page, page_server: PageServer) -> None:
    opened(page, page_server)
    assert page_server.heard("unlock")[-1]["token"] == TOKEN
    page_server.send(Answer(request="", ok=False, known=False, text="the token is wrong"))
    expect(page.locator("#steered")).to_have_text(re.compile("^The token is wrong"))
    expect(page.locator("#steer-token, #steer-controls, #steer-sure").filter(visible=True)).to_have_count(0)
    assert page.evaluate("sessionStorage.getItem('swarmabs-steer')") is None


def test_what_is_asked_when_the_connection_goes_gets_no_answer(page: Page, page_server: PageServer) -> None:
    opened(page, page_server)
    said = page.locator("#steered")
    ask(page)
    expect(said).to_have_text("reference 0.1: requested")
    page.get_by_role("button", name="Kill").click()
    page_server.refusing = 1011
    page_server.close()
    expect(said).to_contain_text("reference 0.1, kill robot 1: no answer: connection lost")
    for name in ("Set reference", "Set disturbance", "Kill", "Freeze", "Remove"):
        expect(page.get_by_role("button", name=name)).to_be_disabled()
    page_server.refusing = 0
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
def test_a_token_is_found_in_what_is_pasted_and_what_is_none_is_refused(
    page: Page, page_server: PageServer, pasted: str
) -> None:
    opened(page, page_server, hash_=f"#steer={'y' * 101}")
    expect(page.locator("#steer-controls")).to_be_hidden()
    for text, why in (
        ("y" * 101, "it has more than 100 characters"),
        (f"http://x/#steer={'y' * 5000}", "it has more than 100 characters"),
        ("http://127.0.0.1:1/#steer=", "the text contains none"),
        ("  ", "the text contains none"),
    ):
        page.get_by_label("Token, as printed in the terminal of the run").fill(text)
        page.get_by_role("button", name="Use").click()
        expect(page.locator("#steered")).to_have_text(re.compile(why))
        expect(page.locator("#steer-token")).to_be_visible()
        expect(page.locator("#steer-controls")).to_be_hidden()
        assert page.evaluate("sessionStorage.getItem('swarmabs-steer')") is None
    assert page_server.heard("steer") == []
    page.get_by_label("Token, as printed in the terminal of the run").fill(pasted)
    page.get_by_role("button", name="Use").click()
    ask(page)
    expect(page.locator("#steered")).to_have_text("reference 0.1: requested")
    assert page_server.heard("steer")[-1]["token"] == TOKEN


def test_a_request_that_the_server_closes_upon_brings_the_form_back(page: Page, page_server: PageServer) -> None:
    opened(page, page_server)
    assert not re.search("steer|x{5}", page.url)  # the token leaves the address
    ask(page)
    expect(page.locator("#steered")).to_have_text("reference 0.1: requested")
    page_server.close(1008)
    expect(page.locator("#steered")).to_have_text("reference 0.1: rejected by the program")
    expect(page.locator("#steer-token")).to_be_visible()
    assert page.evaluate("sessionStorage.getItem('swarmabs-steer')") is None
    expect(page.get_by_role("alert")).to_be_hidden(timeout=10_000)
    expect(page.locator("#steer-token")).to_be_visible()
