"""The floor programs as real processes: they make steps, and nothing of them is left."""

from __future__ import annotations

import ast
import math
import sys
from pathlib import Path

import pytest
from benchmarks import floor_programs
from benchmarks.floor_programs import FLOORS, FOLDER, Floor, measure_floor
from benchmarks.processes import AGENTS

from swarmabs_core.errors import RunError

pytestmark = [pytest.mark.system, pytest.mark.full, pytest.mark.timeout(120)]

BAD = """
import sys, time
from crew import Crew
sys.exit(Crew().serve({"good": lambda crew: (crew.ready(), time.sleep(60)), "bad": lambda crew: 1 / 0}))
"""
LATE = """
import sys
from crew import Crew
def late(crew):
    crew.ready()
    raise SystemExit
sys.exit(Crew().serve({"late": late}))
"""
IDLE = """
import sys, time
from crew import Crew
sys.exit(Crew().serve({"agent_001": lambda crew: (crew.ready(), time.sleep(60))}))
"""


@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize("name", FLOORS)
def test_a_floor_makes_steps_with_all_its_processes(name: str) -> None:
    found = measure_floor(name, 4, warm_up=0.2, window=0.5)
    assert found.steps_per_second > 0.0
    assert found.start_seconds > 0.0
    assert found.load.cpu_share.keys() == {"plane", "observer", "controller", AGENTS}
    assert all(math.isfinite(share) and share >= 0.0 for share in found.load.cpu_share.values())


@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("raise SystemExit('no such socket')", "no such socket"),
        (BAD, "bad ended with 1"),
        (LATE, "late ended with 1"),
    ],
)
def test_a_floor_that_fails_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, reason: str) -> None:
    program = tmp_path / "program.py"
    program.write_text(text)
    monkeypatch.setitem(FLOORS, "broken", Floor(str(program)))
    with pytest.raises(RunError, match=f"floor broken: .*{reason}"):
        measure_floor("broken", 4, warm_up=1.0, window=0.1)


@pytest.mark.usefixtures("nothing_survives")
def test_a_floor_that_makes_no_steps_is_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "program.py"
    program.write_text(IDLE)
    monkeypatch.setitem(FLOORS, "idle", Floor(str(program)))
    with pytest.raises(RunError, match=r"floor idle with 4 robots: no step in 0\.1 s"):
        measure_floor("idle", 4, warm_up=0.0, window=0.1)


@pytest.mark.usefixtures("nothing_survives")
def test_a_floor_that_does_not_answer_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "program.py"
    program.write_text("import time; time.sleep(60)")
    monkeypatch.setitem(FLOORS, "mute", Floor(str(program)))
    monkeypatch.setattr(floor_programs, "START_SECONDS", 0.2)
    monkeypatch.setattr(floor_programs, "END_SECONDS", 0.2)
    with pytest.raises(RunError, match=r"floor mute: no answer in 0\.2 s"):
        measure_floor("mute", 4, warm_up=0.0, window=0.1)


def test_the_floors_share_no_code_with_the_product() -> None:
    programs = list(FOLDER.glob("*.py"))
    assert {floor.program for floor in FLOORS.values()} <= {program.name for program in programs}
    for program in programs:
        for node in ast.walk(ast.parse(program.read_text(encoding="utf-8"))):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            modules += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for module in modules:
                top = module.partition(".")[0]
                assert top in {*sys.stdlib_module_names, "crew", "rclpy", "zmq", "swarmabs_msgs"}, (program, module)
