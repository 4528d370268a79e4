"""What the page draws on its canvases: nothing overlaps, and the scale follows the plane and the swarm."""

from itertools import combinations
from typing import Any

import pytest
from playwright.sync_api import Page, expect
from tests.swarmabs_view.conftest import HELLO, PageServer, curves

from swarmabs_bag.shown.swarm_state import Abstract, Instant, ShownRobot
from swarmabs_view.protocol import Event, Events, Frame, RobotInfo, State

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

NAMES = ("angle", "error", "torque", "inertia")

RECORDED = """
const drawing = CanvasRenderingContext2D.prototype;
const { beginPath, clearRect, fill, fillText, lineTo, moveTo, stroke } = drawing;
window.drawn = {};
let path = [];
const of = ({ canvas }) => window.drawn[canvas.closest(".chart")?.id ?? canvas.id];
const box = (context, what, corners) => {
  const points = corners.map(([x, y]) => context.getTransform().transformPoint({ x, y }));
  const [xs, ys] = ["x", "y"].map((axis) => points.map((point) => point[axis]));
  of(context)?.boxes.push([what, Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)]);
};
drawing.clearRect = function (...all) {
  window.drawn[this.canvas.closest(".chart")?.id ?? this.canvas.id] = { boxes: [], dashes: [], edge: null };
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
drawing.fill = function () {
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
"""Records what is drawn last on each canvas: boxes of texts and marks, dashed lines and the near edge of the plane."""


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


def test_labels_are_apart_and_the_scale_follows_the_angle(page: Page, page_server: PageServer) -> None:
    page.add_init_script(RECORDED)
    events = [
        Event(step=0, time=t, agent=7, kind="DEAD", words="dead", value=None, detail="")
        for t in (1.0, 1.1, 1.2, 3.0, 4.9)
    ]
    still = {"inertia": [0.02555] * 50, "torque": [0.012] * 50}
    page_server.open(curves(0, 50).model_copy(update=still), Events(replace=True, events=events))
    shown = [ShownRobot(position, 0.0, 0.0, "active") for position in (0.1, -0.1)]
    state = Abstract(0.012, 0.02555)
    for width in (1280, 375):
        page.set_viewport_size({"width": width, "height": 800})
        for angle, reference in ((0.0, 0.0), (1.2, 0.1), (0.02, -0.02), (-0.6, 0.9), (0.05, 0.0), (0.3, 0.31)):
            page_server.send(Frame.of(Instant(3, 30_000_000, 0.03, angle, 0.0, reference, state, state), shown, 1.0))
            expect(page.locator("#angle")).to_have_attribute("value", f"{angle:g}")
            expect(page.locator("#reference")).to_have_attribute("value", f"{reference:g}")
            plane = drawn(page, "plane")
            (x0, y0), (x1, y1) = plane["edge"]
            assert min(y0, y1) > 0
            assert max(y0, y1) < plane["height"]
            if abs(angle) < 0.1:  # though it was steeper, and is in the curves
                assert x1 - x0 > 0.5 * plane["width"]
                assert len(plane["boxes"]) > 2
        assert len(drawn(page, "abstract")["boxes"]) >= 8
        texts = [box[0] for box in drawn(page, "chart-angle")["boxes"]]
        assert texts.count("mark") == 5
        assert "7 dead" in texts


def test_a_crowd_has_a_legend_and_bands_of_its_own(page: Page, page_server: PageServer) -> None:
    robots = [RobotInfo(id=n, kind="double_integrator", mass=0.1, damping=None) for n in range(1, 62)]
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
        arg=list(NAMES),
    )
    page.wait_for_function(
        """(names) => new Set(names.map((name) => {
            const [over, outer] = [`#chart-${name} .u-over`, `#chart-${name}`].map(
                (selector) => document.querySelector(selector).getBoundingClientRect());
            return `${over.x - outer.x} ${over.width}`;
        })).size === 1""",
        arg=list(NAMES),
    )
