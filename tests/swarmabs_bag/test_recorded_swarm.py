"""What is shown of a recorded swarm is what was shown while its messages came."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import pytest
from tests.swarmabs_analysis.figures.conftest import record

from swarmabs_bag.reader import open_bag
from swarmabs_bag.recorded_swarm import read_swarm
from swarmabs_bag.swarm_state import SwarmState

MEMBERS = "[{at: 0.05, kind: kill, agent: 1}, {at: 0.1, kind: leave, agent: 2}, {at: 0.02, kind: join, agent: 4}]"
OFFSET = "[{kind: reference, at: 0.1, offset: 0.2, until: 0.2}, {at: 0.05, kind: remove, agent: 3}]"
ARISE = ("arise_het_4", "faults=[{kind: loss, probability: 0.2}, {at: 0.1, kind: freeze, agent: 3}]")


@pytest.mark.parametrize("run", [("pd_het_4", f"faults={MEMBERS}"), ("pd_het_4", f"faults={OFFSET}"), ARISE])
def test_a_bag_shows_what_its_messages_showed(tmp_path: Path, run: tuple[str, str]) -> None:
    recorded = read_swarm(record(tmp_path / "run", *run))
    live = SwarmState.of(recorded.scenario.resolved())
    messages = sorted((message for _, _, message in open_bag(tmp_path / "run").decoded()), key=lambda one: one.step)
    for row, (step, said) in enumerate(groupby(messages, key=lambda one: one.step)):
        for message in said:
            live.add(message)
        assert live.instant() == recorded.instant(row)
        assert live.shown_robots(step) == recorded.shown_robots(row)
        assert live.members() == recorded.members(row)
    assert row == len(recorded) - 1
    assert [event for event, _ in live.events] == list(recorded.events)
