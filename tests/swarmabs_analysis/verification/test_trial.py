"""Trials: nodes of a recorded run answer as they did, and with other settings as their laws say."""

from collections.abc import Iterator, Sequence

import pytest
from tests.swarmabs_core.helpers import builtin, singly

from swarmabs_analysis.verification.base import VerificationResult
from swarmabs_analysis.verification.lockstep import LockstepVerification
from swarmabs_analysis.verification.trial import Trial
from swarmabs_bag.run.step import Step
from swarmabs_config.scenario import Scenario
from swarmabs_core import messages as msg
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError
from swarmabs_core.membership import SILENT
from swarmabs_core.nodes import NodeName
from swarmabs_core.record import Record
from swarmabs_run.simulation import Simulation

RUNS = {
    **{kind: (f"faults=[{{at: 0.5, kind: {kind}, agent: 3}}]",) for kind in ("kill", "leave", "join")},
    "freeze": ("faults=[{at: 0.5, kind: freeze, agent: 2}]",),
    "loss": ("faults=[{kind: loss, probability: 0.3}]",),
    "delay": ("faults=[{kind: delay, steps: 3}]",),
    "many": (
        "faults=[{kind: loss, probability: 0.2}, {kind: delay, steps: 1}]",
        "faults.2={at: 0.2, kind: join, agent: 3}",
        "faults.3={at: 0.7, kind: kill, agent: 3}",
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
ALSO_IN_MANY = ("kill", "join", "loss", "delay")
COORDINATORS = ("controller", "observer", "parent")
NODES = (*((name,) for name in (*COORDINATORS, "agent:1", "agent:3")), ("parent", "observer", "agent:2"))


def names(*texts: str) -> tuple[NodeName, ...]:
    return tuple(map(NodeName.parse, texts))


def run(*overrides: str, division: int | None = None) -> tuple[Scenario, list[Step]]:
    scenario = builtin("pd_het_4", "duration=1", *overrides).resolved()
    return scenario, singly(Simulation(scenario, division=division).steps())


def tried(
    scenario: Scenario,
    steps: Sequence[Step],
    nodes: Sequence[str],
    *overrides: str,
    recorded: Sequence[str] = (),
    division: int | None = None,
) -> VerificationResult:
    """Return the result of a trial of nodes with overrides, for a run that was `recorded` with others."""
    changed = builtin("pd_het_4", "duration=1", *recorded, *overrides).resolved()
    trial = Trial(names(*nodes), overrides, changed, scenario)
    verification = LockstepVerification(scenario, division=division, trial=trial)
    for step in steps:
        for topic, time, payload in step.stored():
            verification.add(topic, time, payload)
    verification.finish()
    return verification.result


def published(steps: Sequence[Step], *nodes: str) -> Iterator[Record]:
    """Yield what nodes have published, without events; by topic and robot, not by the product's own table."""
    topics = {"controller": ("swarm/desired_abstract_state",), "parent": ("plane/state",)}
    topics["observer"] = ("swarm/abstract_state", "swarm/auxiliary_state", "swarm/standing")
    for step in steps:
        for record in step.records:
            for node in nodes:
                robot = node.partition(":")[2]
                if record.topic.name in topics.get(node, ()) or (
                    robot and record.topic is msg.AGENT_STATE and record.agent_id == int(robot)
                ):
                    yield record


@pytest.mark.parametrize("case", [case for case in RUNS if case not in ALSO_IN_MANY])
def test_nodes_answer_their_own_recording_as_they_did(case: str) -> None:
    scenario, steps = run(*RUNS[case])
    for nodes in NODES:
        result = tried(scenario, steps, nodes, recorded=RUNS[case])
        assert (result.difference, result.steps, result.trial["deviations"]) == (None, 101, []), nodes
        assert result.messages == len(list(published(steps, *nodes))), nodes


def test_a_robot_that_was_dropped_is_dropped_again() -> None:
    """To all others it is the same as if it had been killed by plan."""
    _, steps = run("faults=[{at: 0.5, kind: kill, agent: 3}]", "lockstep.on_stall=drop")
    steps = [Step.of(step.step, map(_silenced, step.records)) for step in steps]
    scenario = builtin("pd_het_4", "duration=1", "lockstep.on_stall=drop").resolved()
    for nodes in NODES:
        result = tried(scenario, steps, nodes, recorded=["lockstep.on_stall=drop"])
        assert (result.difference, result.steps) == (None, 101), nodes


def _silenced(record: Record) -> Record:
    """Let the event of a robot's death say that the robot was silent."""
    if not isinstance(record.message, msg.SwarmEvent) or record.message.detail != "kill":
        return record
    message = record.message._replace(detail=SILENT)
    return record._replace(message=message, payload=encode(message))


def test_an_earlier_bag_lacks_the_division_of_the_abstract_state() -> None:
    scenario, steps = run(*RUNS["kill"], division=0)
    for nodes in NODES:
        assert tried(scenario, steps, nodes, recorded=RUNS["kill"], division=0).difference is None, nodes


def test_other_gains_ask_for_another_torque_and_nothing_reacts() -> None:
    """The PD law asks for kp times the angle of a plane at rest; law and filter are linear in the gains."""
    scenario, steps = run("controller.gains=[4, 3.5]")
    result = tried(scenario, steps, ["controller"], "controller.gains=[20, 17.5]")
    first = result.difference
    assert first is not None
    assert (first.step, first.topic, first.field) == (0, "swarm/desired_abstract_state", "torque")
    assert first.a == pytest.approx(4 * scenario.plane.angle, rel=1e-15)
    assert first.b == pytest.approx(20 * scenario.plane.angle, rel=1e-15)
    assert (result.steps, result.messages) == (101, 101)
    (torque,) = (row for row in result.trial["deviations"] if row["field"] == "torque")
    asked = [record.message for record in published(steps, "controller")]
    by_law = [abs((5 - 1) * m.torque) for m in asked if isinstance(m, msg.DesiredAbstractState)]
    assert torque["largest"] == pytest.approx(max(by_law), rel=1e-9)
    assert torque["step"] == by_law.index(max(by_law))
    assert torque["rms"] == pytest.approx((sum(d * d for d in by_law) / len(by_law)) ** 0.5, rel=1e-9)
    assert {row["topic"] for row in result.trial["deviations"]} == {"swarm/desired_abstract_state"}


def test_a_node_keeps_its_own_memory() -> None:
    """A plane without friction under the recorded weight: an angle more by 0.1 rad at the start is so at the end."""
    settings = ("plane.friction=[0, 0, 0, 0, 0, 0]", "duration=0.1")
    scenario = builtin("pd_het_4", *settings).resolved()
    steps = singly(Simulation(scenario).steps())
    changed = builtin("pd_het_4", *settings, f"plane.angle={scenario.plane.angle + 0.1}").resolved()
    verification = LockstepVerification(scenario, trial=Trial(names("parent"), (), changed, scenario))
    for step in steps:
        for topic, time, payload in step.stored():
            verification.add(topic, time, payload)
    verification.finish()
    (angle,) = (row for row in verification.result.trial["deviations"] if row["field"] == "angle")
    assert angle["differing"] == len(steps)
    assert angle["largest"] == pytest.approx(0.1, rel=2e-2)  # the weight acts by the cosine of the angle
    assert angle["rms"] == pytest.approx(0.1, rel=2e-2)


def test_a_node_that_cannot_continue_ends_the_trial_with_the_reason() -> None:
    scenario, steps = run()
    result = tried(scenario, steps, ["parent"], "plane.friction=[1e12, 1e12, 1e12, 1e12, 1e12, 1e12]")
    assert result.difference is not None
    assert (result.difference.step, result.difference.field, result.difference.b) == (1, "message", None)
    assert "not finite" in result.difference.reason


@pytest.mark.parametrize(
    ("node", "override", "message"),
    [
        ("parent", "step=0.02", "--set changes the control period, .*; use run instead"),
        ("parent", "duration=0.5", "--set changes the duration"),
        ("parent", "faults=[{at: 0.2, kind: kill, agent: 2}]", "--set changes the faults that end robots"),
        ("parent", "lockstep.on_stall=drop", "--set changes the reaction to silent robots"),
        ("agent:9", "plane.angle=0.2", "--node agent:9: the scenario has no robot 9; it has 1, 2, 3, 4"),
    ],
)
def test_what_contradicts_the_recording_is_rejected(node: str, override: str, message: str) -> None:
    scenario = builtin("pd_het_4", "duration=1").resolved()
    with pytest.raises(InputError, match=message):
        Trial(names(node), (override,), builtin("pd_het_4", "duration=1", override).resolved(), scenario)
