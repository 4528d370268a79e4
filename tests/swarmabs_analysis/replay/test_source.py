"""Bags as sources of replays."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import pytest
from tests.swarmabs_analysis.replay.conftest import SETTINGS

from swarmabs_analysis.replay import source as source_module
from swarmabs_analysis.replay.source import open_source
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.recording import Digest
from swarmabs_bag.writer import BagWriter
from swarmabs_config.scenario import dump_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError
from swarmabs_core.faults import RobotFault
from swarmabs_core.membership import SILENT, Change, ChangeKind
from swarmabs_core.messages import AGENT_STATE, EVENTS, MAIN_TOPICS, EventKind, SwarmEvent, Topic
from swarmabs_core.publishers import NodeName
from swarmabs_core.record import Record
from swarmabs_run.simulation import Simulation

ALL = (*MAIN_TOPICS, EVENTS)
NODE = (NodeName.parse("controller"),)
STEPS = list(Simulation(find_scenario("pd_het_4", SETTINGS)).steps())


def write(folder: Path, records: list[Record], *settings: str, topics: tuple[Topic, ...] = ALL) -> Path:
    """Write a bag of these records with the scenario of these settings."""
    scenario = find_scenario("pd_het_4", settings).resolved()
    writer = BagWriter(folder, topics=topics, attachments={"scenario.yaml": dump_scenario(scenario).encode()})
    for record in records:
        if record.topic in topics:
            writer.write(record.topic, record.message.stamp, record.payload)
    writer.close()
    return folder


def records(until: int) -> list[Record]:
    return [record for step in STEPS[:until] for record in step.records]


def test_a_source_is_what_was_recorded(recorded: Path) -> None:
    source = open_source(recorded)
    assert list(source.steps()) == STEPS
    assert (source.last_step, source.ends, source.robots) == (60, (), frozenset({1, 2, 3, 4}))
    digest = Digest()
    for step in STEPS:
        digest.update(step)
    assert source.digest == digest.hexdigest()
    assert source.scenario(NODE, ()) == source.recorded


def test_a_run_that_ended_early_is_replayed_as_far_as_its_steps_are_complete(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", records(21)[:-2], *SETTINGS)  # step 20 lacks its last two broadcasts
    source = open_source(bag)
    assert source.last_step == 19
    scenario = source.scenario(NODE, ())
    assert (scenario.steps, [fault.kind for fault in scenario.faults]) == (19, ["loss"])
    assert [step.step for step in source.steps()] == list(range(20))


def test_faults_of_what_comes_later_are_left_out(tmp_path: Path) -> None:
    settings = (
        "duration=0.6",
        (
            "faults=[{kind: join, at: 0.5, agent: 4}, {kind: loss, probability: 0.1, agents: [4]},"
            " {kind: reordering, probability: 0.1, agents: [3, 4]}, {kind: delay, steps: 1, from: 0.4},"
            " {kind: lie, agent: 4, mass_factor: 2}, {kind: clock_offset, agent: 1, offset: 2, from: 0.1, to: 0.4}]"
        ),
    )
    steps = list(Simulation(find_scenario("pd_het_4", settings)).steps())[:21]
    source = open_source(write(tmp_path / "bag", [record for step in steps for record in step.records], *settings))
    scenario = source.scenario(NODE, ())
    assert [agent.id for agent in scenario.agents] == [1, 2, 3]
    assert [(fault.kind, fault.hits(3)) for fault in scenario.faults_of(RobotFault)] == [
        ("reordering", True),
        ("clock_offset", False),
    ]


def test_what_stands_far_behind_a_step_that_is_not_complete_is_not_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag may be larger than the memory, and all of it stand behind a gap."""
    bag = write(tmp_path / "bag", [*records(5), *records(61)[len(records(6)) :]], *SETTINGS)
    read = 0
    kept = BagReader.records

    def counted(self: BagReader, topics: Collection[Topic] | None = None) -> Iterator[Record]:
        nonlocal read
        for found in kept(self, topics):
            read += 1
            yield found

    monkeypatch.setattr(BagReader, "records", counted)
    assert open_source(bag).last_step == 4
    assert read == len(records(61)) - 8
    read = 0
    monkeypatch.setattr(source_module, "_WINDOW", 3)
    assert open_source(bag).last_step == 4
    assert read == len(records(5)) + 3 * 9 + 1


def test_a_robot_that_would_have_joined_later_is_left_out(tmp_path: Path) -> None:
    settings = ("duration=0.6", "faults=[{at: 0.3, kind: join, agent: 3}]")
    steps = list(Simulation(find_scenario("pd_het_4", settings)).steps())
    bag = write(tmp_path / "bag", [record for step in steps[:21] for record in step.records], *settings)
    scenario = open_source(bag).scenario(NODE, ())
    assert [agent.id for agent in scenario.agents] == [1, 2, 4]
    assert scenario.faults == ()


def test_a_stranger_that_fell_silent_is_refused(tmp_path: Path) -> None:
    event = SwarmEvent(0, 5, 9, EventKind.DEAD, 0.0, SILENT)
    told = [*records(21), Record(EVENTS, 9, event, encode(event)), *records(61)[len(records(21)) :]]
    with pytest.raises(InputError, match="robot 9 fell silent, which its scenario does not have"):
        open_source(write(tmp_path / "bag", told, "duration=0.6"))


def test_an_unplanned_end_is_found(tmp_path: Path) -> None:
    def silenced(record: Record) -> Record:
        if not isinstance(record.message, SwarmEvent) or record.message.detail != "kill":
            return record
        message = record.message._replace(detail=SILENT)
        return record._replace(message=message, payload=encode(message))

    silent = list(map(silenced, records(61)))
    source = open_source(write(tmp_path / "bag", silent, "duration=0.6"))
    assert source.ends == (Change(30, 3, ChangeKind.KILL),)
    death = next(step for step in source.steps() if step.step == 31)  # a plane under test waits for it in this step
    assert [record.agent_id for record in death.records if record.topic is EVENTS] == [3]
    assert source.last_step == 60


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["step=0.02"], "--set changes the control period, .*; run it instead"),
        (["swarm.agents.4={id: 9, kind: single_integrator, mass: 0.4, position: 0.1}"], "--set changes the robots"),
        (["faults.0.at=0.2"], "--set changes the faults that end robots or let them join"),
        (["controller.gains.x=1"], "controller.gains"),
    ],
)
def test_changes_that_contradict_the_recording_are_refused(recorded: Path, overrides: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_source(recorded).scenario(NODE, overrides)


def test_a_longer_duration_changes_nothing_and_a_shorter_one_is_kept(recorded: Path) -> None:
    source = open_source(recorded)
    assert source.scenario(NODE, ["duration=10"]).steps == 60
    assert source.scenario(NODE, ["duration=0.4"]).steps == 40


def test_a_robot_that_has_recorded_nothing_is_refused(recorded: Path) -> None:
    with pytest.raises(InputError, match="agent:7: the bag has no states of robot 7; it has those of 1, 2, 3, 4"):
        open_source(recorded).scenario((NodeName.parse("agent:7"),), ())


def test_bags_without_scenario_topic_or_steps_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no topic plane/state: .*; leave out --node"):
        open_source(write(tmp_path / "a", records(3), *SETTINGS, topics=(AGENT_STATE, EVENTS)))
    with pytest.raises(InputError, match="has 1 complete steps, too few for a replay"):
        open_source(write(tmp_path / "b", records(1), *SETTINGS))
    writer = BagWriter(tmp_path / "c", topics=ALL, attachments={})
    writer.close()
    with pytest.raises(InputError, match="holds no scenario"):
        open_source(tmp_path / "c")
    assert open_bag(tmp_path / "c").message_count == 0
