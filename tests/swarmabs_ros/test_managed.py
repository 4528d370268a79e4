"""Health as a ROS message."""

from __future__ import annotations

from swarmabs_core.realtime.base import Health, Level
from swarmabs_ros.managed import diagnostic_array


def test_health_becomes_one_status() -> None:
    health = Health(Level.WARN, "keeps still", (("age", "3"), ("refused", "0")))
    array = diagnostic_array("agent_007", health, 12_000_000_034)
    (status,) = array.status
    assert (array.header.stamp.sec, array.header.stamp.nanosec) == (12, 34)
    assert (status.level, status.message) == (status.WARN, "keeps still")
    assert (status.name, status.hardware_id) == ("agent_007: realtime", "agent_007")
    assert [(value.key, value.value) for value in status.values] == list(health.values)
