"""Show a bag, or a running swarm in this ROS domain, in the browser with `ros2 launch`, until Ctrl-C."""

from __future__ import annotations

from typing import Any

from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage

from launch import LaunchDescription
from swarmabs_core.errors import InputError, RunError

ARGUMENTS = {
    "bag": ("", "a bag, or the folder of a run; empty: the running swarm in this ROS domain"),
    "namespace": ("/", "ROS namespace of the swarm"),
    "port": ("0", "port of the page on 127.0.0.1; 0: any free port"),
    "open": ("false", "true: open the browser"),
}
"""Default and meaning of every launch argument."""


def ended(event: Any, context: Any) -> list[Any]:
    """End the launch; raises `RunError`, so that it fails, if the view failed."""
    if event.returncode and not context.is_shutdown:
        raise RunError(f"the view failed with exit code {event.returncode}; see its message")
    return [Shutdown(reason="the view has ended")]


def actions(context: Any) -> list[Any]:
    """Return the process that serves the page."""
    asked = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    if asked["open"] not in {"true", "false"}:
        raise InputError(f"open:={asked['open']}: give true or false")
    namespace = asked["namespace"]
    shown = ["--live", namespace]
    if asked["bag"]:
        shown = [asked["bag"], *(() if namespace == "/" else ("--namespace", namespace))]
    arguments = ["view", *shown, "--port", asked["port"], *(["--open"] if asked["open"] == "true" else [])]
    program = ExecutableInPackage(package="swarmabs_cli", executable="swarm")
    return [ExecuteProcess(cmd=[program, *arguments], output="both", on_exit=ended)]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the process."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=actions)])
