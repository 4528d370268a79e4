"""A run that fails or is ended from outside, or robots of it, leaves a readable bag; a long one needs no more."""

# That nothing else stays behind is proven by the fixture of all system tests.

import json
import os
import random
import resource
import shlex
import signal
import subprocess
import time
from contextlib import suppress
from functools import cache
from itertools import chain, count
from pathlib import Path

import psutil
import pytest
from rosbags.rosbag2 import Reader
from tests.processes import marked_processes, until
from tests.system import helpers as runs

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair import repair_bag
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.messages import EventKind
from swarmabs_run.orchestration.run_files import ProgressReport, read_progress
from swarmabs_run.run import Progress
from swarmabs_run.simulation import simulated_steps

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

MESSAGES = 8
"""Messages of a step of the scenario."""


def test_a_file_that_may_not_grow_is_named_and_the_bag_readable(folder: Path) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, 600_000))

    with runs.started_swarm("run", "--set", runs.FOREVER, "-o", folder, preexec_fn=limit) as command:
        done = command.wait()
    assert done.code == 1, done.err
    assert "File too large" in done.err
    assert "Traceback" not in done.err
    steps = [message.step for message in runs.bag_messages(folder) if message.topic != "swarm/events"]
    # It is cut where it must; before the last step nothing is missing.
    assert [steps.count(step) for step in range(100)] == [MESSAGES] * 100
    assert runs.summary_of(folder)["status"] == "failed"


def test_ctrl_c_reaches_the_whole_process_group_of_an_impatient_user_again_and_again(folder: Path) -> None:
    with runs.started_swarm("run", "--set", runs.FOREVER, "-o", folder) as command:
        runs.until_stepping(folder)
        asked = 0
        while command.process.poll() is None:
            os.killpg(command.process.pid, signal.SIGINT)
            asked += 1
            with suppress(subprocess.TimeoutExpired):
                command.process.wait(0.005)
        done = command.wait()
    assert asked > 1
    assert done.code == 1
    assert "Traceback" not in done.err


_PRIVATE = ("unshare", "--user", "--map-root-user", "--mount", "--propagation", "private", "sh", "-c")
"""Starts a shell whose mounts are its own."""


def test_nothing_of_the_tracing_library_is_left(folder: Path) -> None:
    """Where no other program has loaded rclpy, which this very process has."""
    words = [*runs.COMMAND, "run", "--set", runs.FOREVER, "-o", str(folder)]
    script = f"mount -t tmpfs tmpfs /dev/shm || exit 77; {shlex.join(words)} >&2; ls /dev/shm"
    with subprocess.Popen([*_PRIVATE, script], stdout=subprocess.PIPE, text=True, start_new_session=True) as shell:
        until(lambda: shell.poll() is not None or runs.run_log(folder), "the run has begun")
        if shell.poll() == 77:
            pytest.skip("this user may not mount anything here")
        runs.until_stepping(folder)
        network = json.loads((folder / "logs" / "network.json").read_text(encoding="utf-8"))
        os.kill(network["orchestrator"], signal.SIGINT)
        left, _ = shell.communicate(timeout=60.0)
    assert runs.summary_of(folder)["status"] == "interrupted"
    assert left == ""


DURATION = 150.0
CREDIT = 100
"""Steps that may be missing however long they took."""
WHOM = ("recorder", "orchestrator", "everything")


@cache
def written() -> tuple[bytes, ...]:
    """Return the payloads of the whole run, as it is without a kill, in the order of a bag."""
    steps = simulated_steps(find_scenario("pd_het_4", [runs.seconds(DURATION)]).resolved())
    return tuple(payload for _, _, payload in chain.from_iterable(step.stored() for step in steps))


def killed(folder: Path, mark: str, whom: str, step: int) -> tuple[float, list[ProgressReport]]:
    """Run, kill all or one when so many steps are recorded, and return when, and what was told of the progress."""
    seen: list[ProgressReport] = []

    def recorded() -> bool:
        told = read_progress(folder / "logs")
        if told is not None and told.phase == "running" and told not in seen:
            seen.append(told)
        return bool(seen) and seen[-1].step >= step

    with runs.started_swarm("run", "--set", runs.seconds(DURATION), "--max-bag-duration", 20, "-o", folder) as command:
        until(recorded, f"{step} steps are recorded", 100.0)
        pids = {"orchestrator": command.process.pid, **runs.named_processes(mark)}
        moment = time.monotonic()
        for pid in marked_processes(mark) if whom == "everything" else [pids[whom]]:
            with suppress(ProcessLookupError):  # it may just have ended
                os.kill(pid, signal.SIGKILL)
        command.wait()
    until(lambda: not marked_processes(mark), "all processes have ended")
    return moment, seen


def checked(folder: Path, moment: float, seen: list[ProgressReport]) -> int:
    """Check what a kill has left behind; return the number of steps."""
    # What was recorded a second before the kill is there, or all but the last 100 steps.
    second_ago = max((told.step for told in seen if told.told_at <= moment - 1.0), default=-1)
    least, report = min(seen[-1].step - CREDIT, second_ago), None
    with suppress(DamagedBagError):
        report = repair_bag(folder, folder / "new")
    if report is None:  # it was killed before it had written a message
        assert least < 0, (seen, moment)
        return 0
    payloads = [payload for _, _, payload in open_bag(folder / "new").messages()]
    assert tuple(payloads) == written()[: len(payloads)], "not the beginning of the run"
    with Reader(folder / "new") as other:
        assert sum(1 for _ in other.messages()) == len(payloads)
    assert report.last_complete_step is not None
    assert report.last_complete_step >= least, (report, seen, moment)
    assert report.last_complete_step == len(payloads) // MESSAGES - 1
    return len(payloads) // MESSAGES


def test_a_run_that_is_killed_loses_no_more_than_a_second(folder: Path, mark: str) -> None:
    assert checked(folder, *killed(folder, mark, "everything", 2000)) > 0


@pytest.mark.full
@pytest.mark.timeout(1500)
def test_a_run_that_is_killed_at_fifty_moments(tmp_path: Path, mark: str) -> None:
    draw = random.Random(1702)
    steps = []
    for number in range(50):
        folder = tmp_path / str(number)
        steps.append(checked(folder, *killed(folder, mark, WHOM[number % len(WHOM)], draw.randrange(1, 10_000))))
    assert len(set(steps)) > 5


SCENARIO, ROBOTS, STEPS = "arise_het_200", 200, 100
LENGTH = runs.seconds(STEPS / 100)


@pytest.mark.full
@pytest.mark.timeout(900)
def test_a_run_that_drops_silent_robots_survives_a_storm_of_signals(folder: Path, mark: str) -> None:
    """It goes on while the run stands still: a run is looked at ten times a second."""
    chance = random.Random(1)
    victims = chance.sample(range(1, ROBOTS + 1), 60)
    killed, stopped, paused = victims[:30], victims[30:45], victims[45:]
    blows = [(chance.randrange(20), robot, signal.SIGKILL) for robot in killed]
    blows += [(chance.randrange(20), robot, signal.SIGSTOP) for robot in stopped]
    for robot in paused:
        look = chance.randrange(20)
        blows += [(look, robot, signal.SIGSTOP), (look + chance.randrange(1, 40), robot, signal.SIGCONT)]
    blows.sort(reverse=True)
    pids: dict[str, int] = {}
    looks = count()

    def storm(progress: Progress) -> None:
        if progress.phase != "running" or not progress.step:
            return
        if not pids:
            pids.update(runs.named_processes(mark))
        now = next(looks)
        while blows and blows[-1][0] <= now:
            _, robot, number = blows.pop()
            os.kill(pids[f"agent_{robot:03d}"], number)

    drop = "lockstep={on_stall: drop, stall_timeout: 2.0}"
    outcome = runs.lockstep(folder, SCENARIO, LENGTH, drop, on_progress=storm)
    assert outcome.status == "ok", outcome.reason
    assert blows == []
    # A robot that is paused is dropped or not, as it happens.
    dead = {event.agent_id for event in runs.events(folder) if event.kind == EventKind.DEAD}
    assert {*killed, *stopped} <= dead <= set(victims)
    messages = runs.bag_messages(folder)
    assert outcome.figures["digest"] == runs.bag_digest(messages)
    last = {m.agent_id for m in messages if m.topic == "swarm/agent_state" and m.step == STEPS}
    assert last == set(range(1, ROBOTS + 1)) - dead


ENDURANCE, EARLY, LATE = 20_000, range(2_000, 5_000), range(16_500, 19_500)
"""Steps; late is before the end: there processes end."""
GROWTH = 2**20
"""Of the resident memory of a process between early and late, bytes: 75 bytes a step would show."""
LOOKS = 3
"""How often each process is looked at, early and late at least."""


def needs(mark: str) -> dict[str, tuple[int, int]]:
    """Return resident memory, bytes, and open file descriptors of the nodes by name, and of the launcher."""
    processes = {name: psutil.Process(pid) for pid, name in marked_processes(mark).items()}
    return {name: (process.memory_info().rss, process.num_fds()) for name, process in processes.items()}


@pytest.mark.full
@pytest.mark.timeout(900)
def test_memory_and_descriptors_of_every_process_stay_flat_over_20000_steps(folder: Path, mark: str) -> None:
    seen: dict[range, list[dict[str, tuple[int, int]]]] = {EARLY: [], LATE: []}

    def watch(progress: Progress) -> None:
        for steps, looks in seen.items():
            if progress.phase == "running" and progress.step in steps:
                looks.append(needs(mark))

    outcome = runs.lockstep(folder, "pd_het_4", runs.seconds(ENDURANCE / 100), on_progress=watch)
    assert outcome.status == "ok", outcome.reason
    assert min(map(len, seen.values())) >= LOOKS
    names = seen[EARLY][0].keys()
    assert len(names) == len(runs.COORDINATORS) + 4 + 1
    for name in names:
        # What it takes for a moment, as to compress a chunk, does not count.
        early, late = (
            [min(held) for held in zip(*(look[name] for look in looks), strict=True)] for looks in seen.values()
        )
        assert late[0] - early[0] < GROWTH, name
        assert late[1] == early[1], name
