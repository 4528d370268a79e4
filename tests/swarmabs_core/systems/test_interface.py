"""Parent systems from installed packages: their settings, their description and its hash."""

import json
from math import inf

import pytest

from swarmabs_core.errors import InputError
from swarmabs_core.systems.interface import NamedSystem, SystemTables

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
    assert NamedSystem("beam", {"added": 2.5}).made.controller(0.01).ask(0.0, (0.0, 1.0), ()) == (2.5,)


def test_ends_of_coordinates_are_described_where_they_are_stated() -> None:
    plain, ended = NamedSystem("faulty"), NamedSystem("faulty", {"fault": "lane"})
    assert json.loads(plain.description)["robot"] == [{"name": "position", "scale": 1.0, "unit": "m"}]
    (row,) = SystemTables.read(ended.description).robot
    assert (row.low, row.high) == (-0.2, 0.2)
    (row,) = SystemTables.read(plain.description).robot
    assert (row.low, row.high) == (-inf, inf)


def test_unknown_systems_and_settings_are_refused() -> None:
    with pytest.raises(InputError, match=r"there is no parent system 'boat'; available: beam, faulty, lift, satellite"):
        _ = NamedSystem("boat").made
    with pytest.raises(InputError, match=r"has no parameter 'colour'; it has stiffness, "):
        _ = NamedSystem("beam", {"colour": 1.0}).made
