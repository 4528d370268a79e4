"""Start a swarm of two robots on your own plane: ros2 launch own_node own_plane.launch.py angle:=0.1."""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the argument, the nodes of the swarm, and the plane in place of `plane_sim`."""
    angle = {"angle": LaunchConfiguration("angle")}
    members = {"members": [1, 2]}
    first = {"agent_id": 1, "position": 0.2}
    second = {"agent_id": 2, "kind": "double_integrator", "damping": 0.8, "position": -0.1}
    return LaunchDescription(
        [
            DeclareLaunchArgument("angle", default_value="0.1", description="angle at the start, rad"),
            Node(package="abstraction_observer", executable="abstraction_observer", parameters=[members]),
            Node(package="parent_controller", executable="parent_controller", parameters=[{"controller.type": "lqr"}]),
            Node(package="agent_node", executable="agent_node", name="agent_001", parameters=[first]),
            Node(package="agent_node", executable="agent_node", name="agent_002", parameters=[second]),
            Node(package="own_node", executable="own_plane.py", parameters=[angle], output="both"),
        ]
    )
