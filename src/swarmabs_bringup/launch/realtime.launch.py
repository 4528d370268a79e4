"""Start all nodes of a scenario in real time with `ros2 launch`, with simulated bodies.

The nodes and their parameters come from the same plan as in ``swarm run --realtime``. They are lifecycle nodes that
configure and activate themselves. Once all are ready, they receive the start time of step 0. The recorder exits after
the last step, which ends the launch. If a robot's process fails, the swarm continues without it and the launch fails
at the end; if any other node fails, the launch fails at once.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from swarmabs_config.graph import REALTIME, RECORDER
from swarmabs_config.scenarios import DEFAULT
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.orchestration.launch_plan import Starter, executable, launch_plan

ARGUMENTS = {
    "scenario": (DEFAULT, "a built-in scenario, a YAML file, or a bag"),
    "duration": ("", "duration of the run, s; empty: that of the scenario"),
    "out": ("", "folder of the results; empty: runs/NAME-NNN"),
    "namespace": ("/", "ROS namespace of the swarm"),
    "markers": ("false", "true: publish markers, joint state and URDF for RViz and Foxglove"),
}
"""Default and meaning of every launch argument."""


class Ends:
    """Decides how the launch reacts when a process of the run ends, depending on whether the run has started."""

    def __init__(self, starter: Starter) -> None:
        self._starter = starter
        self._lost: list[str] = []

    def of_robot(self, name: str, event: Any, context: Any) -> list[Any]:
        """Let the swarm continue without a failed robot, provided that the run has started."""
        if not event.returncode or context.is_shutdown:
            return []
        if not self._starter.begun:
            return self.of_coordinator(name, event, context)
        self._lost.append(f"{name} failed with exit code {event.returncode}")
        return [LogInfo(msg=f"{self._lost[-1]}; the swarm continues without it")]

    def of_coordinator(self, name: str, event: Any, context: Any) -> list[Any]:
        """End the launch; raises `RunError`, so that it fails, if this node or a robot has failed."""
        self._starter.forget()
        if event.returncode and not context.is_shutdown:
            raise RunError(f"{name} failed with exit code {event.returncode}; see its log")
        if name == RECORDER and not context.is_shutdown:
            problems = [*self._lost, self._starter.problem()]
            if any(problems):
                raise RunError("; ".join(filter(None, problems)))
        return [Shutdown(reason=f"{name} has ended")]


def actions(context: Any) -> list[Any]:
    """Return messages for the user and one node per process of the requested scenario."""
    asked = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    if asked["markers"] not in {"true", "false"}:
        raise InputError(f"markers:={asked['markers']}: give true or false")
    overrides = [f"duration={asked['duration']}"] if asked["duration"] else []
    planned = launch_plan(asked["scenario"], asked["out"], REALTIME, overrides)
    starter = Starter(planned.processes)
    starter.start()
    ends, nodes = Ends(starter), []
    for process in planned.processes:
        package, name = executable(process)
        on_exit = partial(ends.of_robot if process.agents else ends.of_coordinator, process.name)
        arguments = process.arguments(asked["namespace"])
        nodes.append(
            Node(
                package=package,
                executable=name,
                arguments=arguments,
                additional_env=starter.environment,
                output="both",
                on_exit=on_exit,
            )
        )
    if asked["markers"] == "true":
        given = [{"scenario_file": str(planned.folder.scenario.resolve())}]
        show = {"package": "swarmabs_view", "executable": "plane_markers", "namespace": asked["namespace"]}
        nodes.append(Node(**show, parameters=given, output="both"))
    warnings = [LogInfo(msg=f"warning: {text}") for text in planned.warnings]
    return [*warnings, LogInfo(msg=f"results: {planned.folder.path}"), *nodes]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=actions)])
