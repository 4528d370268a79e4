"""Node ``plane_driver``: the plane as an encoder or an IMU on it sees it; on hardware in plane_sim's place."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING

from swarmabs_config.graph import PLANE_DRIVER
from swarmabs_core.declaration import part, same
from swarmabs_core.messages import EventKind, Message, Messages, PlaneState, SwarmEvent
from swarmabs_core.realtime.base import PLANE_PHASE, Health, Level, Realtime, Schedule, StepCounter
from swarmabs_core.realtime.instruments import PlaneInstrument
from swarmabs_core.realtime.validation import Refusals
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.readings import (
    Imu,
    Joints,
    Reading,
    RefusedReadingError,
    RefusedReadings,
    Track,
    check_finite,
    check_frame,
    imu_values,
    joint_values,
    signed_axis,
    wrapped,
)
from swarmabs_ros.realtime_runner import run_realtime
from swarmabs_ros.sensors import SensorSubscription

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings


@dataclass(frozen=True, slots=True)
class PlaneDriverConfig(PlaneInstrument):
    """Configuration of the plane's driver."""

    schedule: Schedule = part(Schedule, name="")
    clock_tolerance: float = same(Realtime, "clock_tolerance")


class PlaneDriver:
    """Turns a sensor's readings into the plane's state, one per step.

    While the newest good reading is older than the limit, or there has been none, it publishes nothing; then the parent
    controller asks for nothing, and the robots stop.

    Parameters
    ----------
    take : callable
        Returns what the sensor has said since the last call, in order, without waiting; it is asked once per step.
    """

    def __init__(self, config: PlaneDriverConfig, take: Callable[[], Sequence[Reading]] = tuple) -> None:
        self._config = config
        self._take = take
        self._axis, self._sign = signed_axis(config.axis)
        self._track = Track(config.max_rate, config.max_jump, config.clock_tolerance, config.bandwidth)
        self._age_limit = round(config.age_limit * 1e9)
        self._counter = StepCounter(config.schedule)
        self._silent: bool | None = None
        self._refusals = Refusals()
        self.refused = RefusedReadings()

    def measure(self, readings: Iterable[Reading], now: int) -> Messages:
        """Take over what the sensor has said, in order; answer what is to be told of refusals."""
        told: Messages = ()
        for reading in readings:
            try:
                self._measure(reading, now)
            except RefusedReadingError as error:
                self.refused.add(error)
                reason = f"reading of the plane's sensor: {error.reason}"
                told += self._refusals.add(reason, self._config.schedule.step(now), now)
        return told

    def hear(self, message: Message, now: int) -> Messages:  # noqa: ARG002 - as all nodes
        """Hear nothing: the plane needs no message of the swarm."""
        return ()

    def tick(self, now: int) -> Messages:
        """Publish the plane's state, if it is known; say when the sensor falls silent and when it is back."""
        return (*self.measure(self._take(), now), *self._state(now))

    def _state(self, now: int) -> Messages:
        step = self._counter.next(now)
        if step is None:
            return ()
        sample = self._track.newest
        age = inf if sample is None else (now - sample.stamp) / 1e9
        if sample is None or now - sample.stamp > self._age_limit:
            return self._fall_silent(step, now, age)
        state = PlaneState(now, step, sample.value, sample.rate)
        if self._silent:
            self._silent = False
            return (SwarmEvent(now, step, 0, EventKind.RECOVERED, age, "the plane's sensor is heard"), state)
        self._silent = False
        return (state,)

    def halt(self) -> None:
        """Do nothing: a sensor moves nothing."""

    def health(self, now: int) -> Health:
        """Return whether the sensor is heard, and what was refused."""
        sample = self._track.newest
        values = self.refused.values()
        if sample is None:
            return Health(Level.ERROR, "the plane's sensor has not been heard", values)
        age = (now - sample.stamp) / 1e9
        values = (("age of the reading, s", f"{age:.3f}"), ("angle, rad", f"{sample.value:.6f}"), *values)
        if now - sample.stamp > self._age_limit:
            return Health(Level.ERROR, "the plane's sensor is silent", values)
        return Health(Level.OK, "the plane's sensor is heard", values)

    def _fall_silent(self, step: int, now: int, age: float) -> Messages:
        if self._silent:
            return ()
        self._silent = True
        detail = "the plane's sensor is silent" if age < inf else "the plane's sensor has not been heard"
        if self.refused.last:
            detail += f"; last refusal: {self.refused.last}"
        return (SwarmEvent(now, step, 0, EventKind.STALLED, min(age, 1e9), detail),)

    def _measure(self, reading: Reading, now: int) -> None:
        config = self._config
        rate: float | None
        if isinstance(reading, Imu) and config.source == "imu":
            check_frame(reading.frame, config.frame)
            angle, rate = imu_values(reading, self._axis, self._sign)
            angle = wrapped(config.offset + angle)
        elif isinstance(reading, Joints) and config.source == "joint_state":
            position, velocity = joint_values(reading, config.joint)
            angle = config.offset + config.scale * position
            rate = None if velocity is None or config.differentiate else config.scale * velocity
        else:
            raise RefusedReadingError("source", f"a reading of type {type(reading).__name__}")
        check_finite(angle)
        if abs(angle) > config.angle_limit:
            raise RefusedReadingError("angle", f"{angle:.4g} rad, at most {config.angle_limit:g} is believed")
        self._track.offer(reading.stamp, angle, rate, now)


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
