"""Read fleet files into a checked fleet and its scenario; every error names file, line, field and remedy."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_config.fleet import checks
from swarmabs_config.fleet.model import Fleet
from swarmabs_config.fleet.robots import SimulatedDrive
from swarmabs_config.model.fields import LONGEST_FILE_NAME, schema_of
from swarmabs_config.realtime import check_pairs, check_realtime
from swarmabs_config.scenario import PlaneScenario, ScenarioError, dump_scenario, on_plane, parse_scenario, warnings_of
from swarmabs_config.scenario.dump import dump_tree
from swarmabs_config.scenario.loader import read_mapping, validated
from swarmabs_config.scenario.text_file import read_text
from swarmabs_config.scenarios import as_override, at_parameter, find_scenario, named_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterator

    from swarmabs_config.fleet.robots import Robot
    from swarmabs_config.model.fields import Location
    from swarmabs_config.scenario.yaml_tree import Node, Plain

FLEET_FILE = "fleet.yaml"
SCENARIO_FILE = "scenario.yaml"
_PLACEHOLDER = 0.25
"""Position in the scenario of a robot whose position is measured, in lengths of the plane, on alternating sides."""


@dataclass(frozen=True, slots=True)
class LoadedFleet:
    """A fleet and its scenario with the fleet's robots; the position of a robot that measures it is a placeholder."""

    fleet: Fleet
    scenario: PlaneScenario

    @property
    def fleet_text(self) -> str:
        """The fleet in YAML with every default filled in; it refers to `SCENARIO_FILE` in the same folder."""
        data = self.fleet.model_dump(mode="json", by_alias=True, exclude={"settings"})
        data["scenario"] = SCENARIO_FILE
        return dump_tree(data)

    @property
    def scenario_text(self) -> str:
        """The scenario in canonical YAML."""
        return dump_scenario(self.scenario)

    def warnings(self) -> tuple[str, ...]:
        """Return one line for each setting of fleet or scenario that is valid but likely to cause trouble."""
        return (*checks.warnings(self.fleet), *warnings_of(self.scenario))


def load_fleet(path: str | os.PathLike[str]) -> LoadedFleet:
    """Read a fleet file, whose stem is the default of ``name``, and its scenario.

    Raises
    ------
    InputError
        If the fleet or its scenario is invalid.
    """
    path = Path(path)
    root = read_mapping(read_text(path, "fleet"), str(path), "fleet")
    data = root.plain()
    if isinstance(data, dict):
        data.setdefault("name", _default_name(path.stem))
    fleet = validated(Fleet, data, root, checks.findings)
    settings = [as_override(name, value) for name, value in fleet.settings.items()]
    try:
        scenario = on_plane(find_scenario(named_scenario(fleet.scenario, path.parent), settings), "a fleet")
    except ScenarioError as error:
        raise at_parameter(error, root, {"set": fleet.settings}) from error
    except InputError as error:
        mark, _ = root.locate(("scenario",))
        raise mark.error(error.problem, error.remedy, ("scenario",)) from error
    loaded = LoadedFleet(fleet, _with_robots(scenario, fleet, root))
    _check_against_scenario(loaded, root)
    return loaded


def json_schema() -> dict[str, object]:
    """Return the JSON Schema (2020-12) of a fleet file.

    It covers names, types, units and ranges. Checks across fields are made when a file is loaded.
    """
    return schema_of(Fleet, "swarmabs fleet")


def _check_against_scenario(loaded: LoadedFleet, root: Node) -> None:
    """Check a fleet against its scenario."""
    fleet, scenario = loaded.fleet, loaded.scenario
    for name, coordinator in (("observer", fleet.coordinators.observer), ("controller", fleet.coordinators.controller)):
        if coordinator is not None and scenario.decentralised:
            mark, _ = root.locate(("coordinators", name))
            raise mark.error(f"each robot coordinates the swarm, without {name}", "remove it", ("coordinators", name))
        if coordinator is None and not scenario.decentralised:
            mark, _ = root.locate(("coordinators",))
            remedy = f"add '{name}: {{host: HOST}}', or 'coordination: each_robot' to 'set'"
            raise mark.error(f"there is no {name}", remedy, ("coordinators",))
    if fleet.paired:
        _of_scenario(check_pairs, scenario, root)
    tolerance, half = scenario.realtime.clock_tolerance, scenario.plane.length / 2.0
    if tolerance < 2.0 * fleet.time.max_offset:
        mark, _ = root.locate(("time", "max_offset"))
        raise mark.error(
            f"two clocks may differ by {2.0 * fleet.time.max_offset!r} s, but robots tolerate only {tolerance!r} s",
            f"give at most {tolerance / 2.0!r}, or raise realtime.clock_tolerance with 'set'",
            ("time", "max_offset"),
        )
    for index, robot in enumerate(fleet.robots):
        lane = robot.limits.lane
        if lane is not None and lane > half:
            location = ("robots", index, "limits", "lane")
            mark, _ = root.locate(location)
            raise mark.error(
                f"{lane!r} m exceeds half the length of the plane, {half!r} m", f"give at most {half!r}", location
            )


def _default_name(stem: str) -> str:
    name = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "_" for c in stem)[:LONGEST_FILE_NAME]
    return name if name[:1].isalnum() else f"fleet{name}"[:LONGEST_FILE_NAME]


def _with_robots(scenario: PlaneScenario, fleet: Fleet, root: Node) -> PlaneScenario:
    """Return the scenario with the fleet's robots, checked like any other scenario."""
    _of_scenario(check_realtime, scenario, root)
    data: dict[str, Plain] = scenario.model_dump(mode="json", by_alias=True)
    sides = cycle((_PLACEHOLDER * scenario.plane.length, -_PLACEHOLDER * scenario.plane.length))
    agents: Plain = [dict(_agent(robot, side)) for robot, side in zip(fleet.members, sides, strict=False)]
    data |= {"name": fleet.name, "swarm": {**_mapping(data["swarm"]), "agents": agents}}
    data["swarm"] = {key: value for key, value in _mapping(data["swarm"]).items() if key != "generate"}
    try:
        return on_plane(parse_scenario(dump_tree(data), source=str(root.mark.source)), "a fleet")
    except ScenarioError as error:
        raise _at_robot(error, fleet, root) from error


def _of_scenario(check: Callable[[PlaneScenario], object], scenario: PlaneScenario, root: Node) -> None:
    """Check a scenario; an error names the field of the fleet file that names it."""
    try:
        check(scenario)
    except InputError as error:
        mark, _ = root.locate(("scenario",))
        raise mark.error(error.problem, f"{error.remedy} ('set' changes values)", ("scenario",)) from error


def _mapping(value: Plain) -> dict[str, Plain]:
    return value if isinstance(value, dict) else {}


def _agent(robot: Robot, placeholder: float) -> Iterator[tuple[str, Plain]]:
    yield from (("id", robot.id), ("kind", robot.kind), ("mass", robot.mass))
    yield "position", robot.drive.position if isinstance(robot.drive, SimulatedDrive) else placeholder
    if Kind.of(robot.kind).by_force:
        yield "damping", robot.damping
        if isinstance(robot.drive, SimulatedDrive):
            yield "velocity", robot.drive.velocity


def _at_robot(error: ScenarioError, fleet: Fleet, root: Node) -> ScenarioError:
    """Return an error of the combined scenario at the field of the fleet file that caused it."""
    parts = error.field.split(".")
    location: Location = ("scenario",)
    if parts[:2] == ["swarm", "agents"]:
        location = ("robots",)
        if len(parts) > 2:
            robot = fleet.members[int(parts[2])]
            location = ("robots", fleet.robots.index(robot))
            location = (*location, "drive", *parts[3:]) if parts[3:] in (["position"], ["velocity"]) else location
    mark, _ = root.locate(location)
    return mark.error(error.problem, error.remedy, location)
