"""Publish what a board on the plane's axis measures, as plane_driver expects of an encoder.

python examples/build_one/plane_encoder.py --ros-args -p device:=/dev/ttyACM0
"""

from __future__ import annotations

import sys
import time
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from swarmabs_serial_base import UNPLACED, SerialBase

from swarmabs_core.errors import InputError, RunError

PERIOD = 0.005  # s


class PlaneEncoder(Node):
    """Asks the board, and publishes its newest answer; when the board is gone, the exception ends the node."""

    def __init__(self) -> None:
        super().__init__("plane_encoder")
        device = self.declare_parameter("device", "/dev/ttyACM0").value
        baud = self.declare_parameter("baud", "230400").value
        self._board = SerialBase(str(device), str(baud))
        self._publisher = self.create_publisher(JointState, "plane_driver/joint_states", qos_profile_sensor_data)
        self._last = 0
        self.create_timer(PERIOD, self._tick)

    def _tick(self) -> None:
        now = time.time_ns()
        self._board.command(0, now)  # the number of this command dates the answers
        for answer in self._board.received():
            stamp = answer.stamp(now)
            if answer.state == UNPLACED or stamp <= self._last:
                continue
            self._last = stamp
            message = JointState(
                name=["plane_tilt"], position=[answer.position / 1e6], velocity=[answer.velocity / 1e6]
            )
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
            self._publisher.publish(message)


def main() -> int:
    """Run until Ctrl-C, or until the board is gone; return the exit code."""
    rclpy.init()
    try:
        with suppress(KeyboardInterrupt, ExternalShutdownException):
            rclpy.spin(PlaneEncoder())
    except (InputError, RunError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 2 if isinstance(error, InputError) else 1
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
