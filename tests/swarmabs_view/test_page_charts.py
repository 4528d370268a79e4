"""The curves of the page: their axes, what is read off them, and a zoom that holds."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import FloatRect, Page, expect
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_view.conftest import PageServer, Served, load, serving

from swarmabs_view.protocol import Curves

pytestmark = pytest.mark.timeout(120)

INKED = """(canvas) => {
    const data = canvas.getContext('2d').getImageData(0, 0, 2, canvas.height).data;
    return data.some((value, index) => index % 4 === 3 && value > 0);
}"""
NAMES = ("angle", "error", "torque", "inertia")


def curves(first: int, last: int, scale: float = 1.0) -> Curves:
    """Return points of the curves, one each 0.1 s."""
    steps = range(first, last)
    values: list[float | None] = [scale * (0.5 - step % 7) for step in steps]
    zeros: list[float | None] = [0.0 for _ in steps]
    return Curves(
        replace=first == 0,
        time=[step * 0.1 for step in steps],
        angle=values,
        reference=zeros,
        torque=values,
        desired_torque=zeros,
        inertia=values,
        desired_inertia=zeros,
    )


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


def read_off(page: Page, name: str, part: float) -> list[str]:
    """Return what stands under a chart that is pointed to: the time, and each curve's value."""
    box = place(page, name)
    page.mouse.move(box["x"] + part * (box["width"] - 1), box["y"] + box["height"] / 2)
    page.wait_for_timeout(100)
    return page.locator(f"#chart-{name} .u-value").all_inner_texts()


@pytest.mark.parametrize("scale", [1.0, 3e-6, 1.234567e-9, 4e7])
def test_labels_have_their_room_and_all_charts_the_same(page: Page, page_server: PageServer, scale: float) -> None:
    page_server.open(curves(0, 50, scale))
    page.wait_for_timeout(500)
    places = set()
    for name in NAMES:
        assert not page.locator(f"#chart-{name} canvas").evaluate(INKED), f"{name}: cut off on the left"
        box = page.locator(f"#chart-{name} .u-over").bounding_box()
        outer = page.locator(f"#chart-{name}").bounding_box()
        assert box is not None
        assert outer is not None
        places.add((box["x"] - outer["x"], box["width"]))
    assert len(places) == 1


def test_labels_of_a_bag_with_two_steps_are_whole(page: Page, tmp_path: Path) -> None:
    with serving(record(tmp_path / "run", "pd_het_4", "duration=0.01")) as view:
        load(page, view)
        page.get_by_role("button", name="Last step").click()
        page.wait_for_timeout(500)
        for name in NAMES:
            assert not page.locator(f"#chart-{name} canvas").evaluate(INKED), name


def test_small_numbers_are_read_off_with_their_digits(page: Page, page_server: PageServer) -> None:
    page_server.open(curves(0, 50, 1.23456e-6))
    assert read_off(page, "angle", 1.0) == ["4.9", "6.173e-7", "0"]
    assert read_off(page, "torque", 0.0) == ["0", "-6.173e-7"]
    expect(page.locator(".u-value").filter(has_text="-0").filter(has_not_text=".")).to_have_count(0)


def test_a_zoom_holds_while_a_run_goes_on(page: Page, page_server: PageServer) -> None:
    page_server.open(curves(0, 100))
    page.wait_for_timeout(300)
    drag(page, "angle", 0.5, 0.7)
    page.wait_for_timeout(300)
    begin, end = float(read_off(page, "torque", 0.0)[0]), float(read_off(page, "torque", 1.0)[0])
    assert (begin, end) == (pytest.approx(5.0, abs=0.2), pytest.approx(6.9, abs=0.2))  # in all charts
    for first in range(100, 160, 20):
        page_server.send(curves(first, first + 20))
        page.wait_for_timeout(200)
    page.set_viewport_size({"width": 1000, "height": 900})
    page.keyboard.press("t")
    page.wait_for_timeout(300)
    assert float(read_off(page, "angle", 0.0)[0]) == pytest.approx(begin, abs=0.2)
    assert float(read_off(page, "angle", 1.0)[0]) == pytest.approx(end, abs=0.2)
    page.locator("#chart-error .u-over").dblclick()
    page_server.send(curves(160, 180))
    page.wait_for_timeout(300)
    assert float(read_off(page, "angle", 0.0)[0]) == 0.0
    assert float(read_off(page, "angle", 1.0)[0]) == pytest.approx(17.9, abs=0.2)


def test_another_theme_leaves_the_zoom_of_a_bag(page: Page, served: Served) -> None:
    load(page, served)
    drag(page, "inertia", 0.25, 0.5)
    page.wait_for_timeout(200)
    page.keyboard.press("t")
    page.wait_for_timeout(300)
    assert float(read_off(page, "angle", 0.0)[0]) == pytest.approx(1.0, abs=0.05)
    assert float(read_off(page, "angle", 1.0)[0]) == pytest.approx(2.0, abs=0.05)
