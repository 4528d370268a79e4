"""An operator and a fleet of real nodes: status, stop, reset, drain, join."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.processes import until
from tests.swarmabs_fleet.bundle_processes import ended, running, write_below
from tests.swarmabs_fleet.fleets import ONE_HOST, deployed, edited

from swarmabs_cli import main
from swarmabs_config.fleet.loader import load_fleet
from swarmabs_run.orchestration.network import claimed_domain

PATIENCE = 60.0
THIRD = "  - {id: 3, host: base, kind: single_integrator, mass: 0.3, drive: {type: simulated, position: -0.2}}\n"


def operate(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "swarmabs_cli", *map(str, arguments)]
    return subprocess.run(command, env=os.environ, capture_output=True, text=True, timeout=120, check=False)


def says(fleet: Path) -> dict[str, str]:
    """Return what every node says, by its name."""
    answer: dict[str, Any] = json.loads(operate("status", fleet, "--json").stdout)
    return {row["node"]: f"{row['level']}: {row['text']}" for row in answer["nodes"]}


def left_by(fleet: Path) -> list[str]:
    """Return the ids of the robots that the observer takes to have left."""
    answer: dict[str, Any] = json.loads(operate("status", fleet, "--json").stdout)
    (row,) = [row for row in answer["nodes"] if row["node"] == "abstraction_observer"]
    return str(row["values"]["left"]).split()


def until_all_say(fleet: Path, words: str, *nodes: str) -> None:
    def said() -> bool:
        heard = says(fleet)
        return all(words in heard[node] for node in nodes)

    until(said, f"{', '.join(nodes)} say {words!r}", PATIENCE)


@pytest.mark.system
@pytest.mark.timeout(300)
def test_an_operator_starts_stops_and_thins_out_a_fleet(tmp_path: Path, nothing_survives: str) -> None:
    with claimed_domain() as domain:
        prefix = tmp_path / "etc"
        changes = [("domain: 7", f"domain: {domain}"), ("/etc/swarmabs", str(prefix))]
        third = (
            "  - {id: 3, host: base, kind: single_integrator, mass: 0.3, drive: {type: simulated, position: -0.2}}\n"
        )
        changes.append(("coordinators:", f"{third}coordinators:"))
        file = edited(tmp_path / "one.yaml", ONE_HOST, *changes)
        output = deployed(load_fleet(file), tmp_path / "out")
        prefix.mkdir()
        bundle = (output / "base").rename(prefix / "one")
        write_below(bundle, tmp_path)
        robots = ("agent_001", "agent_002", "agent_003")
        with running(bundle, tmp_path) as units:
            for unit in units.values():
                assert unit.said(b"READY=1"), unit.complaint()
            # A fleet begins stopped.
            until_all_say(file, "stop commanded", *robots)
            assert operate("status", file).returncode == 1
            assert operate("reset", file).returncode == 0
            until_all_say(file, "follows", *robots)
            until_all_say(file, "3 of 3 robots follow", "abstraction_observer")
            until_all_say(file, "OK: records", "recorder")
            until(lambda: operate("status", file).returncode == 0, "all is in order", PATIENCE)
            assert operate("drain", file, 3).returncode == 0
            until_all_say(file, "has left", "agent_003")
            until_all_say(file, "follows", *robots[:2])
            assert operate("join", file, 3).returncode == 0
            until_all_say(file, "follows", *robots)
            alive = operate("remove", file, 3)
            assert alive.returncode == 1
            assert "does so only with one that is silent, another can leave by itself: drain" in alive.stderr
            units["agent_003"].process.kill()
            until_all_say(file, "2 of 3 robots follow", "abstraction_observer")
            assert left_by(file) == []
            removed = operate("remove", file, 3)
            assert (removed.returncode, removed.stderr) == (0, "")
            assert left_by(file) == ["3"]
            del units["agent_003"]
            stopped = operate("stop", file)
            assert (stopped.returncode, stopped.stderr) == (0, "")
            until_all_say(file, "stop commanded", *robots[:2])
            assert ended(units) == [0] * 6
        gone = operate("stop", file, "--timeout", "1")
        assert gone.returncode == 1
        assert "swarm/stop is not there" in gone.stderr
        assert "Traceback" not in gone.stderr


@pytest.mark.parametrize("command", ["status", "stop", "reset"])
def test_what_is_no_swarm_is_refused(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.yaml").write_text("schema: 1\nname: x\n")
    for path in (tmp_path, tmp_path / "x.yaml", tmp_path / "nowhere"):
        assert main([command, str(path)]) == 2
        assert capsys.readouterr().err.startswith("error: ")


def test_a_robot_that_the_fleet_has_not_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = edited(tmp_path / "one.yaml", ONE_HOST)
    assert main(["drain", str(file), "9"]) == 2
    assert "has no robot 9; it has 1, 2" in capsys.readouterr().err
