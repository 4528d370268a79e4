"""The standard topics that show a swarm, relative to its namespace, and the conversion of frames to their messages."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, TransformStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from swarmabs_config.graph import Qos
from swarmabs_core.cdr import SECOND
from swarmabs_view.visualization.scene import (
    ARROW,
    CUBE,
    CYLINDER,
    JOINT,
    LINES,
    NO_TURN,
    PLANE,
    TEXT,
    WORLD,
    plane_urdf,
    tilt,
)

if TYPE_CHECKING:
    from swarmabs_view.visualization.scene import Colour, Frame, Quaternion, Scene, Shape, Vector


RosMessage: TypeAlias = Any
"""A message of any ROS package; rclpy does not type them."""


@dataclass(frozen=True, slots=True)
class VisualTopic:
    """A topic: name, full ROS name of its type, and offered QoS."""

    name: str
    ros_type: str
    qos: Qos


JOINT_STATES = VisualTopic("plane/joint_states", "sensor_msgs/msg/JointState", Qos("reliable", 10))
MARKERS = VisualTopic("swarm/markers", "visualization_msgs/msg/MarkerArray", Qos("reliable", 1))
DESCRIPTION = VisualTopic("robot_description", "std_msgs/msg/String", Qos("reliable", 1, "transient_local"))
TF = VisualTopic("tf", "tf2_msgs/msg/TFMessage", Qos("reliable", 100))
CLOCK = VisualTopic("clock", "rosgraph_msgs/msg/Clock", Qos("best_effort", 1))

VISUAL_TOPICS = (JOINT_STATES, MARKERS, DESCRIPTION, TF, CLOCK)
"""All topics. `TF` exists only where `tf2_msgs` is installed, which is not available as a wheel on PyPI."""


@cache
def message_class(ros_type: str) -> Any:
    """Return the class of a message type, or None if its package is not installed."""
    package, _, name = ros_type.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ModuleNotFoundError:
        return None


def available_topics() -> tuple[VisualTopic, ...]:
    """Return the topics whose types are installed."""
    return tuple(topic for topic in VISUAL_TOPICS if message_class(topic.ros_type) is not None)


_TYPES = {
    ARROW: Marker.ARROW,
    CUBE: Marker.CUBE,
    CYLINDER: Marker.CYLINDER,
    LINES: Marker.LINE_LIST,
    TEXT: Marker.TEXT_VIEW_FACING,
}


class Translator:
    """Converts frames to messages; reuses markers, because creating one costs more than moving it."""

    def __init__(self) -> None:
        self._markers: dict[tuple[str, int], tuple[Marker, Colour, Vector]] = {}

    def messages(self, frame: Frame, *, clock: bool) -> list[tuple[VisualTopic, RosMessage]]:
        """Return the messages of a frame with their topics, on request with the clock of a simulation."""
        stamp = Time(sec=frame.stamp // SECOND, nanosec=frame.stamp % SECOND)
        messages = [(JOINT_STATES, _joint_state(frame, stamp)), (MARKERS, self._array(frame, stamp))]
        transforms = message_class(TF.ros_type)
        if transforms is not None:
            messages.append((TF, transforms(transforms=_transforms(frame, stamp))))
        if clock:
            messages.append((CLOCK, Clock(clock=stamp)))
        return messages

    def _array(self, frame: Frame, stamp: Time) -> MarkerArray:
        for key in frame.gone:
            self._markers.pop(key, None)
        markers = [
            Marker(header=Header(stamp=stamp, frame_id=WORLD), ns=group, id=number, action=Marker.DELETE)
            for group, number in frame.gone
        ]
        markers += [self._marker(shape, stamp) for shape in frame.shapes]
        return MarkerArray(markers=markers)

    def _marker(self, shape: Shape, stamp: Time) -> Marker:
        key = (shape.group, shape.number)
        marker, colour, size = self._markers.get(key) or (_new(shape), None, None)
        if (colour, size) != (shape.colour, shape.size):
            marker.color = ColorRGBA(r=shape.colour.r, g=shape.colour.g, b=shape.colour.b, a=shape.colour.a)
            _set(marker.scale, shape.size)
            self._markers[key] = (marker, shape.colour, shape.size)
        marker.header.stamp = stamp
        _set(marker.pose.position, shape.pose.position)
        _turn(marker.pose.orientation, shape.pose.orientation)
        return marker


def description(scene: Scene) -> tuple[VisualTopic, String]:
    """Return the message that describes the plane, with its topic."""
    return DESCRIPTION, String(data=plane_urdf(scene))


def _joint_state(frame: Frame, stamp: Time) -> JointState:
    """Return angle, rate and the robots' torque as the state of the joint."""
    return JointState(
        header=Header(stamp=stamp),
        name=[JOINT],
        position=[frame.angle],
        velocity=[frame.rate],
        effort=[] if frame.effort is None else [frame.effort],
    )


def _transforms(frame: Frame, stamp: Time) -> list[TransformStamped]:
    """Return the plane in the world, and each robot on the plane."""
    plane = TransformStamped(header=Header(stamp=stamp, frame_id=WORLD), child_frame_id=PLANE)
    _turn(plane.transform.rotation, tilt(frame.angle))
    transforms = [plane]
    for agent_id, place in frame.places.items():
        robot = TransformStamped(header=Header(stamp=stamp, frame_id=PLANE), child_frame_id=f"robot_{agent_id:03d}")
        _set(robot.transform.translation, place)
        _turn(robot.transform.rotation, NO_TURN)
        transforms.append(robot)
    return transforms


def _new(shape: Shape) -> Marker:
    points = [Point(x=point.x, y=point.y, z=point.z) for point in shape.points]
    header = Header(frame_id=WORLD)
    return Marker(
        header=header, ns=shape.group, id=shape.number, type=_TYPES[shape.kind], points=points, text=shape.text
    )


def _set(target: RosMessage, vector: Vector) -> None:
    target.x, target.y, target.z = vector


def _turn(target: RosMessage, turn: Quaternion) -> None:
    target.x, target.y, target.z, target.w = turn
