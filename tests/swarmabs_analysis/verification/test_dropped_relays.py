"""Bags of runs without an observer in which robots dropped silent ones."""

from collections.abc import Iterable
from pathlib import Path
from random import Random

import pytest
from tests.swarmabs_core.behaviours.peers_in_time import World
from tests.swarmabs_core.behaviours.test_dropping import swarm
from tests.swarmabs_core.realtime.bags import Stored

from swarmabs_analysis.difference import Difference
from swarmabs_analysis.verification.lockstep import LockstepVerification
from swarmabs_analysis.verification.relays import TIMED
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.repair.completeness import complete_steps
from swarmabs_bag.run.gatherer import RunCollector
from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import encode
from swarmabs_core.messages import Relay
from swarmabs_core.record import Record

CASES = [(seed, links) for seed in range(3) for links in ("{}", "{type: ring, loss: 0.3}", "{sensing: [2]}")]


def dropped(scenario: Scenario, seed: int) -> World:
    """Run a swarm of which a robot ends somewhere in the run."""
    draw = Random(seed)
    world = World(scenario, draw)
    world.end_at(draw.choice((1, 3, 4, 5)), draw.randint(4, 30))
    world.run(20.0)
    assert len(world.drops) == 1 and not world.stopped
    return world


def steps(scenario: Scenario, world: World) -> list[Step]:
    """Gather what was said, of which nothing is missing but what a robot did not say any more."""
    gathered = RunCollector(
        configure.members(scenario),
        configure.schedule(scenario),
        scenario.steps,
        division=configure.division(scenario),
        relayed=True,
    )
    found: list[Step] = []
    for _, message in world.log:
        found += gathered.add(Record.of(message))
    assert gathered.finished
    return found


def bag(folder: Path, scenario: Scenario, of: Iterable[Step]) -> Path:
    recording = Recording(scenario, folder / "bag", driver="lockstep")
    for step in of:
        recording.add(step)
    recording.close()
    return folder


@pytest.mark.parametrize(("seed", "links"), CASES)
def test_a_run_is_verified_to_its_end(tmp_path: Path, seed: int, links: str) -> None:
    scenario = swarm(5, links).resolved()
    folder = bag(tmp_path, scenario, steps(scenario, dropped(scenario, seed)))
    result = BagToVerify(folder).verify()
    assert (result.difference, result.complete) == (None, True)
    assert {*result.not_checkable} == {TIMED}
    complete = complete_steps(folder)
    assert complete is not None and complete.last_complete == scenario.steps


@pytest.mark.parametrize("messages", [4, 14, 24])
def test_a_run_is_verified_in_which_a_robot_is_dropped_before_it_was_to_join(tmp_path: Path, messages: int) -> None:
    scenario = swarm(5, "{}", faults="[{kind: join, agent: 4, at: 0.1}]").resolved()
    world = World(scenario, Random(messages))
    world.end_at(4, messages)
    world.run(20.0)
    assert {*world.drops} == {4} and not world.stopped
    result = BagToVerify(bag(tmp_path, scenario, steps(scenario, world))).verify()
    assert (result.difference, result.complete) == (None, True)


def difference(scenario: Scenario, of: Iterable[Step], at: tuple[int, int, int], place: int | None) -> Difference:
    """Verify a run in which a byte of a relay, by step, robot and round, is changed, or the relay is missing."""
    verification = LockstepVerification(scenario, relayed=True)
    for stored in (Stored(*message) for step in of for message in step.stored()):
        relay, message = stored.message, stored
        if isinstance(relay, Relay) and (relay.step, relay.agent_id, relay.round) == at:
            if place is None:
                continue
            content = bytearray(relay.content)
            content[place] ^= 4
            message = stored._replace(payload=encode(relay._replace(content=bytes(content))))
        verification.add(*message)
    verification.finish()
    assert verification.result.difference is not None
    return verification.result.difference


def test_a_relay_that_repeats_another_state_is_found_in_any_step() -> None:
    """And where it does not depend on time which relays there are, one that is missing."""
    scenario = swarm(5, "{}").resolved()
    world = dropped(scenario, 1)
    run = steps(scenario, world)
    ((robot, end),) = world.drops.items()
    other = 2 if robot == 1 else 1
    motion = 3 + 12  # after three sets and three sizes: that of the sender, which is all that it holds in round 0
    assert end > 2
    for step in (end - 2, end, end + 1):
        found = difference(scenario, run, (step, other, 0), motion)
        assert (found.step, found.agent, found.field) == (step, other, f"robot_{other}.position")
    for step in (end - 2, end + 1):
        missing = difference(scenario, run, (step, other, 0), None)
        assert (missing.topic, missing.step, missing.agent) == (f"agent_00{other}/relay", step, other)
        assert missing.reason == "not all of its relays are there, and it is not dropped"
