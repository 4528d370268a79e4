"""Injected faults: the same bits as simulated, and what is said to have died is dead."""

from __future__ import annotations

import signal
from pathlib import Path

import psutil
import pytest
from tests.processes import until
from tests.system.helpers import (
    bag_digest,
    bag_messages,
    lockstep,
    named_processes,
    run_log,
    seconds,
    signal_process,
    simulated_digest,
    started_swarm,
    summary_of,
    swarm,
    until_stepping,
)

from swarmabs_core.cdr import decode
from swarmabs_core.messages import EventKind, SwarmEvent
from swarmabs_run.run import Progress

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]


def faults(*texts: str) -> str:
    return f"faults=[{', '.join('{' + text + '}' for text in texts)}]"


CASES = {
    "kill": (faults("at: 0.5, kind: kill, agent: 3"), [(51, 3, EventKind.DEAD)]),
    "freeze": (faults("at: 0.5, kind: freeze, agent: 2"), [(51, 2, EventKind.DEAD)]),
    "leave": (faults("at: 0.5, kind: leave, agent: 1"), [(51, 1, EventKind.LEFT)]),
    "remove": (faults("at: 0.5, kind: remove, agent: 1"), [(51, 1, EventKind.LEFT)]),
    "settings": (
        faults(
            "at: 0.3, kind: reference, offset: 0.05",
            "at: 0.5, kind: disturbance, torque: -0.2, until: 0.9",
            "at: null, kind: join, agent: 2",
        ),
        [],
    ),
    "join": (faults("at: 0.5, kind: join, agent: 4"), [(50, 4, EventKind.JOINED)]),
    "loss": (faults("kind: loss, probability: 0.2"), []),
    "delay": (faults("kind: delay, steps: 2"), []),
    "duplication": (faults("kind: duplication, probability: 0.3"), []),
    "reordering": (faults("kind: reordering, probability: 0.4, steps: 3, agents: [1, 4]"), []),
    "clock_offset": (faults("kind: clock_offset, agent: 3, offset: -0.75, from: 0.3"), []),
    "lie": (faults("kind: lie, agent: 3, position_offset: 0.02, mass_factor: 0.9, from: 0.3, to: 1"), []),
    "all": (
        faults(
            "at: 0.2, kind: join, agent: 4",
            "at: 0.4, kind: kill, agent: 1",
            "at: 0.8, kind: leave, agent: 4",
            "kind: loss, probability: 0.1",
            "kind: delay, steps: 1",
            "kind: duplication, probability: 0.2, from: 0.1",
            "kind: reordering, probability: 0.1, steps: 2, to: 1",
            "kind: clock_offset, agent: 2, offset: 3.5",
            "kind: lie, agent: 1, position_factor: 1.1, to: 0.3",
        ),
        [(20, 4, EventKind.JOINED), (41, 1, EventKind.DEAD), (81, 4, EventKind.LEFT)],
    ),
}


def membership_events(folder: Path) -> list[tuple[int, int, int]]:
    """Return step, robot and kind of the recorded changes of the membership."""
    found = []
    for message in bag_messages(folder):
        if message.topic == "swarm/events":
            event = decode(SwarmEvent, message.payload)
            assert isinstance(event, SwarmEvent)
            if event.kind in {EventKind.JOINED, EventKind.LEFT, EventKind.DEAD}:
                found.append((event.step, event.agent_id, event.kind))
    return found


def steps_of_robot(folder: Path, agent_id: int) -> list[int]:
    return [
        message.step
        for message in bag_messages(folder)
        if message.topic == "swarm/agent_state" and message.agent_id == agent_id
    ]


@pytest.mark.parametrize("case", CASES)
def test_a_fault_has_the_same_bits_as_simulated_and_is_recorded(folder: Path, case: str) -> None:
    fault, events = CASES[case]
    outcome = lockstep(folder, "pd_het_4", seconds(1.5), fault)
    assert outcome.status == "ok", outcome.reason
    assert outcome.figures["digest"] == simulated_digest("pd_het_4", seconds(1.5), fault)
    assert outcome.figures["digest"] == bag_digest(bag_messages(folder))
    assert membership_events(folder) == events


@pytest.mark.parametrize(("case", "robot", "first", "last"), [("kill", 3, 0, 50), ("join", 4, 50, 150)])
def test_a_robot_is_recorded_while_it_takes_part(folder: Path, case: str, robot: int, first: int, last: int) -> None:
    lockstep(folder, "pd_het_4", seconds(1.5), CASES[case][0])
    assert steps_of_robot(folder, robot) == list(range(first, last + 1))


@pytest.mark.parametrize(("case", "robot", "alive"), [("kill", 3, False), ("freeze", 2, True), ("leave", 1, False)])
def test_the_process_is_really_gone_and_the_run_goes_on(
    folder: Path,
    mark: str,
    case: str,
    robot: int,
    alive: bool,  # noqa: FBT001
) -> None:
    name = f"agent_{robot:03d}"
    seen: list[bool] = []

    def watch(progress: Progress) -> None:
        if progress.phase != "running" or progress.step < 500:
            return
        until(lambda: (name in named_processes(mark)) is alive, f"{name} is as it should be")
        if alive:
            pid = named_processes(mark)[name]
            until(lambda: psutil.Process(pid).status() == psutil.STATUS_STOPPED, f"{name} is stopped")
        seen.append(True)

    outcome = lockstep(folder, "pd_het_4", seconds(20.0), CASES[case][0], on_progress=watch)
    assert outcome.status == "ok", outcome.reason
    assert seen
    assert "to process" in run_log(folder)


@pytest.mark.parametrize("case", ["kill", "leave"])
def test_the_last_process_of_several_robots_may_hold_one(folder: Path, case: str) -> None:
    fault = faults(f"at: 0.5, kind: {case}, agent: 4")
    outcome = lockstep(folder, "pd_het_4", seconds(20.0), fault, agents_per_process=3)
    assert outcome.status == "ok", outcome.reason
    assert outcome.figures["digest"] == simulated_digest("pd_het_4", seconds(20.0), fault)
    assert "to process" in run_log(folder)


DROP = "lockstep={on_stall: drop, stall_timeout: 0.5}"


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_a_silent_robot_is_dropped_if_that_is_wanted(folder: Path, mark: str, number: signal.Signals) -> None:
    words = ("run", "pd_het_4", "--set", DROP, "--duration", 30, "-o", folder, "--json")
    with started_swarm(*words) as command:
        until_stepping(folder)
        signal_process(mark, "agent_003", number)
        done = command.wait()
    assert done.code == 0, done.err
    ((step, robot, kind),) = membership_events(folder)
    assert (robot, kind) == (3, EventKind.DEAD)
    assert steps_of_robot(folder, 3) == list(range(step))
    assert steps_of_robot(folder, 1) == list(range(3001))
    assert bag_digest(bag_messages(folder)) == done.summary()["digest"] == summary_of(folder)["digest"]


def test_a_lost_disturbance_shows() -> None:
    """The digests above depend on what they are meant to prove."""
    digests = {simulated_digest("pd_het_4", seconds(1.5), fault) for fault, _ in CASES.values()}
    assert len(digests) == len(CASES)


def test_a_swarm_that_nobody_is_left_of_fails_and_says_so(folder: Path) -> None:
    everybody = faults(*(f"at: 0.5, kind: kill, agent: {robot}" for robot in (1, 2, 3, 4)))
    done = swarm("run", "pd_het_4", "--duration", 2, "--set", everybody, "-o", folder)
    assert done.code in {1, 2}
    assert "robot" in done.err
