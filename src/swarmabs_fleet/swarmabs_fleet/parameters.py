"""The ROS parameters of every node of a fleet; only this module maps fleet and scenario to realtime parameters."""

from __future__ import annotations

import math
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

from swarmabs_config import realtime
from swarmabs_config.fleet.loader import SCENARIO_FILE
from swarmabs_config.fleet.participants import DISCOVERY
from swarmabs_config.fleet.parts import MeasuredPlane
from swarmabs_config.fleet.robots import SimulatedDrive
from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, RECORDER
from swarmabs_config.scenario.dump import dump_tree
from swarmabs_core.declaration import values_of
from swarmabs_core.messages import Mode
from swarmabs_core.realtime.agent import RealtimeAgentConfig
from swarmabs_core.realtime.instruments import TopicSettings
from swarmabs_core.realtime.leadership import Pair
from swarmabs_core.realtime.seals import SealFiles
from swarmabs_core.robot_controller import Limits
from swarmabs_fleet.host_plan import PUBLIC_KEYS, HostPlan

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import TypeAlias

    from swarmabs_config.fleet.loader import LoadedFleet
    from swarmabs_config.fleet.model import Fleet
    from swarmabs_config.fleet.participants import NodePlan
    from swarmabs_config.fleet.robots import Robot
    from swarmabs_config.scenario.yaml_tree import Plain

    Parameters: TypeAlias = dict[str, object]


_READERS_OF_ROBOTS = (PLANE, OBSERVER, RECORDER)


def parameters(loaded: LoadedFleet, node: NodePlan) -> Parameters:
    """Return the parameters of a node by name."""
    if node.kind == DISCOVERY:
        return {}
    own = loaded.fleet.own_topics and (node.robot is not None or node.kind in _READERS_OF_ROBOTS)
    return _parameters(loaded, node) | ({"own_topics": True} if own else {}) | _seal(loaded.fleet, node)


def _seal(fleet: Fleet, node: NodePlan) -> Parameters:
    """Return the files with the keys of an author of states, in a fleet whose states are signed."""
    if not fleet.sealed or node.author is None:
        return {}
    host = HostPlan(fleet, node.host)
    key = f"{host.keystore}/enclaves{host.enclave(node.name)}/key.pem"
    return {**values_of(SealFiles(key, f"{host.installed}/{PUBLIC_KEYS}"))}


def _parameters(loaded: LoadedFleet, node: NodePlan) -> Parameters:
    fleet, scenario, host = loaded.fleet, loaded.scenario, HostPlan(loaded.fleet, node.host)
    schedule = realtime.schedule(scenario, fleet.epoch_ns)
    if node.kind == RECORDER:
        common = {**values_of(schedule), "clock_tolerance": scenario.realtime.clock_tolerance}
        return (
            common
            | _recorder(fleet)
            | {
                "scenario_file": f"{host.installed}/{SCENARIO_FILE}",
                "bags": host.state,
                "pair": node.pair,
            }
        )
    mass = fleet.swarm_mass or math.fsum(robot.mass for robot in fleet.members)
    pair = Pair(node.pair, fleet.paired, scenario.realtime.takeover_after)
    if node.robot is not None:
        robots = realtime.agent_configs(scenario, schedule)
        config = next(config for config in robots if config.agent_id == node.robot.id)
        robot: Parameters = {**values_of(_robot(replace(config, swarm_mass=mass, paired=fleet.paired), node.robot))}
        if not fleet.decentralised:
            return robot
        hosted = (
            realtime.controller_config(scenario, schedule, Mode.STOP),
            replace(realtime.observer_config(scenario, schedule), swarm_mass=mass),
            realtime.peer_config(scenario, schedule, node.robot.id),
        )
        return {name: value for part in hosted for name, value in values_of(part).items()} | robot
    if node.kind == CONTROLLER:
        assert fleet.coordinators.controller is not None  # noqa: S101 - its node is in the plan
        mode = Mode[fleet.coordinators.controller.start_mode.upper()]
        return {**values_of(replace(realtime.controller_config(scenario, schedule, mode), pair=pair))}
    if node.kind == OBSERVER:
        observer = replace(realtime.observer_config(scenario, schedule), swarm_mass=mass, pair=pair)
        return {**values_of(observer), "memory": f"{host.state}/silent_robots.json"}
    plane = fleet.coordinators.plane
    if isinstance(plane, MeasuredPlane):
        tolerance = scenario.realtime.clock_tolerance
        return {**values_of(plane.instrument), **values_of(schedule), "clock_tolerance": tolerance}
    return {**values_of(realtime.plane_config(scenario, schedule))}


def parameter_file(values: Mapping[str, object]) -> str:
    """Return the text of a parameter file for ``--params-file`` that applies to a node of any name."""
    tree: dict[str, Plain] = {}
    for name, value in values.items():
        if value in ((), []):  # ROS cannot tell the type of an empty array, and the node has it as its default
            continue
        *parents, last = name.split(".")
        branch = tree
        for parent in parents:
            inner = branch.setdefault(parent, {})
            assert isinstance(inner, dict), f"{name}: {parent} is a parameter, too"  # noqa: S101 - names are constants
            branch = inner
        branch[last] = _plain(value)
    text = dump_tree({"ros__parameters": tree})
    return "/**:\n" + "".join(f"  {line}\n" for line in text.splitlines())


def _plain(value: object) -> Plain:
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"no ROS parameter: {value!r}")


def _recorder(fleet: Fleet) -> Parameters:
    """Return what checks of the bag need in addition to the scenario."""
    real = {robot.id for robot in fleet.robots if not isinstance(robot.drive, SimulatedDrive)}
    limited = {robot.id for robot in fleet.robots if any(limit is not None for _, limit in robot.limits)}
    simulated = fleet.coordinators.plane.type == "simulated"
    lists = {"driven": sorted(real), "own_limits": sorted(limited)}
    return {"simulated_plane": simulated, "paired": fleet.paired, **lists}


def _robot(config: RealtimeAgentConfig, robot: Robot) -> RealtimeAgentConfig:
    """Return a robot's configuration with its own limits and drive; only a simulated one has an initial state."""
    own, drive = robot.limits, robot.drive
    limits = Limits(own.velocity or config.limits.velocity, own.force or config.limits.force)
    config = replace(config, limits=limits, deceleration=own.deceleration or inf)
    if own.lane is not None:
        config = replace(config, lane_margin=0.5 * config.plane_length - own.lane)
    if isinstance(drive, SimulatedDrive):
        return config
    if isinstance(drive, TopicSettings):
        return replace(config, position=0.0, velocity=0.0, drive=drive.type, drive_settings=values_of(drive))
    return replace(config, position=0.0, velocity=0.0, drive=drive.name, drive_settings=drive.parameters)
