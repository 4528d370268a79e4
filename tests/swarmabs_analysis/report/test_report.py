"""A report has the numbers that another reader finds in its bag; its page needs nothing else, however the run ended."""

import json
import math
import re
import shutil
import subprocess
import sys
from hashlib import sha256
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from playwright.sync_api import sync_playwright
from scipy.ndimage import binary_dilation
from tests.swarmabs_analysis.figures.conftest import ReadBag, record
from tests.swarmabs_analysis.report.conftest import SCENARIO, Page, messages, write
from tests.swarmabs_bag.test_arrays import digest
from tests.swarmabs_view.conftest import browser_arguments, chromium

from swarmabs_analysis.figures.style import BLACK, styled
from swarmabs_analysis.report import Report, make_report
from swarmabs_analysis.report.panels import Panel, panels
from swarmabs_analysis.report.pictures import WIDTH, page_picture, thin_lines
from swarmabs_analysis.report.record import read_recorded
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_bag.shown.colours import FAILED
from swarmabs_bag.shown.recorded_swarm import column_points
from swarmabs_config.scenario import dump_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.messages import AgentState, EventKind, Kind, Message, PlaneState, SwarmEvent
from swarmabs_core.systems.kinds import KINDS
from swarmabs_run.simulated_run import simulate_run

Floats = NDArray[np.float64]
LENGTH, GRAVITY = 1.0, 9.81


def value(page: Page, row: str) -> float:
    return float(page.rows[row][1])


def test_metrics(page: Page, run: Path, report: Report) -> None:
    bag = ReadBag(run)
    times, error = bag.times(), -bag.column("/plane/state", "angle")
    assert len(times) == 31
    assert value(page, "Final error") == error[-1]
    assert value(page, "RMS error") == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-13)
    outside = np.flatnonzero(np.abs(error) >= 0.01)
    assert len(outside) > 5
    assert value(page, "Settled at") == pytest.approx(times[outside[-1] + 1], rel=1e-15)
    positions = np.abs(bag.column("/swarm/agent_state", "position"))
    assert value(page, "Largest |position|") == positions.max()
    assert value(page, "Messages") == bag.count
    assert report.numbers["digest"] == digest(run / "bag" / "bag_0.mcap")
    step = report.numbers["step_response"]
    assert (step["at"], value(page, "Step at")) == (0.0, 0.0)
    assert value(page, "Steady-state error") == step["steady_state_error"] == error[-1]
    change = (-error - -error[0]) / (error[0] - error[-1])
    assert value(page, "Overshoot") == pytest.approx(100.0 * (change.max() - 1.0), abs=1e-9)
    assert ("code", report.numbers["digest"]) in page.texts


def test_margins_at_each_step(page: Page, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag, recorded = ReadBag(run), read_recorded(run)
    # Robot 4 joins at step 2, robot 1 dies after step 5 and stays, robot 2 leaves after step 10.
    on_plane = [[1, 2, 3]] * 2 + [[1, 2, 3, 4]] * 9 + [[1, 3, 4]] * 20
    states = {agent: bag.column("/swarm/agent_state", "position", agent) for agent in bag.agents()}
    mass = {agent: bag.column("/swarm/agent_state", "mass", agent)[0] for agent in bag.agents()}
    first = {1: 0, 2: 0, 3: 0, 4: 2}
    torque, inertia = bag.column("/swarm/abstract_state", "torque"), bag.column("/swarm/abstract_state", "inertia")
    wanted = bag.column("/swarm/desired_abstract_state", "torque")
    wanted_inertia = bag.column("/swarm/desired_abstract_state", "inertia")
    reach, clearance = [], []
    for step, agents in enumerate(on_plane):
        at = {agent: states[agent][min(step - first[agent], len(states[agent]) - 1)] for agent in agents}
        reach.append(max(map(abs, at.values())))
        assert GRAVITY * sum(mass[agent] * at[agent] for agent in agents) == pytest.approx(torque[step], abs=1e-12)
        # The nearest of very many points of the curve on which the outermost robot can be at the plane's end.
        total, least = sum(mass[agent] for agent in agents), min(mass[agent] for agent in agents)
        moment = np.linspace(-total * LENGTH / 2, total * LENGTH / 2, 40_001)
        curve = moment**2 / total + (LENGTH / 2 - np.abs(moment) / total) ** 2 / (1 / least - 1 / total)
        for tau, j in ((torque[step], inertia[step]), (wanted[step], wanted_inertia[step])):
            clearance.append(np.hypot(GRAVITY * moment - tau, curve - j).min())
    s0, s3 = (bag.column("/swarm/auxiliary_state", field) for field in ("s0", "s3"))
    expected = (LENGTH / 2 - np.array(reach), np.array(clearance[::2]), np.array(clearance[1::2]), s3 / s0**2)
    margin = recorded.margins
    for values, others in zip((margin.end, margin.actual, margin.desired, margin.spread), expected, strict=True):
        np.testing.assert_allclose(values, others, rtol=1e-14, atol=1e-6)
    rows = ("Margin to the plane's end", "Margin to A_A's boundary", "Margin of the desired state", "Smallest S₃/S₀²")
    assert [value(page, row) for row in rows] == pytest.approx([min(values) for values in expected], abs=1e-6)
    # Of long runs, the boundary of A_A is computed at some steps, and drawn there.
    monkeypatch.setattr(import_module("swarmabs_analysis.report.record"), "_MOST_ROWS", 10)
    (panel,) = (panel for panel in panels(read_recorded(run)) if panel.key == "margin-set")
    line = draw(panel)[0].lines[0]
    np.testing.assert_array_equal(line.get_xdata(), recorded.arrays.time[::4])
    np.testing.assert_array_equal(line.get_ydata(), margin.actual[::4])


def test_weights_give_the_recorded_abstract_state_and_events_have_a_table(page: Page, run: Path) -> None:
    recorded, bag = read_recorded(run), ReadBag(run)
    np.testing.assert_allclose(recorded.torque, bag.column("/swarm/abstract_state", "torque"), rtol=0, atol=1e-14)
    on_plane = recorded.swarm.on_plane.sum(axis=1)
    np.testing.assert_array_equal(on_plane, bag.column("/swarm/abstract_state", "agent_count"))
    cells = [text for tag, text in page.texts if tag in {"td", "th"}]
    at = cells.index("dead")
    assert cells[at - 3 : at] == ["0.06 s", "6", "1"]
    assert {"left", "joined", "kill", "leave"} <= set(cells)


def test_a_picture_in_the_page_shows_the_bag(report: Report, run: Path) -> None:
    """The angle's line in the page, taken back to rad by the labels of the axis, is the recorded angle."""
    svg = report.html[report.html.index('id="panel-parent-0"') :]
    svg = svg[: svg.index("</svg>")]
    line = next(d for d in re.findall(r'<path d="([^"]*)"[^>]*var\(--plane\)', svg) if d.count("L") > 8)
    points = np.array(re.findall(r"[ML] (-?[\d.]+) (-?[\d.]+)", line), dtype=float)
    angle = ReadBag(run).column("/plane/state", "angle")
    # Path simplification leaves out points, so only the ends and the extremes are compared, in units of the range.
    height = (points[:, 1].max() - points[:, 1]) / np.ptp(points[:, 1])
    scaled = (angle - angle.min()) / np.ptp(angle)
    assert height[[0, -1]] == pytest.approx(scaled[[0, -1]], abs=0.005)


UNITS = {
    "parent-0": "rad",
    "parent-1": "rad/s",
    "parent-error": "rad",
    "parent-error-decades": "rad",
    "robots-coordinate-0": "m",
    "robots-rate-0": "m/s",
    "robots-command-position-1": "m/s",
    "robots-command-position-2": "N",
    "abstract-0": "N m",
    "abstract-1": "kg m²",
    "abstract-error": "N m",
    "space": "kg m²",
    "margin-end": "m",
    "margin-set": "N m and kg m²",
    "margin-spread": "m²",
    "sums": "kg²",
}
"""Units of the vertical axes, by panel."""
RANGE = re.compile(r"(?:^|; )([^:;]*): (?:from \S+ to \S+ ?([^,;]*), )?between (\S+) and (\S+) ?([^;]*)")


def test_panels_state_units_and_ranges_of_what_they_draw(run: Path) -> None:
    shown = {panel.key: panel for panel in panels(read_recorded(run))}
    axes = {key: draw(panel) for key, panel in shown.items()}
    assert {key: axes[key][0].get_ylabel().removesuffix(" (logarithmic)").split(", ")[-1] for key in UNITS} == UNITS
    assert [one.get_ylabel().split(", ")[1] for one in axes["sums"]] == [
        *("kg²", "kg² m", "kg² m²", "kg⁴ m²", "kg²/s", "kg² m/s", "kg² m²/s", "kg m²/s²")
    ]
    for key, panel in shown.items():
        ranges = RANGE.findall(panel.about)
        assert bool(ranges) == (key not in {"parent-error-decades", "space", "membership"})
        if key in {"parent-0", "parent-1", "parent-error", "margin-end", "margin-spread"}:
            (_, unit, low, high, also) = ranges[0]
            values = np.asarray(axes[key][0].lines[0].get_ydata(), dtype=float)
            assert (unit, also) == (UNITS[key], UNITS[key])
            assert [float(low), float(high)] == pytest.approx([values.min(), values.max()], rel=1e-3)
    assert shown["margin-end"].about.endswith(" m at 0.3 s")
    bag = ReadBag(run)
    (line, *_) = axes["parent-error"][0].lines
    assert (line.get_label(), line.get_ydata()[-1]) == ("reference - θ", -bag.column("/plane/state", "angle")[-1])
    about = shown["membership"].about
    assert about.startswith("robots on the plane: initially 3, finally 3; robots that report: initially 3, finally 2;")


def test_the_panel_of_membership_shows_when_each_robot_follows_or_is_dead(run: Path) -> None:
    """Robot 1 dies at 0.06 s, robot 2 has left at 0.11 s, robot 4 joins at 0.02 s; the run ends at 0.3 s."""
    (panel,) = (panel for panel in panels(read_recorded(run)) if panel.key == "membership")
    (axes,) = draw(panel)
    spans = {}
    for bar in axes.collections:
        (begin, low), (end, high) = bar.get_paths()[0].vertices.min(axis=0), bar.get_paths()[0].vertices.max(axis=0)
        spans[round((low + high) / 2.0), to_hex(bar.get_facecolor()[0])] = (begin, end)
    single, double = (KINDS[kind].colour.lower() for kind in (Kind.SINGLE_INTEGRATOR, Kind.DOUBLE_INTEGRATOR))
    assert spans == {
        (0, single): pytest.approx((0.0, 0.06)),
        (0, FAILED.lower()): pytest.approx((0.06, 0.3)),
        (1, single): pytest.approx((0.0, 0.11)),
        (2, double): pytest.approx((0.0, 0.3)),
        (3, double): pytest.approx((0.02, 0.3)),
    }


def test_every_column_keeps_its_ends_extremes_and_gaps() -> None:
    draw = np.random.default_rng(5)
    column = np.sort(draw.integers(0, 50, 20_000))
    values = draw.normal(size=len(column))
    values[3_000:3_100] = np.nan
    values[column == 40] = np.nan
    chosen = column_points(column, values)
    assert len(chosen) <= 4 * 50 + 8
    for number in range(50):
        rows = np.flatnonzero(column == number)
        kept = chosen[column[chosen] == number]
        assert {rows[0], rows[-1]} <= set(kept.tolist())
        if number != 40:
            assert np.nanmin(values[kept]) == np.nanmin(values[rows])
            assert np.nanmax(values[kept]) == np.nanmax(values[rows])
    assert {2_999, 3_000, 3_099, 3_100} <= set(chosen.tolist())


def test_a_single_peak_survives_and_the_picture_stays_the_same() -> None:
    time = np.arange(100_000) / 100.0
    values = np.zeros(len(time))
    values[61_803] = 1.0

    def picture(*, thin: bool) -> tuple[int, NDArray[np.int64]]:
        figure = Figure(figsize=(4.0, 2.0), dpi=100)
        (line,) = figure.add_subplot().plot(time, values)
        figure.draw_without_rendering()
        if thin:
            thin_lines(figure)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        return len(np.asarray(line.get_xdata())), np.asarray(canvas.buffer_rgba()).astype(np.int64)

    (count, whole), (fewer, thinned) = picture(thin=False), picture(thin=True)
    assert count == 100_000 and fewer < 2_500
    inked, also = (picture[..., :3].min(axis=2) < 200 for picture in (whole, thinned))
    assert np.count_nonzero(inked) > 1_000
    # The same to a pixel: a peak of one point gets the width of a column.
    assert not (inked & ~binary_dilation(also)).any()
    assert not (also & ~binary_dilation(inked)).any()


def thinned(x: Floats, y: Floats, **view: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return what is left of a line in a small figure."""
    figure = Figure(figsize=(3.0, 3.0), dpi=100)
    axes = figure.add_subplot()
    (line,) = axes.plot(x, y)
    axes.set(**view)
    figure.draw_without_rendering()
    thin_lines(figure)
    return np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)


def test_a_path_that_is_no_function_of_time_is_thinned_too_and_noise_and_gaps_do_not_keep_it_from_ending() -> None:
    turn = np.linspace(0.0, 200.0 * np.pi, 300_000)
    x, y = thinned(np.cos(turn), np.sin(turn))
    assert len(x) <= 4_000
    np.testing.assert_allclose(np.hypot(x, y), 1.0)
    x, y = np.random.default_rng(7).normal(size=(2, 60_000))
    x[1_000:50_000:2] = np.nan
    assert 2_000 <= len(thinned(x, y, xlim=(0.5, 1.0), ylim=(0.5, 1.0))[0]) <= 4_000


HOSTILE = "</td></pre><script>alert(1)</script><img src=x onerror='alert(2)'>\"&amp;\x00\x1b[31m\u202e $\\frac$"
NAME = "a<script>alert(3)<img src=x onerror=alert(4)>\"'&$\\frac$".replace("\\", "")
SCRIPT = """
import hashlib, sys
from pathlib import Path
from swarmabs_analysis.report import make_report
report = make_report(Path(sys.argv[1]))
print(hashlib.sha256(report.html.encode()).hexdigest(), hashlib.sha256(report.png).hexdigest())
"""


def assert_self_contained(html: str) -> None:
    page = Page(html)
    assert re.findall(r"https?:", html) == []
    assert "@import" not in html
    assert set(re.findall(r"url\((.)", html)) <= {"#"}
    assert re.search(r"\ssrc\s*=", re.sub(r">[^<]*<", "><", html)) is None
    assert {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object", "embed", "base", "form"} == set()
    identities = [str(attributes["id"]) for _, attributes in page.tags if "id" in attributes]
    assert len(identities) == len(set(identities))
    for tag, attributes in page.tags:
        assert not [name for name in attributes if name.startswith("on")]
        if (reference := attributes.get("href")) is not None:
            inside = reference.startswith("#") and reference[1:] in identities
            assert inside or (tag == "image" and reference.startswith("data:image/png;base64,"))
    policies = [a["content"] for _, a in page.tags if a.get("http-equiv") == "Content-Security-Policy"]
    assert policies == ["default-src 'none'; style-src 'unsafe-inline'; img-src data:"]


def test_page_is_complete_and_refers_to_nothing(report: Report, page: Page) -> None:
    assert_self_contained(report.html)
    assert report.html.startswith("<!DOCTYPE html>\n<html lang=")
    headings = [text for tag, text in page.texts if tag == "h2"]
    contents = [text for tag, text in page.texts if tag == "a"]
    assert headings == contents
    assert {"Metrics", "Parent system", "Robots", "Constraint margins", "Events", "Timing", "Scenario"} <= set(headings)
    assert [text for tag, text in page.texts if tag == "h1"] == ["pd_het_4"]
    assert "prefers-color-scheme: dark" in report.html
    pictures = [attributes for tag, attributes in page.tags if tag == "svg"]
    assert len(pictures) == 17 and all(one["role"] == "img" and one["aria-label"] for one in pictures)
    # Tables can be scrolled by keys, and no column is without a name.
    tables = [attributes for tag, attributes in page.tags if tag == "div" and attributes.get("class") == "table"]
    assert len(tables) > 5 and all(one.get("tabindex") == "0" for one in tables)
    assert re.findall(r"<th[^>]*>\s*</th>", report.html) == []
    # No colour of a picture is fixed: all follow the scheme.
    assert re.findall(r'style="[^"]*#[0-9a-f]{6}', report.html) == []
    assert report.png.startswith(b"\x89PNG")


@pytest.mark.usefixtures("undrawn")
def test_a_report_is_the_same_elsewhere(run: Path, tmp_path: Path) -> None:
    assert make_report(Path(shutil.copytree(run, tmp_path / "elsewhere"))).html == make_report(run).html


def broken(message: Message) -> Message:
    """Return a message of a run in which numbers are what no picture can show."""
    if isinstance(message, PlaneState) and message.step == 3:
        return message._replace(angle=math.inf)
    if isinstance(message, AgentState) and message.step > 5:
        return message._replace(position=-1e300, velocity=math.nan)
    return message


@pytest.mark.usefixtures("sketched")
def test_hostile_text_stays_text_and_numbers_that_cannot_be_drawn_are_left_out(tmp_path: Path) -> None:
    run = [*map(broken, messages(40)), SwarmEvent(0, 0, 2, EventKind.DEAD, 0.0, HOSTILE)]
    run += [SwarmEvent(0, 0, 1, 200, float("nan"), HOSTILE)]
    provenance = {"driver": HOSTILE, "machine": [HOSTILE], "versions": {HOSTILE: {HOSTILE: 1}}}
    scenario, made_with = SCENARIO.replace("sample", json.dumps(NAME)), json.dumps(provenance).encode()
    report = make_report(write(tmp_path / "bag", run, scenario=scenario, provenance=made_with, aborted=HOSTILE))
    assert report.numbers["rms_error"] is None
    assert_self_contained(report.html)
    page = Page(report.html)
    assert [text for tag, text in page.texts if tag == "h1"] == [NAME]
    shown = re.sub("[\x00\x1b\u202e]", "\ufffd", HOSTILE)
    assert page.texts.count(("td", shown)) == 2
    assert ("th", shown) in page.texts
    assert any(shown in text for tag, text in page.texts if tag == "p")  # why it ended
    assert not set("\x00\x1b\u202e") & set(report.html)


@pytest.mark.usefixtures("undrawn")
def test_timing_of_another_run_is_not_taken(tmp_path: Path) -> None:
    write(tmp_path / "bag", messages(40))
    for summary in ({"digest": "0" * 64, "wall_time": 3.5}, [], {"wall_time": "<script>"}):
        (tmp_path / "summary.json").write_text(json.dumps(summary))
        recorded = read_recorded(tmp_path)
        assert recorded.summary is None
        assert "another run" in recorded.summary_note
    summary = {"digest": recorded.metrics["digest"], "wall_time": 3.5, "real_time_factor": 0.2}
    shown = {"Wall time": 3.5, "Stepping": 2.0, "Speed": 20.0}
    for more, rows in (({}, {"Rest": 1.5}), ({"setup_time": 0.5, "startup_time": 0.7}, {"Set-up": 0.5, "Rest": 0.3})):
        (tmp_path / "summary.json").write_text(json.dumps(summary | more))
        page = Page(make_report(tmp_path).html)
        assert {name: page.rows[name][1] for name in {**shown, **rows}} == pytest.approx({**shown, **rows})
    assert page.rows["Start"][1] == pytest.approx(0.7)


@pytest.mark.system
@pytest.mark.timeout(300)
def test_another_process_gives_the_same_bytes_elsewhere(report: Report, run: Path, tmp_path: Path) -> None:
    elsewhere = shutil.copytree(run, tmp_path / "elsewhere")
    done = subprocess.run([sys.executable, "-c", SCRIPT, elsewhere], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [sha256(content).hexdigest() for content in (report.html.encode(), report.png)]


@pytest.mark.usefixtures("undrawn")
def test_failed_run(tmp_path: Path) -> None:
    scenario = find_scenario("arise_si_4", ["duration=1.0", "plane.angle=1.4", "plane.angular_velocity=3.0"])
    outcome = simulate_run(scenario.resolved(), new_run_folder(tmp_path / "run"))
    assert outcome.status == "failed" and outcome.reason
    report = make_report(tmp_path / "run")
    assert (report.numbers["status"], report.numbers["reason"]) == ("failed", outcome.reason)
    page = Page(report.html)
    assert ("span", "failed") in page.texts
    assert any(outcome.reason in text for _, text in page.texts)
    assert page.rows["RMS error"][1] == pytest.approx(float(outcome.figures["rms_error"] or 0.0), abs=0)


@pytest.mark.usefixtures("undrawn")
def test_bag_without_its_end_and_perhaps_a_topic(tmp_path: Path) -> None:
    file = write(tmp_path / "bag", messages(40)) / "bag_0.mcap"
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    report = make_report(file)
    assert report.numbers["status"] == "damaged"
    assert "the end of the bag is missing" in str(report.numbers["reason"])
    assert 0 < report.numbers["steps"] <= 40
    Page(report.html)
    # Nothing of a topic came before the end was lost.
    file = write(tmp_path / "topic", [m for m in messages(40) if not isinstance(m, AgentState)]) / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-200])
    report = make_report(file)
    assert (report.numbers["status"], report.numbers["agents"], report.numbers["steps"]) == ("damaged", 0, 40)


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_or_one_step_recorded(tmp_path: Path, count: int) -> None:
    write(tmp_path / "bag", messages(0)[: 7 * count], aborted="interrupted")
    report = make_report(tmp_path / "bag")
    assert report.numbers["status"] == "interrupted"
    assert report.numbers["steps"] == 0
    assert any("nothing to draw" in text for _, text in Page(report.html).texts)
    assert "<svg" not in report.html
    assert report.png.startswith(b"\x89PNG")


@pytest.mark.system
def test_two_hundred_robots_are_drawn_as_percentiles_three_of_them_and_density(tmp_path: Path) -> None:
    run = record(tmp_path / "run", "arise_het_200", "duration=0.5")
    recorded, bag = read_recorded(run), ReadBag(run)
    shown = {panel.key: panel for panel in panels(recorded)}
    positions = np.stack([bag.column("/swarm/agent_state", "position", agent) for agent in bag.agents()], axis=1)
    masses = np.array([bag.column("/swarm/agent_state", "mass", agent)[0] for agent in bag.agents()])
    (axes,) = draw(shown["robots-coordinate-0"])
    above = positions[:, positions[0] > 0.0]
    low, high = np.quantile(above[0], [0.05, 0.95])
    band = axes.collections[0].get_paths()[0].vertices
    assert [band[band[:, 0] == 0.0, 1].min(), band[band[:, 0] == 0.0, 1].max()] == pytest.approx([low, high])
    (median,) = (line for line in axes.lines if line.get_linewidth() == 1.1 and line.get_color() == BLACK)
    assert np.asarray(median.get_ydata())[[0, -1]] == pytest.approx(np.median(above, axis=1)[[0, -1]])
    named = {str(line.get_label()): line for line in axes.lines if not str(line.get_label()).startswith("_")}
    for word, column in (
        ("largest", np.abs(positions).max(axis=0).argmax()),
        ("heaviest", masses.argmax()),
        ("lightest", masses.argmin()),
    ):
        (line,) = (line for label, line in named.items() if word in label)
        np.testing.assert_array_equal(line.get_ydata(), positions[:, column])
    density, _ = draw(shown["mass"])
    mesh = density.collections[0]
    millimetres = 1e3 * np.diff(np.array(mesh.get_coordinates())[:, 0, 1])
    assert millimetres @ np.asarray(mesh.get_array()) == pytest.approx(masses.sum())
    assert f"total mass {masses.sum():.4g} kg" in shown["mass"].about
    assert "positions of 200 robots" in shown["robots-coordinate-0"].about
    assert "<image" in page_picture(shown["mass"])
    assert len(page_picture(shown["robots-coordinate-0"])) < 40_000


@pytest.mark.usefixtures("undrawn")
def test_many_events_share_rows(tmp_path: Path) -> None:
    limits = [SwarmEvent(step * 10_000_000, step, 1 + step % 2, 7, step / 8, "limited") for step in range(41)]
    more = [SwarmEvent(0, 0, 7, 6, float(step), "loss") for step in range(40)]
    page = Page(make_report(write(tmp_path / "bag", [*messages(40), *limits, *more])).html)
    cells = [text for tag, text in page.texts if tag in {"td", "th"}]
    at = [place for place, text in enumerate(cells) if text == "limit hit"]
    assert [cells[place + 1 : place + 6] for place in at] == [
        ["1", "21", "0 s", "0.4 s", "0 to 5"],
        ["2", "20", "0.01 s", "0.39 s", "0.125 to 4.875"],
        ["7", "1", "0.03 s", "0.03 s", "0.3333"],
    ]


def test_refused_bags(tmp_path: Path) -> None:
    with pytest.raises(NotABagError, match="contains no bag"):
        make_report(tmp_path)
    strange = [m._replace(kind=9) if isinstance(m, AgentState) and m.step == 4 else m for m in messages(40)]
    with pytest.raises(DamagedBagError, match="agent 1 at step 4: kind 9 is unknown"):
        make_report(write(tmp_path / "strange", strange))
    file = write(tmp_path / "flipped", messages(40)) / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 0xFF
    file.write_bytes(content)
    with pytest.raises(DamagedBagError, match="can be read"):
        make_report(file)


def draw(panel: Panel) -> list[Axes]:
    """Return the axes of a panel."""
    with styled():
        figure = Figure((WIDTH, panel.height), layout="constrained")
        panel.draw(figure)
    return figure.axes


def entries(axes: Axes) -> list[str]:
    legend = axes.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


@pytest.mark.system
def test_a_zoom_names_all_events_in_it_and_no_legend_leaves_its_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    faults = "faults=[{at: 3, kind: kill, agent: 5}, {at: 5, kind: kill, agent: 7}, {at: 7, kind: leave, agent: 9}]"
    run = record(tmp_path, "arise_het_20", "duration=10", "swarm.generate.single_integrator=11", faults)
    recorded = read_recorded(run)
    shown = {panel.key: panel for panel in panels(recorded)}
    assert shown["zoom-1"].heading == "Around 5.01 s: robot 7 dead"
    assert shown["zoom-1"].about.endswith("then 7.01 s: robot 9 left")
    assert shown["zoom-0"].about.endswith("then 3.01 s: robot 5 dead")
    for name in ("robots-coordinate-0", "robots-command-position-2", "membership", "space"):
        (axes, *_) = draw(shown[name])
        axes.figure.draw_without_rendering()
        legend = axes.get_legend()
        assert legend is not None and legend.get_window_extent().x1 <= axes.figure.bbox.x1
    # Of too many moments, those with the largest errors are shown.
    error, times = np.abs(recorded.error), recorded.arrays.time
    largest = [error[(times >= moment) & (times <= moment + 4.0)].max() for moment in (0.0, 5.01)]
    monkeypatch.setattr(import_module("swarmabs_analysis.report.panels"), "MOST_ZOOMS", 1)
    (zoom,) = (panel for panel in panels(recorded) if panel.section == "zooms")
    assert zoom.heading == ("Around the start" if largest[0] > largest[1] else shown["zoom-1"].heading)
    assert f"largest error {max(largest):.4g} rad" in zoom.about


SETTINGS = (
    "faults=[{at: 5, until: 6, kind: disturbance, torque: 0.1}, {at: 7, kind: disturbance, torque: -0.2}, "
    "{at: 10, kind: reference, offset: 0.05}]"
)


def shaded(axes: Axes) -> list[tuple[float, float]]:
    """Return the intervals that are shaded over the whole height of a panel."""
    spans = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    assert all((patch.get_y(), patch.get_height()) == (0.0, 1.0) for patch in spans)
    return [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in spans]


def test_disturbances_are_shaded_and_steps_of_the_reference_marked_with_their_names(tmp_path: Path, run: Path) -> None:
    settings = record(tmp_path / "run", "pd_het_4", "duration=15", "step=0.05", SETTINGS)
    shown = {panel.key: panel for panel in panels(read_recorded(settings))}
    for key in ("parent-0", "robots-coordinate-0", "abstract-0", "margin-end", "sums"):
        axes = draw(shown[key])[0]
        assert shaded(axes) == [pytest.approx((5.0, 6.0)), pytest.approx((7.0, 15.0))]
        assert [line for line in axes.lines if np.asarray(line.get_xdata()).tolist() == [10.0, 10.0]]
        assert key == "sums" or {"disturbance", "reference step"} <= set(entries(axes))
    zooms = {panel.heading: panel for panel in shown.values() if panel.section == "zooms"}
    assert list(zooms) == ["Around the start", "Around 5 s: disturbance 0.1 N m", "Around 10 s: reference 0.05 rad"]
    upper, _ = draw(zooms["Around the start"])
    assert len(entries(upper)) == 4
    upper, _ = draw(zooms["Around 10 s: reference 0.05 rad"])
    assert entries(upper)[4:] == ["disturbance", "reference step"]
    (quiet,) = (panel for panel in panels(read_recorded(run)) if panel.key == "parent-0")
    (axes,) = draw(quiet)
    assert shaded(axes) == [] and entries(axes) == ["θ", "reference θ"]


@pytest.mark.system
@pytest.mark.timeout(240)
def test_on_paper_pages_are_full_and_contain_the_whole_scenario(report: Report, tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text(report.html, encoding="utf-8")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=browser_arguments())
        page = browser.new_page()
        page.goto((tmp_path / "report.html").as_uri())
        assert len(re.findall(rb"/Type\s*/Page\b", page.pdf(prefer_css_page_size=True))) <= 5
        page.emulate_media(media="print")
        scenario = page.locator("#scenario pre")
        assert scenario.inner_text() == dump_scenario(read_recorded(report.bag).scenario.resolved()).rstrip("\n")
        assert scenario.evaluate("pre => pre.scrollHeight - pre.clientHeight") == 0
        whole = "figures => figures.every(figure => getComputedStyle(figure).breakInside === 'avoid')"
        assert page.locator("figure").evaluate_all(whole)
        browser.close()
