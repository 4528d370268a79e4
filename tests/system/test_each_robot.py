"""Robots that coordinate the swarm by themselves, over DDS, on a parent system of the examples."""

import os
from pathlib import Path

import pytest
from tests.examples.test_each_robot import FAULTS, RANDOM, cut
from tests.examples.test_parent_systems import _installed  # noqa: F401 - a fixture
from tests.swarmabs_core.helpers import digest
from tests.system import helpers as runs

from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenario import parse_scenario
from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.run import RunOptions
from swarmabs_run.simulation import Simulation

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

ALONE = ("coordination=each_robot", f"links={{{RANDOM}, loss: 0.5, sensing: [1, 3]}}")


def test_a_run_has_the_digest_of_the_usual_coordination_and_verifies(
    folder: Path, packages: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = [packages, Path("examples", "plate").resolve(), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, search)))
    central, alone = (parse_scenario(cut("plate", 10), overrides=[FAULTS, *more]) for more in ((), ALONE))
    outcome = LockstepRun(alone.resolved(), new_run_folder(folder), RunOptions(agents_per_process=2)).run()
    assert (outcome.status, outcome.figures["digest"]) == ("ok", digest(Simulation(central).steps())), outcome.reason
    verified = runs.swarm("verify", folder, "--json").summary()
    assert (verified["complete"], verified["messages"]) == (True, outcome.figures["messages"])
