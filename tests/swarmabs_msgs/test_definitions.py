"""The message definitions against their twins in the core, and against what a reader of them needs."""

from __future__ import annotations

import re
from enum import IntEnum
from pathlib import Path
from typing import get_type_hints

import pytest
from tests.swarmabs_msgs.definitions import DEFINITIONS, FILES, FOLDER, Definition, Field as Entry

from swarmabs_core.messages import NEVER, TOPICS, Action, EventKind, Field, Kind, Mode, Source, Status, fields_of

MESSAGES = {topic.message.__name__: topic.message for topic in TOPICS}
PYTHON_TYPE = {"float64": float, "uint8": int, "uint16": int, "uint64": int, "string": str} | MESSAGES
PYTHON_TYPE |= {f"{name}[]": tuple[int, ...] for name in ("uint8", "uint16", "uint64")}
CONSTANTS: dict[str, tuple[type[IntEnum], ...]] = {
    "AgentState": (Kind, Status),
    "DesiredAbstractState": (Mode,),
    "SwarmEvent": (EventKind,),
    "Basis": (Source,),
    "Steering": (Action,),
}
CONTRACT = {
    "PlaneState": ["angle", "angular_velocity"],
    "AgentState": [
        *("broadcast_step", "agent_id", "kind", "status"),
        *("mass", "damping", "position", "velocity", "command"),
    ],
    "AbstractState": ["agent_count", "torque", "inertia", "torque_rate", "inertia_rate"],
    "AuxiliaryState": ["s0", "s1", "s2", "s3", "d0", "d1", "d2", "q"],
    "DesiredAbstractState": [
        *("mode", "torque", "inertia", "torque_rate", "inertia_rate"),
        *("mean_torque_rate", "mean_inertia_rate", "torque_acceleration", "inertia_acceleration"),
    ],
    "SwarmEvent": ["agent_id", "kind", "value", "detail"],
    "RecordingProgress": ["written_step"],
    "Broadcast": ["abstract", "auxiliary", "desired"],
    "Basis": ["since", "begun", "source", "state_steps", "agent_ids", "standing"],
    "Steering": ["request", "action", "agent_id", "value"],
}
UNIT = re.compile(r"^(kg|m|rad|N|s|1)\b[\w^/() ]*(,| along|$)|\bkg\^?\d?\b|\bm/s\b|\bN\b|\bin the unit\b")

definitions = pytest.mark.parametrize("definition", DEFINITIONS.values(), ids=DEFINITIONS)
fields = pytest.mark.parametrize(
    ("message", "field"),
    [(d.name, f) for d in DEFINITIONS.values() for f in (*d.fields, *d.constants)],
    ids=lambda value: value.name if isinstance(value, Entry) else value,
)


def test_there_is_a_definition_for_every_message_and_no_other() -> None:
    assert DEFINITIONS.keys() == MESSAGES.keys()


def test_every_definition_is_built() -> None:
    text = (FOLDER.parent / "CMakeLists.txt").read_text(encoding="utf-8")
    assert re.findall(r'"msg/(\w+\.msg)"', text) == [path.name for path in FILES]


@definitions
def test_fields_are_those_of_the_contract(definition: Definition) -> None:
    head = [(field.type, field.name) for field in definition.fields[:2]]
    assert head == [("std_msgs/Header", "header"), ("uint64", "step")]
    assert [field.name for field in definition.fields[2:]] == CONTRACT[definition.name]


@definitions
def test_fields_and_their_order_are_those_of_the_core(definition: Definition) -> None:
    hints = get_type_hints(MESSAGES[definition.name])
    assert hints.pop("stamp") is int
    assert {field.name: PYTHON_TYPE[field.type] for field in definition.fields[1:]} == hints
    assert [field.name for field in definition.fields[1:]] == list(hints)


@definitions
def test_what_is_declared_of_a_field_is_what_the_definition_says(definition: Definition) -> None:
    """Its type, its unit, with which its comment begins, and the values that it may have."""
    declared = fields_of(MESSAGES[definition.name])
    constants = {c.name: c.value for c in definition.constants if c.name not in {"NO_BROADCAST", "NO_STEP"}}
    explained = {}
    for field in definition.fields[1:]:
        found = declared[field.name]
        if not isinstance(found, Field):
            assert found is MESSAGES[field.type]
            continue
        assert found.ros_type == field.type
        if field.type == "float64" and field.name not in {"command", "value"}:
            assert re.match(rf"{re.escape(found.unit)}(,| along|$)", field.comment)
        elif field.type == "string":
            assert not found.unit
        explained |= {value.name: value.value for value in found.constants or ()}
    assert explained == constants


@definitions
def test_constants_are_those_of_the_core(definition: Definition) -> None:
    expected = {member.name: int(member) for enum in CONSTANTS.get(definition.name, ()) for member in enum}
    if definition.name == "AgentState":
        expected["NO_BROADCAST"] = NEVER
    if definition.name == "Basis":
        expected["NO_STEP"] = NEVER
    assert {constant.name: constant.value for constant in definition.constants} == expected


@fields
def test_everything_is_explained_and_has_a_unit(message: str, field: Entry) -> None:
    assert field.comment, f"{message}.{field.name} has no comment"
    if field.type == "float64":
        assert UNIT.search(field.comment), f"{message}.{field.name} has no unit: {field.comment}"


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_definition_begins_with_what_it_is_for(path: Path) -> None:
    assert path.read_text(encoding="utf-8").startswith("# ")
