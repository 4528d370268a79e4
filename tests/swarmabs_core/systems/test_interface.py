"""Parent systems from installed packages: their settings, their description and its hash."""

import json
from math import inf

import pytest

from swarmabs_core import messages as msg
from swarmabs_core.errors import InputError
from swarmabs_core.systems.interface import PLANE_TABLES, TABLES, NamedSystem, SystemTables

pytestmark = pytest.mark.usefixtures("systems")


@pytest.mark.parametrize(("name", "sizes"), [("beam", (2, 2, 1, 1)), ("sheet", (4, 5, 2, 2)), ("lift", (4, 2, 1, 2))])
def test_the_description_names_all_numbers(name: str, sizes: tuple[int, ...]) -> None:
    described = json.loads(NamedSystem(name).description)
    assert tuple(len(described[table]) for table in ("parent", "abstract", "robot", "needs")) == sizes
    assert described["name"] == name


def test_the_hash_depends_on_the_settings_not_on_whether_they_are_defaults() -> None:
    plain = NamedSystem("beam")
    assert plain.hash == NamedSystem("beam", {"added": 2.0}).hash
    assert len({plain.hash, NamedSystem("beam", {"added": 2.5}).hash, NamedSystem("tilting_plane").hash}) == 3
    assert NamedSystem("beam", {"added": 2.5}).instance.controller(0.01).ask(0.0, (0.0, 1.0), ()) == (2.5,)


def test_ends_of_coordinates_are_described_where_they_are_stated() -> None:
    plain, ended = NamedSystem("faulty"), NamedSystem("faulty", {"fault": "lane"})
    assert json.loads(plain.description)["robot"] == [{"name": "position", "scale": 1.0, "unit": "m"}]
    (row,) = SystemTables.read(ended.description).robot
    assert (row.low, row.high) == (-0.2, 0.2)
    (row,) = SystemTables.read(plain.description).robot
    assert (row.low, row.high) == (-inf, inf)


def test_unknown_systems_and_settings_are_refused() -> None:
    with pytest.raises(InputError, match=r"there is no parent system 'boat'; available: beam, faulty, lift, satellite"):
        _ = NamedSystem("boat").instance
    with pytest.raises(InputError, match=r"has no parameter 'colour'; it has stiffness, "):
        _ = NamedSystem("beam", {"colour": 1.0}).instance


VECTORS = [
    (msg.PlaneState, "state", "parent", (0.1, -0.2)),
    (msg.AbstractState, "value", "abstract", (3.0, 4.0)),
    (msg.DesiredAbstractState, "value", "abstract", (3.0, 4.0)),
    (msg.AgentState, "coordinates", "robot", (0.3,)),
    (msg.AgentState, "velocities", "robot", (0.4,)),
    (msg.AgentState, "command", "robot", (0.5,)),
    (msg.AgentState, "constants", "constants", (0.6, 0.7)),
]


@pytest.mark.parametrize(("message", "vector", "table", "values"), VECTORS)
def test_the_tables_of_the_plane_name_the_fields_of_its_messages_in_their_order(
    message: type[msg.Message], vector: str, table: str, values: tuple[float, ...]
) -> None:
    """A list of a message of any parent system is made of the plane's fields by the tables' names and units."""
    named = {
        "angle": 0.1,
        "angular_velocity": -0.2,
        "torque": 3.0,
        "inertia": 4.0,
        "position": 0.3,
        "velocity": 0.4,
        "command": 0.5,
        "mass": 0.6,
        "damping": 0.7,
    }
    found = message(**{field: named.get(field, 1) for field in message._fields})
    assert msg.vector_of(found, vector) == values
    if vector not in {"velocities", "command"}:  # which are called after the coordinate
        declared = msg.fields_of(message)
        rows = [(row.name, row.unit) for row in getattr(PLANE_TABLES, table)]
        assert [named[name] for name, _ in rows] == list(values)
        assert rows == [(name, getattr(declared[name], "unit", None)) for name, _ in rows]
    assert {*TABLES} <= {*PLANE_TABLES._fields}


def test_lists_of_other_systems_are_read_as_they_are() -> None:
    assert msg.vector_of(msg.ParentState(0, 0, 1, (1.0, 2.0)), "state") == (1.0, 2.0)
    assert msg.vector_of(msg.SwarmDesired(0, 0, 1, 1, (1.0,), (), (), (), ()), "value") == (1.0,)
