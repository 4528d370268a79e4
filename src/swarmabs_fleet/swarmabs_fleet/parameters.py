"""The ROS parameters of every node of a fleet: the one place that knows what the realtime nodes are told."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_config.fleet.participants import DISCOVERY
from swarmabs_config.fleet.robots import PluginDrive, SimulatedDrive
from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE_DRIVER, RECORDER
from swarmabs_config.scenario.dump import dump_tree
from swarmabs_core.declaration import values_of
from swarmabs_core.realtime.topic_drive import TopicSettings
from swarmabs_run.orchestration.plan import controller_parameters, plane_parameters

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import TypeAlias

    from swarmabs_config.fleet.model import Fleet
    from swarmabs_config.fleet.participants import NodePlan
    from swarmabs_config.fleet.robots import Robot
    from swarmabs_config.scenario import Scenario
    from swarmabs_config.scenario.yaml_tree import Plain

    Parameters: TypeAlias = dict[str, object]


def parameters(fleet: Fleet, scenario: Scenario, node: NodePlan, *, installed: str, state: str) -> Parameters:
    """Return the parameters of a node by name.

    Parameters
    ----------
    fleet, scenario : Fleet, Scenario
        The fleet, and the scenario with its robots.
    node : NodePlan
        The node.
    installed, state : str
        Folders on its host: of the installed bundle, and of what the node writes.
    """
    if node.name == DISCOVERY:
        return {}
    common: Parameters = {
        "epoch_ns": fleet.epoch_ns,
        "period_ns": scenario.step_ns,
        "clock_tolerance": scenario.realtime.clock_tolerance,
    }
    if node.robot is not None:
        return common | _robot(fleet, scenario, node.robot)
    if node.name == RECORDER:
        return common | {"scenario_file": f"{installed}/scenario.yaml", "bags": state} | _recorder(fleet)
    if node.name == CONTROLLER:
        return common | _controller(fleet, scenario)
    if node.name == OBSERVER:
        return common | _observer(fleet, scenario) | {"memory": f"{state}/silent_robots.json"}
    return common | (_plane_driver(fleet) if node.name == PLANE_DRIVER else _plane(scenario))


def parameter_file(values: Mapping[str, object]) -> str:
    """Return a file of parameters as ``--params-file`` takes it, for a node of any name."""
    tree: dict[str, Plain] = {}
    for name, value in values.items():
        *parents, last = name.split(".")
        branch = tree
        for parent in parents:
            inner = branch.setdefault(parent, {})
            assert isinstance(inner, dict), f"{name}: {parent} is a parameter, too"  # noqa: S101 - names are the program's
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


def _swarm_mass(fleet: Fleet) -> float:
    """Return the mass of all robots that ever take part, kg."""
    return fleet.swarm_mass or math.fsum(robot.mass for robot in fleet.members)


def _plane(scenario: Scenario) -> Parameters:
    return {
        "members": configure.members(scenario),
        "gravity": scenario.plane.gravity,
        "length": scenario.plane.length,
        **plane_parameters(scenario),
    }


def _plane_driver(fleet: Fleet) -> Parameters:
    plane = fleet.coordinators.plane
    given: Parameters = plane.model_dump(mode="json", exclude={"type", "host"})
    return given


def _observer(fleet: Fleet, scenario: Scenario) -> Parameters:
    return {
        "members": configure.members(scenario),
        "gravity": scenario.plane.gravity,
        "plane_length": scenario.plane.length,
        "swarm_mass": _swarm_mass(fleet),
        "ksd": scenario.swarm.gains.ksd,
        "state_age_limit": scenario.realtime.state_age_limit,
        "start": scenario.realtime.start,
        "quorum": scenario.realtime.quorum or 0,
    }


def _controller(fleet: Fleet, scenario: Scenario) -> Parameters:
    return {
        **controller_parameters(scenario),
        "plane_age_limit": scenario.realtime.plane_age_limit,
        "gravity": scenario.plane.gravity,
        "plane_length": scenario.plane.length,
        "start_mode": fleet.coordinators.controller.start_mode,
    }


def _recorder(fleet: Fleet) -> Parameters:
    """Return what the check of a bag must know that the scenario does not say."""
    real = {robot.id for robot in fleet.robots if not isinstance(robot.drive, SimulatedDrive)}
    limited = {robot.id for robot in fleet.robots if any(limit is not None for _, limit in robot.limits)}
    lists = {name: sorted(ids) for name, ids in (("driven", real), ("own_limits", limited)) if ids}
    return {"simulated_plane": fleet.coordinators.plane.type == "simulated", **lists}


def _robot(fleet: Fleet, scenario: Scenario, robot: Robot) -> Parameters:
    gains, limits, law = scenario.swarm.gains, robot.limits, scenario.swarm.law
    half = scenario.plane.length / 2.0
    values: Parameters = {
        "agent_id": robot.id,
        "kind": robot.kind,
        "mass": robot.mass,
        "damping": robot.damping,
        "gravity": scenario.plane.gravity,
        "plane_length": scenario.plane.length,
        "swarm_mass": _swarm_mass(fleet),
        "gains.k": gains.k,
        "gains.kp": gains.kp,
        "gains.kd": gains.kd,
        "gains.ksd": gains.ksd,
        "law.type": law.type,
        "limits.velocity": limits.velocity or scenario.limits.velocity or 0.0,
        "limits.force": limits.force or scenario.limits.force or 0.0,
        "limits.deceleration": limits.deceleration or 0.0,
        "lane_margin": scenario.realtime.lane_margin if limits.lane is None else half - limits.lane,
        "broadcast_age_limit": scenario.realtime.broadcast_age_limit,
    }
    config = next(config for config in configure.agent_configs(scenario) if config.agent_id == robot.id)
    values |= {f"law.{name}": value for name, value in config.law_settings.items()}
    return values | _drive(robot)


def _drive(robot: Robot) -> Parameters:
    drive = robot.drive
    if isinstance(drive, SimulatedDrive):
        return {"drive.type": drive.type, "position": drive.position, "velocity": drive.velocity}
    if isinstance(drive, TopicSettings):
        return {"drive.type": drive.type, **values_of(drive, "drive.")}
    assert isinstance(drive, PluginDrive)  # noqa: S101 - there are three
    own: Parameters = {f"drive.{name}": value for name, value in drive.settings.items()}
    return {"drive.type": drive.name} | own
