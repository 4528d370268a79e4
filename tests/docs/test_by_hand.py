"""The nodes of docs/ros.md, started by hand, do what the page says."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from tests.docs.pages import blocks, read, section

if TYPE_CHECKING:
    from tests.docs.conftest import NodesByHand


def documented_nodes() -> list[list[str]]:
    """Return module and arguments of every node that the page starts."""
    (text,) = blocks(section(read("docs/ros.md"), "Run nodes by hand"), "sh")
    return [shlex.split(line)[2:] for line in re.findall(r"^(python -m .*) &$", text, re.MULTILINE)]


def test_all_four_kinds_of_nodes_are_started() -> None:
    assert {module.split(".")[0] for module, *_ in documented_nodes()} == {
        "plane_sim",
        "abstraction_observer",
        "parent_controller",
        "agent_node",
    }


@pytest.mark.system
@pytest.mark.timeout(90)
def test_nodes_of_the_page_level_the_plane_and_its_script_sees_it(by_hand: NodesByHand) -> None:
    for index, (module, *arguments) in enumerate(documented_nodes()):
        by_hand.start(module, *arguments, name=f"{index} {module}")
    (script,) = blocks(section(read("docs/ros.md"), "Look into a run"), "python")
    command = [sys.executable, "-u", "-c", script]
    with subprocess.Popen(command, env=by_hand.environment, stdout=subprocess.PIPE, text=True) as looker:
        try:
            assert looker.stdout is not None
            seen = (line.split() for line in looker.stdout)
            angle = next(float(angle) for step, angle in seen if int(step) >= 1000)
        finally:
            looker.kill()
    assert abs(angle) < 0.01
