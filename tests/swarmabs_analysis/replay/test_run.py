"""Bags as sources of replays, which say the same bit for bit in this process; and the processes of a live replay."""

import json
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path

import pytest
from rich.console import Console
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_core.helpers import builtin, digest, singly

from swarmabs_analysis.comparison.table import replay_parts
from swarmabs_analysis.replay import source as source_module
from swarmabs_analysis.replay.run import ReplayRun, replayed_steps
from swarmabs_analysis.replay.source import open_source
from swarmabs_bag.attached import attached_scenario
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.run.step import Step
from swarmabs_bag.run.writer import BagWriter
from swarmabs_bag.run_folder import RunFolder, new_run_folder
from swarmabs_config.scenario import Scenario, dump_scenario
from swarmabs_core import messages as msg
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.faults import RobotFault
from swarmabs_core.membership import SILENT, Change, ChangeKind
from swarmabs_core.publishers import PARENT, NodeName
from swarmabs_core.record import Record
from swarmabs_run.orchestration.plan import ProcessPlan, plan
from swarmabs_run.simulation import Simulation

SETTINGS = ("duration=0.6", "faults=[{at: 0.3, kind: kill, agent: 3}, {kind: loss, probability: 0.2}]")


def silenced(record: Record) -> Record:
    """Let the event of a robot's death say that the robot was silent."""
    if not isinstance(record.message, msg.SwarmEvent) or record.message.detail != "kill":
        return record
    message = record.message._replace(detail=SILENT)
    return record._replace(message=message, payload=encode(message))


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a simulated run of 60 steps in which robot 3 is killed."""
    return record(tmp_path_factory.mktemp("recorded") / "run", "pd_het_4", *SETTINGS)


ALL = (*msg.MAIN_TOPICS, msg.STANDING, msg.EVENTS)
EARLIER = (*msg.MAIN_TOPICS, msg.EVENTS)
"""The topics of bags without the division of the abstract state."""
NODE = (NodeName.parse("controller"),)
STEPS = singly(Simulation(builtin("pd_het_4", *SETTINGS)).steps())


def write(folder: Path, records: Iterable[Record], *settings: str, topics: tuple[msg.Topic, ...] = ALL) -> Path:
    """Write a bag of these records with the scenario of these settings."""
    scenario = dump_scenario(builtin("pd_het_4", *settings).resolved())
    with BagWriter(folder, topics=topics, attachments={"scenario.yaml": scenario.encode()}) as writer:
        for each in records:
            if each.topic in topics:
                writer.write(each.topic, each.message.stamp, each.payload)
    return folder


def records(until: int, steps: Sequence[Step] = STEPS) -> list[Record]:
    return [record for step in steps[:until] for record in step.records]


def test_a_source_is_what_was_recorded(recorded: Path) -> None:
    source = open_source(recorded)
    assert list(source.steps()) == STEPS
    assert (source.last_step, source.ends, source.robots) == (60, (), frozenset({1, 2, 3, 4}))
    assert source.digest == digest(STEPS)
    assert source.scenario(NODE, ()) == source.recorded
    assert [source.scenario(NODE, [f"duration={time}"]).steps for time in (10, 0.4)] == [60, 40]


def test_a_run_that_ended_early_is_replayed_as_far_as_its_steps_are_complete(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", records(21)[:-2], *SETTINGS)  # step 20 lacks its last two broadcasts
    source = open_source(bag)
    assert source.last_step == 19
    scenario = source.scenario(NODE, ())
    assert (scenario.steps, [fault.kind for fault in scenario.faults]) == (19, ["loss"])
    assert [step.step for step in source.steps()] == list(range(20))


def of_the_first_steps(folder: Path, *settings: str) -> Scenario:
    """Return the scenario of a replay of what ended after 20 steps."""
    steps = singly(Simulation(builtin("pd_het_4", *settings)).steps())
    return open_source(write(folder, records(21, steps), *settings)).scenario(NODE, ())


def test_faults_and_robots_of_what_comes_later_are_left_out(tmp_path: Path) -> None:
    faults = (
        "faults=[{kind: join, at: 0.5, agent: 4}, {kind: loss, probability: 0.1, agents: [4]},"
        " {kind: reordering, probability: 0.1, agents: [3, 4]}, {kind: delay, steps: 1, from: 0.4},"
        " {kind: lie, agent: 4, mass_factor: 2}, {kind: clock_offset, agent: 1, offset: 2, from: 0.1, to: 0.4}]"
    )
    scenario = of_the_first_steps(tmp_path / "faults", "duration=0.6", faults)
    assert [agent.id for agent in scenario.agents] == [1, 2, 3]
    hits = [(fault.kind, fault.hits(3)) for fault in scenario.faults_of(RobotFault)]
    assert hits == [("reordering", True), ("clock_offset", False)]
    scenario = of_the_first_steps(tmp_path / "join", "duration=0.6", "faults=[{at: 0.3, kind: join, agent: 3}]")
    assert ([agent.id for agent in scenario.agents], scenario.faults) == ([1, 2, 4], ())


def test_what_is_far_behind_an_incomplete_step_is_not_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bag may be larger than the memory, and all of it stand behind a gap."""
    bag = write(tmp_path / "bag", [*records(5), *records(61)[len(records(6)) :]], *SETTINGS)
    read: list[Record] = []
    kept = BagReader.records

    def noted(self: BagReader, topics: Collection[msg.Topic] | None = None) -> Iterator[Record]:
        for found in kept(self, topics):
            read.append(found)
            yield found

    monkeypatch.setattr(BagReader, "records", noted)
    assert open_source(bag).last_step == 4
    assert len(read) == len(records(61)) - 8
    read.clear()
    monkeypatch.setattr(source_module, "WINDOW", 3)
    assert open_source(bag).last_step == 4
    assert len(read) == len(records(5)) + 3 * 9 + 1


def test_an_unplanned_end_is_found_unless_it_is_of_a_stranger(tmp_path: Path) -> None:
    source = open_source(write(tmp_path / "bag", list(map(silenced, records(61))), "duration=0.6"))
    assert source.ends == (Change(30, 3, ChangeKind.KILL),)
    death = next(step for step in source.steps() if step.step == 31)  # a plane under test waits for it in this step
    assert [record.agent_id for record in death.records if record.topic is msg.EVENTS] == [3]
    assert source.last_step == 60
    event = msg.SwarmEvent(0, 5, 9, msg.EventKind.DEAD, 0.0, SILENT)
    told = [*records(21), Record(msg.EVENTS, 9, event, encode(event)), *records(61)[len(records(21)) :]]
    with pytest.raises(InputError, match="robot 9 fell silent, but the scenario lacks it"):
        open_source(write(tmp_path / "stranger", told, "duration=0.6"))


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["step=0.02"], "--set changes the control period, .*; use run instead"),
        (["swarm.agents.4={id: 9, kind: single_integrator, mass: 0.4, position: 0.1}"], "--set changes the robots"),
        (["faults.0.at=0.2"], "--set changes the faults that end robots or let them join"),
        (["lockstep.on_stall=drop"], "--set changes the reaction to silent robots"),
        (["controller.gains.x=1"], "controller.gains"),
    ],
)
def test_changes_that_contradict_the_recording_are_refused(recorded: Path, overrides: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_source(recorded).scenario(NODE, overrides)


def test_bags_without_scenario_topic_or_steps_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no topic plane/state.*; leave out --node"):
        open_source(write(tmp_path / "a", records(3), *SETTINGS, topics=(msg.AGENT_STATE, msg.EVENTS)))
    with pytest.raises(InputError, match="has 1 complete steps, too few for a replay"):
        open_source(write(tmp_path / "b", records(1), *SETTINGS))
    BagWriter(tmp_path / "c", topics=ALL, attachments={}).close()
    with pytest.raises(InputError, match="contains no scenario"):
        open_source(tmp_path / "c")
    assert open_bag(tmp_path / "c").message_count == 0


RUNS = {
    "undisturbed": (),
    **{kind: (f"faults=[{{at: 0.5, kind: {kind}, agent: 3}}]",) for kind in ("kill", "leave", "join")},
    "freeze": ("faults=[{at: 0.5, kind: freeze, agent: 2}]",),
    "loss": ("faults=[{kind: loss, probability: 0.3}]",),
    "delay": ("faults=[{kind: delay, steps: 3}]",),
    "many": (
        "faults=[{kind: loss, probability: 0.2}, {kind: delay, steps: 1}]",
        "faults.2={at: 0.2, kind: join, agent: 3}",
        "faults.3={at: 0.7, kind: kill, agent: 3}",
    ),
    "safe stop": (
        "faults=[{at: 0.3, kind: kill, agent: 2}, {at: 0.6, kind: join, agent: 3}, {at: 0.6, kind: join, agent: 4}]",
    ),
    "limits": (
        *("limits={velocity: 0.05, force: 0.2}", "manifold.torque_max=0.2"),
        *("plane.end_stop=0.12", "plane.angular_velocity=0.5"),
    ),
    "noise and lag": (
        *(f"{part}.sensor.noise=[0.001, 0.01]" for part in ("plane", "swarm")),
        "swarm.actuator_lag=0.02",
    ),
    "torque from the plane": ("observer.type=parent_response",),
    "robots feel gravity": ("plane.robot_gravity=true",),
}
ALONE = [(node,) for node in ("controller", "observer", "parent", "agent:1", "agent:3")]
EVERYBODY = ("controller", "observer", "parent", *(f"agent:{number}" for number in (1, 2, 3, 4)))
NODES = (*ALONE, ("parent", "observer"), EVERYBODY)


def names(*texts: str) -> list[NodeName]:
    return [NodeName.parse(text) for text in texts]


def run(*overrides: str) -> tuple[Scenario, list[Step]]:
    scenario = builtin("pd_het_4", "duration=1", *overrides).resolved()
    return scenario, singly(Simulation(scenario).steps())


def only(steps: list[Step], topic: msg.Topic) -> list[Record]:
    return [each for each in records(len(steps), steps) if each.topic is topic]


def torque(steps: list[Step]) -> float:
    """Return the torque that is asked for first."""
    desired = only(steps, msg.DESIRED_ABSTRACT_STATE)[0].message
    assert isinstance(desired, msg.DesiredAbstractState)
    return desired.torque


@pytest.mark.parametrize("case", RUNS)
def test_the_same_code_gives_the_same_messages_and_events(case: str) -> None:
    scenario, recorded = run(*RUNS[case])
    for nodes in NODES:
        assert singly(replayed_steps(scenario, names(*nodes), iter(recorded))) == recorded, nodes


def test_a_robot_that_was_dropped_is_dropped_again() -> None:
    """To all others it is the same as if it had been killed by plan."""
    _, steps = run("faults=[{at: 0.5, kind: kill, agent: 3}]", "lockstep.on_stall=drop")
    recorded = [Step.of(step.step, tuple(map(silenced, step.records))) for step in steps]
    scenario = builtin("pd_het_4", "duration=1", "lockstep.on_stall=drop").resolved()
    end = Change(50, 3, ChangeKind.KILL)
    for nodes in NODES:
        assert singly(replayed_steps(scenario, names(*nodes), iter(recorded), [end])) == recorded, nodes


@pytest.mark.parametrize("nodes", NODES)
@pytest.mark.parametrize("on_stall", ["fail", "drop"])
def test_an_earlier_bag_is_replayed_without_the_division_that_it_lacks(
    nodes: tuple[str, ...], on_stall: str, tmp_path: Path
) -> None:
    settings = (*SETTINGS, f"lockstep.on_stall={on_stall}")
    scenario = builtin("pd_het_4", *settings).resolved()
    steps = singly(Simulation(scenario, division=0).steps())
    source = open_source(write(tmp_path / "bag", records(61, steps), *settings, topics=EARLIER))
    assert list(source.steps()) == steps
    replay, folder = ReplayRun(source, tuple(names(*nodes)), (), scenario), new_run_folder(tmp_path / "run")
    result = replay.result(folder, replay.in_process(folder).figures["digest"])
    assert (result["same"], result["first_difference"]) == (True, None)
    assert open_bag(folder.path).topics() == EARLIER
    tested = [process for process in replay.plan(plan(scenario, folder)) if "division" in process.parameters]
    assert [process.parameters["division"] for process in tested] == [0] * len(tested)
    wanted = {"observer": "abstraction_observer", "controller": "parent_controller"}
    assert {process.name for process in tested} == {"recorder", *(wanted[name] for name in nodes if name in wanted)}
    assert all("swarm/standing" not in matches(process) for process in tested if process.name != "recorder")


def test_changed_gains_are_what_the_node_would_have_said_and_nobody_reacts() -> None:
    """The PD law asks for kp times the angle of a plane at rest; all others say what they said."""
    scenario, recorded = run()
    changed = builtin("pd_het_4", "duration=1", "controller.gains=[20, 3]").resolved()
    replayed = singly(replayed_steps(changed, names("controller"), iter(recorded)))
    assert torque(replayed) == pytest.approx(20 * scenario.plane.angle, rel=1e-15)
    for before, after in zip(recorded, replayed, strict=True):
        said = [r.topic for r, other in zip(before.records, after.records, strict=True) if r != other]
        assert said == [msg.DESIRED_ABSTRACT_STATE]


def test_nodes_under_test_hear_each_other() -> None:
    """A plane that begins at another angle is what the controller beside it sees."""
    _, recorded = run()
    changed = builtin("pd_het_4", "duration=1", "plane.angle=0.2").resolved()
    alone = singly(replayed_steps(changed, names("plane"), iter(recorded)))
    both = singly(replayed_steps(changed, names("plane", "controller"), iter(recorded)))
    first = only(both, msg.PLANE_STATE)[0].message
    assert isinstance(first, msg.PlaneState)
    assert first.angle == 0.2
    assert only(both, msg.PLANE_STATE) == only(alone, msg.PLANE_STATE)
    assert only(alone, msg.DESIRED_ABSTRACT_STATE) == only(recorded, msg.DESIRED_ABSTRACT_STATE)
    assert torque(both) == pytest.approx(2.0 * torque(recorded), rel=1e-12)


def test_a_node_that_cannot_go_on_fails_the_replay() -> None:
    _, recorded = run()
    heavy = builtin("pd_het_4", "duration=1", "plane.disturbance={amplitude: 5000, angular_frequency: 1}").resolved()
    replay = replayed_steps(heavy, names("plane", "controller"), iter(recorded))
    with pytest.raises(RunError, match=r"the plane's angle is .* and a run ends at 1\.5 rad"):
        list(replay)


def test_a_recording_that_lacks_a_robot_stalls_and_says_who() -> None:
    scenario, recorded = run()
    incomplete = [
        Step.of(step.step, tuple(r for r in step.records if r.agent_id != 2 or step.step < 30)) for step in recorded
    ]
    with pytest.raises(RunError, match="the replay stalls at step 30; missing: agent 2"):
        singly(replayed_steps(scenario, names("observer"), iter(incomplete)))


def planned(recorded: Path, *nodes: str) -> dict[str, ProcessPlan]:
    scenario = builtin("pd_het_4", *SETTINGS).resolved()
    replay = ReplayRun(open_source(recorded), tuple(names(*nodes)), ("controller.gains=[it's]",), scenario)
    return {process.name: process for process in replay.plan(plan(scenario, RunFolder(Path("run"))))}


def matches(process: ProcessPlan) -> dict[str, int]:
    texts = process.parameters["match"]
    assert isinstance(texts, list)
    return {name: int(number) for name, number in (text.split() for text in texts)}


def test_there_are_the_player_the_nodes_under_test_and_the_recorder(recorded: Path) -> None:
    for nodes, programs in (
        (("controller",), ["parent_controller"]),
        (("agent:3", "parent"), ["agent_003", "plane_sim"]),
    ):
        processes = planned(recorded, *nodes)
        assert list(processes) == ["replay_player", *programs, "recorder"]
        assert len({process.participant for process in processes.values()}) == len(processes)
        player = processes["replay_player"].parameters
        assert (player["nodes"], player["last_step"]) == (nodes, 60)
        assert player["bag"] == str(recorded / "bag" / "bag_0.mcap")
        told = json.loads(str(processes["recorder"].parameters["replay"]))
        assert (told["nodes"], told["overrides"]) == (list(nodes), ["controller.gains=[it's]"])


def test_each_waits_for_the_counterparts_that_there_are(recorded: Path) -> None:
    """Of the desired state, which the controller publishes, there is no second publisher."""
    processes = planned(recorded, "controller")
    assert matches(processes["parent_controller"]) == {
        "swarm/events": 1,  # the recorder
        "swarm/desired_abstract_state": 2,  # player and recorder
        "plane/state": 1,
        "swarm/standing": 1,
        "recording/progress": 1,
    }
    assert matches(processes["recorder"])["swarm/desired_abstract_state"] == 1
    assert matches(processes["recorder"])["swarm/events"] == 2
    assert "swarm/desired_abstract_state" not in [t.name for t in processes["replay_player"].publications]
    processes = planned(recorded, "agent:3")  # robots share their topic with the player
    assert matches(processes["recorder"])["swarm/agent_state"] == 2
    assert matches(processes["agent_003"])["swarm/abstract_state"] == 1


@pytest.mark.parametrize("lacks", ["replay", "recording"])
def test_a_missing_message_is_said_to_be_missing(tmp_path: Path, lacks: str) -> None:
    short = record(tmp_path / "short", "pd_het_4", "duration=0.2")
    long = record(tmp_path / "long", "pd_het_4")
    recorded, replayed = (long, short) if lacks == "replay" else (short, long)
    scenario = attached_scenario(open_bag(long)).resolved()
    run = ReplayRun(open_source(recorded), (PARENT,), (), scenario)
    result = run.result(RunFolder(replayed), None)
    first = result["first_difference"]
    assert (first["step"], first["topic"], first["field"]) == (21, "plane/state", "message")
    side = {"replay": "replayed", "recording": "recorded"}
    assert {name: first[key] is None for name, key in side.items()} == {name: name == lacks for name in side}
    console = Console(width=200)
    with console.capture() as capture:
        console.print(*replay_parts(result))
    assert f"step 21, plane/state, the message is missing in the {lacks}" in capture.get()
