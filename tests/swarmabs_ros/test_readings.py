"""Geometry of sensors, against scipy's rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation
from tests.swarmabs_ros.bodies import attitude

from swarmabs_core.realtime.instruments import AXES
from swarmabs_ros.readings import (
    Joints,
    RefusedReadingError,
    check_frame,
    joint_values,
    normalised,
    rotation_row,
    signed_axis,
    tilt,
    wrapped,
)

ANGLES = st.floats(-3.0, 3.0)


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
    # Oracle: how high the tip of the nose is.
    assert stands.apply([1.0, 0.0, 0.0])[2] == pytest.approx(facing * math.sin(angle))


def test_signed_axes() -> None:
    assert [signed_axis(name) for name in AXES] == [(0, 1), (1, 1), (2, 1), (0, -1), (1, -1), (2, -1)]


def test_angles_are_wrapped() -> None:
    assert wrapped(0.1 + 4.0 * math.pi) == pytest.approx(0.1)
    assert wrapped(-3.2) == pytest.approx(2.0 * math.pi - 3.2)


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.1), (1.0, 1.0, 0.0, 0.0)])
def test_what_is_no_rotation_is_refused(quaternion: tuple[float, float, float, float]) -> None:
    with pytest.raises(RefusedReadingError, match="is no rotation") as caught:
        normalised(quaternion)
    assert caught.value.reason == "orientation"


def test_a_quaternion_that_is_not_finite_is_refused() -> None:
    with pytest.raises(RefusedReadingError) as caught:
        normalised((math.nan, 0.0, 0.0, 1.0))
    assert caught.value.reason == "not finite"


def test_a_frame_must_be_the_one_asked_for() -> None:
    check_frame("anything", "")
    check_frame("odom", "odom")
    with pytest.raises(RefusedReadingError, match="frame 'map', not 'odom'") as caught:
        check_frame("map", "odom")
    assert caught.value.reason == "frame"


def test_joints_are_found_by_name() -> None:
    assert joint_values(Joints(1, ("a", "b"), (0.1, 0.2), (1.0, 2.0)), "b") == (0.2, 2.0)
    assert joint_values(Joints(1, ("a", "b"), (0.1, 0.2), ()), "a") == (0.1, None)


@pytest.mark.parametrize(
    ("joints", "text"),
    [
        (Joints(1, ("a", "c"), (0.1, 0.2), ()), "no joint 'b', only a, c"),
        (Joints(1, (), (), ()), "no joint 'b', only none"),
        (Joints(1, ("a", "b"), (0.1,), ()), "joint 'b' has no position"),
    ],
)
def test_a_joint_that_is_not_there_is_refused(joints: Joints, text: str) -> None:
    with pytest.raises(RefusedReadingError, match=text):
        joint_values(joints, "b")
