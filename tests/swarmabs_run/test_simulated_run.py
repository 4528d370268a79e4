"""A run in one process."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from swarmabs_bag.errors import BagWriteError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.run import Progress, RunOptions
from swarmabs_run.simulated_run import simulate_run


def test_it_tells_how_it_goes_and_what_it_came_to(tmp_path: Path) -> None:
    told: list[Progress] = []
    scenario = find_scenario("pd_het_4", ["duration=1"]).resolved()
    outcome = simulate_run(scenario, new_run_folder(tmp_path / "run"), RunOptions(on_progress=told.append))
    assert (outcome.status, outcome.reason) == ("ok", None)
    assert outcome.figures["messages"] == 101 * 8
    assert outcome.stepping_seconds
    assert told[-1].phase == "closing"
    assert told[-1].step == told[-1].steps == 100
    assert open_bag(tmp_path / "run").message_count == 101 * 8


def test_without_a_bag_the_digest_is_the_same(tmp_path: Path) -> None:
    scenario = find_scenario("arise_si_4", ["duration=0.5"]).resolved()
    recorded, other = (
        simulate_run(scenario, new_run_folder(tmp_path / str(record)), RunOptions(record=record))
        for record in (True, False)
    )
    assert recorded.figures["digest"] == other.figures["digest"]
    assert (tmp_path / "True" / "bag").is_dir()
    assert not (tmp_path / "False" / "bag").exists()


def test_a_plane_that_turns_over_fails_the_run_and_leaves_a_readable_bag(tmp_path: Path) -> None:
    scenario = find_scenario("pd_si_4", ["plane.disturbance={amplitude: 500, angular_frequency: 1}"]).resolved()
    outcome = simulate_run(scenario, new_run_folder(tmp_path / "run"))
    assert outcome.status == "failed"
    assert outcome.reason is not None
    assert "the plane's angle is" in outcome.reason
    bag = open_bag(tmp_path / "run")
    assert bag.message_count == outcome.figures["messages"] > 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupt_ends_it_in_order(tmp_path: Path, number: signal.Signals, monkeypatch: pytest.MonkeyPatch) -> None:
    real = Recording.add

    def add(self: Recording, step: object) -> None:
        real(self, step)  # type: ignore[arg-type]
        if self.run.latest is not None and self.run.latest.step == 30:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(Recording, "add", add)
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    outcome = simulate_run(find_scenario("pd_het_4").resolved(), new_run_folder(tmp_path / "run"))
    assert (outcome.status, outcome.reason) == ("interrupted", "interrupted")
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before
    assert open_bag(tmp_path / "run").message_count == outcome.figures["messages"] >= 31 * 8


def test_a_disk_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Recording, step: object) -> None:
        raise BagWriteError(tmp_path / "bag_0.mcap", OSError(28, "No space left on device"))

    monkeypatch.setattr(Recording, "add", full)
    outcome = simulate_run(find_scenario("pd_het_4").resolved(), new_run_folder(tmp_path / "run"))
    assert outcome.status == "failed"
    assert outcome.reason is not None
    assert "No space left on device" in outcome.reason
    assert outcome.figures["digest"] is None
