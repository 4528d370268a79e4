"""Many of 200 robots killed, stopped and continued at once: the run ends as its scenario says, and nothing is left."""

from __future__ import annotations

import os
import random
import signal
from pathlib import Path

import pytest
from tests.system.helpers import (
    bag_digest,
    bag_messages,
    lockstep,
    named_processes,
    seconds,
    simulated_digest,
)

from swarmabs_core.cdr import decode
from swarmabs_core.messages import EventKind, SwarmEvent
from swarmabs_run.run import Progress

pytestmark = [pytest.mark.system, pytest.mark.full, pytest.mark.timeout(600)]

SCENARIO, ROBOTS, STEPS = "arise_het_200", 200, 100
LENGTH = seconds(STEPS / 100)
Blow = tuple[int, int, signal.Signals]
"""When a robot's process gets a signal: at which look at the run, counted from its first step."""


class Storm:
    """Deals its blows while a run goes on, also while it stands still: a run is looked at ten times a second."""

    def __init__(self, mark: str, blows: list[Blow]) -> None:
        self._mark = mark
        self._blows = sorted(blows)
        self._pids: dict[str, int] = {}
        self._looks = 0

    def __call__(self, progress: Progress) -> None:
        if progress.phase != "running" or not progress.step:
            return
        if not self._pids:
            self._pids = named_processes(self._mark)
            assert len([name for name in self._pids if name.startswith("agent_")]) == ROBOTS
        while self._blows and self._blows[0][0] <= self._looks:
            _, robot, number = self._blows.pop(0)
            os.kill(self._pids[f"agent_{robot:03d}"], number)
        self._looks += 1

    @property
    def over(self) -> bool:
        return not self._blows


def dead_robots(folder: Path) -> set[int]:
    """Return the robots that the bag says have fallen silent."""
    found = set()
    for message in bag_messages(folder):
        if message.topic == "swarm/events":
            event = decode(SwarmEvent, message.payload)
            assert isinstance(event, SwarmEvent)
            if event.kind == EventKind.DEAD:
                found.add(event.agent_id)
    return found


def drawn(seed: int, count: int) -> tuple[random.Random, list[int]]:
    """Return a source of chance, and so many different robots."""
    chance = random.Random(seed)
    return chance, chance.sample(range(1, ROBOTS + 1), count)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_run_that_drops_silent_robots_goes_on_without_them(folder: Path, mark: str, seed: int) -> None:
    chance, victims = drawn(seed, 60)
    killed, stopped, paused = victims[:30], victims[30:45], victims[45:]
    blows: list[Blow] = [(chance.randrange(20), robot, signal.SIGKILL) for robot in killed]
    blows += [(chance.randrange(20), robot, signal.SIGSTOP) for robot in stopped]
    for robot in paused:
        look = chance.randrange(20)
        blows += [(look, robot, signal.SIGSTOP), (look + chance.randrange(1, 40), robot, signal.SIGCONT)]
    storm = Storm(mark, blows)
    drop = "lockstep={on_stall: drop, stall_timeout: 2.0}"
    outcome = lockstep(folder, SCENARIO, LENGTH, drop, on_progress=storm)
    assert outcome.status == "ok", outcome.reason
    assert storm.over
    # A robot that is paused is dropped or not, as it happens.
    assert {*killed, *stopped} <= dead_robots(folder) <= set(victims)
    messages = bag_messages(folder)
    assert outcome.figures["digest"] == bag_digest(messages)
    last = {m.agent_id for m in messages if m.topic == "swarm/agent_state" and m.step == STEPS}
    assert last == set(range(1, ROBOTS + 1)) - dead_robots(folder)


@pytest.mark.parametrize(
    ("number", "words"),
    [(signal.SIGKILL, "was killed by SIGKILL"), (signal.SIGSTOP, "not answered step")],
    ids=["killed", "stopped"],
)
def test_a_run_that_fails_by_silent_robots_names_one_of_them(
    folder: Path, mark: str, number: signal.Signals, words: str
) -> None:
    chance, victims = drawn(3, 60)
    storm = Storm(mark, [(chance.randrange(5), robot, number) for robot in victims])
    outcome = lockstep(folder, SCENARIO, LENGTH, "lockstep={on_stall: fail, stall_timeout: 2.0}", on_progress=storm)
    assert outcome.status == "failed"
    reason = (outcome.reason or "").splitlines()[0]
    assert words in reason
    named = [robot for robot in victims if any(f"agent{gap}{robot:03d} (" in reason for gap in " _")]
    assert named, reason
    assert len(bag_messages(folder)) > ROBOTS


@pytest.mark.parametrize("on_stall", ["fail", "drop"])
def test_robots_that_pause_for_a_moment_change_no_bit(folder: Path, mark: str, on_stall: str) -> None:
    chance = random.Random(4)
    blows: list[Blow] = []
    for gust in range(0, 15, 5):
        for robot in chance.sample(range(1, ROBOTS + 1), 100):
            look = gust + chance.randrange(2)
            blows += [(look, robot, signal.SIGSTOP), (look + chance.randrange(1, 3), robot, signal.SIGCONT)]
    storm = Storm(mark, blows)
    patient = f"lockstep={{on_stall: {on_stall}, stall_timeout: 20.0}}"
    outcome = lockstep(folder, SCENARIO, LENGTH, patient, on_progress=storm)
    assert outcome.status == "ok", outcome.reason
    assert storm.over
    assert outcome.figures["digest"] == simulated_digest(SCENARIO, LENGTH)
