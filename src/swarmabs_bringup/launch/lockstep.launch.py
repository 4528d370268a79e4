"""Start all nodes of a scenario in lockstep with `ros2 launch`, for those who have a complete ROS 2 installation.

The nodes and their parameters are those of ``swarm run``, since they come from the same plan; each node waits until
it has met its counterparts, then begins. The recorder ends when the run is complete, and that ends the launch. What
only ``swarm run`` does: a ROS domain and a network of its own, the search for who is silent, ending the processes of
robots that a scenario kills or freezes (they fall silent here, too), and ``summary.json``.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from swarmabs_bag.attached import scenario_of
from swarmabs_bag.run_folder import new_run_folder, next_run_folder
from swarmabs_config.scenarios import DEFAULT
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.orchestration.plan import plan

if TYPE_CHECKING:
    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_run.orchestration.plan import ProcessPlan

ARGUMENTS = {
    "scenario": (DEFAULT, "a built-in scenario, a YAML file, or a bag"),
    "out": ("", "folder of the results; empty: runs/NAME-NNN"),
    "namespace": ("/", "ROS namespace of the swarm"),
}
"""Default and meaning of every launch argument."""


def executable(process: ProcessPlan) -> tuple[str, str]:
    """Return package and executable of a process: ``recorder`` of ``swarmabs_bag.recorder.node``, for example."""
    *_, name, _node = process.module.split(".")
    return process.module.partition(".")[0], name


def ended(event: Any, context: Any) -> list[Any]:
    """End the launch when a node has ended; raises `RunError`, so that the launch fails, if the node has failed."""
    if event.returncode and not context.is_shutdown:
        raise RunError(f"{event.process_name} failed with exit code {event.returncode}; its log says why")
    return [Shutdown(reason=f"{event.process_name} has ended")]


def results(out: str, name: str) -> RunFolder:
    """Make the folder of the results; errors name the argument of the launch file."""
    try:
        return new_run_folder(Path(out)) if out else next_run_folder(Path("runs"), name)
    except InputError as error:
        raise InputError(str(error).replace("with -o", "with out:=")) from error


def actions(context: Any) -> list[Any]:
    """Return a node for every process of the scenario that was asked for, and what there is to say about it."""
    asked = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    scenario = scenario_of(asked["scenario"])
    warnings = [LogInfo(msg=f"warning: {text}") for text in scenario.warnings()]
    scenario = scenario.resolved()
    folder = results(asked["out"], scenario.name)
    folder.fill(scenario)
    processes = plan(scenario, folder)
    begun = f"{scenario.name}: {len(processes)} processes started by ros2 launch"
    (folder.logs / "orchestrator.log").write_text(f"{begun}\n", encoding="utf-8")
    nodes = []
    for process in processes:
        package, name = executable(process)
        nodes.append(
            Node(
                package=package,
                executable=name,
                arguments=process.arguments(asked["namespace"]),
                output="both",
                on_exit=ended,
            )
        )
    return [*warnings, LogInfo(msg=f"results: {folder.path}"), *nodes]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=actions)])
