"""What a replay says of a message that one side does not have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from tests.swarmabs_analysis.figures.conftest import record

from swarmabs_analysis.comparison.table import replay_parts
from swarmabs_analysis.replay.run import ReplayRun
from swarmabs_analysis.replay.source import open_source
from swarmabs_bag.attached import attached_scenario
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import RunFolder
from swarmabs_core.publishers import NodeName


def shown(result: dict[str, Any]) -> str:
    console = Console(width=200)
    with console.capture() as capture:
        console.print(*replay_parts(result))
    return capture.get()


@pytest.mark.parametrize("lacks", ["replay", "recording"])
def test_a_missing_message_is_said_to_be_missing(tmp_path: Path, lacks: str) -> None:
    short = record(tmp_path / "short", "pd_het_4", "duration=0.2")
    long = record(tmp_path / "long", "pd_het_4")
    recorded, replayed = (long, short) if lacks == "replay" else (short, long)
    scenario = attached_scenario(open_bag(long)).resolved()
    run = ReplayRun(open_source(recorded), (NodeName.parse("plane"),), (), scenario)
    result = run.result(RunFolder(replayed), None)
    first = result["first_difference"]
    assert (first["step"], first["topic"], first["field"]) == (21, "plane/state", "message")
    assert [side for side in ("recorded", "replayed") if first[side] is None] == [
        {"replay": "replayed", "recording": "recorded"}[lacks]
    ]
    assert f"step 21, plane/state, the message is missing in the {lacks}" in shown(result)
