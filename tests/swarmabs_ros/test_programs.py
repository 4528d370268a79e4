"""The programs that the packages install."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest
from tests.processes import ROOT, programs

PROGRAMS = [program for path in sorted((ROOT / "src").glob("*/setup.cfg")) for program in programs(path.parent.name)]


def test_every_node_has_a_program_for_lockstep_and_one_for_real_time() -> None:
    names = {program.name for program in PROGRAMS}
    for node in ("plane_sim", "abstraction_observer", "parent_controller", "agent_node"):
        assert {node, f"{node}_realtime"} <= names


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_what_a_program_runs_is_there(program: EntryPoint) -> None:
    assert callable(program.load())
