"""Subscriptions to sensors over real DDS, and what ROS's own messages say."""

from __future__ import annotations

import time
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, Vector3
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import Imu as ImuMessage, JointState
from tests.swarmabs_ros.nodes import started_node

from swarmabs_ros.readings import Imu, Joints, Odometry
from swarmabs_ros.sensors import DEPTH, SensorSubscription, reading

STAMP = Time(sec=1_700_000_000, nanosec=250_000_000)
NANOSECONDS = 1_700_000_000_250_000_000


def odometry() -> Any:
    message = OdometryMessage()
    message.header.stamp, message.header.frame_id = STAMP, "odom"
    message.pose.pose.position = Point(x=1.0, y=2.0, z=3.0)
    message.pose.pose.orientation = Quaternion(x=0.1, y=0.2, z=0.3, w=0.4)
    message.twist.twist.linear = Vector3(x=4.0, y=5.0, z=6.0)
    message.twist.twist.angular = Vector3(x=7.0, y=8.0, z=9.0)
    return message


def imu() -> Any:
    message = ImuMessage(orientation=Quaternion(x=0.1, y=0.2, z=0.3, w=0.4))
    message.header.stamp, message.header.frame_id = STAMP, "imu_link"
    message.angular_velocity = Vector3(x=7.0, y=8.0, z=9.0)
    message.linear_acceleration = Vector3(x=4.0, y=5.0, z=6.0)
    return message


def joints(position: float = 0.5) -> Any:
    message = JointState(name=["a", "b"], position=[position, 1.5], velocity=[2.5], effort=[9.0, 9.0])
    message.header.stamp = STAMP
    return message


def test_what_the_messages_say() -> None:
    turned = (0.1, 0.2, 0.3, 0.4)
    assert reading(odometry()) == Odometry(NANOSECONDS, "odom", (1.0, 2.0, 3.0), turned, (4.0, 5.0, 6.0))
    assert reading(imu()) == Imu(NANOSECONDS, "imu_link", turned, (7.0, 8.0, 9.0))
    assert reading(joints()) == Joints(NANOSECONDS, ("a", "b"), (0.5, 1.5), (2.5,))
    assert reading(joints(), 77).stamp == 77


def test_an_imu_says_what_it_does_not_measure() -> None:
    message = imu()
    message.orientation_covariance[0] = -1.0
    assert reading(message) == Imu(NANOSECONDS, "imu_link", None, (7.0, 8.0, 9.0))
    message = imu()
    message.angular_velocity_covariance[0] = -1.0
    assert reading(message) == Imu(NANOSECONDS, "imu_link", (0.1, 0.2, 0.3, 0.4), None)


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize("reliability", [QoSReliabilityPolicy.RELIABLE, QoSReliabilityPolicy.BEST_EFFORT])
@pytest.mark.parametrize("stamped", ["header", "arrival"])
def test_what_arrives_is_taken_once_and_in_order(reliability: QoSReliabilityPolicy, stamped: str) -> None:
    before = time.time_ns()
    with started_node() as node:
        sensor = SensorSubscription(node, "joint_state", "~/joint_states", arrival=stamped == "arrival")
        publisher = node.create_publisher(
            JointState, "/probe/joint_states", QoSProfile(depth=DEPTH, reliability=reliability)
        )
        deadline = time.monotonic() + 10.0
        while publisher.get_subscription_count() < 1:
            assert time.monotonic() < deadline, "endpoints do not meet"
            time.sleep(0.01)
        assert sensor.take() == []
        for position in range(5):
            publisher.publish(joints(float(position)))
        found: list[Joints] = []
        while len(found) < 5:
            assert time.monotonic() < deadline, f"{len(found)} messages arrived"
            found += sensor.take()  # type: ignore[arg-type]
        assert [each.positions[0] for each in found] == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert sensor.take() == []
        stamps = [each.stamp for each in found]
        if stamped == "arrival":
            assert before <= stamps[0]
            assert stamps == sorted(stamps)
            assert stamps[-1] <= time.time_ns()
        else:
            assert stamps == [NANOSECONDS] * 5
