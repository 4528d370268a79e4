"""Node ``plane_driver``: the plane as an encoder or an IMU on it sees it; on hardware in plane_sim's place."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Literal, cast

from swarmabs_config.graph import PLANE_DRIVER
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.base import PLANE_PHASE
from swarmabs_core.realtime.plane_driver import PlaneDriver, PlaneDriverConfig
from swarmabs_core.realtime.readings import AXES
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import run_realtime, schedule_of
from swarmabs_ros.sensors import SensorSubscription

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings

SOURCES = ("joint_state", "imu")
PARAMETERS = (
    Parameter("source", "joint_state", "what says how the plane is: an encoder or an IMU", choices=SOURCES),
    Parameter("topic", "", "topic of sensor_msgs/JointState or sensor_msgs/Imu; '': ~/joint_states or ~/imu"),
    Parameter(
        "stamp", "header", "time of a reading: its header's, or that of its arrival", choices=("header", "arrival")
    ),
    Parameter("joint", "plane_tilt", "joint of the encoder"),
    Parameter("scale", 1.0, "turn of the plane per unit of the encoder, rad, not 0; negative: it counts backwards"),
    Parameter("frame", "imu_link", "frame_id that the IMU must have; '': any"),
    Parameter("axis", "-y", "axis of the IMU about which the plane's angle is positive", choices=AXES),
    Parameter("offset", 0.0, "angle of the plane where the sensor says 0, rad"),
    Parameter(
        "differentiate", default=False, description="whether the encoder's velocity is not used even if there is one"
    ),
    Parameter("bandwidth", 100.0, "bandwidth of differentiation where there is no velocity, rad/s", above=0.0),
    Parameter("age_limit", 0.05, "age from which on the sensor counts as silent, s", above=0.0),
    Parameter("angle_limit", 1.5, "largest angle that is believed, rad", above=0.0, maximum=1.5),
    Parameter("max_rate", 10.0, "largest angular velocity that is believed, rad/s", above=0.0),
    Parameter("max_jump", 0.05, "angle beyond it by which two readings may differ, rad", minimum=0.0),
)


def config(settings: Settings) -> PlaneDriverConfig:
    """Return the behaviour's configuration."""
    return PlaneDriverConfig(
        schedule=schedule_of(settings),
        source=cast("Literal['joint_state', 'imu']", settings.text("source")),
        joint=settings.text("joint"),
        scale=settings.number("scale"),
        frame=settings.text("frame"),
        axis=settings.text("axis"),
        offset=settings.number("offset"),
        differentiate=settings.flag("differentiate"),
        bandwidth=settings.number("bandwidth"),
        age_limit=settings.number("age_limit"),
        clock_tolerance=settings.number("clock_tolerance"),
        angle_limit=settings.number("angle_limit"),
        max_rate=settings.number("max_rate"),
        max_jump=settings.number("max_jump"),
    )


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:
    """Return the behaviour, the sensor connected."""
    driver = config(settings)
    topic = settings.text("topic") or ("~/imu" if driver.source == "imu" else "~/joint_states")
    arrival = settings.text("stamp") == "arrival"
    sensor = SensorSubscription(node, driver.source, topic, node.loop_group, arrival=arrival)
    return RealtimeSpec(PlaneDriver(driver, sensor.take), PLANE_PHASE)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_realtime(PLANE_DRIVER, PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
