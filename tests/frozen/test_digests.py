"""Results of runs in one process, over DDS, and of a fleet in real time on a simulated clock."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.frozen import digests, fleets

from swarmabs_core.fingerprint import libm_fingerprints

FINGERPRINT = "c1d491c2e05e87ee"

pytestmark = [
    pytest.mark.timeout(120),
    pytest.mark.skipif(
        FINGERPRINT not in libm_fingerprints(),
        reason="this machine's mathematical library is not that of the frozen digests",
    ),
]


@pytest.mark.parametrize("name", digests.CASES)
def test_a_simulation_gives_its_frozen_results(name: str, tmp_path: Path) -> None:
    assert digests.difference(name, digests.summary(name, tmp_path)) == {}


@pytest.mark.system
@pytest.mark.parametrize("name", digests.chosen("run"))
def test_processes_over_dds_give_them_too(name: str, tmp_path: Path) -> None:
    assert digests.difference(name, digests.summary(name, tmp_path, "run", "--agents-per-process", "4")) == {}


@pytest.mark.system
def test_messages_packed_into_one_give_them_too(tmp_path: Path) -> None:
    assert digests.difference("join_freeze", digests.summary("join_freeze", tmp_path, "run", "--packed")) == {}


@pytest.mark.parametrize("name", fleets.CASES)
def test_a_fleet_in_real_time_says_the_same_at_the_same_times(name: str) -> None:
    assert fleets.digest(name) == fleets.CASES[name]["found"]
