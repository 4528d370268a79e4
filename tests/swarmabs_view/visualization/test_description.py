"""The plane as URDF, read by the parser of the ROS community."""

from __future__ import annotations

import pytest
from scipy.spatial.transform import Rotation
from tests.processes import ROOT
from urdf_parser_py.urdf import URDF

from swarmabs_config.scenarios import find_scenario
from swarmabs_view.visualization.scene import Scene, plane_urdf, tilt


def described(*overrides: str) -> tuple[str, float]:
    scenario = find_scenario("pd_het_4", overrides).resolved()
    return plane_urdf(Scene.of(scenario), scenario.plane.inertia), scenario.plane.inertia


def test_it_is_a_plate_on_a_level_joint() -> None:
    text, inertia = described("plane.length=2.0", "plane.inertia=0.7")
    robot = URDF.from_xml_string(text.encode())
    assert robot.check_valid() is None
    assert robot.get_root() == "world"
    (joint,) = robot.joints
    assert (joint.name, joint.type, joint.parent, joint.child) == ("plane_tilt", "revolute", "world", "plane")
    assert (joint.limit.lower, joint.limit.upper) == (-1.5, 1.5)  # where every run ends
    # The joint turns the plane as the markers do.
    assert Rotation.from_rotvec([0.3 * part for part in joint.axis]).as_quat() == pytest.approx(tilt(0.3))
    plate = robot.link_map["plane"]
    assert plate.visual.geometry.size == plate.collision.geometry.size == [2.0, 4 * 0.2, 0.04]  # four lanes
    moments = plate.inertial.inertia
    assert moments.iyy == inertia == 0.7
    # A box of this mass, about the axis and about the others.
    mass, (length, width, thickness) = plate.inertial.mass, plate.visual.geometry.size
    assert moments.iyy == pytest.approx(mass * (length**2 + thickness**2) / 12.0)
    assert moments.ixx == pytest.approx(mass * (width**2 + thickness**2) / 12.0)
    assert moments.izz == pytest.approx(mass * (length**2 + width**2) / 12.0)


def test_the_file_that_is_installed_is_that_of_the_default_scenario() -> None:
    path = ROOT / "src" / "swarmabs_bringup" / "urdf" / "plane.urdf"
    assert path.read_text(encoding="utf-8") == described()[0]
