"""The nodes of a swarm in real time, driving the robots of a rig; time is that of the rig, so nothing waits."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import sin
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_config import configure, realtime
from swarmabs_config.graph import CONTROLLER, OBSERVER, REALTIME, ROBOT, endpoints
from swarmabs_core.messages import TOPIC_OF, Message, PlaneState
from swarmabs_core.realtime.agent import RealtimeAgent
from swarmabs_core.realtime.base import RealtimeBehaviour
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_core.realtime.drives import Measurement
from swarmabs_core.realtime.observer import RealtimeObserver

if TYPE_CHECKING:
    from mujoco_rig import MujocoRig, Readings

    from swarmabs_config.scenario import PlaneScenario

EPOCH = 1_700_000_000_000_000_000
"""Time of the swarm's clock at which a trial begins, ns since 1970."""


class State(NamedTuple):
    """What a trial records in each period: time (s), true angle (rad) and angular velocity (rad/s), places (m)."""

    time: float
    angle: float
    rate: float
    places: tuple[float, ...]


class RigDrive:
    """The drive of a robot of the rig; of one that is driven by force it bears the weight along the plank."""

    def __init__(self, rig: MujocoRig, robot: int, newest: Callable[[], tuple[int, Readings]]) -> None:
        self._rig = rig
        self._robot = rig.robots[robot]
        self._newest = newest

    def read(self, now: int) -> Measurement:  # noqa: ARG002 - all measure at once
        """Return the newest measurement that has arrived, with the time at which it was taken."""
        stamp, readings = self._newest()
        reading = readings.robots[self._robot.id]
        return Measurement(stamp, reading.position, reading.velocity)

    def write(self, command: float, now: int) -> None:  # noqa: ARG002 - the rig knows the time
        """Give the base a command along the lane, m/s or N."""
        robot = self._robot
        if robot.forced:
            _, readings = self._newest()
            angle, rate = readings.tilt
            command += robot.mass * (self._rig.gravity * sin(angle) - readings.robots[robot.id].position * rate**2)
        self._rig.drive(robot.id, robot.facing * command)

    def stop(self) -> None:
        """Let the base brake."""
        self._rig.drive(self._robot.id, 0.0)


class Swarm:
    """Observer, parent controller and robots of a scenario, connected to a rig.

    Parameters
    ----------
    scenario : PlaneScenario
        The swarm as its nodes know it; the rig's robots may differ.
    rig : Rig
        A rig with robots of the same ids.
    """

    def __init__(self, scenario: PlaneScenario, rig: MujocoRig) -> None:
        realtime.check_realtime(scenario)
        self._rig = rig
        self._period = scenario.period
        clock = realtime.schedule(scenario, EPOCH)
        law = configure.parent_controller
        observer = RealtimeObserver(realtime.observer_config(scenario, clock), {})
        controller = RealtimeController(realtime.controller_config(scenario, clock), lambda: law(scenario))
        self._coordinators: tuple[RealtimeBehaviour, ...] = (observer, controller)
        self._observer = observer
        self._agents = [
            RealtimeAgent(config, RigDrive(rig, config.agent_id, lambda: self._newest))
            for config in realtime.agent_configs(scenario, clock)
        ]
        roles: list[tuple[str, RealtimeBehaviour]] = [(OBSERVER, observer), (CONTROLLER, controller)]
        roles += [(ROBOT, agent) for agent in self._agents]
        robots = len(self._agents)
        self._hears = [
            (node, frozenset(topic.name for topic in endpoints(role, REALTIME, robots=robots).subscriptions))
            for role, node in roles
        ]
        self._step = 0
        self._newest = EPOCH, rig.read()

    def advance(self) -> State:
        """Simulate a control period; return the state of the rig at its end."""
        now = self._measure(0.0)
        for agent in self._agents:
            self._send(agent.tick(now), now)
        now = self._measure(0.5)
        stamp, readings = self._newest
        self._send((PlaneState(stamp, self._step, readings.encoder, readings.tilt[1]),), now)
        for node in self._coordinators:
            self._send(node.tick(now), now)
        self._step += 1
        rig = self._rig
        rig.advance(self._step * self._period)
        return State(rig.time, rig.angle, rig.rate, tuple(rig.place(robot) for robot in rig.robots))

    def _measure(self, phase: float) -> int:
        """Simulate up to a phase of the period, and let all sensors measure; return the time, ns."""
        time = (self._step + phase) * self._period
        self._rig.advance(time)
        readings = self._rig.read()
        self._newest = EPOCH + round(readings.time * 1e9), readings
        return EPOCH + round(time * 1e9)

    def _send(self, messages: Iterable[Message], now: int) -> None:
        waiting = list(messages)
        while waiting:
            message = waiting.pop(0)
            name = TOPIC_OF[type(message)].name
            for node, hears in self._hears:
                if name in hears:
                    waiting.extend(node.hear(message, now))
