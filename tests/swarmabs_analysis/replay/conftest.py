"""A short run with a fault, recorded once."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.simulated_run import simulate_run

SETTINGS = ("duration=0.6", "faults=[{at: 0.3, kind: kill, agent: 3}, {kind: loss, probability: 0.2}]")


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a simulated run of 60 steps in which robot 3 is killed."""
    folder = new_run_folder(tmp_path_factory.mktemp("recorded") / "run")
    assert simulate_run(find_scenario("pd_het_4", SETTINGS).resolved(), folder).status == "ok"
    return folder.path
