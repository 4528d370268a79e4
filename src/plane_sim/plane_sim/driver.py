"""Node ``plane_driver``: the plane measured by an encoder or an IMU; on hardware it replaces plane_sim."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING

from swarmabs_config.graph import PLANE_DRIVER
from swarmabs_core.declaration import part, same
from swarmabs_core.events import EventCode
from swarmabs_core.messages import PARENT, Message, Messages, PlaneState
from swarmabs_core.realtime.base import PLANE_PHASE, UNKNOWN, Health, Level, Realtime, Schedule, Sender, StepCounter
from swarmabs_core.realtime.instruments import MEASURED, PlaneInstrument
from swarmabs_core.realtime.seals import SealFiles, sealed_plane
from swarmabs_core.realtime.validation import Problem, Refusals
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
from swarmabs_ros.realtime_runner import RealtimeProgram
from swarmabs_ros.sealed import seals_in
from swarmabs_ros.sensors import SensorSubscription

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings


@dataclass(frozen=True, slots=True)
class PlaneDriverConfig(PlaneInstrument):
    """Configuration of the plane driver."""

    schedule: Schedule = part(Schedule, name="")
    clock_tolerance: float = same(Realtime, "clock_tolerance")


class PlaneDriver:
    """Converts a sensor's readings to one state of the plane per step.

    If there is no valid reading, or the newest one is older than the limit, it publishes nothing; the parent controller
    then publishes nothing either, and the robots stop.

    Parameters
    ----------
    take : callable
        Returns the readings since the last call, in order, without waiting; it is called once per step.
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
        """Process readings in order; return events for rejected ones."""
        told: Messages = ()
        for reading in readings:
            try:
                self._measure(reading, now)
            except RefusedReadingError as error:
                self.refused.add(error)
                problem = Problem(error.reason).of("reading of the plane's sensor")
                told += self._refusals.add(problem, self._config.schedule.step(now), now)
        return told

    def hear(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Messages:  # noqa: ARG002 - the interface of behaviours
        """Ignore all messages: the plane needs none of the swarm."""
        return ()

    def tick(self, now: int) -> Messages:
        """Return the plane's state, if it is known, and events when the sensor falls silent or returns."""
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
            return (EventCode.SENSOR_HEARD.event(now, step, age), state)
        self._silent = False
        return (state,)

    def halt(self) -> None:
        """Do nothing: a sensor needs no safe state."""

    def health(self, now: int) -> Health:
        """Return whether the sensor reports, and counts of rejected readings."""
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
        problem = "is silent" if age < inf else "has not been heard"
        if self.refused.last:
            problem += f"; last refusal: {self.refused.last}"
        return (EventCode.NO_SENSOR.event(now, step, min(age, 1e9), problem=problem),)

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
            raise RefusedReadingError("angle", f"{angle:.4g} rad, at most {config.angle_limit:g} is plausible")
        self._track.offer(reading.stamp, angle, rate, now)


PARAMETERS = (PlaneDriverConfig, SealFiles)


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:
    """Return the behaviour, with its sensor connected."""
    config = settings.declared(PlaneDriverConfig)
    topic = config.topic or MEASURED[config.source]
    sensor = SensorSubscription(node, config.source, topic, node.loop_group, arrival=config.stamp == "arrival")
    seals = seals_in(settings.declared(SealFiles), PARENT)
    return RealtimeSpec(sealed_plane(PlaneDriver(config, sensor.take), seals, config.schedule), PLANE_PHASE)


main = RealtimeProgram(PLANE_DRIVER, PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())
