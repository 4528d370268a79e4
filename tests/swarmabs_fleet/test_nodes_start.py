"""The nodes of a bundle start as their units start them: command, environment files, parameters, word to systemd."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.swarmabs_fleet.bundle_processes import ended, running
from tests.swarmabs_fleet.fleets import ONE_HOST, deployed, edited

from swarmabs_config.fleet.loader import load_fleet
from swarmabs_run.orchestration.network import claimed_domain


@pytest.mark.system
@pytest.mark.timeout(120)
@pytest.mark.parametrize("plane", ["simulated", "driver"])
def test_every_node_takes_its_parameters_and_says_that_it_is_ready(
    plane: str, tmp_path: Path, nothing_survives: str
) -> None:
    with claimed_domain() as domain:
        prefix = tmp_path / "etc"
        topic = "drive: {type: topic, topic: /odom, command_topic: /force}}"
        changes = [("domain: 7", f"domain: {domain}"), ("/etc/swarmabs", str(prefix)), (", recorder: {host: base}", "")]
        if plane == "driver":
            changes.append(("plane: {host", "plane: {type: driver, topic: /encoder, host"))
            changes.append(("drive: {type: simulated, position: -0.1}}", topic))
        output = deployed(load_fleet(edited(tmp_path / "one.yaml", ONE_HOST, *changes)), tmp_path / "out")
        prefix.mkdir()
        bundle = (output / "base").rename(prefix / "one")
        with running(bundle, tmp_path) as units:
            assert len(units) == 5
            for name, unit in units.items():
                assert unit.said(b"READY=1", b"WATCHDOG=1"), f"{name}: {unit.complaint()}"
            assert ended(units) == [0] * 5
