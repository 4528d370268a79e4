"""Start all nodes of a scenario in lockstep with `ros2 launch`. Requires a complete ROS 2 installation.

The nodes and their parameters come from the same plan as in ``swarm run``. Each node starts when it has discovered its
counterparts. The recorder exits when the run is complete, which ends the launch. Only ``swarm run`` provides a separate
ROS domain and network, reports which process does not respond, ends or stops the processes of robots that a scenario
kills or freezes (here these robots only fall silent), and writes ``summary.json``.
"""

from __future__ import annotations

from typing import Any

from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from swarmabs_config.graph import LOCKSTEP
from swarmabs_config.scenarios import DEFAULT
from swarmabs_core.errors import RunError
from swarmabs_run.orchestration.launch_plan import executable, launch_plan

ARGUMENTS = {
    "scenario": (DEFAULT, "a built-in scenario, a YAML file, or a bag"),
    "out": ("", "folder of the results; empty: runs/NAME-NNN"),
    "namespace": ("/", "ROS namespace of the swarm"),
}
"""Default and meaning of every launch argument."""


def ended(event: Any, context: Any) -> list[Any]:
    """End the launch when a node has ended; raises `RunError`, so that the launch fails, if the node failed."""
    if event.returncode and not context.is_shutdown:
        raise RunError(f"{event.process_name} failed with exit code {event.returncode}; see its log")
    return [Shutdown(reason=f"{event.process_name} has ended")]


def actions(context: Any) -> list[Any]:
    """Return messages for the user and one node per process of the requested scenario."""
    asked = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    planned = launch_plan(asked["scenario"], asked["out"], LOCKSTEP)
    nodes = []
    for process in planned.processes:
        package, name = executable(process)
        arguments = process.arguments(asked["namespace"])
        nodes.append(Node(package=package, executable=name, arguments=arguments, output="both", on_exit=ended))
    warnings = [LogInfo(msg=f"warning: {text}") for text in planned.warnings]
    return [*warnings, LogInfo(msg=f"results: {planned.folder.path}"), *nodes]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=actions)])
