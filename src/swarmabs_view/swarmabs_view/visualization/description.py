"""The plane as URDF: a plate on a level joint `plane_tilt`, for RViz, Foxglove and `robot_state_publisher`."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from swarmabs_view.visualization.geometry import AXIS, JOINT, PLANE, WORLD

if TYPE_CHECKING:
    from swarmabs_view.visualization.geometry import Layout

LARGEST_ANGLE = 1.5
"""rad; every run ends there."""


def plane_urdf(layout: Layout, inertia: float) -> str:
    """Return the description of a plane.

    Parameters
    ----------
    layout : Layout
        Its dimensions.
    inertia : float
        Its moment of inertia about its axis, kg m^2.

    Returns
    -------
    str
        URDF. The mass is that of a uniform plate with this moment of inertia, 12 J / (l^2 + t^2).
    """
    robot = Element("robot", name="swarmabs_plane")
    SubElement(robot, "link", name=WORLD)
    link = SubElement(robot, "link", name=PLANE)
    length, width, thickness = layout.length, layout.width, layout.thickness
    mass = 12.0 * inertia / (length**2 + thickness**2)
    for part in ("visual", "collision"):
        element = SubElement(link, part)
        SubElement(SubElement(element, "geometry"), "box", size=_numbers(length, width, thickness))
        if part == "visual":
            material = SubElement(element, "material", name="plate")
            SubElement(material, "color", rgba="0.80 0.78 0.72 1")
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "mass", value=_numbers(mass))
    SubElement(
        inertial,
        "inertia",
        ixx=_numbers(mass * (width**2 + thickness**2) / 12.0),
        ixy="0",
        ixz="0",
        iyy=_numbers(inertia),
        iyz="0",
        izz=_numbers(mass * (length**2 + width**2) / 12.0),
    )
    joint = SubElement(robot, "joint", name=JOINT, type="revolute")
    SubElement(joint, "parent", link=WORLD)
    SubElement(joint, "child", link=PLANE)
    SubElement(joint, "axis", xyz=_numbers(*AXIS))
    limit = _numbers(LARGEST_ANGLE)
    SubElement(joint, "limit", lower=f"-{limit}", upper=limit, effort="1000", velocity="1000")
    indent(robot)
    return f'<?xml version="1.0"?>\n{tostring(robot, encoding="unicode")}\n'


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)
