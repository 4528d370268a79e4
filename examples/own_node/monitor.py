#!/usr/bin/env python3
"""A node of your own: it monitors a swarm, and requests a stop when the plane tilts too far.

It uses rclpy and the messages of the swarm only. In a shell prepared by `eval "$(./scripts/swarm env RUN)"`:
python examples/own_node/monitor.py --ros-args -p angle_limit:=0.08
"""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import TYPE_CHECKING

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from swarmabs_msgs.msg import AbstractState, PlaneState, SwarmEvent

if TYPE_CHECKING:
    from rclpy.task import Future

STATES = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Suits every publisher: what is lost is replaced by the state of the next step."""
EVENTS = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Also receives the events from before the monitor started."""
PERIOD = 1.0
"""Time between two reports, s."""


class Monitor(Node):
    """Prints angle and torque once a second, and events; requests a stop once beyond `angle_limit` (rad; 0: never)."""

    def __init__(self) -> None:
        super().__init__("monitor")
        self._limit = float(self.declare_parameter("angle_limit", 0.0).value)
        self._plane: PlaneState | None = None
        self._torque = 0.0
        self._asked = False
        self._stop = self.create_client(Trigger, "swarm/stop")
        self.create_subscription(PlaneState, "plane/state", self._hear_plane, STATES)
        self.create_subscription(AbstractState, "swarm/abstract_state", self._hear_swarm, STATES)
        self.create_subscription(SwarmEvent, "swarm/events", self._hear_event, EVENTS)
        self.create_timer(PERIOD, self._report)

    def _hear_plane(self, plane: PlaneState) -> None:
        self._plane = plane
        beyond = self._limit > 0.0 and abs(plane.angle) > self._limit
        if beyond and not self._asked and self._stop.service_is_ready():
            self._asked = True
            print(f"step {plane.step}: {plane.angle:.4f} rad is beyond {self._limit} rad: stop requested", flush=True)
            self._stop.call_async(Trigger.Request()).add_done_callback(self._answered)

    def _hear_swarm(self, swarm: AbstractState) -> None:
        self._torque = swarm.torque

    def _hear_event(self, event: SwarmEvent) -> None:
        print(f"step {event.step}: event {event.kind} of robot {event.agent_id}: {event.detail}", flush=True)

    def _report(self) -> None:
        if self._plane is not None:
            print(f"step {self._plane.step}: {self._plane.angle:+.4f} rad, {self._torque:+.3f} N m", flush=True)

    def _answered(self, answer: Future) -> None:
        result = answer.result()
        print(f"stop {'accepted' if result.success else 'rejected'}: {result.message}", flush=True)


def main() -> int:
    """Run the monitor until Ctrl-C."""
    rclpy.init()
    node = Monitor()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
