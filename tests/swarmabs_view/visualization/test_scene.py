"""What is drawn of a swarm, against plain geometry."""

import cmath
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.processes import ROOT
from urdf_parser_py.urdf import URDF

from swarmabs_bag.shown.swarm_state import SILENT_STEPS, SwarmState
from swarmabs_config.scenarios import find_scenario
from swarmabs_core import messages as msg
from swarmabs_core.steering import OffsetReference, StepSchedule
from swarmabs_view.visualization.scene import (
    COLOURS,
    DEAD,
    GREY,
    LINES,
    SAFE_STOP,
    Frame,
    Scene,
    Shape,
    Vector,
    plane_urdf,
    tilt,
    tilted,
)

ROBOTS = [(3, msg.Kind.DOUBLE_INTEGRATOR, 0.5), (1, msg.Kind.SINGLE_INTEGRATOR, 4.0)]
SCENE = Scene(2.0, 1.0, ROBOTS, torque_max=5.0)
PERIOD = 10_000_000


def plane(step: int, angle: float) -> msg.PlaneState:
    return msg.PlaneState(step * PERIOD, step, angle, 0.25)


def robot(step: int, agent_id: int, position: float, status: msg.Status = msg.Status.ACTIVE) -> msg.AgentState:
    return msg.AgentState(
        step * PERIOD, step, msg.NEVER, agent_id, msg.Kind.SINGLE_INTEGRATOR, status, 1.0, 0.0, position, 0.0, 0.0
    )


def abstract(step: int, torque: float) -> msg.AbstractState:
    return msg.AbstractState(step * PERIOD, step, 2, torque, 0.0, 0.0, 0.0)


def desired(step: int, torque: float) -> msg.DesiredAbstractState:
    return msg.DesiredAbstractState(step * PERIOD, step, msg.Mode.RUN, torque, *([0.0] * 7))


def new() -> tuple[Scene, SwarmState]:
    reference = OffsetReference(lambda time: time, StepSchedule(), PERIOD)
    return Scene(2.0, 1.0, ROBOTS, torque_max=5.0), SwarmState(reference=reference, period_ns=PERIOD)


def drawn(
    *messages: object, scene: tuple[Scene, SwarmState] | None = None
) -> tuple[Frame, dict[tuple[str, int], Shape]]:
    scene, swarm = scene or new()
    for message in messages:
        swarm.add(message)  # type: ignore[arg-type]
    frame = scene.frame(swarm)
    assert frame is not None
    assert all(0.0 <= part <= 1.0 for shape in frame.shapes for part in shape.colour)
    assert all(shape.size[1:] == (0.0, 0.0) for shape in frame.shapes if shape.kind == LINES)
    return frame, {(shape.group, shape.number): shape for shape in frame.shapes}


@pytest.mark.parametrize("angle", [-1.4, -0.3, 0.0, 0.1, 1.2])
def test_a_positive_angle_lifts_the_positive_end(angle: float) -> None:
    turn = Rotation.from_quat(tilt(angle))
    assert turn.apply([1.0, 0.0, 0.0]) == pytest.approx([math.cos(angle), 0.0, math.sin(angle)])
    assert turn.apply([0.0, 1.0, 0.0]) == pytest.approx([0.0, 1.0, 0.0])
    point = np.array([0.3, -0.2, 0.05])
    assert tilted(Vector(*point), angle) == pytest.approx(turn.apply(point))


def test_the_plate_is_tilted_and_robots_stand_on_it_in_lanes_of_their_own() -> None:
    angle = 0.2
    frame, shapes = drawn(plane(5, angle), robot(5, 1, -0.7), robot(5, 3, 0.4))
    for agent_id, position in ((1, -0.7), (3, 0.4)):
        shape = shapes["robots", agent_id]
        # In the vertical plane a point (along, up) of the tilted plane is turned by the angle.
        height = SCENE.thickness / 2.0 + shape.size.z / 2.0
        turned = (position + 1j * height) * cmath.exp(1j * angle)
        assert (shape.pose.position.x, shape.pose.position.z) == pytest.approx((turned.real, turned.imag))
        assert shape.pose.orientation == tilt(angle)
        assert frame.places[agent_id] == pytest.approx((position, shape.pose.position.y, height))
    first, second = (shapes["robots", agent_id] for agent_id in (1, 3))
    assert second.pose.position.y - first.pose.position.y == pytest.approx(SCENE.lane_width)
    assert first.pose.position.y == -second.pose.position.y
    assert SCENE.lane_width > first.size.y  # the heaviest is the widest
    assert (first.size.x / second.size.x) ** 3 == pytest.approx(4.0 / 0.5)  # volumes as masses
    assert (first.kind, second.kind) == ("cylinder", "cube")
    assert (first.colour, second.colour) == (COLOURS[msg.Kind.SINGLE_INTEGRATOR], COLOURS[msg.Kind.DOUBLE_INTEGRATOR])
    assert shapes["labels", 3].text == "3"
    _, shapes = drawn(plane(30, 0.2))
    plate = shapes["plane", 0]
    assert (plate.size, plate.pose.position) == ((2.0, SCENE.width, SCENE.thickness), (0.0, 0.0, 0.0))
    assert plate.pose.orientation == tilt(0.2)
    assert [point.x for point in shapes["lanes", 0].points] == [-1.0, 1.0] * 2
    assert shapes["reference", 0].pose.orientation == tilt(0.3)  # the reference is the time


def test_torques_point_to_the_end_that_they_push_down() -> None:
    frame, shapes = drawn(plane(1, 0.5), abstract(1, 2.5), desired(1, -50.0))
    actual, wanted = shapes["torque", 0], shapes["torque", 1]
    assert actual.size.x == pytest.approx(0.5)  # half of torque_max, of half of the plane
    assert wanted.size.x == pytest.approx(1.0)  # never longer than half of the plane
    assert Rotation.from_quat(actual.pose.orientation).apply([1, 0, 0]) == pytest.approx([1, 0, 0])
    assert Rotation.from_quat(wanted.pose.orientation).apply([1, 0, 0]) == pytest.approx([-1, 0, 0])
    # A weight at positive positions turns the joint backwards: (J + Js) w' = -cos(angle) tau.
    assert frame.effort == pytest.approx(-math.cos(0.5) * 2.5)


def test_states_of_robots_are_seen() -> None:
    states = [plane(0, 0.0), robot(0, 1, 0.1, msg.Status.SAFE_STOP), robot(0, 3, 0.2)]
    dead = msg.SwarmEvent(0, 0, 3, msg.EventKind.DEAD, 0.0, "kill")
    own = COLOURS[msg.Kind.DOUBLE_INTEGRATOR]
    for more, colour in (
        ([], own),
        ([dead], DEAD),
        ([dead, dead._replace(kind=msg.EventKind.JOINED)], own),
        ([plane(SILENT_STEPS, 0.0)], own),
        ([plane(SILENT_STEPS + 1, 0.0)], GREY),
    ):
        _, shapes = drawn(*states, *more)
        assert shapes["robots", 3].colour == colour, more
        assert shapes["robots", 1].colour == (GREY if plane(SILENT_STEPS + 1, 0.0) in more else SAFE_STOP)


@pytest.mark.parametrize(
    "said", [robot(1, 3, 0.2, msg.Status.LEFT), msg.SwarmEvent(0, 1, 3, msg.EventKind.LEFT, 0.0, "remove")]
)
def test_who_leaves_or_is_removed_is_taken_away_once_and_who_is_dead_stands_where_its_event_says(said: object) -> None:
    """A robot that is removed says nothing of it: the observer does."""
    scene = new()
    drawn(plane(0, 0.0), robot(0, 1, 0.1), robot(0, 3, 0.2), scene=scene)
    frame, shapes = drawn(said, plane(1, 0.0), robot(1, 1, 0.1), scene=scene)
    assert ("robots", 3) not in shapes and 3 not in frame.places
    assert frame.gone == (("labels", 3), ("robots", 3))
    dead = msg.SwarmEvent(0, 2, 1, msg.EventKind.DEAD, -0.3, "kill")
    frame, shapes = drawn(dead, plane(2, 0.0), robot(2, 1, 0.1), scene=scene)
    assert (frame.step, frame.gone, frame.places[1].x) == (2, (), -0.3)
    assert shapes["robots", 1].colour == DEAD


def test_what_does_not_belong_here_is_left_out() -> None:
    scene = new()
    assert scene[0].frame(scene[1]) is None
    frame, shapes = drawn(plane(3, 0.3), plane(2, 0.2), robot(3, 99, 0.1), robot(3, 1, math.nan), scene=scene)
    assert (frame.step, frame.angle, frame.stamp, frame.rate) == (3, 0.3, 3 * PERIOD, 0.25)
    assert not any(group in {"robots", "torque"} for group, _ in shapes)
    scene[1].add(plane(4, math.nan))
    scene[1].add(robot(4, 1, 0.0))
    assert scene[0].frame(scene[1]) is None


def test_by_a_clock_the_reference_begins_with_the_law() -> None:
    scene = new()
    begin = 1_700_000_000 * 10**9
    _, shapes = drawn(plane(30, 0.0)._replace(stamp=begin), scene=scene)
    assert ("reference", 0) not in shapes
    basis = msg.Basis(begin, 30, msg.NEVER, 10, msg.Source.CONTROLLER, (), (), ())
    _, shapes = drawn(basis, scene=scene)
    assert shapes["reference", 0].pose.orientation == tilt(0.2)  # 20 periods


def test_a_scenario_gives_its_dimensions() -> None:
    scenario = find_scenario("arise_het_200", ["plane.length=3"]).resolved()
    scene = (Scene.of(scenario), SwarmState.of(scenario))
    layout = scene[0]
    assert (layout.length, len(layout.robots)) == (3.0, 200)
    lanes = sorted(robot.lane for robot in layout.robots.values())
    assert layout.width / 2.0 >= lanes[-1] + layout.lane_width / 2.0 - 1e-9
    frame, shapes = drawn(plane(0, 0.0), *(robot(0, agent_id, 0.0) for agent_id in layout.robots), scene=scene)
    assert len(frame.places) == 200
    assert not any(group == "labels" for group, _ in shapes)


def described(*overrides: str) -> tuple[str, float]:
    scenario = find_scenario("pd_het_4", overrides).resolved()
    return plane_urdf(Scene.of(scenario)), scenario.plane.inertia


def test_the_urdf_is_a_plate_on_a_level_joint() -> None:
    """By the parser of the ROS community."""
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
    # The file that is installed is that of the default scenario.
    path = ROOT / "src" / "swarmabs_bringup" / "urdf" / "plane.urdf"
    assert path.read_text(encoding="utf-8") == described()[0]
