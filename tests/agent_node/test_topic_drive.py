"""The topic drive: what it measures, what it refuses, and that a body on a tilted plane feels the law's force alone."""

from collections.abc import Sequence
from math import inf, nan, sin

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.swarmabs_ros.bodies import EPOCH, SECOND, imu, lane, odometry

from agent_node.topic_drive import TopicDrive
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind
from swarmabs_core.parameters import Value
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.drives import DRIVES, Body, Measurement
from swarmabs_core.realtime.instruments import TopicSettings
from swarmabs_core.robot_controller import Limits
from swarmabs_ros.readings import Joints, Reading

SI, DI = Kind.SINGLE_INTEGRATOR, Kind.DOUBLE_INTEGRATOR
MS = 1_000_000
GRAVITY = 9.81
FACING, AXES = st.sampled_from([1.0, -1.0]), st.sampled_from(["+x", "+y", "-x", "-y"])


class Wire:
    """A connection that remembers."""

    def __init__(self) -> None:
        self.arrived: list[Reading] = []
        self.sent: list[float] = []
        self.settings = TopicSettings()

    def connect(self, settings: TopicSettings, body: Body) -> TopicDrive:
        return TopicDrive(settings, body, self.wired)  # type: ignore[arg-type]

    def wired(self, settings: TopicSettings) -> "Wire":
        self.settings = settings
        return self

    def take(self) -> Sequence[Reading]:
        arrived, self.arrived = self.arrived, []
        return arrived

    def send(self, value: float) -> None:
        self.sent.append(value)


def wired_drive(
    kind: Kind, *, mass: float = 0.5, limits: Limits | None = None, **given: Value
) -> tuple[TopicDrive, Wire]:
    wire = Wire()
    body = Body(1, kind, Schedule(10 * MS), mass, 0.0, GRAVITY, limits or Limits(), connect=wire.connect)
    drive = DRIVES.make("topic", {name.replace("__", "."): value for name, value in given.items()}, body)
    assert isinstance(drive, TopicDrive)
    return drive, wire


def heard(drive: TopicDrive, wire: Wire, *readings: Reading, now: int = EPOCH) -> Measurement | None:
    wire.arrived.extend(readings)
    return drive.read(now)


@given(AXES, FACING, st.floats(-0.4, 0.4), st.floats(-0.5, 0.5), st.floats(-1.0, 1.0), st.floats(-0.2, 0.2))
def test_odometry(axis: str, facing: float, heading: float, position: float, velocity: float, offset: float) -> None:
    drive, wire = wired_drive(SI, axis=axis, offset=offset)
    where = {"axis": "xy".index(axis[-1]), "sign": -1.0 if axis[0] == "-" else 1.0}
    measured = heard(drive, wire, odometry(EPOCH, position, velocity, facing=facing, heading=heading, **where))
    assert measured is not None
    assert measured == pytest.approx((EPOCH, offset + position, velocity), abs=1e-12)
    drive.write(0.25, EPOCH)
    drive.stop()
    assert wire.sent == [facing * 0.25, 0.0]


@given(
    FACING,
    st.floats(-3.0, 3.0),
    st.tuples(st.floats(-1.2, 1.2), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)),
    st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-1.0, 1.0)),
)
def test_a_body_on_a_tilting_plane_feels_the_force_of_the_law_alone(
    facing: float, yaw: float, tilt: tuple[float, float, float], motion: tuple[float, float, float]
) -> None:
    """Newton's law in space: the law wants m p''; what the base must exert is m r'' less the weight, along the lane.

    r(t) = p(t) e(th(t)) is differentiated numerically, so no formula of a rotating frame enters.
    """
    mass, step = 0.7, 1e-4

    def r(t: float) -> np.ndarray:
        p, angle = (start + rate * t + 0.5 * change * t * t for start, rate, change in (motion, tilt))
        return p * lane(angle)

    second = (r(step) - 2.0 * r(0.0) + r(-step)) / step**2
    needed = mass * float((second + np.array([0.0, 0.0, GRAVITY])) @ lane(tilt[0]))
    drive, wire = wired_drive(DI, mass=mass)
    heard(drive, wire, odometry(EPOCH, *motion[:2], facing=facing), imu(EPOCH, *tilt[:2], facing, yaw))
    drive.write(mass * motion[2], EPOCH)
    assert facing * wire.sent[-1] == pytest.approx(needed, abs=2e-6)


def test_forces_stay_within_the_limit_and_are_told_only_while_the_motion_is_known() -> None:
    drive, wire = wired_drive(DI, mass=2.0, limits=Limits(inf, 1.5))
    heard(drive, wire, odometry(EPOCH, 0.0, 0.0), imu(EPOCH, 0.1, 0.0, 1.0))
    for command in (1.5, -1.5, -0.5):
        drive.write(command, EPOCH)
    assert wire.sent == pytest.approx([1.5, 2.0 * 9.81 * sin(0.1) - 1.5, 2.0 * 9.81 * sin(0.1) - 0.5])
    # Zero force is no rest on a tilted plane; a velocity of zero is.
    for kind, told in ((DI, []), (SI, [0.0])):
        drive, wire = wired_drive(kind, gravity="none")
        drive.write(0.0, EPOCH)
        assert wire.sent == told
        heard(drive, wire, odometry(EPOCH, 0.1, 0.0))
        wire.sent.clear()
        drive.write(0.0, EPOCH + 101 * MS)
        assert wire.sent == told


def test_a_double_integrator_is_measured_only_while_its_imu_is_heard() -> None:
    drive, wire = wired_drive(DI)
    assert heard(drive, wire, odometry(EPOCH, 0.1, 0.0)) is None
    assert heard(drive, wire, imu(EPOCH - 5 * MS, 0.1, 0.0, 1.0)) == pytest.approx((EPOCH - 5 * MS, 0.1, 0.0))
    later = EPOCH + 500 * MS
    measured = heard(drive, wire, odometry(later, 0.1, 0.0), now=later)
    assert measured is not None
    assert measured.stamp == EPOCH - 5 * MS  # as old as the oldest thing it depends on
    drive.write(0.3, EPOCH + 90 * MS)
    assert len(wire.sent) == 1
    drive.write(0.3, later)  # a tilt of half a second ago is nothing to push against: now the base brakes by itself
    assert len(wire.sent) == 1
    drive.stop()
    assert wire.sent[-1] == 0.0


@pytest.mark.parametrize("source", ["joint_state", "odometry"])
@pytest.mark.parametrize(("kind", "sent"), [(SI, 0.2 / 0.05), (DI, 0.2 * 0.05)])
@pytest.mark.parametrize("facing", [1.0, -1.0])
def test_a_wheel_by_its_radius(source: str, kind: Kind, sent: float, facing: float) -> None:
    """A wheel of 0.05 m: v = r w, and a torque of r F; the power F v = tau w is the same on both sides."""
    wheel = Joints(EPOCH, ("other", "wheel"), (9.0, 4.0), (9.0, 2.0))
    base = odometry(EPOCH, facing * 0.2, facing * 0.1, facing=facing)
    told, extra = (wheel, {"reversed": facing < 0}) if source == "joint_state" else (base, {})
    joint: dict[str, Value] = {"command": "joint", "joint__name": "wheel", "joint__scale": 0.05, **extra}
    drive, wire = wired_drive(kind, source=source, gravity="none", offset=0.1, **joint)
    assert heard(drive, wire, told) == pytest.approx((EPOCH, 0.1 + facing * 0.2, facing * 0.1))
    drive.write(0.2, EPOCH)
    assert wire.sent == pytest.approx([facing * sent])


def test_a_joint_without_velocity_is_differentiated() -> None:
    drive, wire = wired_drive(DI, source="joint_state", joint__name="cart", gravity="none")
    for time in range(EPOCH, EPOCH + 300 * MS, 5 * MS):
        measured = heard(drive, wire, Joints(time, ("cart",), (0.4e-9 * (time - EPOCH),), ()), now=time)
    assert measured == pytest.approx((EPOCH + 295 * MS, 0.118, 0.4))


NEXT = EPOCH + 10 * MS
REFUSED = {
    "frame": odometry(NEXT, 0.1, 0.0, frame="map"),
    "not finite": odometry(NEXT, 0.1, 0.0)._replace(position=(0.1, inf, 0.0)),
    "order": odometry(EPOCH, 0.1, 0.0),
    "future": odometry(EPOCH + SECOND, 0.1, 0.0),
    "jump": odometry(NEXT, 0.2, 0.0),
    "speed": odometry(NEXT, 0.1, 3.0),
    "heading": odometry(NEXT, 0.1, 0.0, heading=0.6),
    "orientation": odometry(NEXT, 0.1, 0.0)._replace(rotation=(0.0, 0.0, 0.0, 0.0)),
    "joint": Joints(NEXT, ("wheel",), (0.1,), (0.0,)),
}


@pytest.mark.parametrize("reason", REFUSED)
def test_what_cannot_be_vouched_for_is_refused_and_counted(reason: str) -> None:
    drive, wire = wired_drive(SI)
    good = heard(drive, wire, odometry(EPOCH, 0.1, 0.0))
    assert heard(drive, wire, REFUSED[reason], now=EPOCH + 10 * MS) == good
    assert drive.refused.counts == {reason: 1}
    assert drive.refused.last
    after = heard(drive, wire, odometry(EPOCH + 20 * MS, 0.1, 0.0), now=EPOCH + 20 * MS)
    assert after == pytest.approx((EPOCH + 20 * MS, 0.1, 0.0))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"frame": "camera"}, "frame"),
        ({"rotation": None}, "orientation"),
        ({"angular_velocity": None}, "orientation"),
        ({"angular_velocity": (nan, 0.0, 0.0)}, "not finite"),
        ({"angular_velocity": (0.0, -6.0, 0.0)}, "speed"),
    ],
)
def test_an_imu_that_cannot_be_vouched_for(change: dict[str, object], reason: str) -> None:
    drive, wire = wired_drive(DI)
    reading = imu(EPOCH, 0.1, 0.0, 1.0)._replace(**change)  # type: ignore[arg-type]
    assert heard(drive, wire, odometry(EPOCH, 0.1, 0.0), reading) is None
    assert drive.refused.counts == {reason: 1}


@pytest.mark.parametrize(
    ("kind", "settings", "text"),
    [
        (DI, {"command": "twist"}, "a twist is a velocity"),
        (SI, {"source": "joint_state"}, "give the name of the joint"),
        (SI, {"command": "joint"}, "give the name of the joint"),
        (SI, {"source": "joint_state", "joint__name": "a", "joint__scale": 0.0}, "0 is not allowed"),
        (SI, {"reversed": True}, "states which way the body faces"),
        (SI, {"axis": "north"}, r"one of \+x, \+y, \+z"),
        (SI, {"frames": "odom"}, "has no parameter 'frames'"),
    ],
)
def test_settings_that_make_no_sense_are_refused(kind: Kind, settings: dict[str, Value], text: str) -> None:
    with pytest.raises(InputError, match=text):
        wired_drive(kind, **settings)
    with pytest.raises(InputError, match="needs a ROS node"):
        DRIVES.make("topic", {}, Body(1, SI, Schedule(MS), 0.5))


def test_a_body_that_was_turned_round_is_believed_after_a_while_or_when_the_clock_was_set_back() -> None:
    drive, wire = wired_drive(SI)
    heard(drive, wire, odometry(EPOCH, 0.1, 0.0))
    for time in range(10, 510, 10):
        now = EPOCH + time * MS
        measured = heard(drive, wire, odometry(now, 0.1, 0.0, facing=-1.0), now=now)
        drive.write(0.2, now)
        believed = time == 500
        assert measured == pytest.approx((now if believed else EPOCH, 0.1, 0.0))
        assert time > 100 or wire.sent[-1] == 0.2
    assert wire.sent[-1] == -0.2
    assert drive.refused.counts == {"heading": 49}
    assert "turned around 0.490 s after" in drive.refused.last
    drive, wire = wired_drive(SI)
    heard(drive, wire, odometry(EPOCH, 0.1, 0.0))
    earlier = EPOCH - SECOND
    measured = heard(drive, wire, odometry(earlier, 0.1, 0.0, facing=-1.0), now=earlier)
    assert measured == pytest.approx((earlier, 0.1, 0.0))
