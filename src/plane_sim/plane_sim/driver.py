"""Node ``plane_driver``: the plane as an encoder or an IMU on it sees it; on hardware in plane_sim's place."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from swarmabs_config.graph import PLANE_DRIVER
from swarmabs_core.realtime.base import PLANE_PHASE
from swarmabs_core.realtime.plane_driver import PlaneDriver, PlaneDriverConfig
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import run_realtime
from swarmabs_ros.sensors import SensorSubscription

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings

PARAMETERS = (PlaneDriverConfig,)


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:
    """Return the behaviour, the sensor connected."""
    config = settings.made(PlaneDriverConfig)
    topic = config.topic or ("~/imu" if config.source == "imu" else "~/joint_states")
    sensor = SensorSubscription(node, config.source, topic, node.loop_group, arrival=config.stamp == "arrival")
    return RealtimeSpec(PlaneDriver(config, sensor.take), PLANE_PHASE)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_realtime(PLANE_DRIVER, PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
