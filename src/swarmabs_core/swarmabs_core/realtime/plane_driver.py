"""The plane as a sensor on its axis sees it: what takes the simulated plane's place on hardware."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf

from swarmabs_core.declaration import part, same, setting
from swarmabs_core.messages import EventKind, Message, Messages, PlaneState, SwarmEvent
from swarmabs_core.parameters import SettingError
from swarmabs_core.realtime.base import Health, Level, Realtime, Schedule, StepCounter
from swarmabs_core.realtime.readings import (
    AXES,
    STAMPS,
    Imu,
    Joints,
    Reading,
    RefusedReadingError,
    check_finite,
    check_frame,
    joint_values,
    signed_axis,
    wrapped,
)
from swarmabs_core.realtime.refusals import Refusals
from swarmabs_core.realtime.topic_drive import imu_values
from swarmabs_core.realtime.tracking import Plausible, RefusedReadings, Track


@dataclass(frozen=True, slots=True)
class PlaneInstrument:
    """The plane's motion is measured."""

    source: str = setting(
        "joint_state", "what says how the plane is: an encoder or an IMU", choices=("joint_state", "imu")
    )
    topic: str = setting(
        "", "topic of sensor_msgs/JointState or sensor_msgs/Imu; '': ~/joint_states or ~/imu", names="topic"
    )
    stamp: str = setting("header", "time of a reading: its header's, or that of its arrival", choices=STAMPS)
    joint: str = setting("plane_tilt", "joint of the encoder", names="frame")
    scale: float = setting(1.0, "turn of the plane per unit of the encoder, rad, not 0; negative: it counts backwards")
    frame: str = setting("imu_link", "frame_id that the IMU must have; '': any", names="frame")
    axis: str = setting("-y", "axis of the IMU about which the plane's angle is positive", choices=AXES)
    offset: float = setting(0.0, "angle of the plane where the sensor says 0, rad")
    differentiate: bool = setting(
        default=False, description="whether the encoder's velocity is not used even if there is one"
    )
    bandwidth: float = setting(100.0, "bandwidth of differentiation where there is no velocity, rad/s", above=0.0)
    age_limit: float = setting(0.05, "age from which on the sensor counts as silent, s", above=0.0)
    angle_limit: float = setting(1.5, "largest angle that is believed, rad", above=0.0, maximum=1.5)
    max_rate: float = setting(10.0, "largest angular velocity that is believed, rad/s", above=0.0)
    max_jump: float = setting(0.05, "angle beyond it by which two readings may differ, rad", minimum=0.0)

    def __post_init__(self) -> None:
        """Refuse an encoder that measures nothing.

        Raises
        ------
        SettingError
            If the scale is 0.
        """
        if self.scale == 0.0:
            raise SettingError(
                "scale", "a scale of 0 measures nothing", "give rad per unit; negative: it counts backwards"
            )


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
    config : PlaneDriverConfig
        Its configuration.
    take : callable
        Returns what the sensor has said since the last call, in order, without waiting; it is asked once per step.

    Attributes
    ----------
    refused : RefusedReadings
        What was refused.
    """

    def __init__(self, config: PlaneDriverConfig, take: Callable[[], Sequence[Reading]] = tuple) -> None:
        self._config = config
        self._take = take
        self._axis, self._sign = signed_axis(config.axis)
        tolerance = round(config.clock_tolerance * 1e9)
        self._track = Track(Plausible(config.max_rate, config.max_jump, tolerance), config.bandwidth)
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
