#!/usr/bin/env python3
"""A simulator of your own in place of `plane_sim`: it moves the plane in lockstep with the other nodes.

It uses rclpy and the messages of the swarm only. In a shell prepared by `eval "$(./scripts/swarm env)"`:
python examples/own_node/own_plane.py --ros-args -p angle:=0.1
"""

from __future__ import annotations

import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from swarmabs_core.elementary import cos
from swarmabs_msgs.msg import AbstractState, PlaneState

REPEAT = 0.1
"""Time, s, after which the last state is published again: the others wait for it if they missed it."""
REPORT = 100
"""Steps between two printed lines."""


class OwnPlane(Node):
    """Solves (J + Js) w' = -cos(angle) torque - Js' w - friction w, one control period per step of the swarm."""

    def __init__(self) -> None:
        super().__init__("own_plane")
        self._period = self._declared("period", 0.01)  # s
        self._inertia = self._declared("inertia", 0.5)  # kg m^2, J
        self._friction = self._declared("friction", 1.0)  # N m s
        self._state = self._declared("angle", 0.1), 0.0  # rad, rad/s
        self._step = 0
        self._publisher = self.create_publisher(PlaneState, "plane/state", 100)
        self.create_subscription(AbstractState, "swarm/abstract_state", self._hear, 100)
        self.create_timer(REPEAT, self._publish)

    def _declared(self, name: str, default: float) -> float:
        return float(self.declare_parameter(name, default).value)

    def _hear(self, swarm: AbstractState) -> None:
        """Move through a period when the swarm's state at its end is known, and publish the state there."""
        if swarm.step == self._step + 1:
            self._advance(swarm)
            self._step += 1
            self._publish()
            if self._step % REPORT == 0:
                print(f"step {self._step}: {self._state[0]:+.6f} rad", flush=True)

    def _advance(self, end: AbstractState) -> None:
        """Perform one step of the classical Runge-Kutta method."""

        def slope(before: float, state: tuple[float, float]) -> tuple[float, float]:
            """Return the derivative of the state at a time before the end of the period, s."""
            angle, rate = state
            torque = end.torque - end.torque_rate * before
            inertia = self._inertia + end.inertia - end.inertia_rate * before
            return rate, (-cos(angle) * torque - (end.inertia_rate + self._friction) * rate) / inertia

        def moved(by: float, along: tuple[float, float]) -> tuple[float, float]:
            return self._state[0] + by * along[0], self._state[1] + by * along[1]

        h = self._period
        k1 = slope(h, self._state)
        k2 = slope(h / 2, moved(h / 2, k1))
        k3 = slope(h / 2, moved(h / 2, k2))
        k4 = slope(0.0, moved(h, k3))
        mean = tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
        self._state = moved(h, (mean[0], mean[1]))

    def _publish(self) -> None:
        plane = PlaneState(step=self._step)
        stamp = round(self._step * self._period * 1e9)
        plane.header.stamp.sec, plane.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        plane.header.frame_id = "plane"
        plane.angle, plane.angular_velocity = self._state
        self._publisher.publish(plane)


def main() -> int:
    """Run the plane until Ctrl-C."""
    rclpy.init()
    node = OwnPlane()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
