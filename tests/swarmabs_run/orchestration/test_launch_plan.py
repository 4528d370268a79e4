"""What launch files start: the processes are told the epoch when all are ready, and the recorder's word is known."""

import tempfile
from pathlib import Path

import pytest
from tests.processes import until

from swarmabs_config.graph import REALTIME
from swarmabs_core.errors import InputError
from swarmabs_ros.status import StatusChannel
from swarmabs_run.orchestration.launch_plan import Starter, launch_plan


def test_all_are_told_the_same_epoch_when_the_last_is_ready(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    processes = launch_plan("pd_het_4", str(tmp_path / "run"), REALTIME).processes
    assert all(process.parameters["await_epoch"] is True for process in processes)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    starter = Starter(processes)
    for name, path in starter.environment.items():
        monkeypatch.setenv(name, path)
    starter.start()
    first, *others = (StatusChannel(process.name) for process in processes)
    for channel in others:
        channel.send("ready")
        channel.send("ready")
    assert not first.wait_for_start(0.0)
    first.send("ready")
    (epoch,) = {channel.wait_for_epoch() for channel in (first, *others)}
    assert epoch > 1_600_000_000_000_000_000
    until(lambda: starter.begun, "the starter notes the beginning", 10.0)
    first.send("done", problem="the plane has fallen")
    assert starter.problem() == "the plane has fallen"
    until(lambda: not any(Path(path).exists() for path in starter.environment.values()), "no pipe remains", 10.0)


def test_what_is_for_lockstep_only_and_a_folder_in_use_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="robot_gravity"):
        launch_plan("pd_het_4", str(tmp_path / "run"), REALTIME, ["plane.robot_gravity=true"])
    assert not (tmp_path / "run").exists()
    (tmp_path / "mine").touch()
    with pytest.raises(InputError, match="name another with out:="):
        launch_plan("pd_het_4", str(tmp_path), REALTIME)
