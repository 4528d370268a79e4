"""The channel between a node and the process that started it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator

import pytest

from swarmabs_core.errors import InputError, RunError
from swarmabs_ros.status import EPOCH_RECORD, REPORT_FD, START_FD, StatusChannel, epoch_records


@pytest.fixture
def pipes(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, int]]:
    """Pipes as an orchestrator makes them; a test may close the orchestrator's ends."""
    report_read, report_write = os.pipe()
    start_read, start_write = os.pipe()
    monkeypatch.setenv(REPORT_FD, str(report_write))
    monkeypatch.setenv(START_FD, str(start_read))
    ends = {"reports": report_read, "start": start_write}
    yield ends
    for descriptor in (report_write, start_read, *ends.values()):
        os.close(descriptor)


def test_reports_are_lines_of_json(pipes: dict[str, int]) -> None:
    channel = StatusChannel("agent_007")
    channel.send("ready")
    channel.send("stalled", step=3, missing=("plane_sim", "ä\n"), silence=5.1)
    lines = os.read(pipes["reports"], 65536).decode().splitlines()
    me = {"node": "agent_007", "pid": os.getpid()}
    assert [json.loads(line) for line in lines] == [
        me | {"event": "ready"},
        me | {"event": "stalled", "step": 3, "missing": ["plane_sim", "ä\n"], "silence": 5.1},
    ]


def test_the_start_signal_is_the_end_of_the_other_pipe(pipes: dict[str, int]) -> None:
    channel = StatusChannel("plane_sim")
    assert not channel.wait_for_start(0.0)
    os.close(pipes.pop("start"))
    assert channel.wait_for_start(0.0)
    assert channel.wait_for_start(0.0)


def test_an_orchestrator_that_has_gone_is_no_error(pipes: dict[str, int]) -> None:
    channel = StatusChannel("plane_sim")
    os.close(pipes.pop("reports"))
    channel.send("ready")
    channel.send("ready")


def test_a_node_started_by_hand_reports_nowhere_and_begins_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(REPORT_FD, raising=False)
    monkeypatch.delenv(START_FD, raising=False)
    channel = StatusChannel("plane_sim")
    channel.send("ready")
    assert channel.wait_for_start(0.0)


@pytest.mark.parametrize("epoch", [0, 1_795_270_218_089_639_907, 2**63 - 1])
def test_every_process_finds_the_epoch_in_the_pipe_of_all(pipes: dict[str, int], epoch: int) -> None:
    channels = [StatusChannel(name) for name in ("plane_sim", "recorder", "agent_001")]
    os.write(pipes["start"], epoch_records(epoch, len(channels)))
    os.close(pipes.pop("start"))
    assert [channel.wait_for_epoch() for channel in channels] == [epoch] * 3
    assert len(epoch_records(epoch, 1)) == EPOCH_RECORD
    with pytest.raises(RunError, match="has gone before the start"):
        StatusChannel("one too many").wait_for_epoch()


def test_a_node_started_by_hand_has_nobody_to_tell_it_the_epoch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(START_FD, raising=False)
    with pytest.raises(InputError, match="parameter await_epoch: nobody is there to tell the epoch"):
        StatusChannel("plane_sim").wait_for_epoch()
