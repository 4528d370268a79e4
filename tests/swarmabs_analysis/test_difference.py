"""Differences of messages whose fields are vectors."""

import math

import pytest

from swarmabs_analysis.comparison import compare_steps, recorded_steps
from swarmabs_analysis.difference import component_of, differing_fields, judge, surplus
from swarmabs_core.messages import Basis, RobotState, SwarmAbstract, SwarmAuxiliary
from swarmabs_core.record import Record

SUMS = SwarmAuxiliary(0, 3, 9, (1.0, 2.0, 3.0), (0.0, -0.0), ())
ROBOT = RobotState(0, 3, 9, 2, 5, 1, 1, (0.5, 0.25), (1.0, 2.0), (1.0, 2.0), (70.0, 0.0))


def changed(values: tuple[float, ...], index: int, value: float) -> tuple[float, ...]:
    return (*values[:index], value, *values[index + 1 :])


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (SUMS, []),
        (SUMS._replace(gram=(1.0, math.nextafter(2.0, 3.0), 3.0)), [("gram[1]", 2.0, math.nextafter(2.0, 3.0))]),
        (SUMS._replace(gram=(1.5, 2.0, 3.5)), [("gram[0]", 1.0, 1.5), ("gram[2]", 3.0, 3.5)]),
        (SUMS._replace(drift=(-0.0, -0.0)), [("drift[0]", 0.0, -0.0)]),
        (SUMS._replace(curvature=(1.0, 2.0)), [("curvature", (), (1.0, 2.0))]),
        (SUMS._replace(drift=(0.0,)), [("drift", (0.0, -0.0), (0.0,))]),
    ],
)
def test_of_vectors_the_components_that_differ_are_named(
    other: SwarmAuxiliary, expected: list[tuple[str, object, object]]
) -> None:
    assert repr(list(differing_fields(SUMS, other))) == repr(expected)


def test_the_tolerance_holds_for_each_component_and_not_a_number_equals_itself() -> None:
    near = SUMS._replace(gram=(1.0 + 1e-12, 2.0, 3.0 + 1e-3), drift=(math.nan, -0.0))
    assert [name for name, _, _ in differing_fields(SUMS, near, 1e-9)] == ["gram[2]", "drift[0]"]
    assert list(differing_fields(near, near._replace(drift=(math.nan, -0.0)))) == []
    # It is absolute near 0, and no number is near infinity.
    assert list(differing_fields(SUMS._replace(drift=(1e-10, 0.0)), SUMS, 1e-9)) == []
    assert [name for name, _, _ in differing_fields(SUMS, SUMS._replace(drift=(math.inf, 0.0)), 0.5)] == ["drift[0]"]


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"coordinates": (0.5, 0.26), "velocities": (1.0, 3.0), "command": (1.0, 3.0)}, "command[1]"),
        ({"coordinates": (0.6, 0.25), "velocities": (3.0, 2.0)}, "velocities[0]"),
        ({"constants": (70.0, 1.0), "status": 2}, "constants[1]"),
        ({"system": 8, "constants": (70.0, 1.0)}, "system"),
    ],
)
def test_the_field_that_is_named_is_the_cause_of_the_others(wrong: dict[str, object], named: str) -> None:
    stored = ROBOT._replace(**wrong)
    difference = judge(Record.of(stored), ROBOT, 0.0)
    assert difference is not None
    assert (difference.topic, difference.step, difference.agent, difference.field) == ("swarm/robot_state", 3, 5, named)
    field, index = component_of(named)
    values = [getattr(message, field) for message in (stored, ROBOT)]
    assert [difference.a, difference.b] == (values if index < 0 else [value[index] for value in values])


def test_lists_of_integers_are_compared_as_a_whole() -> None:
    basis = Basis(0, 3, 2, 0, 1, (2, 2), (1, 3), (0, 0))
    assert list(differing_fields(basis, basis._replace(standing=(0, 1)))) == [("standing", (0, 0), (0, 1))]


def test_deviations_of_vectors_are_those_of_their_components_in_order() -> None:
    size = 12
    a = [SwarmAbstract(0, step, 9, 4, (0.0,) * size, (0.0,) * size) for step in range(3)]
    b = [state._replace(value=changed(state.value, 11, 3.0), rate=changed(state.rate, 2, 1.0)) for state in a]
    b[1] = b[1]._replace(value=changed(b[1].value, 2, -4.0))

    (topic,) = compare_steps(*(recorded_steps(map(Record.of, run), "run") for run in (a, b))).topics
    assert [(field.field, field.largest, field.step, field.differing) for field in topic.fields] == [
        ("value[2]", 4.0, 1, 1),
        ("value[11]", 3.0, 0, 3),
        ("rate[2]", 1.0, 0, 3),
    ]
    assert topic.fields[1].rms == 3.0
    assert topic.fields[0].rms == math.sqrt(16.0 / 3.0)


def test_a_surplus_state_of_robot_0_names_it() -> None:
    difference = surplus(Record.of(ROBOT._replace(agent_id=0)), 3, "why")
    assert (difference.agent, difference.missing) == (0, "B")
