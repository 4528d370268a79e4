"""What the page draws on its canvases: nothing overlaps, and the scale follows the plane and the swarm."""

from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise
from math import atan2, cos, dist, sin
from typing import Any

import pytest
from playwright.sync_api import Page, expect
from tests.swarmabs_view.conftest import (
    HELLO,
    PRESENTER,
    PageServer,
    Served,
    curves,
    frame_of,
    load,
    robot_info,
    seek,
)

from swarmabs_bag.shown.swarm_state import RobotStatus
from swarmabs_view.protocol import (
    Event,
    Events,
    Frame,
    Message,
    Plane,
    RobotInfo,
    Robots,
    Row,
    State,
    Steering,
    System,
)

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

CHARTS = range(4)
"""Charts of the plane that are beside each other: angle, error, angular velocity and torque."""

RECORDED = """
const drawing = CanvasRenderingContext2D.prototype;
const { beginPath, clearRect, fill, fillRect, fillText, lineTo, moveTo, stroke } = drawing;
window.drawn = {};
let path = [];
const of = ({ canvas }) => window.drawn[canvas.closest(".chart")?.id ?? canvas.id];
const box = (context, what, corners) => {
  const points = corners.map(([x, y]) => context.getTransform().transformPoint({ x, y }));
  const [xs, ys] = ["x", "y"].map((axis) => points.map((point) => point[axis]));
  of(context)?.boxes.push([what, Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)]);
};
drawing.clearRect = function (...all) {
  const nothing = { boxes: [], dashes: [], shapes: [], areas: [], edge: null };
  window.drawn[this.canvas.closest(".chart")?.id ?? this.canvas.id] = nothing;
  clearRect.apply(this, all);
};
drawing.fillText = function (text, x, y) {
  const size = this.measureText(text);
  const [left, right] = [x - size.actualBoundingBoxLeft, x + size.actualBoundingBoxRight];
  const [top, bottom] = [y - size.actualBoundingBoxAscent, y + size.actualBoundingBoxDescent];
  box(this, text, [[left, top], [right, bottom]]);
  fillText.call(this, text, x, y);
};
drawing.beginPath = function () { path = []; beginPath.call(this); };
drawing.moveTo = function (x, y) { path.push([x, y]); moveTo.call(this, x, y); };
drawing.lineTo = function (x, y) { path.push([x, y]); lineTo.call(this, x, y); };
drawing.fillRect = function (x, y, w, h) {
  of(this)?.areas.push([x, y, w, h]);
  fillRect.call(this, x, y, w, h);
};
drawing.fill = function () {
  of(this)?.shapes.push(path);
  if (path.length === 3) {
    box(this, "mark", path);
  }
  fill.call(this);
};
drawing.stroke = function () {
  const found = of(this);
  if (found && this.getLineDash().length && path.length === 4) {
    found.dashes.push(path.slice(0, 2), path.slice(2));
  } else if (found && this.lineWidth === 4) {
    found.edge = path;
  }
  stroke.call(this);
};
"""
"""Records what is drawn last on each canvas: boxes of texts and marks, dashed lines, filled shapes and rectangles, and
the near edge of the plane."""


def drawn(page: Page, canvas: str) -> dict[str, Any]:
    """Return what was drawn on a canvas, after a check that boxes overlap neither each other nor dashed lines."""
    found: dict[str, Any] = page.evaluate("(canvas) => window.drawn[canvas]", canvas)
    for (one, *first), (other, *second) in combinations(found["boxes"], 2):
        apart = first[2] <= second[0] or second[2] <= first[0] or first[3] <= second[1] or second[3] <= first[1]
        on_robots = canvas == "plane" and (one.isdigit() or other.isdigit())
        assert apart or on_robots or one == other == "mark", (canvas, one, first, other, second)
    points = [
        (x0 + k / 99 * (x1 - x0), y0 + k / 99 * (y1 - y0)) for (x0, y0), (x1, y1) in found["dashes"] for k in range(100)
    ]
    for what, x0, y0, x1, y1 in found["boxes"]:
        assert not any(x0 <= x <= x1 and y0 <= y <= y1 for x, y in points), what
    width, height = page.locator(f"#{canvas} canvas, canvas#{canvas}").evaluate("(one) => [one.width, one.height]")
    _, left, top, right, bottom = zip(*found["boxes"], strict=True)
    assert min(*left, *top) >= 0
    assert max(right) <= width
    assert max(bottom) <= height
    return {**found, "width": width, "height": height}


def drawn_again(page: Page) -> None:
    """Wait until the page has drawn what it has received."""
    for _ in range(2):
        page.evaluate("() => new Promise(requestAnimationFrame)")


def on_the_plane(
    places: Sequence[float], dead: Sequence[int] = (), heights: Mapping[int, float] | None = None
) -> tuple[Message, ...]:
    """Return what shows robots at these positions of a plane of 1 m, the dead ones and heights by their number."""
    robots = [robot_info(n + 1) for n in range(len(places))]
    status: list[RobotStatus] = ["dead" if n + 1 in dead else "active" for n in range(len(places))]
    plane = Plane(length=1.0, inertia=0.1, gravity=9.81, heights={**(heights or {})})
    hello = HELLO.model_copy(update={"robots": robots, "plane": plane})
    return hello, frame_of(7, 0.05, [*zip(places, status, strict=True)])


def on_a_system(angle: float, places: Sequence[float], bodies: Sequence[Sequence[Any]]) -> tuple[Message, ...]:
    """Return what shows robots with bodies on a beam at an angle (rad), in two dimensions."""
    robots = [
        RobotInfo(id=n + 1, kind="single_integrator", constants=[], body=list(bodies[n]) if bodies else [])
        for n in range(len(places))
    ]
    rows = [Row(role="parent", name="roll", unit="rad"), Row(role="robot", name="position", unit="m")]
    rows[1:1] = [Row(role=role, name="moment", unit="N m") for role in ("abstract", "desired")]
    system = System(name="beam", rows=rows, kinds=PRESENTER.system.kinds, placed=True, disturbance_unit="")
    position = [[p * cos(angle), p * sin(angle), angle] for p in places]
    vectors = [[p] for p in places]
    states = Robots(
        position=position, coordinates=vectors, velocities=vectors, command=vectors, status=["active"] * len(places)
    )
    ends = [[-2.0 * cos(angle), -2.0 * sin(angle)], [2.0 * cos(angle), 2.0 * sin(angle)]]
    frame = Frame(step=7, time=0.07, values=[angle, 0.0, 0.0], outline=[ends], robots=states, step_rate=None)
    return HELLO.model_copy(update={"system": system, "robots": robots}), frame


def show(page: Page, server: PageServer, messages: Sequence[Message]) -> None:
    """Have the page show these messages, the last of which is of step 7."""
    for message in messages:
        server.send(message)
    expect(page.locator("#step")).to_have_attribute("value", "7")
    drawn_again(page)


def test_labels_are_apart_and_the_scale_follows_the_angle(page: Page, page_server: PageServer) -> None:
    page.add_init_script(RECORDED)
    events = [
        Event(step=0, time=t, agent=7, kind="DEAD", words="dead", value=None, detail="")
        for t in (1.0, 1.1, 1.2, 3.0, 4.9)
    ]
    moving = curves(0, 50)
    still = [*moving.values[:3], [0.012] * 50, [0.02555] * 50, *moving.values[5:]]
    page_server.open(moving.model_copy(update={"values": still}), Events(replace=True, events=events))
    robots: list[tuple[float, RobotStatus]] = [(0.1, "active"), (-0.1, "active")]
    for width in (1280, 375):
        page.set_viewport_size({"width": width, "height": 800})
        for angle, reference in ((0.0, 0.0), (1.2, 0.1), (0.02, -0.02), (-0.6, 0.9), (0.05, 0.0), (0.3, 0.31)):
            page_server.send(frame_of(3, angle, robots, reference=reference, abstract=(0.012, 0.02555)))
            expect(page.locator("#parent-0")).to_have_attribute("value", f"{angle:g}")
            expect(page.locator("#reference-0")).to_have_attribute("value", f"{reference:g}")
            plane = drawn(page, "plane")
            (x0, y0), (x1, y1) = plane["edge"]
            assert min(y0, y1) > 0
            assert max(y0, y1) < plane["height"]
            if abs(angle) < 0.1:  # though it was steeper, and is in the curves
                assert x1 - x0 > 0.5 * plane["width"]
                assert len(plane["boxes"]) > 2
        assert len(drawn(page, "abstract")["boxes"]) >= 8
        texts = [box[0] for box in drawn(page, "chart-0")["boxes"]]
        assert texts.count("mark") == 5
        assert "7 dead" in texts


def test_a_crowd_has_a_legend_and_bands_of_its_own(page: Page, page_server: PageServer) -> None:
    robots = [robot_info(n, "double_integrator") for n in range(1, 62)]
    page_server.open()
    each, crowd = page.locator(".legend .each"), page.locator(".legend .crowd")
    expect(each.filter(visible=True)).to_have_count(3)
    expect(crowd).to_be_hidden()
    expect(page.locator("#processes-panel")).to_be_visible()
    page_server.send(HELLO.model_copy(update={"source": "bag", "robots": robots}))
    page_server.send(State(phase="recorded", text=""))
    expect(crowd).to_be_visible()
    expect(each.filter(visible=True)).to_have_count(0)
    expect(page.locator("#processes-panel")).to_be_hidden()


@pytest.mark.parametrize("scale", [1.0, 1.234567e-9, 4e7])
def test_labels_have_their_room_and_all_charts_the_same(page: Page, page_server: PageServer, scale: float) -> None:
    page.add_init_script(RECORDED)
    page_server.open(curves(0, 50, scale))
    page.wait_for_function(
        "(names) => names.every((name) => window.drawn[`chart-${name}`].boxes.every(([, left]) => left >= 0))",
        arg=list(CHARTS),
    )
    page.wait_for_function(
        """(names) => new Set(names.map((name) => {
            const [over, outer] = [`#chart-${name} .u-over`, `#chart-${name}`].map(
                (selector) => document.querySelector(selector).getBoundingClientRect());
            return `${over.x - outer.x} ${over.width}`;
        })).size === 1""",
        arg=list(CHARTS),
    )


@pytest.mark.parametrize("width", [1280, 390])
def test_robots_are_drawn_with_the_body_of_their_system_where_and_how_it_is_turned(
    page: Page, page_server: PageServer, width: int
) -> None:
    page.add_init_script(RECORDED)
    page.set_viewport_size({"width": width, "height": 844})
    page_server.open()
    angle, places = 0.3, (-1.2, 0.4, 1.0)
    boxes = [[[[-0.2, 0.0], [0.2, 0.0], [0.2, h], [-0.2, h], [-0.2, 0.0]]] for h in (0.1, 0.2, 0.3)]
    show(page, page_server, on_a_system(angle, places, boxes))
    plane = drawn(page, "plane")
    found = [shape[:4] for shape in plane["shapes"] if len(shape) == 5]
    assert len(found) == 3  # drawn from the last to the first
    for (left, right, top, _), height in zip(reversed(found), (0.1, 0.2, 0.3), strict=True):
        assert dist(right, top) / dist(left, right) == pytest.approx(height / 0.4)
        assert atan2(left[1] - right[1], right[0] - left[0]) == pytest.approx(angle)
    feet = [((left[0] + right[0]) / 2, (left[1] + right[1]) / 2) for left, right, *_ in reversed(found)]
    scale = dist(*found[0][:2]) / 0.4
    assert [dist(*pair) / scale for pair in pairwise(feet)] == pytest.approx([1.6, 0.6])
    texts = [text for text, *_ in plane["boxes"]]
    assert {"1", "2", "3", "x, m", "y, m"} <= set(texts)
    expect(page.locator("#plane")).to_have_attribute(
        "aria-label", "Beam at 0.07000 s; 3 robots, listed in the table of robots"
    )


def test_labels_of_axes_follow_the_part_shown_even_if_the_system_is_flat(page: Page, page_server: PageServer) -> None:
    page.add_init_script(RECORDED)
    page_server.open()
    show(page, page_server, on_a_system(0.001, (-0.3, 0.3), []))
    marks = [float(text) for text, *_ in drawn(page, "plane")["boxes"] if text.strip("-").replace(".", "").isdigit()]
    assert max(marks) >= 2.0
    assert len(marks) < 24  # `drawn` has found no two of them overlapping


@pytest.mark.parametrize(("count", "named"), [(24, True), (25, False)])
@pytest.mark.parametrize("width", [1280, 390])
def test_every_robot_of_a_small_swarm_has_its_id_dead_or_alive(
    page: Page, page_server: PageServer, count: int, width: int, *, named: bool
) -> None:
    page.add_init_script(RECORDED)
    page.set_viewport_size({"width": width, "height": 844})
    page_server.open()
    dead = (1, 7, count)
    show(page, page_server, on_the_plane([0.004 * (n % 5) for n in range(count)], dead))
    boxes = [box for box in drawn(page, "plane")["boxes"] if box[0].isdigit()]
    if named:
        assert sorted(int(text) for text, *_ in boxes) == list(range(1, count + 1))
    else:
        assert not {str(n) for n in dead} & {text for text, *_ in boxes}
    for (one, *first), (other, *second) in combinations(boxes, 2):
        apart = first[2] <= second[0] or second[2] <= first[0] or first[3] <= second[1] or second[3] <= first[1]
        assert apart, (one, other)


def test_a_robot_is_drawn_at_the_height_of_its_mass(page: Page, page_server: PageServer) -> None:
    """Perpendicular to the edge of the plane, which is 1 m long."""
    page.add_init_script(RECORDED)
    page_server.open()

    def centres() -> dict[str, tuple[float, float]]:
        boxes = [box for box in drawn(page, "plane")["boxes"] if box[0].isdigit()]
        return {text: ((x0 + x1) / 2.0, (y0 + y1) / 2.0) for text, x0, y0, x1, y1 in boxes}

    show(page, page_server, on_the_plane([-0.2, 0.3]))
    level = centres()
    show(page, page_server, on_the_plane([-0.2, 0.3], heights={2: 0.1}))
    raised, ((x0, y0), (x1, y1)) = centres(), drawn(page, "plane")["edge"]
    assert raised["1"] == level["1"]
    moved = [new - old for new, old in zip(raised["2"], level["2"], strict=True)]
    assert moved == pytest.approx([0.1 * (y1 - y0), -0.1 * (x1 - x0)], abs=1.0)
    assert moved[1] < -10.0


def test_a_section_is_called_one_and_has_break_lines(page: Page, page_server: PageServer) -> None:
    page.add_init_script(RECORDED)
    page_server.open()
    show(page, page_server, on_the_plane([-0.1, 0.1]))
    plane = drawn(page, "plane")
    assert len(plane["shapes"][1]) == 4  # after the support
    assert not any("section" in text for text, *_ in plane["boxes"])
    page.get_by_role("button", name="Fit to swarm").click()
    drawn_again(page)
    plane = drawn(page, "plane")
    assert len(plane["shapes"][1]) > 10
    (said,) = [text for text, *_ in plane["boxes"] if "section" in text]
    assert said == "section: 0.23 m of 1.00 m"
    show(page, page_server, on_the_plane([-0.5, 0.5]))  # the swarm needs all of it
    assert not any("section" in text for text, *_ in drawn(page, "plane")["boxes"])
    show(page, page_server, on_a_system(0.0, (-0.3, 0.3), []))
    page.get_by_role("button", name="Fit to swarm").click()
    drawn_again(page)
    assert "section around the robots" in [text for text, *_ in drawn(page, "plane")["boxes"]]


def test_charts_shade_the_time_in_which_the_plane_is_disturbed(page: Page, page_server: PageServer) -> None:
    page.add_init_script(RECORDED)
    changes = ((1.0, 0.2), (2.0, 0.4), (3.0, 0.0), (4.5, -0.1))
    events = [
        Event(step=0, time=t, agent=0, kind="STEERING", words="disturbance", value=value, detail="disturbance")
        for t, value in changes
    ]
    page_server.open(curves(0, 50), Events(replace=True, events=events))
    page.wait_for_function("() => window.drawn['chart-0'].areas.length === 3")
    charts = [drawn(page, f"chart-{number}") for number in CHARTS]
    over = page.locator("#chart-0 .u-over").evaluate("(one) => one.clientWidth * devicePixelRatio")
    for chart in charts:
        (first, second, last) = chart["areas"]
        begin = first[0] - over * 1.0 / 4.9
        assert [first[2], second[2], last[2]] == pytest.approx([over / 4.9, over / 4.9, over * 0.4 / 4.9], abs=1.5)
        assert [second[0], last[0]] == pytest.approx([begin + over * t / 4.9 for t in (2.0, 4.5)], abs=1.5)
    labels = [[text for text, *_ in chart["boxes"]].count("disturbance") for chart in charts]
    assert labels[0] >= 1
    assert labels[1:] == [0, 0, 0]
    assert all("mark" not in [text for text, *_ in chart["boxes"]] for chart in charts)


HEIGHTS = "(parts) => parts.filter((part) => part.offsetParent).map((part) => part.getBoundingClientRect().height)"


@pytest.mark.parametrize("size", [(1280, 900), (390, 844)])
def test_legends_are_smaller_than_what_they_explain_and_a_phone_shows_the_picture_first(
    page: Page, served: Served, size: tuple[int, int]
) -> None:
    page.set_viewport_size({"width": size[0], "height": size[1]})
    load(page, served)
    seek(page, 350)
    for panel in ("plane", "abstract"):
        (canvas,) = page.locator(f"#{panel}").evaluate_all(HEIGHTS)
        (legend,) = page.locator(f"#{panel}-panel .legend").evaluate_all(HEIGHTS)
        assert legend < 0.25 * canvas
    legends = page.locator(".u-legend").evaluate_all(HEIGHTS)
    assert len(legends) == 6
    assert max(legends) < 0.3 * min(page.locator(".u-wrap").evaluate_all(HEIGHTS))
    below = "(part) => part.getBoundingClientRect().bottom"
    if size[0] == 390:
        assert page.locator("#playback").evaluate(below) <= size[1]
    small = """(parts) => parts.filter((part) => part.offsetParent && Math.min(
        part.getBoundingClientRect().height, part.getBoundingClientRect().width) < 24).map((part) => part.id)"""
    assert page.locator("button, select, input, summary").evaluate_all(small) == []


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080)])
def test_the_layout_for_presenters_fills_a_projector_and_is_remembered(
    page: Page, page_server: PageServer, size: tuple[int, int]
) -> None:
    page.add_init_script(RECORDED)
    page.set_viewport_size({"width": size[0], "height": size[1]})
    steered = Steering(open=True, largest_reference=1.0, largest_disturbance=2.0, members=[1, 2], absent=[])
    page_server.open(curves(0, 50), steered, hash_=f"#steer={'x' * 43}")
    usual = [box[4] - box[2] for box in drawn(page, "plane")["boxes"] if box[0].isdigit()]
    page.keyboard.press("p")
    expect(page.locator("#layout")).to_have_text("Full page")
    seen = page.locator("main section, .chart").filter(visible=True)
    parts = ["plane-panel", "steering", "curves-panel", "chart-0", "abstract-panel"]
    assert seen.evaluate_all("(parts) => parts.map((part) => part.id)") == parts
    expect(page.locator("table:not(.u-legend)").filter(visible=True)).to_have_count(0)
    page.wait_for_function(
        "(chart) => chart.firstChild.offsetHeight <= chart.clientHeight",
        arg=page.locator("#chart-0").element_handle(),
    )
    boxes = seen.evaluate_all("(parts) => parts.map((part) => part.getBoundingClientRect().toJSON())")
    assert all(box["bottom"] <= size[1] and box["right"] <= size[0] for box in boxes)
    assert boxes[0]["width"] > 0.6 * size[0]
    assert page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]") == list(size)
    drawn_again(page)
    for canvas in ("plane", "abstract", "chart-0"):
        drawn(page, canvas)
    large = [box[4] - box[2] for box in drawn(page, "plane")["boxes"] if box[0].isdigit()]
    assert min(large) > 1.4 * min(usual)
    fonts = page.locator("#plane, #abstract, .chart").evaluate_all(
        "(parts) => parts.map((part) => parseFloat(getComputedStyle(part).fontSize))"
    )
    assert min(fonts) >= size[1] / 45
    expect(page.get_by_role("button", name="Kill")).to_be_enabled()
    page.set_viewport_size({"width": 1600, "height": 900})  # texts and the chart follow the window
    page.wait_for_function(
        """(chart) => chart.clientHeight > 200 && Math.abs(chart.clientHeight - chart.firstChild.offsetHeight) < 2
        && window.drawn["chart-0"].boxes.length""",
        arg=page.locator("#chart-0").element_handle(),
    )
    drawn(page, "chart-0")
    page.reload()
    expect(page.locator("#layout")).to_have_text("Full page")
    expect(page.locator("#now-panel")).to_be_hidden()
    page.get_by_role("button", name="Full page").click()
    expect(page.locator("#now-panel")).to_be_visible()
    expect(page.locator(".chart").filter(visible=True)).to_have_count(6)


def test_axes_have_no_more_room_after_a_look_at_the_layout_for_presenters(page: Page, page_server: PageServer) -> None:
    page.add_init_script(RECORDED)
    page_server.open(curves(0, 50))
    before = drawn(page, "abstract")
    for usual in (False, True):
        page.keyboard.press("p")
        page.wait_for_function(
            "([width, usual]) => (document.getElementById('abstract').width === width) === usual",
            arg=[before["width"], usual],
        )
        drawn_again(page)
    assert drawn(page, "abstract") == before
