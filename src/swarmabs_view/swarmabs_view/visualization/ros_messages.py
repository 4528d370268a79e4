"""Frames of a scene as messages of ROS: a translation without any thought of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, TransformStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from swarmabs_view.visualization.geometry import JOINT, PLANE, WORLD, tilt
from swarmabs_view.visualization.scene import ARROW, CUBE, CYLINDER, LINES, NO_TURN, TEXT
from swarmabs_view.visualization.topics import CLOCK, DESCRIPTION, JOINT_STATES, MARKERS, TF, message_class

if TYPE_CHECKING:
    from swarmabs_view.visualization.geometry import Quaternion, Vector
    from swarmabs_view.visualization.scene import Colour, Frame, Shape
    from swarmabs_view.visualization.topics import VisualTopic

_TYPES = {
    ARROW: Marker.ARROW,
    CUBE: Marker.CUBE,
    CYLINDER: Marker.CYLINDER,
    LINES: Marker.LINE_LIST,
    TEXT: Marker.TEXT_VIEW_FACING,
}
_SECOND = 1_000_000_000


class Translator:
    """Translates frames; markers that stay are kept, since to make one costs more than to move it."""

    def __init__(self) -> None:
        self._markers: dict[tuple[str, int], tuple[Any, Colour, Vector]] = {}

    def messages(self, frame: Frame, *, clock: bool) -> list[tuple[VisualTopic, Any]]:
        """Return the messages of a frame with their topics; with the clock of a simulation if it is asked for."""
        stamp = _time(frame.stamp)
        found = [(JOINT_STATES, joint_state(frame, stamp)), (MARKERS, self._array(frame, stamp))]
        transforms = message_class(TF.ros_type)
        if transforms is not None:
            found.append((TF, transforms(transforms=_transforms(frame, stamp))))
        if clock:
            found.append((CLOCK, Clock(clock=stamp)))
        return found

    def _array(self, frame: Frame, stamp: Any) -> Any:
        for key in frame.gone:
            self._markers.pop(key, None)
        markers = [
            Marker(header=Header(stamp=stamp, frame_id=WORLD), ns=group, id=number, action=Marker.DELETE)
            for group, number in frame.gone
        ]
        markers += [self._marker(shape, stamp) for shape in frame.shapes]
        return MarkerArray(markers=markers)

    def _marker(self, shape: Shape, stamp: Any) -> Any:
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


def description(urdf: str) -> tuple[VisualTopic, Any]:
    """Return the message that describes the plane, with its topic."""
    return DESCRIPTION, String(data=urdf)


def joint_state(frame: Frame, stamp: Any) -> Any:
    """Return angle, rate and the robots' torque as the state of the joint."""
    return JointState(
        header=Header(stamp=stamp),
        name=[JOINT],
        position=[frame.angle],
        velocity=[frame.rate],
        effort=[] if frame.effort is None else [frame.effort],
    )


def robot_frame(agent_id: int) -> str:
    """Return the name of a robot's frame."""
    return f"robot_{agent_id:03d}"


def _transforms(frame: Frame, stamp: Any) -> list[Any]:
    """Return the plane in the world, and each robot on the plane."""
    plane = TransformStamped(header=Header(stamp=stamp, frame_id=WORLD), child_frame_id=PLANE)
    _turn(plane.transform.rotation, tilt(frame.angle))
    found = [plane]
    for agent_id, place in frame.places.items():
        robot = TransformStamped(header=Header(stamp=stamp, frame_id=PLANE), child_frame_id=robot_frame(agent_id))
        _set(robot.transform.translation, place)
        _turn(robot.transform.rotation, NO_TURN)
        found.append(robot)
    return found


def _new(shape: Shape) -> Any:
    points = [Point(x=point.x, y=point.y, z=point.z) for point in shape.points]
    header = Header(frame_id=WORLD)
    return Marker(
        header=header, ns=shape.group, id=shape.number, type=_TYPES[shape.kind], points=points, text=shape.text
    )


def _set(target: Any, vector: Vector) -> None:
    target.x, target.y, target.z = vector


def _turn(target: Any, turn: Quaternion) -> None:
    target.x, target.y, target.z, target.w = turn


def _time(nanoseconds: int) -> Any:
    seconds, rest = divmod(nanoseconds, _SECOND)
    return Time(sec=seconds, nanosec=rest)
