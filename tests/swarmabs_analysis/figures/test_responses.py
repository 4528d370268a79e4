"""The figures of runs show what is in the bags, and say what it is."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tests.swarmabs_analysis.figures.conftest import ReadBag, record

from swarmabs_analysis.figures import FIGURES
from swarmabs_analysis.figures.responses import STRETCHED
from swarmabs_analysis.figures.runs import RecordedRun, find_runs
from swarmabs_analysis.figures.style import PAGE, styled

Floats = NDArray[np.float64]
ROWS = ("si", "di", "het")


@cache
def draw(name: str, runs: Path) -> Figure:
    needed = FIGURES[name].scenarios
    found = find_runs([runs], needed)
    with styled():
        figure = FIGURES[name].draw([found[scenario].load() for scenario in needed])
        figure.draw_without_rendering()
    return figure


def drawn(axes: Axes, label: str) -> tuple[Floats, Floats]:
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)


def grid(figure: Figure, columns: int) -> tuple[list[list[Axes]], list[Axes]]:
    """Return the panels row by row, and the axes on their right sides in the order of the panels that have them."""
    panels = [axes for axes in figure.axes if axes.yaxis.get_label_position() == "left"]
    others = [axes for axes in figure.axes if axes not in panels]
    return [panels[start : start + columns] for start in range(0, len(panels), columns)], others


def assert_same(found: tuple[Floats, Floats], times: Floats, values: Floats) -> None:
    np.testing.assert_allclose(found[0], times, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[1], values, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("name", "controller"), [("PD_res", "pd"), ("ARISE_res", "arise")])
def test_nine_panels_show_the_bags(name: str, controller: str, short_runs: Path) -> None:
    figure = draw(name, short_runs)
    rows, others = grid(figure, 3)
    assert len(rows) == 3
    for number, (kind, (plane, robots, error)) in enumerate(zip(ROWS, rows, strict=True)):
        bag = ReadBag(short_runs / f"{controller}_{kind}_4")
        times = bag.times()
        assert len(times) == 31
        rate = next(axes for axes in others if axes.bbox.bounds == plane.bbox.bounds)
        inertia = next(axes for axes in others if axes.bbox.bounds == error.bbox.bounds)
        assert_same(drawn(plane, "θ"), times, bag.column("/plane/state", "angle"))
        assert_same(drawn(rate, "ω"), times, bag.column("/plane/state", "angular_velocity"))
        for robot in bag.agents():
            assert_same(drawn(robots, f"p{'₀₁₂₃₄'[robot]}"), times, bag.column("/swarm/agent_state", "position", robot))
        for axes, label, field, unit in ((error, "τ", "torque", 1.0), (inertia, "J", "inertia", 1e3)):
            wanted = bag.column("/swarm/desired_abstract_state", field)
            actual = bag.column("/swarm/abstract_state", field)
            assert_same(drawn(axes, label), times, unit * (wanted - actual))
        texts = [text.get_text() for text in plane.texts]
        assert texts == [("single integrators", "double integrators", "heterogeneous")[number]]
        assert (plane.get_ylabel(), rate.get_ylabel()) == ("θ, rad", "ω, rad/s")
        assert robots.get_ylabel() == "position p, m"
        assert (error.get_ylabel(), inertia.get_ylabel()) == ("error of τ, N m", "error of J, 10⁻³ kg m²")
    assert [axes.get_xlabel() for axes in rows[-1]] == ["time, s"] * 3


def test_arise_shows_the_reference_and_pd_none(short_runs: Path) -> None:
    (plane, *_), *_ = grid(draw("ARISE_res", short_runs), 3)[0]
    times, wanted = drawn(plane, "θ wanted")
    assert wanted == pytest.approx([0.7 * math.sin(0.015 * math.pi * t) for t in times], abs=1e-12)
    (plane, *_), *_ = grid(draw("PD_res", short_runs), 3)[0]
    assert "θ wanted" not in [line.get_label() for line in plane.lines]


def test_four_panels_show_the_large_swarms(short_runs: Path) -> None:
    figure = draw("ARISE_lg_swarm", short_runs)
    ((a, b, c, d),), others = grid(figure, 4)
    assert [axes.get_title() for axes in (a, b, c, d)] == [
        "a) 20 robots",
        "b) 20 robots",
        "c) 200 robots",
        "d) 200 robots",
    ]
    for plane, rate, robots, name in ((a, others[0], b, "arise_het_20"), (c, others[1], d, "arise_het_200")):
        bag = ReadBag(short_runs / name)
        times = bag.times()
        assert_same(drawn(plane, "θ"), times, bag.column("/plane/state", "angle"))
        assert_same(drawn(rate, "ω"), times, bag.column("/plane/state", "angular_velocity"))
        assert len(robots.lines) == len(bag.agents())
        for line, robot in zip(robots.lines, bag.agents(), strict=True):
            assert_same(
                (np.asarray(line.get_xdata()), np.asarray(line.get_ydata())),
                times,
                bag.column("/swarm/agent_state", "position", robot),
            )
        kinds = [bag.column("/swarm/agent_state", "kind", robot)[0] for robot in bag.agents()]
        colours = [to_hex(line.get_color()) for line in robots.lines]
        legend = robots.get_legend()
        assert legend is not None
        names = [text.get_text() for text in legend.get_texts()]
        by_name = dict(zip(names, (to_hex(line.get_color()) for line in legend.get_lines()), strict=True))
        assert colours == [by_name["SI" if kind == 1 else "DI"] for kind in kinds]
        labels = [axes.get_ylabel() for axes in (plane, rate, robots)]
        assert labels == ["θ, rad", "ω, rad/s", "position p, m"]
        assert plane.get_xlabel() == robots.get_xlabel() == "time, s"


@pytest.mark.parametrize("name", ["PD_res", "ARISE_res", "ARISE_lg_swarm"])
def test_what_is_compared_has_the_same_scale_and_nothing_is_cut_off(name: str, short_runs: Path) -> None:
    figure = draw(name, short_runs)
    columns = 4 if name == "ARISE_lg_swarm" else 3
    rows, others = grid(figure, columns)
    planes = rows[0][::2] if columns == 4 else [row[0] for row in rows]
    assert len({axes.get_ylim() for axes in planes}) == 1
    if columns == 3:
        assert len({row[1].get_ylim() for row in rows}) == len({row[2].get_ylim() for row in rows}) == 1
    for axes in (*(axes for row in rows for axes in row), *others):
        low, high = axes.get_ylim()
        for line in axes.lines:
            assert np.min(line.get_ydata()) >= low and np.max(line.get_ydata()) <= high
    heights = {round(float(-axes.get_ylim()[0] / np.ptp(axes.get_ylim())), 9) for axes in (*planes, others[0])}
    assert len(heights) == 1  # both zeros of a panel are at one height


def test_text_can_be_read_in_print_and_stays_clear_of_the_data(short_runs: Path) -> None:
    figure = draw("ARISE_res", short_runs)
    assert figure.get_figwidth() == PAGE
    for axes in figure.axes:
        texts = [*axes.get_xticklabels(), *axes.get_yticklabels(), axes.xaxis.label, axes.yaxis.label, axes.title]
        legend = axes.get_legend()
        if legend is not None:
            texts += legend.get_texts()
            assert legend.get_window_extent().y0 >= axes.bbox.y1
        assert min(text.get_fontsize() for text in texts) >= 7.0


def test_start_of_a_long_run_is_stretched_and_shaded(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    for kind in ROWS:
        record(runs / kind, f"pd_{kind}_4", "duration=12.0")
    axes = grid(draw("PD_res", runs), 3)[0][0][0]
    left, right = axes.get_xlim()
    places = axes.transAxes.inverted().transform(
        axes.transData.transform([(t, 0.0) for t in (left, 2.5, STRETCHED, 8.5, right)])
    )
    np.testing.assert_allclose(places[:, 0], [0.0, 0.25, 0.5, 0.75, 1.0], atol=1e-9)
    assert (left, right) == (0.0, 12.0)


def test_a_robot_that_is_not_there_yet_is_not_drawn(tmp_path: Path) -> None:
    fault = "faults=[{at: 0.1, kind: join, agent: 4}]"
    run = find_runs([record(tmp_path / "run", "pd_het_4", fault)], ["pd_het_4"])["pd_het_4"].load()
    assert isinstance(run, RecordedRun)
    with styled():
        figure = FIGURES["PD_res"].draw([run, run, run])
        figure.draw_without_rendering()
    robots = grid(figure, 3)[0][0][1]
    assert np.isnan(drawn(robots, "p₄")[1]).sum() == 10
