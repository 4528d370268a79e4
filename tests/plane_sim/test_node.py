"""The adapters of the simulated plane, and of the driver of a real one."""

from math import exp, inf
from typing import cast

import pytest
from hypothesis import given, strategies as st
from sensor_msgs.msg import Imu, JointState
from tests.agent_node.fake_node import NOW, FakeNode
from tests.swarmabs_ros.bodies import EPOCH, imu
from tests.swarmabs_ros.nodes import realtime_settings_from

from plane_sim import driver, realtime
from plane_sim.driver import PlaneDriver, PlaneDriverConfig
from swarmabs_core.errors import InputError
from swarmabs_core.messages import EventKind, PlaneState, SwarmEvent
from swarmabs_core.parameters import Value
from swarmabs_core.realtime.base import PLANE_PHASE, Level, Schedule
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_ros.managed import RealtimeNode
from swarmabs_ros.readings import Joints, Reading


def test_in_real_time_the_plane_begins_as_the_parameters_say() -> None:
    settings = realtime_settings_from(realtime.PARAMETERS, angle=0.3, period_ns=5_000_000)
    spec = realtime.make(settings, cast("RealtimeNode", FakeNode()))
    assert isinstance(spec.behaviour, RealtimePlane)
    assert spec.phase == PLANE_PHASE
    assert [(m.step, m.angle) for m in spec.behaviour.tick(7_500_000) if isinstance(m, PlaneState)] == [(1, 0.3)]


@pytest.mark.parametrize(
    ("values", "topic"),
    [
        ({}, "~/joint_states"),
        ({"topic": "/axis"}, "/axis"),
        ({"source": "imu"}, "~/imu"),
        ({"stamp": "header"}, "~/joint_states"),
    ],
)
def test_a_driver_hears_its_sensor(values: dict[str, Value], topic: str) -> None:
    fake = FakeNode()
    settings = realtime_settings_from(driver.PARAMETERS, **{"stamp": "arrival", **values})
    spec = driver.make(settings, cast("RealtimeNode", fake))
    assert (spec.phase, fake.sensors) == (PLANE_PHASE, {topic: []})
    message = Imu() if "source" in values else JointState(name=["plane_tilt"], position=[0.0], velocity=[0.0])
    message.header.frame_id = "imu_link"
    message.header.stamp.sec = NOW // 1_000_000_000 - 1
    fake.sensors[topic].append(message)
    # A reading whose header is a second old is too old, unless its arrival counts.
    said = [m.angle for m in spec.behaviour.tick(NOW) if isinstance(m, PlaneState)]
    assert said == ([] if values.get("stamp") == "header" else [0.0])


MS = 1_000_000
SCHEDULE = Schedule(10 * MS, EPOCH)
ENCODER = PlaneDriverConfig(schedule=SCHEDULE)
IMU = PlaneDriverConfig(schedule=SCHEDULE, source="imu")


def at(step: int) -> int:
    return SCHEDULE.begin(step, 0.5)


def encoder(stamp: int, position: float, *velocity: float, joint: str = "plane_tilt") -> Joints:
    return Joints(stamp, ("motor", joint), (7.0, position), (7.0, *velocity) if velocity else ())


def test_an_encoder_behind_a_gear_that_counts_backwards_and_one_that_measures_nothing() -> None:
    driver = PlaneDriver(PlaneDriverConfig(schedule=SCHEDULE, scale=-0.1, offset=0.3))
    driver.measure([encoder(at(4) - MS, 2.0, 0.5)], at(4))
    assert driver.tick(at(4)) == (PlaneState(at(4), 4, pytest.approx(0.1), pytest.approx(-0.05)),)
    with pytest.raises(InputError, match="scale: 0 is not allowed"):
        PlaneDriver(PlaneDriverConfig(schedule=SCHEDULE, scale=0.0))


@given(angle=st.floats(-1.2, 1.2), rate=st.floats(-5.0, 5.0), yaw=st.floats(-3.0, 3.0), offset=st.floats(-0.2, 0.2))
def test_an_imu_that_is_turned_on_the_plane_s_axis(angle: float, rate: float, yaw: float, offset: float) -> None:
    """Its x axis along growing positions, the axis is -y; against them, +y."""
    for facing, axis in ((1.0, "-y"), (-1.0, "+y")):
        driver = PlaneDriver(PlaneDriverConfig(schedule=SCHEDULE, source="imu", axis=axis, offset=offset))
        driver.measure([imu(at(0), angle, rate, facing, yaw)], at(0))
        assert driver.tick(at(0)) == (
            PlaneState(at(0), 0, pytest.approx(angle + offset, abs=1e-9), pytest.approx(rate, abs=1e-9)),
        )


@pytest.mark.parametrize("velocity", [(), (99.0,)])
def test_an_encoder_s_velocity_is_derived_where_it_has_none_or_shall_not_be_used(velocity: tuple[float, ...]) -> None:
    """A ramp of 0.2 rad/s through a low-pass of 100 rad/s, from rest: 0.2 (1 - exp(-100 t))."""
    driver = PlaneDriver(PlaneDriverConfig(schedule=SCHEDULE, differentiate=bool(velocity)))
    for time in range(0, 100, 5):
        driver.measure([encoder(EPOCH + time * MS, 0.2e-3 * time, *velocity)], EPOCH + time * MS)
    (state,) = driver.tick(at(9))
    assert isinstance(state, PlaneState)
    assert (state.angle, state.angular_velocity) == pytest.approx((0.019, 0.2 * (1.0 - exp(-9.5))))


def test_it_takes_what_has_arrived_once_per_step_and_begins_anew_when_the_clock_was_set_back_far() -> None:
    arrived: list[Reading] = [encoder(at(0), 0.1, 0.0)]
    driver = PlaneDriver(ENCODER, lambda: [arrived.pop(0) for _ in list(arrived)])
    assert driver.tick(at(0)) == (PlaneState(at(0), 0, 0.1, 0.0),)
    assert driver.tick(at(0) + MS) == ()
    assert driver.tick(at(-1)) == ()
    arrived += [encoder(at(1) - 2 * MS, 0.101, 0.0), encoder(at(1) - MS, 0.102, 0.0)]
    assert driver.tick(at(1)) == (PlaneState(at(1), 1, 0.102, 0.0),)
    assert driver.hear(PlaneState(at(1), 1, 9.0, 9.0), at(1)) == ()
    driver = PlaneDriver(ENCODER)
    published = []
    for step in (1000, 999, 998, 1001, 500, 501, 502):
        driver.measure([encoder(at(step), 0.1, 0.0)], at(step))
        published += [message.step for message in driver.tick(at(step)) if isinstance(message, PlaneState)]
    assert published == [1000, 1001, 501, 502]


def test_a_silent_sensor_or_one_of_another_frame_silences_the_plane_and_that_is_said_once() -> None:
    """The limit of 50 ms: the reading is good for five steps, then nothing is published until another comes."""
    driver = PlaneDriver(ENCODER)
    driver.measure([encoder(at(0), 0.1, 0.0)], at(0))
    told = [driver.tick(at(step)) for step in range(9)]
    assert [len(messages) for messages in told] == [1, 1, 1, 1, 1, 1, 1, 0, 0]
    assert all(isinstance(messages[0], PlaneState) for messages in told[:6])
    assert [lost[1:5] for lost in told[6]] == [(6, 0, EventKind.STALLED, pytest.approx(0.06))]
    assert driver.health(at(8)).level == Level.ERROR
    driver.measure([encoder(at(9), 0.1, 0.0)], at(9))
    back, state = driver.tick(at(9))
    assert (back[3], state) == (EventKind.RECOVERED, PlaneState(at(9), 9, 0.1, 0.0))
    assert len(driver.tick(at(10))) == 1
    assert driver.health(at(10)).level == Level.OK
    driver = PlaneDriver(IMU)
    driver.measure([encoder(at(0), 0.1, 0.0), imu(at(0), 0.1, 0.0, 1.0, frame="camera")], at(0))
    assert driver.refused.counts == {"source": 1, "frame": 1}
    (event,) = driver.tick(at(0))
    assert isinstance(event, SwarmEvent)
    assert (event.kind, event.value) == (EventKind.STALLED, 1e9)
    assert "has not been heard; last refusal: frame 'camera', not 'imu_link'" in event.detail
    assert "not been heard" in driver.health(at(0)).text
    driver.halt()
    assert driver.tick(at(1)) == ()


REFUSED = {
    "joint": encoder(at(1), 0.1, 0.0, joint="elbow"),
    "not finite": encoder(at(1), inf, 0.0),
    "angle": encoder(at(1), 1.6, 0.0),
    "jump": encoder(at(1), 0.9, 0.0),
    "speed": encoder(at(1), 0.1, 11.0),
    "order": encoder(at(0), 0.1, 0.0),
    "future": encoder(at(1) + 21 * MS, 0.1, 0.0),
    "source": imu(at(1), 0.1, 0.0, 1.0),
}


@pytest.mark.parametrize("reason", REFUSED)
def test_what_cannot_be_vouched_for_is_not_published(reason: str) -> None:
    driver = PlaneDriver(ENCODER)
    driver.measure([encoder(at(0), 0.1, 0.0)], at(0))
    (event,) = driver.measure([REFUSED[reason]], at(1))
    assert isinstance(event, SwarmEvent)
    assert (event.kind, event.step) == (EventKind.REFUSED, 1)
    assert reason in event.detail
    assert driver.measure([REFUSED[reason]], at(1)) == ()  # told once, counted always
    assert driver.tick(at(1)) == (PlaneState(at(1), 1, 0.1, 0.0),)
    assert driver.refused.counts == {reason: 2}
    assert (f"readings refused, {reason}", "2") in driver.health(at(1)).values
