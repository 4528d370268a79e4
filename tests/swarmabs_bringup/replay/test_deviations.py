"""How a replay differs from its recording."""

from __future__ import annotations

import math

from tests.swarmabs_core.helpers import builtin

from swarmabs_bringup.replay.deviations import Difference, deviations
from swarmabs_core.behaviours.player import CONTROLLER, OBSERVER, PLANE, NodeKind, NodeName
from swarmabs_core.cdr import encode
from swarmabs_core.messages import ABSTRACT_STATE, AGENT_STATE, Message, Topic
from swarmabs_core.recording import Record, RecordedStep
from swarmabs_core.simulation import Simulation

STEPS = list(Simulation(builtin("pd_het_4", "duration=0.2")).steps())


def changed(topic: Topic, step: int, agent_id: int = 0, **fields: float) -> list[RecordedStep]:
    """Return the run with fields of one message set to other values."""

    def replaced(record: Record) -> Record:
        if (record.topic, record.message.step, record.agent_id) != (topic, step, agent_id):
            return record
        message: Message = record.message._replace(**fields)  # type: ignore[arg-type]
        return record._replace(message=message, payload=encode(message))

    return [RecordedStep(s.step, tuple(map(replaced, s.records))) for s in STEPS]


def torque(step: int) -> float:
    return next(r.message.torque for r in STEPS[step].records if r.topic is ABSTRACT_STATE)  # type: ignore[union-attr]


def test_one_bit_is_found() -> None:
    value = torque(7)
    above = math.nextafter(value, math.inf)
    found = deviations(STEPS, changed(ABSTRACT_STATE, 7, torque=above), [OBSERVER])
    assert found.messages == 2 * 21
    assert found.first == Difference(7, "swarm/abstract_state", 0, "torque", value, above)
    (field,) = found.fields
    assert (field.field, field.differing, field.largest, field.step) == ("torque", 1, above - value, 7)


def test_only_nodes_under_test_are_compared() -> None:
    other = changed(ABSTRACT_STATE, 7, torque=1.0)
    found = deviations(STEPS, other, [PLANE, CONTROLLER])
    assert (found.messages, found.first, found.fields) == (2 * 21, None, ())


def test_the_largest_deviation_is_named_with_step_and_robot() -> None:
    once = changed(AGENT_STATE, 3, 2, position=5.0, command=1.0)
    robots = [NodeName(NodeKind.AGENT, 1), NodeName(NodeKind.AGENT, 2)]
    found = deviations(STEPS, once, robots)
    assert found.messages == 2 * 21
    assert {(d.field, d.step, d.agent) for d in found.fields} == {("position", 3, 2), ("command", 3, 2)}
    before = next(r.message for r in STEPS[3].records if r.agent_id == 2)
    assert {d.field: d.largest for d in found.fields}["position"] == abs(5.0 - before.position)  # type: ignore[union-attr]


def test_what_is_no_number_differs_without_a_size() -> None:
    found = deviations(STEPS, changed(ABSTRACT_STATE, 7, torque=math.nan), [OBSERVER])
    (field,) = found.fields
    assert (field.differing, field.largest, field.step) == (1, None, None)
    same = changed(ABSTRACT_STATE, 7, torque=math.nan)
    assert deviations(same, same, [OBSERVER]).first is None


def test_the_shorter_one_ends_the_comparison() -> None:
    assert deviations(STEPS, STEPS[:5], [PLANE]).messages == 5
