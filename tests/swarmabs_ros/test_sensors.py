"""Sensors: subscriptions over real DDS, what ROS's messages say, geometry against scipy's, and what is believed."""

import math
from math import inf, nan
from time import time_ns
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, Vector3
from hypothesis import given, strategies as st
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu as ImuMessage, JointState
from tests.processes import until
from tests.swarmabs_ros.bodies import EPOCH, attitude
from tests.swarmabs_ros.nodes import started_node

from swarmabs_ros.readings import (
    SETTLING,
    Imu,
    Joints,
    Odometry,
    RefusedReadingError,
    RefusedReadings,
    Sample,
    Track,
    check_frame,
    joint_values,
    normalised,
    rotation_row,
    signed_axis,
    tilt,
    wrapped,
)
from swarmabs_ros.sensors import DEPTH, SensorSubscription, reading

STAMP = Time(sec=1_700_000_000, nanosec=250_000_000)
NANOSECONDS = 1_700_000_000_250_000_000
MS = 1_000_000
BANDWIDTH = 50.0
ANGLES = st.floats(-3.0, 3.0)


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


def test_what_the_messages_say_and_what_an_imu_says_that_it_does_not_measure() -> None:
    turned = (0.1, 0.2, 0.3, 0.4)
    assert reading(odometry()) == Odometry(NANOSECONDS, "odom", (1.0, 2.0, 3.0), turned, (4.0, 5.0, 6.0))
    assert reading(imu()) == Imu(NANOSECONDS, "imu_link", turned, (7.0, 8.0, 9.0))
    assert reading(joints()) == Joints(NANOSECONDS, ("a", "b"), (0.5, 1.5), (2.5,))
    assert reading(joints(), 77).stamp == 77
    without_rotation, without_rate = imu(), imu()
    without_rotation.orientation_covariance[0] = without_rate.angular_velocity_covariance[0] = -1.0
    assert reading(without_rotation) == Imu(NANOSECONDS, "imu_link", None, (7.0, 8.0, 9.0))
    assert reading(without_rate) == Imu(NANOSECONDS, "imu_link", turned, None)


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(
    ("reliability", "stamped"),
    [(QoSReliabilityPolicy.RELIABLE, "header"), (QoSReliabilityPolicy.BEST_EFFORT, "arrival")],
)
def test_what_arrives_is_taken_once_and_in_order(reliability: QoSReliabilityPolicy, stamped: str) -> None:
    before = time_ns()
    with started_node() as node:
        sensor = SensorSubscription(node, "joint_state", "~/joint_states", arrival=stamped == "arrival")
        publisher = node.create_publisher(
            JointState, "/probe/joint_states", QoSProfile(depth=DEPTH, reliability=reliability)
        )
        until(publisher.get_subscription_count, "endpoints meet")
        assert sensor.take() == []
        for position in range(5):
            publisher.publish(joints(float(position)))
        readings: list[Any] = []
        until(lambda: readings.extend(sensor.take()) or len(readings) == 5, "all arrive")
        assert [one.positions[0] for one in readings] == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert sensor.take() == []
        stamps = [one.stamp for one in readings]
        if stamped == "arrival":
            assert before <= stamps[0] <= stamps[-1] <= time_ns() and stamps == sorted(stamps)
        else:
            assert stamps == [NANOSECONDS] * 5


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_rows_are_those_of_the_rotation_matrix(vector: tuple[float, float, float]) -> None:
    rotation = Rotation.from_rotvec(np.pi * np.array(vector) / np.sqrt(3.0))
    rows = [rotation_row(normalised(tuple(rotation.as_quat())), row) for row in range(3)]
    np.testing.assert_allclose(rows, rotation.as_matrix(), atol=1e-12)


@given(axis=st.integers(0, 2), angle=ANGLES, yaw=ANGLES)
def test_tilt_is_the_turn_about_a_level_axis_whatever_the_heading(axis: int, angle: float, yaw: float) -> None:
    level = (Rotation.identity(), Rotation.identity(), Rotation.from_euler("x", 90, degrees=True))[axis]
    about = np.eye(3)[axis]
    turned = Rotation.from_rotvec([0.0, 0.0, yaw]) * level * Rotation.from_rotvec(angle * about)
    assert tilt(normalised(tuple(turned.as_quat())), axis) == pytest.approx(angle, abs=1e-9)


@given(angle=st.floats(-1.5, 1.5), yaw=ANGLES, facing=st.sampled_from([1.0, -1.0]))
def test_the_nose_of_a_robot_rises_with_the_plane_about_minus_y(angle: float, yaw: float, facing: float) -> None:
    axis, sign = signed_axis("-y")
    stands = attitude(angle, facing, yaw=yaw)
    assert facing * sign * tilt(normalised(tuple(stands.as_quat())), axis) == pytest.approx(angle, abs=1e-9)
    assert wrapped(angle + 4.0 * math.pi) == pytest.approx(angle)
    # Oracle: how high the tip of the nose is.
    assert stands.apply([1.0, 0.0, 0.0])[2] == pytest.approx(facing * math.sin(angle))


def test_what_is_no_rotation_is_refused() -> None:
    for x, w in ((0.0, 0.0), (0.0, 1.011), (1.0, 1.0), (nan, 1.0)):
        with pytest.raises(RefusedReadingError) as caught:
            normalised((x, 0.0, 0.0, w))
        assert caught.value.reason == ("orientation" if math.isfinite(x) else "not finite")


def test_frames_are_compared_and_joints_found_by_name() -> None:
    check_frame("anything", "")
    check_frame("odom", "odom")
    with pytest.raises(RefusedReadingError, match="frame 'map', not 'odom'") as caught:
        check_frame("map", "odom")
    assert caught.value.reason == "frame"
    assert joint_values(Joints(1, ("a", "b"), (0.1, 0.2), (1.0, 2.0)), "b") == (0.2, 2.0)
    assert joint_values(Joints(1, ("a", "b"), (0.1, 0.2), ()), "a") == (0.1, None)
    for names, positions, text in (
        (("a", "c"), (0.1, 0.2), "no joint 'b', only a, c"),
        ((), (), "no joint 'b', only none"),
        (("a", "b"), (0.1,), "joint 'b' has no position"),
    ):
        with pytest.raises(RefusedReadingError, match=text):
            joint_values(Joints(1, names, positions, ()), "b")


@pytest.fixture
def track() -> Track:
    return Track(2.0, 0.01, 0.02, BANDWIDTH)


def refusal(track: Track, stamp: int, value: float, rate: float | None = 0.0, now: int | None = None) -> str:
    """Offer what is to be refused; return the reason."""
    before = track.newest
    with pytest.raises(RefusedReadingError) as caught:
        track.offer(stamp, value, rate, stamp if now is None else now)
    assert track.newest == before
    return caught.value.reason


@pytest.mark.parametrize(
    ("stamp", "value", "rate", "reason"),
    [
        *((1, value, 0.0, "not finite") for value in (nan, inf)),
        *((1, 0.1, rate, "not finite") for rate in (nan, -inf)),
        (1, nan, None, "not finite"),
        *((-age, 0.1, 0.0, "order") for age in (0, 1, 10 * MS)),
        *((1, 0.1, rate, "speed") for rate in (2.1, -2.1)),
        (20 * MS + 1, 0.1, 0.0, "future"),
        (-EPOCH, 0.1, 0.0, "no stamp"),
    ],
)
def test_what_cannot_be_is_refused(track: Track, stamp: int, value: float, rate: float | None, reason: str) -> None:
    track.offer(EPOCH, 0.1, 0.0, EPOCH)
    assert refusal(track, EPOCH + stamp, value, rate, now=EPOCH) == reason
    track.offer(EPOCH + 20 * MS, 0.1, 0.0, EPOCH)  # the future is borne as far as this


def test_a_jump_is_refused_and_believed_when_there_was_time_for_it(track: Track) -> None:
    """With 2 m/s and 0.01 m, a place 0.5 m away is believed 0.245 s later."""
    track.offer(EPOCH, 0.0, 0.0, EPOCH)
    for late in range(10, 245, 10):
        assert refusal(track, EPOCH + late * MS, 0.5) == "jump"
    assert refusal(track, EPOCH + 240 * MS, 0.5, now=EPOCH + 900 * MS) == "jump", "its own time counts"
    track.offer(EPOCH + 246 * MS, 0.5, 0.0, EPOCH + 246 * MS)
    assert track.newest == Sample(EPOCH + 246 * MS, 0.5, 0.0)


def test_a_straight_line_is_differentiated_as_the_filter_s_equation_says(track: Track) -> None:
    """r' = w (x' - r), r(0) = 0, x' = 0.3: r = 0.3 (1 - exp(-w t)), whatever the intervals."""
    times = [0, 3, 10, 17, 18, 40, 60, 90, 100, 120, 121, 150, 200]
    for time in times:
        track.offer(EPOCH + time * MS, 0.3 * time / 1000, None, EPOCH + time * MS)
        settled = time / 1000 >= SETTLING / BANDWIDTH
        assert (track.newest is not None) == settled
        if track.newest is not None:
            assert track.newest.rate == pytest.approx(0.3 * (1.0 - math.exp(-BANDWIDTH * time / 1000)), rel=1e-12)


def test_a_place_that_was_jumped_to_gives_no_rate(track: Track) -> None:
    for time in range(0, 200, 10):
        track.offer(EPOCH + time * MS, 0.0, None, EPOCH + time * MS)
    samples = []
    for time in range(200, 700, 10):
        try:
            track.offer(EPOCH + time * MS, 0.4, None, EPOCH + time * MS)
        except RefusedReadingError:
            continue
        samples.append(track.newest)
    assert samples[0] is None
    assert samples[-1] == Sample(EPOCH + 690 * MS, 0.4, 0.0)
    assert {sample.rate for sample in samples if sample is not None} == {0.0}


def test_refusals_are_counted_by_reason() -> None:
    refusals = RefusedReadings()
    assert refusals.values() == ()
    for reason in ("jump", "frame", "jump"):
        refusals.add(RefusedReadingError(reason, f"a {reason}"))
    told = {"readings refused, frame": "1", "readings refused, jump": "2", "last reading refused": "a jump"}
    assert refusals.values() == tuple(told.items())
