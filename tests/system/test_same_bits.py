"""Distributed equals monolithic, bit for bit, whatever else happens on the machine."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from tests.system.helpers import (
    bag_digest,
    bag_messages,
    domain_of,
    lockstep,
    run_log,
    seconds,
    simulated_digest,
    started_swarm,
    summary_of,
    swarm,
)

from swarmabs_run.orchestration import process_run
from swarmabs_run.orchestration.plan import ProcessPlan

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

FOUR_ROBOTS = ("pd_si_4", "pd_di_4", "pd_het_4", "arise_si_4", "arise_di_4", "arise_het_4")


def same_as_simulated(folder: Path, scenario: str, *overrides: str, **options: object) -> None:
    """Run a scenario as processes, and prove that its digest is that of the simulation and of its bag."""
    outcome = lockstep(folder, scenario, *overrides, **options)  # type: ignore[arg-type]
    assert outcome.status == "ok", outcome.reason
    assert outcome.figures["digest"] == simulated_digest(scenario, *overrides)
    assert outcome.figures["digest"] == bag_digest(bag_messages(folder))


def test_the_main_job_twice_and_simulated_once(tmp_path: Path) -> None:
    commands = {"first": ["run"], "second": ["run", "pd_het_4"], "simulated": ["simulate"]}
    found = {name: swarm(*words, "-o", tmp_path / name, "--json") for name, words in commands.items()}
    assert {name: done.code for name, done in found.items()} == dict.fromkeys(commands, 0), found
    digests = {name: done.summary()["digest"] for name, done in found.items()}
    assert len(set(digests.values())) == 1, digests
    for name, done in found.items():
        assert done.summary() == summary_of(tmp_path / name)
        assert done.summary()["steps"] == 3000
        assert bag_digest(bag_messages(tmp_path / name)) == digests[name]


@pytest.mark.parametrize("scenario", FOUR_ROBOTS)
def test_every_scenario_of_four_robots(folder: Path, scenario: str) -> None:
    same_as_simulated(folder, scenario, seconds(3.0))


def test_an_imperfect_world_watched_through_the_plane(folder: Path) -> None:
    options = (
        *("plane.sensor={noise: [1e-4, 1e-3], resolution: [1e-5, 0]}", "plane.end_stop=0.1005"),
        *("swarm.sensor={noise: [1e-3, 1e-3]}", "swarm.actuator_lag=0.02", "plane.angular_velocity=0.2"),
        *("controller.trajectory={type: quintic}", "observer={type: parent_response}"),
    )
    same_as_simulated(folder, "arise_het_4", seconds(2.0), *options)


def shuffled(processes: Sequence[ProcessPlan]) -> Sequence[ProcessPlan]:
    return random.Random(5).sample(processes, len(processes))


@pytest.mark.parametrize("order", [lambda processes: processes[::-1], shuffled], ids=["reversed", "shuffled"])
def test_processes_started_in_another_order(
    folder: Path, order: Callable[[Sequence[ProcessPlan]], Sequence[ProcessPlan]]
) -> None:
    same_as_simulated(folder, "arise_het_4", seconds(2.0), arrange=order)


def by_executor(processes: Sequence[ProcessPlan]) -> Sequence[ProcessPlan]:
    return [replace(process, parameters=process.parameters | {"receive": "executor"}) for process in processes]


def test_the_public_executor_gives_the_same(folder: Path) -> None:
    same_as_simulated(folder, "arise_het_4", seconds(2.0), arrange=by_executor)


def test_a_machine_without_multicast_gives_the_same(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_run, "multicast_works", lambda: False)
    same_as_simulated(folder, "arise_het_4", seconds(2.0))
    assert "<defaultMulticastLocatorList>" not in (folder / "logs" / "fastdds.xml").read_text(encoding="utf-8")


@pytest.mark.parametrize("scenario", ["pd_het_4"])
def test_robots_that_share_processes(folder: Path, scenario: str) -> None:
    same_as_simulated(folder, scenario, seconds(2.0), agents_per_process=3)


@pytest.mark.parametrize(
    ("scenario", "overrides", "agents_per_process"),
    [
        ("arise_het_4", (), 1),
        ("pd_het_4", ("plane.robot_gravity=true",), 1),
        ("pd_het_4", ("faults=[{at: 0.5, kind: kill, agent: 1}, {at: 1.0, kind: leave, agent: 4}]",), 1),
        ("pd_het_4", ("faults=[{at: 0.7, kind: join, agent: 3}, {kind: delay, steps: 2}]",), 1),
        ("arise_het_20", (), 7),
    ],
    ids=["plain", "gravity", "robots that go", "a robot that comes", "shared"],
)
def test_packed_broadcasts(folder: Path, scenario: str, overrides: tuple[str, ...], agents_per_process: int) -> None:
    options = {"packed": True, "agents_per_process": agents_per_process}
    same_as_simulated(folder, scenario, *overrides, seconds(2.0), **options)


@pytest.fixture
def full_load() -> Iterator[None]:
    """Keep every core busy twice over."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2 * (os.cpu_count() or 1))]
    yield
    for process in busy:
        process.kill()
        process.wait()


@pytest.mark.usefixtures("full_load")
def test_under_full_load_from_other_programs(folder: Path) -> None:
    same_as_simulated(folder, "pd_het_4", seconds(2.0))


def lossy(processes: Sequence[ProcessPlan]) -> Sequence[ProcessPlan]:
    return [replace(process, module="tests.system.lossy_node") for process in processes]


@pytest.mark.usefixtures("own_modules")
@pytest.mark.parametrize("options", [{}, {"packed": True}], ids=["three broadcasts", "packed"])
def test_lost_packets_change_nothing(folder: Path, options: dict[str, object]) -> None:
    """Every node loses one message in a hundred: whoever lacks one waits until it is repeated."""
    same_as_simulated(folder, "pd_het_4", seconds(0.8), arrange=lossy, **options)
    logs = [log.read_text(encoding="utf-8") for log in (folder / "logs").glob("*.log")]
    assert sum(text.count("lost: ") for text in logs) > 5


def late(processes: Sequence[ProcessPlan]) -> Sequence[ProcessPlan]:
    return [replace(p, module="tests.system.late_node") if p.name == "agent_002" else p for p in processes]


@pytest.mark.usefixtures("own_modules")
def test_a_robot_that_comes_up_only_the_second_time(folder: Path) -> None:
    same_as_simulated(folder, "pd_het_4", seconds(1.0), arrange=late)
    assert "agent_002" in run_log(folder)
    assert "not today" in (folder / "logs" / "agent_002.log").read_text(encoding="utf-8")


def test_two_runs_at_the_same_time(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("one", "two")]
    words = ("run", "arise_het_4", "--duration", 3, "--json", "-o")
    with started_swarm(*words, folders[0]) as one, started_swarm(*words, folders[1]) as two:
        found = [command.wait() for command in (one, two)]
    assert [done.code for done in found] == [0, 0], found
    assert [done.summary()["digest"] for done in found] == [simulated_digest("arise_het_4", seconds(3))] * 2
    assert domain_of(folders[0]) != domain_of(folders[1])


def test_a_bag_runs_again(tmp_path: Path) -> None:
    first = swarm("run", "pd_di_4", "--duration", 1, "-o", tmp_path / "first", "--json")
    again = swarm("run", tmp_path / "first", "-o", tmp_path / "again", "--json")
    assert (first.code, again.code) == (0, 0)
    assert first.summary()["digest"] == again.summary()["digest"]
    assert again.summary()["scenario"] == "pd_di_4"


@pytest.mark.timeout(180)
def test_twenty_robots(folder: Path) -> None:
    same_as_simulated(folder, "arise_het_20", seconds(2.0))


@pytest.mark.full
@pytest.mark.timeout(900)
def test_two_hundred_robots(folder: Path) -> None:
    same_as_simulated(folder, "arise_het_200", seconds(1.0))
