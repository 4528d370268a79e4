"""Random scenarios: repeatable, different, valid, and such that a swarm can recover."""

from __future__ import annotations

from collections import Counter

import pytest

from swarmabs_analysis.soak.draw import FAULTS_UNTIL, FEWEST, MOST, drawn_scenario
from swarmabs_analysis.soak.invariants import last_fault
from swarmabs_config.scenario import FAULT_KINDS, dump_scenario


def test_seed_and_number_decide_alone() -> None:
    texts = {(seed, number): dump_scenario(drawn_scenario(seed, number)) for seed in (1, 2) for number in (0, 1, 11)}
    assert len(set(texts.values())) == len(texts)
    assert all(dump_scenario(drawn_scenario(*key)) == text for key, text in texts.items())


@pytest.mark.parametrize("robots", [None, 4, 25])
def test_what_is_drawn(robots: int | None) -> None:
    kinds: Counter[str] = Counter()
    for number in range(150):
        scenario = drawn_scenario(3, number, robots)
        count = len(scenario.agents)
        assert FEWEST <= count <= MOST if robots is None else count == robots
        kinds.update(fault.kind for fault in scenario.faults)
        gone = {fault.agent for fault in scenario.membership_faults if fault.kind != "join"}
        assert count - len(gone) >= max(3, 2 * count // 3)
        assert not gone & {fault.agent for fault in scenario.robot_faults if fault.kind == "lie"}
        assert scenario.faults
        assert last_fault(scenario) * scenario.period <= FAULTS_UNTIL + 0.02
        assert not [text for text in scenario.warnings() if text.startswith("faults")]
    assert set(kinds) == set(FAULT_KINDS)
