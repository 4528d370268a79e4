"""The rig as a process: publishes standard sensor messages, accepts standard commands, and logs the true state."""

from __future__ import annotations

import csv
import sys
import time
from functools import partial
from math import cos, sin
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import Quaternion, TwistStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rig import Rig, Robot
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64

RATE = 100.0  # Hz, of all sensors


def name_of(robot: int) -> str:
    """Return the name of a robot's node, which is the namespace of its sensors and its base."""
    return f"agent_{robot:03d}"


class RigNode(Node):
    """Publishes the measurements of the sensors, and receives the commands for the bases."""

    def __init__(self, rig: Rig) -> None:
        super().__init__("rig")
        self.rig = rig
        self._senders: list[tuple[Any, Any]] = []
        self._connect("plane_driver/joint_states", JointState, self._plane)
        for body in rig.bodies.values():
            self._robot(body.robot)

    def _robot(self, robot: Robot) -> None:
        name = name_of(robot.id)
        if robot.source == "wheel":
            self._connect(f"{name}/joint_states", JointState, partial(self._wheel, robot))
        else:
            self._connect(f"{name}/odom", Odometry, partial(self._odometry, robot))
        if robot.kind == "single_integrator":
            self._listen(f"{name}/cmd_vel", TwistStamped, lambda message: message.twist.linear.x, robot)
            return
        self._connect(f"{name}/imu", Imu, partial(self._imu, robot))
        if robot.source == "wheel":  # the torque of the wheel is force times radius
            self._listen(f"{name}/joint_command", JointState, lambda m: m.effort[0] / robot.wheel_radius, robot)
        else:
            self._listen(f"{name}/force", Float64, lambda message: message.data, robot)

    def _connect(self, topic: str, kind: Any, make: Any) -> None:
        self._senders.append((self.create_publisher(kind, topic, 10), make))

    def _listen(self, topic: str, kind: Any, value: Any, robot: Robot) -> None:
        def hear(message: Any) -> None:
            self.rig.drive(robot.id, value(message))

        self.create_subscription(kind, topic, hear, 10)

    def publish(self) -> None:
        """Publish the current measurements of all sensors."""
        stamp = self.get_clock().now().to_msg()
        for publisher, make in self._senders:
            message = make()
            message.header.stamp = stamp
            publisher.publish(message)

    def _plane(self) -> Any:
        return JointState(name=["plane_tilt"], position=[self.rig.encoder()])  # an encoder without a tachometer

    def _wheel(self, robot: Robot) -> Any:
        return JointState(name=["wheel"], position=[self.rig.wheel(robot.id)])

    def _odometry(self, robot: Robot) -> Any:
        position, velocity = self.rig.position(robot.id)
        message = Odometry()
        message.twist.twist.linear.x = robot.facing * velocity  # in the body frame
        if robot.source == "localisation":  # in a frame of the plane
            message.header.frame_id = "plane"
            message.pose.pose.position.x = position
            yaw = 0.0 if robot.facing > 0.0 else 1.0
            message.pose.pose.orientation = Quaternion(x=0.0, y=0.0, z=yaw, w=1.0 - yaw)
        else:  # forwards from its initial position
            message.header.frame_id = "odom"
            message.pose.pose.position.x = robot.facing * (position - robot.position)
        return message

    def _imu(self, robot: Robot) -> Any:
        """Return the orientation in the world: pitched by th, and turned by pi if the robot faces against the lane."""
        angle, rate = self.rig.tilt()
        s, c = sin(angle / 2.0), cos(angle / 2.0)
        message = Imu()
        message.header.frame_id = "imu_link"
        if robot.facing > 0.0:
            message.orientation = Quaternion(x=0.0, y=-s, z=0.0, w=c)
        else:
            message.orientation = Quaternion(x=-s, y=0.0, z=c, w=0.0)
        message.angular_velocity = Vector3(x=0.0, y=-robot.facing * rate, z=0.0)
        return message


def main(file: Path) -> None:
    """Run in real time until stopped; write the time since the release of the plane, angle and positions to a file."""
    rclpy.init()
    rig = Rig()
    node = RigNode(rig)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    begun, due, freed = time.monotonic(), 0.0, None
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time", "angle", *(f"position_{robot}" for robot in rig.bodies)])
        try:
            while True:
                heard = 0
                # Process commands even when the machine is too busy to keep time.
                while (rest := begun + due - time.monotonic()) > 0.0 or heard < 2 * len(rig.bodies):
                    executor.spin_once(timeout_sec=max(0.0, rest))
                    heard += 1
                rig.advance(due)
                node.publish()
                if not rig.held:
                    freed = due if freed is None else freed
                    row = [due - freed, rig.angle, *(body.position for body in rig.bodies.values())]
                    writer.writerow([f"{x:.6f}" for x in row])
                    stream.flush()
                due += 1.0 / RATE
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        finally:
            node.destroy_node()  # type: ignore[no-untyped-call]
            rclpy.try_shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
