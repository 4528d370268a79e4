"""Replays in this process: what was recorded comes out again, bit for bit, whatever happened in the run."""

from __future__ import annotations

import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_analysis.replay.run import replayed_steps
from swarmabs_bag.recording import RecordedStep
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.membership import Change, ChangeKind, with_ends
from swarmabs_core.messages import (
    DESIRED_ABSTRACT_STATE,
    PLANE_STATE,
    DesiredAbstractState,
    EventKind,
    PlaneState,
    SwarmEvent,
    Topic,
)
from swarmabs_core.publishers import NodeName, publisher_of
from swarmabs_core.record import Record
from swarmabs_run.simulation import Simulation

RUNS = {
    "undisturbed": (),
    "kill": ("faults=[{at: 0.5, kind: kill, agent: 3}]",),
    "freeze": ("faults=[{at: 0.5, kind: freeze, agent: 2}]",),
    "leave": ("faults=[{at: 0.5, kind: leave, agent: 3}]",),
    "join": ("faults=[{at: 0.5, kind: join, agent: 3}]",),
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
        "limits={velocity: 0.05, force: 0.2}",
        "manifold.torque_max=0.2",
        "plane.end_stop=0.12",
        "plane.angular_velocity=0.5",
    ),
    "noise and lag": (
        "plane.sensor.noise=[0.001, 0.01]",
        "swarm.sensor.noise=[0.001, 0.01]",
        "swarm.actuator_lag=0.02",
    ),
    "torque from the plane": ("observer.type=parent_response",),
    "robots feel gravity": ("plane.robot_gravity=true",),
}
NODES = (
    ("controller",),
    ("observer",),
    ("plane",),
    ("agent:1",),
    ("agent:3",),
    ("plane", "observer"),
    ("controller", "observer", "plane", "agent:1", "agent:2", "agent:3", "agent:4"),
)


def names(*texts: str) -> list[NodeName]:
    return [NodeName.parse(text) for text in texts]


def run(*overrides: str) -> tuple[Scenario, list[RecordedStep]]:
    scenario = builtin("pd_het_4", "duration=1", *overrides).resolved()
    return scenario, list(Simulation(scenario).steps())


def only(steps: list[RecordedStep], topic: Topic) -> list[Record]:
    return [record for step in steps for record in step.records if record.topic is topic]


@pytest.mark.parametrize("case", RUNS)
def test_the_same_code_gives_the_same_messages_and_events(case: str) -> None:
    scenario, recorded = run(*RUNS[case])
    for nodes in NODES:
        assert list(replayed_steps(scenario, names(*nodes), iter(recorded))) == recorded, nodes


def test_every_node_that_announces_something_does_so_in_these_runs() -> None:
    """The events above are told apart by who has said what; without them the test above would say little."""
    announced = {
        (publisher_of(record.message).kind.value, EventKind(record.message.kind))
        for overrides in RUNS.values()
        for step in run(*overrides)[1]
        for record in step.records
        if isinstance(record.message, SwarmEvent)
    }
    assert announced >= {
        *(("observer", kind) for kind in (EventKind.JOINED, EventKind.LEFT, EventKind.DEAD)),
        *(
            ("agent", kind)
            for kind in (EventKind.SAFE_STOP, EventKind.RECOVERED, EventKind.FAULT_INJECTED, EventKind.LIMIT_HIT)
        ),
        ("plane", EventKind.LIMIT_HIT),
        ("controller", EventKind.LIMIT_HIT),
    }


def silent_run() -> tuple[Scenario, list[RecordedStep], Change]:
    """Return a run in which robot 3 was dropped: to all others the same as if it had been killed by plan."""
    _, steps = run("faults=[{at: 0.5, kind: kill, agent: 3}]")
    steps = [RecordedStep(step.step, tuple(map(as_silence, step.records))) for step in steps]
    return builtin("pd_het_4", "duration=1").resolved(), steps, Change(50, 3, ChangeKind.KILL)


def as_silence(record: Record) -> Record:
    """Let the event of a robot's death say that the robot was silent."""
    if not isinstance(record.message, SwarmEvent):
        return record
    message = record.message._replace(detail="silent")
    return record._replace(message=message, payload=encode(message))


@pytest.mark.parametrize("nodes", NODES)
def test_a_robot_that_was_dropped_is_dropped_again(nodes: tuple[str, ...]) -> None:
    scenario, recorded, end = silent_run()
    assert list(replayed_steps(scenario, names(*nodes), iter(recorded), [end])) == recorded


def test_an_unplanned_end_comes_before_the_planned_one() -> None:
    planned = (Change(10, 3, ChangeKind.JOIN), Change(500, 3, ChangeKind.LEAVE), Change(70, 2, ChangeKind.KILL))
    unplanned = Change(50, 3, ChangeKind.KILL)
    assert with_ends(planned, [unplanned]) == (planned[0], unplanned, planned[2])
    assert with_ends(planned, ()) == tuple(sorted(planned))


def test_changed_gains_are_what_the_node_would_have_said_and_nobody_reacts() -> None:
    """The PD law asks for kp times the angle of a plane at rest; all others say what they said."""
    scenario, recorded = run()
    changed = builtin("pd_het_4", "duration=1", "controller.gains=[20, 3]").resolved()
    replayed = list(replayed_steps(changed, names("controller"), iter(recorded)))
    first = only(replayed, DESIRED_ABSTRACT_STATE)[0].message
    assert isinstance(first, DesiredAbstractState)
    assert first.torque == pytest.approx(20 * scenario.plane.angle, rel=1e-15)
    others = [[r for r in step.records if r.topic is not DESIRED_ABSTRACT_STATE] for step in recorded]
    assert [[r for r in step.records if r.topic is not DESIRED_ABSTRACT_STATE] for step in replayed] == others
    pairs = zip(only(replayed, DESIRED_ABSTRACT_STATE), only(recorded, DESIRED_ABSTRACT_STATE), strict=True)
    assert all(after != before for after, before in pairs)


def test_nodes_under_test_hear_each_other() -> None:
    """A plane that begins at another angle is what the controller beside it sees."""
    _, recorded = run()
    changed = builtin("pd_het_4", "duration=1", "plane.angle=0.2").resolved()
    alone = list(replayed_steps(changed, names("plane"), iter(recorded)))
    both = list(replayed_steps(changed, names("plane", "controller"), iter(recorded)))
    (first, *_) = [r.message for r in only(both, PLANE_STATE)]
    assert isinstance(first, PlaneState)
    assert first.angle == 0.2
    assert only(both, PLANE_STATE) == only(alone, PLANE_STATE)
    assert only(alone, DESIRED_ABSTRACT_STATE) == only(recorded, DESIRED_ABSTRACT_STATE)
    desired = only(both, DESIRED_ABSTRACT_STATE)[0].message
    before = only(recorded, DESIRED_ABSTRACT_STATE)[0].message
    assert isinstance(desired, DesiredAbstractState)
    assert isinstance(before, DesiredAbstractState)
    assert desired.torque == pytest.approx(2.0 * before.torque, rel=1e-12)


def test_a_node_that_cannot_go_on_fails_the_replay() -> None:
    _, recorded = run()
    heavy = builtin("pd_het_4", "duration=1", "plane.disturbance={amplitude: 5000, angular_frequency: 1}").resolved()
    replay = replayed_steps(heavy, names("plane", "controller"), iter(recorded))
    with pytest.raises(RunError, match=r"the plane's angle is .* and a run ends at 1\.5 rad"):
        list(replay)


def test_a_recording_that_lacks_a_robot_stalls_and_says_who() -> None:
    scenario, recorded = run()
    incomplete = [
        RecordedStep(step.step, tuple(r for r in step.records if r.agent_id != 2 or step.step < 30))
        for step in recorded
    ]
    with pytest.raises(RunError, match="the replay stalls at step 30; missing: agent 2"):
        list(replayed_steps(scenario, names("observer"), iter(incomplete)))
