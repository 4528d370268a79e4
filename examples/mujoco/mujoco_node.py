"""Node ``mujoco_rig``: the world of MuJoCo stepped by the clock, as the hardware of a plane and its robots.

Commands and measurements are the topics of docs/how-to/drives.md. The node needs no message of the swarm, and no node
of the swarm knows that its hardware is simulated.
"""

from __future__ import annotations

import csv
import signal
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from math import cos, sin
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Quaternion, TwistStamped, Vector3
from mujoco_setup import BASES, FAULTS, GRIPPING, Setup, rig_of
from nav_msgs.msg import Odometry
from pacing import Pacing
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64

from swarmabs_config.graph import DIAGNOSTICS, PLANE_DRIVER
from swarmabs_config.scenario import on_plane
from swarmabs_core.declaration import same, setting
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime.base import Health, Level, Schedule
from swarmabs_ros.managed import DIAGNOSTICS_PERIOD, diagnostic_array
from swarmabs_ros.runner import Settings, declared_settings
from swarmabs_ros.scenario_file import ScenarioFile
from swarmabs_ros.settings import RealtimeSettings
from swarmabs_ros.start import SwarmNode, run_program

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from typing import TextIO

    from mujoco_rig import MujocoRig, Reading, Readings
    from mujoco_world import Base, Robot
    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.subscription import Subscription

    from swarmabs_config.scenario import PlaneScenario
    from swarmabs_ros.status import StatusChannel

RIG = "mujoco_rig"
TILT = "plane_tilt"
"""Joint of the plane's encoder."""
TICK = 0.002
"""Time between two looks at the commands, s."""
BEFORE = 0.1
"""Part of a period by which the sensors are read before the robots begin their next step."""
SLOW = 0.98
"""Real-time factor below which the rig warns."""

Command: TypeAlias = TwistStamped | Float64
Measurement: TypeAlias = JointState | Imu | Odometry


@dataclass(frozen=True, slots=True)
class RigSettings(ScenarioFile):
    """Settings of the rig: how its world differs from the scenario."""

    base: str = setting("rover", "base of all robots", choices=BASES)
    height: float | None = setting(
        None,
        "height of the robots' centres of mass; -1: that of the scenario, 3 cm where it is 0",
        unit="m",
        minimum=-1.0,
        unset=-1.0,
    )
    mass_error: float = setting(
        Setup.mass_error, "largest relative error of the masses that robots know", minimum=0.0, below=1.0
    )
    tilt_offset: float = setting(Setup.tilt_offset, "largest offset of the plane's encoder", unit="rad", minimum=0.0)
    delay: float = setting(
        FAULTS.delay,
        "age of measurements and commands when they take effect, besides that of DDS",
        unit="s",
        minimum=0.0,
    )
    grip: float = setting(GRIPPING.grip, "coefficient of sliding friction of the wheels", above=0.0)
    sim_speed_factor: float = setting(
        1.0, "time of the world by time of the clock that is aimed at", above=0.0, maximum=1.0
    )
    seed: int = setting(1, "seed of the errors and of the noise", minimum=0)
    truth: str = setting("", "file for the true states; empty: none")

    @property
    def setup(self) -> Setup:
        """How the rig differs from the scenario."""
        base: Base = "rover" if self.base == "rover" else "differential"
        faults, physics = replace(FAULTS, delay=self.delay), replace(GRIPPING, grip=self.grip)
        return Setup(base, self.height, self.mass_error, self.tilt_offset, faults, physics)


@dataclass(frozen=True, slots=True)
class RigClock:
    """When the world begins."""

    epoch_ns: int = same(Schedule, "epoch_ns")
    await_epoch: bool = same(RealtimeSettings, "await_epoch")


PARAMETERS = (RigSettings, RigClock)


class Sensor:
    """A publisher of measurements, which are made only while somebody listens."""

    def __init__(
        self, node: Node, kind: type[Measurement], topic: str, measure: Callable[[Readings], Measurement]
    ) -> None:
        self._publisher: Publisher = node.create_publisher(kind, topic, qos_profile_sensor_data)
        self._measure = measure

    def publish(self, readings: Readings, stamp: int) -> None:
        """Publish what was measured at a time, ns since 1970."""
        if self._publisher.get_subscription_count():
            message = self._measure(readings)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
            self._publisher.publish(message)


class Commands:
    """The commands for a robot's base: forward velocities, m/s, or forces, N."""

    def __init__(self, node: Node, robot: Robot) -> None:
        self._type: type[Command] = Float64 if robot.forced else TwistStamped
        topic = f"{agent_name(robot.id)}/{'force' if robot.forced else 'cmd_vel'}"
        self._subscription: Subscription = node.create_subscription(self._type, topic, lambda _: None, 10)

    def take(self) -> Iterable[float]:
        """Yield the commands that have arrived, in order, without waiting."""
        while (taken := self._subscription.handle.take_message(self._type, False)) is not None:
            message: Command = taken[0]
            yield message.data if isinstance(message, Float64) else message.twist.linear.x


class Truth:
    """The file of true states: a row for each time at which the sensors are read."""

    def __init__(self, stream: TextIO, rig: MujocoRig) -> None:
        self._stream, self._rig = stream, rig
        self._writer = csv.writer(stream)
        self._writer.writerow(
            ["stamp", "time", "factor", "held", "angle", *(f"position_{robot}" for robot in rig.robots)]
        )

    def write(self, stamp: int, factor: float) -> None:
        """Write the present state; `stamp` in ns since 1970."""
        rig = self._rig
        values = (rig.time, factor, float(rig.held), rig.angle, *map(rig.place, rig.robots))
        self._writer.writerow([stamp, *(f"{value:.6f}" for value in values)])
        self._stream.flush()


class RigProcess:
    """Steps the world by the clock, and connects it to the topics of the swarm.

    Parameters
    ----------
    node : Node
        The node of the rig.
    rig : MujocoRig
        The world.
    period : float
        Time of the clock between two measurements, s.
    speed : float
        Time of the world by time of the clock that is aimed at.
    truth : Truth, optional
        File for the true states.
    """

    def __init__(self, node: Node, rig: MujocoRig, period: float, speed: float, truth: Truth | None) -> None:
        self._rig, self._period, self._speed, self._truth = rig, period, speed, truth
        self._log = node.get_logger()
        self._commands = {robot: Commands(node, body) for robot, body in rig.robots.items()}
        self._sensors = [
            Sensor(node, JointState, f"{PLANE_DRIVER}/joint_states", encoder),
            Sensor(node, Imu, f"{PLANE_DRIVER}/imu", lambda r: imu(r, 1.0)),
        ]
        for robot in rig.robots.values():
            self._connect(node, robot, agent_name(robot.id))
        self._diagnostics = node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self._name = node.get_name()
        self._stamps: dict[float, int] = {}
        self._diagnosed, self._slow = 0.0, False
        self._slowest = 1.0
        self._stopped = False

    def _connect(self, node: Node, robot: Robot, name: str) -> None:
        joints = self._rig.joints[robot.id]
        self._sensors += [
            Sensor(node, Odometry, f"{name}/odom", lambda r: odometry(r.robots[robot.id], robot)),
            Sensor(node, JointState, f"{name}/joint_states", lambda r: wheels(r.robots[robot.id], joints)),
            Sensor(node, Imu, f"{name}/imu", lambda r: imu(r, robot.facing)),
        ]

    def stop(self, *_: object) -> None:
        """End the loop because of a signal."""
        self._stopped = True

    def run(self, epoch_ns: int) -> None:
        """Run until stopped; the sensors are read shortly before each step that counts from the epoch, ns."""
        period, now = round(self._period * 1e9), time.time_ns()
        first = epoch_ns - (epoch_ns - now) // period * period
        pacing = Pacing(first - round(BEFORE * period), speed=self._speed)
        ticks = max(1, round(self._period / TICK))
        tick = 0
        while not self._stopped:
            tick += 1
            due = tick * self._period * self._speed / ticks
            time.sleep(max(0.0, (pacing.due(due) - time.time_ns()) / 1e9))
            for robot, commands in self._commands.items():
                for command in commands.take():
                    self._rig.drive(robot, command)
            self._rig.advance(due)
            now = time.time_ns()
            pacing.reached(due, now)
            if tick % ticks == 0:
                self._measure(now)
                self._report(pacing.factor, now)

    def _measure(self, now: int) -> None:
        """Publish the measurements that have arrived from the sensors, with the times at which they were made."""
        self._stamps[self._rig.time] = now
        readings = self._rig.read()
        self._stamps = {time: stamp for time, stamp in self._stamps.items() if time >= readings.time}
        for sensor in self._sensors:
            sensor.publish(readings, self._stamps[readings.time])

    def _report(self, factor: float, now: int) -> None:
        if self._truth is not None:
            self._truth.write(now, factor)
        if self._rig.time - self._diagnosed < DIAGNOSTICS_PERIOD:
            return
        self._diagnosed = self._rig.time
        self._slowest = min(self._slowest, factor)
        slow = factor < SLOW * self._speed
        text = f"the world runs at {factor:.2f} of real time"
        if slow:
            self._log.warning(f"{text}: this machine is too slow for it")
        elif self._slow:
            self._log.info(text)
        self._slow = slow
        values = (
            ("real-time factor", f"{factor:.3f}"),
            ("slowest real-time factor", f"{self._slowest:.3f}"),
            ("time of the world, s", f"{self._rig.time:.3f}"),
            ("held", str(self._rig.held).lower()),
        )
        health = Health(Level.WARN if slow else Level.OK, text, values)
        self._diagnostics.publish(diagnostic_array(self._name, health, now))


def encoder(readings: Readings) -> JointState:
    """Return what the encoder on the plane's axis measures."""
    return JointState(name=[TILT], position=[readings.encoder], velocity=[readings.tilt[1]])


def odometry(reading: Reading, robot: Robot) -> Odometry:
    """Return the odometry of a robot, which begins with 0 where it was put down."""
    message = Odometry()
    message.header.frame_id, message.child_frame_id = "odom", "base_link"
    message.pose.pose.position.x = robot.facing * (reading.position - robot.position)
    message.twist.twist.linear.x = robot.facing * reading.velocity
    return message


def wheels(reading: Reading, joints: tuple[str, ...]) -> JointState:
    """Return what the encoders of a robot's wheels measure."""
    angles, speeds = zip(*reading.wheels, strict=True)
    return JointState(name=list(joints), position=list(angles), velocity=list(speeds))


def imu(readings: Readings, facing: float) -> Imu:
    """Return what an IMU on the plane measures whose body faces along the lanes (1) or against them (-1)."""
    angle, rate = readings.tilt
    s, c = sin(angle / 2.0), cos(angle / 2.0)
    message = Imu()
    message.header.frame_id = "imu_link"
    if facing > 0.0:
        message.orientation = Quaternion(x=0.0, y=-s, z=0.0, w=c)
    else:  # turned by pi about the vertical, then pitched
        message.orientation = Quaternion(x=-s, y=0.0, z=c, w=0.0)
    message.angular_velocity = Vector3(x=0.0, y=-facing * rate, z=0.0)
    message.linear_acceleration_covariance[0] = -1.0  # not measured
    return message


def _serve(node: Node, settings: Settings, status: StatusChannel) -> None:
    own, clock = settings.declared(RigSettings), settings.declared(RigClock)
    scenario: PlaneScenario = on_plane(own.load(), "the rig").resolved()
    rig = rig_of(scenario, own.setup, own.seed)
    with ExitStack() as stack:
        truth = None
        if own.truth:
            truth = Truth(stack.enter_context(Path(own.truth).open("w", newline="", encoding="utf-8")), rig)
        process = RigProcess(node, rig, scenario.period, own.sim_speed_factor, truth)
        epoch = clock.epoch_ns
        if clock.await_epoch:
            status.send("ready")
            epoch = status.wait_for_epoch()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, process.stop)
        process.run(epoch)


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""

    def body(node: SwarmNode, status: StatusChannel) -> None:
        _serve(node, declared_settings(node, PARAMETERS), status)

    return run_program(RIG, SwarmNode, body, args)


if __name__ == "__main__":
    sys.exit(main())
