"""Health as ROS says it: one ``diagnostic_msgs/DiagnosticStatus`` per node, in an array as the tools expect it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

if TYPE_CHECKING:
    from swarmabs_core.realtime.base import Health

PERIOD = 1.0
"""Time between two, s."""


def diagnostic_array(node: str, health: Health, now: int) -> DiagnosticArray:
    """Return the message of a node.

    Parameters
    ----------
    node : str
        Its name, which is also the hardware's: a robot is its node.
    health : Health
        How it is.
    now : int
        ns since 1970.
    """
    status = DiagnosticStatus(
        level=bytes([health.level]),
        name=f"{node}: realtime",
        message=health.text,
        hardware_id=node,
        values=[KeyValue(key=name, value=text) for name, text in health.values],
    )
    array = DiagnosticArray(status=[status])
    array.header.stamp.sec, array.header.stamp.nanosec = divmod(now, 10**9)
    return array
