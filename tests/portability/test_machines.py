"""The same digests on other processors, C libraries and interpreters.

Each test needs a rig, and skips where there is none: docs/developers/testing.md#other-machines.
"""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from scripts.build_wheel import build
from tests.frozen.digests import CASES
from tests.portability.machines import HERE, MACHINES, Machine, aarch64, other_library
from tests.processes import ROOT
from tests.system.helpers import seconds, started_swarm

from swarmabs_config import configure
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.messages import MAIN_TOPICS
from swarmabs_run.simulation import nodes_in_process

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

PROGRAM = Path(__file__).with_name("state_machines.py")
HARD_CASES = ROOT / "tests/swarmabs_core/hard_cases.txt"
CORE = ROOT / "src/swarmabs_core"
RUN = ("pd_het_4", "join_freeze", "sensors", "end_stop", "everything_at_once")
"""Frozen cases whose state machines run with the standard library alone."""
BUILT_IN = ("pd_si_4", "pd_di_4", "pd_het_4", "arise_het_4")
COMMAND = ("-c", "import sys; from swarmabs_cli import main; sys.exit(main())")


def nodes(name: str) -> list[Any]:
    """Return the nodes of a frozen case, as `state_machines` needs them."""
    scenario = find_scenario(CASES[name]["scenario"], CASES[name]["set"])
    configurations = [
        configure.observer_config(scenario),
        configure.parent_config(scenario),
        configure.controller_config(scenario, recording_window=0),
        *configure.agent_configs(scenario),
    ]
    return [
        (type(node.behaviour), configuration, [topic.name for topic in node.hears])
        for node, configuration in zip(nodes_in_process(scenario).values(), configurations, strict=True)
    ]


@pytest.fixture(scope="module")
def systems(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("systems") / "systems.pickle"
    path.write_bytes(pickle.dumps(([topic.name for topic in MAIN_TOPICS], {name: nodes(name) for name in RUN}), 4))
    return path


def results(machine: Machine, systems: Path) -> dict[str, Any]:
    """Run the state machines on a machine; return what its program prints."""
    printed = json.loads(machine.run(PROGRAM, systems, HARD_CASES, folder=systems.parent, search=[CORE]))
    assert isinstance(printed, dict)
    return printed


@pytest.fixture(scope="module")
def here(systems: Path) -> dict[str, Any]:
    return results(HERE, systems)


@pytest.mark.parametrize("name", MACHINES)
def test_state_machines_and_functions_have_the_same_bits(name: str, systems: Path, here: dict[str, Any]) -> None:
    there = results(MACHINES[name](), systems)
    assert there["digests"] == {name: CASES[name]["summary"]["digest"] for name in RUN}
    assert there["elementary"] == here["elementary"]
    assert not there["numpy"]
    if name in {"other library", "WebAssembly"}:
        assert there["library"] != here["library"], "the library is that of this machine"


def test_another_library_does_not_change_the_digests_of_simulations(nothing_survives: str, tmp_path: Path) -> None:
    environment = {**os.environ, **other_library().variables}
    for name in ("pd_het_4", "arise_het_20"):
        with started_swarm("simulate", name, "--json", "-o", tmp_path / name, env=environment) as command:
            assert command.wait().summary()["digest"] == CASES[name]["summary"]["digest"]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Machine, Path]:
    """Return the machine for aarch64, and a folder with the wheel and what it requires, from the root's wheels."""
    machine = aarch64()
    folder = tmp_path_factory.mktemp("aarch64")
    version = machine.run("-c", "import sys; print('{}.{}'.format(*sys.version_info))", folder=folder).strip()
    root = Path(machine.words[2])
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-index"]
    platforms = [f"--platform={name}_aarch64" for name in ("manylinux2014", "manylinux_2_17", "manylinux_2_28")]
    choice = [*platforms, f"--python-version={version}", "--only-binary=:all:", f"--find-links={root / 'wheels'}"]
    subprocess.run([*pip, *choice, f"--target={folder / 'site'}", str(build(folder))], check=True)
    return machine, folder / "site"


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_wheel_simulates_the_same_on_aarch64(name: str, installed: tuple[Machine, Path], tmp_path: Path) -> None:
    machine, site = installed
    printed = machine.run(*COMMAND, "simulate", name, "--json", "-o", "run", folder=tmp_path, search=[site])
    assert json.loads(printed)["digest"] == CASES[name]["summary"]["digest"]


def test_the_wheel_verifies_on_aarch64_what_was_recorded_over_dds_here(
    installed: tuple[Machine, Path], nothing_survives: str, tmp_path: Path
) -> None:
    machine, site = installed
    with started_swarm("run", "arise_het_4", "--set", seconds(1.5), "-o", tmp_path / "run") as command:
        done = command.wait()
    assert done.code == 0, done.err
    assert "agree bit for bit" in machine.run(*COMMAND, "verify", "run", folder=tmp_path, search=[site])
