"""What the live panel of a run says, and that it fits into any terminal."""

import re
from io import StringIO

import pytest
from rich.cells import cell_len
from rich.console import Console

from swarmabs_bag.recorder.swarm_summary import SwarmSummary
from swarmabs_config.scenario import Scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.processes import ProcessState
from swarmabs_run.run import Progress
from swarmabs_view.terminal import RunPanel

SCENARIO = find_scenario("pd_het_4", ["duration=10"]).resolved()
SEEN = SwarmSummary(
    {"-": 1, "A": 2, "S": 1}, "A-AS", [-1000, 0, 500, 1000], [f"step {n}: robot 2 dead" for n in (1, 2, 3)]
)
ONE_LINE = "pd_het_4: step 400 of 1000; 250 steps/s, 2.5 x real time; angle +0.5000 rad, error -0.2500 rad"
"""What is longer than some terminals are wide."""


def progress(step: int, error: float | None = -0.25, seen: SwarmSummary | None = SEEN) -> Progress:
    return Progress("running", 8, 8, step, 1000, 250.0, 0.5, error, seen)


def drawn(
    *told: Progress, width: int = 82, height: int = 30, encoding: str = "utf-8", scenario: Scenario = SCENARIO
) -> list[str]:
    panel = RunPanel(scenario)
    for each in told:
        panel.take(each)
    stream = type("Stream", (StringIO,), {"encoding": encoding})()
    console = Console(file=stream, width=width, height=height, force_terminal=True, no_color=True)
    console.print(panel)
    return re.sub("\x1b\\[[012]m", "", stream.getvalue()).splitlines()


def line(lines: list[str], label: str) -> str:
    """Return what stands behind a label, with the blanks that have a meaning."""
    (found,) = [text for text in lines if text[2:].split(" ", 1)[0] == label or text[2:10].strip() == label]
    return found[10:-2].rstrip()


def test_numbers_and_what_is_asked_of_the_plane() -> None:
    lines = drawn(progress(400))
    assert "pd_het_4: step 400 of 1000" in lines[0]
    assert "40%" in lines[1]
    assert line(lines, "angle") == "+0.5000 rad, reference +0.2500 rad, error -0.2500 rad"
    assert line(lines, "speed") == "250 steps/s, 2.5 x real time"
    assert line(lines, "robots") == "2 active, 1 in safe stop, 1 silent"
    assert line(lines, "events") == "step 1: robot 2 dead"
    assert "step 3: robot 2 dead" in lines[-2]
    assert line(drawn(progress(400, None)), "angle") == "+0.5000 rad"
    further = drawn(progress(400, seen=SEEN._replace(further=["effort power +2 W", "effort work +3 J"])))
    assert line(further, "further") == "effort power +2 W"
    (row,) = (number for number, text in enumerate(further) if "effort power" in text)
    assert further[row + 1][10:-2].rstrip() == "effort work +3 J"


def test_the_load_of_the_processes_and_those_that_are_gone_are_shown() -> None:
    panel = RunPanel(SCENARIO)
    panel.take(progress(400))
    loads = {"orchestrator": 1.4, "recorder": 20.0, "plane_sim": 30.0, "agent_001": 10.0, "agent_002": 0.0}
    panel.processes = [ProcessState(name, 5, "sleeping", cpu, 10**6) for name, cpu in loads.items()]
    panel.processes.append(ProcessState("agent_003", 6, "gone"))
    console = Console(file=StringIO(), width=120)
    with console.capture() as capture:
        console.print(panel)
    wanted = "6 with 61 % CPU, plane_sim 30 %, recorder 20 %, agent_001 10 %, gone: agent_003"
    assert line(capture.get().splitlines(), "process") == wanted
    assert not any(text[2:10].strip() == "process" for text in drawn(progress(400)))  # a simulation has none


def test_every_robot_stands_at_its_place_in_its_lane() -> None:
    lines = drawn(progress(400), width=82)  # 68 columns for a lane
    lanes = {robot: line(lines, str(robot)) for robot in (1, 2, 3, 4)}
    assert {robot: len(lane) for robot, lane in lanes.items()} == dict.fromkeys((1, 2, 3, 4), 68)
    # -1, 0, 1/2 and 1 of half the plane: 0, half, three quarters and all of 67 columns.
    assert [lanes[1].index("●"), lanes[2].index("●"), lanes[3].index("■"), lanes[4].index("■")] == [0, 34, 50, 67]


@pytest.mark.parametrize(("encoding", "sign"), [("utf-8", "×"), ("ascii", "x")])
def test_who_is_out_is_told_apart(encoding: str, sign: str) -> None:
    seen = SwarmSummary({"?": 1, "A": 1, "D": 1, "L": 1}, "DLA?", [-1000, 0, 500, 1000], [])
    lines = drawn(progress(400, seen=seen), width=82, encoding=encoding)
    assert line(lines, "robots") == "1 active, 1 left, 1 dead, 1 no data"
    lanes = [set(line(lines, str(robot))) for robot in (1, 2, 3, 4)]
    empty = lanes[1]
    assert lanes[0] - empty == {sign}
    assert lanes[2] - empty == {"■" if sign == "×" else "#"}
    assert lanes[3] == empty
    assert line(lines, "1")[0] == sign
    if encoding == "ascii":
        assert all(text.isascii() for text in lines)


def test_the_error_shrinks_over_the_run_and_is_drawn_only_where_it_is_a_number() -> None:
    lines = drawn(*(progress(step, 1000.0 / (step + 1000.0)) for step in range(501)))
    bars = line(lines, "error").split("  ")[0].split(" ")[0]
    heights = ["▁▂▃▄▅▆▇█".index(bar) for bar in bars]
    assert heights[0] == 7 and heights == sorted(heights, reverse=True)
    assert len(bars) == 56 // 2 + 1  # half of the run, half of the columns
    # 1000 / 1500 of the largest error.
    assert heights[-1] == int(8 * 1000 / 1500)
    assert line(lines, "error").endswith("1.0000 rad")
    lines = drawn(progress(0, float("nan")), progress(100, float("inf")), progress(200, 0.1))
    assert "0.1000 rad" in line(lines, "error")


def test_many_robots_share_a_lane() -> None:
    scenario = find_scenario("arise_het_20").resolved()
    seen = SwarmSummary({"A": 19, "L": 1}, "A" * 19 + "L", [-1000] * 12 + [0] * 7 + [1000], [])
    lane = line(drawn(progress(1, seen=seen), scenario=scenario), "plane")
    assert (lane[0], lane[34], lane[-1]) == ("+", "7", "─")  # who has left is not on the plane


@pytest.mark.parametrize("width", [10, 51, 52, 60, 100, 300])
@pytest.mark.parametrize("height", [3, 8, 9, 11, 14, 50])
def test_it_fits(width: int, height: int) -> None:
    lines = drawn(progress(400), width=width, height=height)
    assert len(lines) < height
    assert max(map(cell_len, lines)) <= min(width - 2, 100), "what a terminal echoes at Ctrl-C begins no other line"
    if width < 52 or height < 9:
        (only,) = lines
        assert only.rstrip("…") == ONE_LINE[: len(only.rstrip("…"))]
    else:
        assert any("reference" in text for text in lines)


def test_nothing_is_drawn_before_the_first_progress() -> None:
    assert "".join(drawn()) == ""


def test_starting_and_closing() -> None:
    assert drawn(Progress("starting", 2, 8, 0, 1000))[0] == "pd_het_4: starting, 2 of 8 processes ready"
    assert line(drawn(Progress("closing", 8, 8, 1000, 1000, 100.0, 0.0, 0.0)), "speed") == "completing the bag"
