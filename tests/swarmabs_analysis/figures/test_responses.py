"""Runs are found or made whole; their figures show what is in the bags, in files that are the same bytes each time."""

import io
import math
import re
import shutil
import subprocess
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree as ET

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from tests.swarmabs_analysis.figures.conftest import NAMES, ReadBag, record

from swarmabs_analysis.figures import FIGURES, draw_files
from swarmabs_analysis.figures.responses import STRETCHED, kinds, robots_by_kind, time_axis
from swarmabs_analysis.figures.runs import find_made, find_runs, make_run
from swarmabs_analysis.figures.style import COLUMN, FORMATS, PAGE, styled
from swarmabs_bag.errors import NotABagError
from swarmabs_bag.run.writer import BagWriter
from swarmabs_bag.run_folder import RunFolder
from swarmabs_config.scenario import Scenario, dump_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError, RunError, SwarmabsError
from swarmabs_core.messages import MAIN_TOPICS, PLANE_STATE, Kind, PlaneState
from swarmabs_core.systems.kinds import DOUBLE_INTEGRATOR, SINGLE_INTEGRATOR
from swarmabs_run.run import Outcome, RunOptions
from swarmabs_run.simulated_run import simulate_run

WIDTHS = {"mappingEx": COLUMN, "posMapping": COLUMN, "PD_res": PAGE, "ARISE_res": PAGE, "ARISE_lg_swarm": PAGE}
SEVERAL_RUNS = ("PD_res", "ARISE_res", "ARISE_lg_swarm")
SCRIPT = """
import hashlib, sys
from pathlib import Path
from swarmabs_analysis.figures import FIGURES, draw_files
from swarmabs_analysis.figures.runs import find_runs
for name in sys.argv[2:]:
    bags = find_runs([Path(sys.argv[1])], FIGURES[name].scenarios)
    for file, content in draw_files(name, bags, ("png", "svg")).items():
        print(file, hashlib.sha256(content).hexdigest())
assert "matplotlib.pyplot" not in sys.modules
"""


@cache
def files(name: str, runs: Path) -> dict[str, bytes]:
    return draw_files(name, find_runs([runs], FIGURES[name].scenarios), FORMATS)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.system] * (name in SEVERAL_RUNS)) for name in FIGURES]
)
def test_files_are_pictures_of_the_printed_width(name: str, short_runs: Path) -> None:
    contents = files(name, short_runs)
    assert contents.keys() == {f"{name}.png", f"{name}.svg"}
    picture = imread(io.BytesIO(contents[f"{name}.png"]), format="png")
    assert picture.shape[1] == pytest.approx(WIDTHS[name] * 300, abs=1)
    assert picture.std() > 0.05
    root = ET.fromstring(contents[f"{name}.svg"])
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert float(root.attrib["width"].removesuffix("pt")) == pytest.approx(WIDTHS[name] * 72, abs=0.1)


def test_a_file_depends_neither_on_other_formats_nor_on_the_users_own_style(short_runs: Path) -> None:
    with mpl.rc_context({"lines.linewidth": 7.0, "font.size": 20.0, "axes.grid": True, "svg.fonttype": "path"}):
        again = draw_files("posMapping", {}, ["svg"]) | draw_files("posMapping", {}, ["png"])
        assert again == files("posMapping", short_runs)
        assert mpl.rcParams["lines.linewidth"] == 7.0


@pytest.mark.system
@pytest.mark.timeout(300)
def test_another_process_gives_the_same_bytes(short_runs: Path) -> None:
    names = ("mappingEx", "posMapping", "PD_res")
    words = [sys.executable, "-c", SCRIPT, short_runs, *names]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    contents = [file_and_content for name in names for file_and_content in files(name, short_runs).items()]
    assert done.stdout.splitlines() == [f"{file} {sha256(content).hexdigest()}" for file, content in contents]


Floats = NDArray[np.float64]
ROWS = ("si", "di", "het")


@cache
def draw(name: str, runs: Path) -> Figure:
    bags = find_runs([runs], FIGURES[name].scenarios)
    with styled():
        figure = FIGURES[name].draw([bags[scenario].load() for scenario in FIGURES[name].scenarios])
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


def assert_same(line: tuple[Floats, Floats], times: Floats, values: Floats) -> None:
    np.testing.assert_allclose(line[0], times, rtol=0, atol=1e-12)
    np.testing.assert_allclose(line[1], values, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("name", "controller"), [pytest.param("PD_res", "pd", marks=pytest.mark.system), ("ARISE_res", "arise")]
)
def test_nine_panels_show_the_bags_and_any_reference(name: str, controller: str, short_runs: Path) -> None:
    rows, others = grid(draw(name, short_runs), 3)
    assert len(rows) == 3
    for kind, (plane, robots, error) in zip(ROWS, rows, strict=True):
        bag = ReadBag(short_runs / f"{controller}_{kind}_4")
        times = bag.times()
        assert len(times) == 31
        assert {axes.get_xlim() for axes in (plane, robots, error)} == {(0.0, 0.3)}
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
    plane = rows[0][0]
    if controller == "arise":
        times, wanted = drawn(plane, "reference")
        assert wanted == pytest.approx([0.7 * math.sin(0.015 * math.pi * t) for t in times], abs=1e-12)
    else:
        assert "reference" not in [line.get_label() for line in plane.lines]


def dashes(line: Line2D) -> str:
    return str(line._dash_pattern)  # type: ignore[attr-defined]  # noqa: SLF001 - nothing public tells it


@pytest.mark.parametrize("name", ["PD_res", "ARISE_res"])
def test_four_robots_have_the_colours_of_their_kinds_and_dashes_of_their_own(name: str, short_runs: Path) -> None:
    rows, _ = grid(draw(name, short_runs), 3)
    single, double = SINGLE_INTEGRATOR.colour, DOUBLE_INTEGRATOR.colour
    expected = ([single] * 4, [double] * 4, [single, single, double, double])
    for (_, robots, _), colours in zip(rows, expected, strict=True):
        lines = [line for line in robots.lines if str(line.get_label()).startswith("p")]
        assert [line.get_color() for line in lines] == colours
        assert len(set(map(dashes, lines))) == 4
    legend = rows[0][1].get_legend()
    assert legend is not None
    entries = {text.get_text(): line for text, line in zip(legend.get_texts(), legend.get_lines(), strict=True)}
    assert list(entries) == ["p₁", "p₂", "p₃", "p₄", "SI", "DI"]
    assert (entries["SI"].get_color(), entries["DI"].get_color()) == (single, double)
    assert [dashes(entries[f"p{number}"]) for number in "₁₂₃₄"] == [dashes(line) for line in rows[0][1].lines[:4]]


def test_kinds_have_the_colours_of_all_views(tmp_path: Path) -> None:
    record(tmp_path / "run", "arise_het_4", "faults=[{kind: join, agent: 4, at: 0.1}]")
    run = find_runs([tmp_path], ["arise_het_4"])["arise_het_4"].load()
    figure = Figure()
    axes = figure.add_subplot()
    robots_by_kind(axes, run.arrays, run.arrays.agents.position)
    drawn = [line.get_color() for line in axes.lines]
    assert drawn == [
        (SINGLE_INTEGRATOR if kind == Kind.SINGLE_INTEGRATOR else DOUBLE_INTEGRATOR).colour
        for kind in run.arrays.agents.kind[-1].tolist()
    ]
    named = {str(line.get_label()): line.get_color() for line in kinds(run)}
    assert named == {"SI": SINGLE_INTEGRATOR.colour, "DI": DOUBLE_INTEGRATOR.colour}


def test_start_of_a_long_run_is_stretched_and_shaded() -> None:
    axes = Figure().add_subplot()
    time_axis(axes, 12.0)
    left, right = axes.get_xlim()
    shown = axes.transData.transform([(t, 0.0) for t in (left, 2.5, STRETCHED, 8.5, right)])
    places = axes.transAxes.inverted().transform(shown)
    np.testing.assert_allclose(places[:, 0], [0.0, 0.25, 0.5, 0.75, 1.0], atol=1e-9)
    assert (left, right) == (0.0, 12.0)


def test_a_run_is_named_in_three_ways(short_runs: Path) -> None:
    for part in ("pd_si_4", "pd_si_4/bag", "pd_si_4/bag/bag_0.mcap"):
        bags = find_runs([short_runs / part], NAMES)
        assert bags.keys() == {"pd_si_4"}
        assert bags["pd_si_4"].bag == short_runs / "pd_si_4" / "bag" / "bag_0.mcap"
        assert bags["pd_si_4"].altered  # it is shorter than the paper's
        assert len(bags["pd_si_4"].load().arrays.time) == 31


def test_a_folder_of_runs_is_searched_by_what_the_bags_say(short_runs: Path, tmp_path: Path) -> None:
    shutil.copytree(short_runs / "arise_het_20", tmp_path / "any_name")
    shutil.copy(short_runs / "pd_di_4" / "bag" / "bag_0.mcap", tmp_path / "loose.mcap")
    shutil.copytree(short_runs / "pd_si_4", tmp_path / ".hidden")
    (tmp_path / "notes.txt").write_text("no bag")
    assert find_runs([tmp_path], NAMES).keys() == {"arise_het_20", "pd_di_4"}
    assert find_runs([tmp_path], ["pd_di_4"]).keys() == {"pd_di_4"}
    assert find_runs([short_runs], NAMES).keys() == set(NAMES)
    # A bag that is named twice is one, and two bags of a scenario are refused.
    assert len(find_runs([short_runs / "pd_si_4", short_runs], ["pd_si_4"])) == 1
    shutil.copytree(short_runs / "pd_si_4", tmp_path / "more" / "pd_si_4-002")
    with pytest.raises(InputError, match=r"pd_si_4/bag.* and .*pd_si_4-002/bag.* are both runs of pd_si_4"):
        find_runs([short_runs, tmp_path / "more"], NAMES)


def test_a_bag_of_no_use_is_left_out_among_others_and_refused_alone(short_runs: Path, tmp_path: Path) -> None:
    whole = (short_runs / "pd_si_4" / "bag" / "bag_0.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    with BagWriter(tmp_path / "foreign", topics=MAIN_TOPICS, attachments={}):
        pass
    scenario = dump_scenario(find_scenario("pd_di_4").resolved()).encode()
    with BagWriter(tmp_path / "ends_early", topics=MAIN_TOPICS, attachments={"scenario.yaml": scenario}) as writer:
        for step in range(3000):
            writer.write(PLANE_STATE, 0, encode(PlaneState(0, step, 0.0, 0.0)))
    (tmp_path / "stub.mcap").write_bytes(whole[:3])
    (tmp_path / "whole.mcap").write_bytes(whole)
    reasons: list[str] = []
    assert find_runs([tmp_path], NAMES, reasons.append)["pd_si_4"].bag == tmp_path / "whole.mcap"
    expected = (
        "cut.mcap is not complete: ",
        "bag_0.mcap is not complete: 3000 of 3001 states",
        "contains no scenario",
        "3 byt",
    )
    assert all(text in reason for text, reason in zip(expected, reasons, strict=True))
    for name, text in zip(("cut.mcap", "ends_early", "foreign", "stub.mcap"), expected, strict=True):
        with pytest.raises(SwarmabsError, match=re.escape(text)):
            find_runs([tmp_path / name], NAMES)


def test_what_is_no_bag_is_refused_and_why_a_run_ended_stays_in_its_line(tmp_path: Path) -> None:
    with pytest.raises(NotABagError, match="contains neither a bag nor run folders"):
        find_runs([tmp_path], NAMES)
    with pytest.raises(NotABagError, match=r"cannot read .*nothing"):
        find_runs([tmp_path / "nothing"], NAMES)
    with BagWriter(tmp_path / "bag", topics=MAIN_TOPICS, attachments={}) as writer:
        writer.abort("\n\x1b[2J" * 9999)
    with pytest.raises(InputError, match="is not complete: ") as error:
        find_runs([tmp_path / "bag"], NAMES)
    assert str(error.value).isprintable() and len(str(error.value)) < 3000


def test_a_run_that_was_made_is_found_again_and_no_variant_or_leftovers(tmp_path: Path) -> None:
    assert find_made(tmp_path, ["pd_si_4"]) == {}
    bag = make_run(find_scenario("pd_si_4"), tmp_path, simulate_run, RunOptions())
    assert {path.name for path in (tmp_path / "pd_si_4").iterdir()} == {"bag", "logs", "scenario.yaml", "summary.json"}
    assert [path.name for path in tmp_path.iterdir()] == ["pd_si_4"]
    assert find_made(tmp_path, ["pd_si_4", "pd_di_4"]) == {"pd_si_4": bag}
    assert not bag.altered
    record(tmp_path / "pd_het_4", "pd_het_4")
    (tmp_path / "pd_di_4").mkdir()
    for name in ("pd_het_4", "pd_di_4"):
        with pytest.raises(InputError, match=rf"{name}.*; remove .*, or name another -o"):
            find_made(tmp_path, [name])


def test_a_failed_run_leaves_nothing_and_can_be_made_again(tmp_path: Path) -> None:
    def failing(scenario: Scenario, folder: RunFolder, options: RunOptions) -> Outcome:
        simulate_run(scenario, folder, options)
        return Outcome("failed", "the plane turns over", {})

    scenario = find_scenario("pd_si_4", ["duration=0.1"])
    with pytest.raises(RunError, match="pd_si_4: the plane turns over"):
        make_run(scenario, tmp_path, failing, RunOptions())
    assert list(tmp_path.iterdir()) == []
    assert make_run(scenario, tmp_path, simulate_run, RunOptions()).bag.exists()
