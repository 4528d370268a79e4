"""Start the monitor: ros2 launch own_node monitor.launch.py executable:=monitor.py angle_limit:=0.08."""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the node."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("executable", default_value="monitor", description="monitor (C++) or monitor.py"),
            DeclareLaunchArgument("namespace", default_value="/", description="ROS namespace of the swarm"),
            DeclareLaunchArgument("angle_limit", default_value="0.0", description="rad; 0: never request a stop"),
            Node(
                package="own_node",
                executable=LaunchConfiguration("executable"),
                namespace=LaunchConfiguration("namespace"),
                parameters=[{"angle_limit": LaunchConfiguration("angle_limit")}],
                output="both",
            ),
        ]
    )
