"""Which swarm an operator means: a fleet by its file, or a run in real time by its folder."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from swarmabs_config.fleet.loader import load_fleet
from swarmabs_config.fleet.participants import DISCOVERY, node_plans
from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, RECORDER, agent_name
from swarmabs_config.scenario import load_scenario
from swarmabs_core.errors import InputError
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_fleet.node_files import profile, tool_environment
from swarmabs_run.orchestration.dds_environment import dds_environment
from swarmabs_run.orchestration.run_environment import environment_of_run, goes_on, is_realtime

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from swarmabs_config.fleet.model import Fleet


def _always() -> bool:
    return True


@dataclass(frozen=True, slots=True)
class Target:
    """A swarm that can be spoken to.

    Parameters
    ----------
    name : str
        What people call it.
    namespace : str
        ROS namespace of its nodes.
    hosts : mapping
        Host by node, in the order in which they are shown.
    robots : tuple of int
        Ids of the robots, ascending.
    environment : mapping
        Environment variables by which a process joins its network.
    goes_on : callable
        Tells whether the network is still that of this swarm: the domain of a run that is over is given to another.
    """

    name: str
    namespace: str
    hosts: Mapping[str, str]
    robots: tuple[int, ...]
    environment: Mapping[str, str]
    goes_on: Callable[[], bool] = _always

    def robot(self, agent_id: int) -> str:
        """Return the node of a robot.

        Raises
        ------
        InputError
            If the swarm has none of this id.
        """
        if agent_id not in self.robots:
            known = ", ".join(map(str, self.robots[:20]))
            raise InputError(f"{self.name} has no robot {agent_id}; it has {known}")
        return agent_name(agent_id)


@contextmanager
def target(path: Path) -> Iterator[Target]:
    """Find out how to speak to a swarm; files that this needs are removed at the end.

    Parameters
    ----------
    path : Path
        A fleet file, or the folder of a run in real time.

    Raises
    ------
    InputError
        If it is neither, a run that is over, or one in lockstep.
    """
    if path.is_dir():
        yield _run(path)
        return
    fleet = load_fleet(path).fleet
    with TemporaryDirectory(prefix="swarmabs-operator-") as folder:
        yield _fleet(fleet, Path(folder))


def _run(folder: Path) -> Target:
    environment = environment_of_run(folder)
    if not is_realtime(folder):
        raise InputError(
            f"{folder}: a run in lockstep has no operator; look at it with top, change it with run --steer"
        )
    scenario = load_scenario(folder / "scenario.yaml")
    robots = tuple(agent.id for agent in scenario.agents)
    nodes = (PLANE, OBSERVER, CONTROLLER, RECORDER, *map(agent_name, robots))
    hosts = dict.fromkeys(nodes, "this one")
    return Target(scenario.name, "/", hosts, robots, environment, partial(goes_on, folder))


def _fleet(fleet: Fleet, folder: Path) -> Target:
    host = HostPlan(fleet, fleet.coordinators.controller.host)
    file = folder / "operator.xml"
    file.write_text(profile(host, "operator"), encoding="utf-8")
    # Everything as in the installed bundle, whose keys may be needed, but the profile: it is made anew.
    environment = tool_environment(host, "operator") | dds_environment(fleet.network.domain, str(file))
    hosts = {node.name: node.host for node in node_plans(fleet) if node.name != DISCOVERY}
    robots = tuple(robot.id for robot in fleet.members)
    return Target(fleet.name, fleet.namespace, hosts, robots, environment)
