"""Recomputation of every message of a run in real time from its sender's inputs (docs/explanation/realtime.md).

In real time the messages that a node receives depend on the network. Each message therefore names its inputs: a robot's
state the step of the broadcasts, a coordinator's answer its provenance, and a relay what a robot has computed without
coordinators. From these, the same pure functions that run in the nodes recompute it. Messages that need inputs lost on
the way to the recorder are counted as not checkable.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_analysis.difference import PUBLISH_TIME, Difference, surplus, wrong_padding
from swarmabs_analysis.verification.base import Verification
from swarmabs_analysis.verification.history import WAIT, History, StandbyHistory, wrong_stamp
from swarmabs_analysis.verification.realtime_nodes import ControllerCheck, ObserverCheck, PlaneCheck, RobotCheck
from swarmabs_analysis.verification.realtime_relays import PeerChecks, PeerRobotCheck
from swarmabs_bag.run.realtime_gatherer import MEMORY, SECOND_WRITER, TWO_MESSAGES
from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_core.messages import AGENT_STATE, EVENTS, PLANE_STATE, Basis, DesiredAbstractState
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_analysis.verification.base import Finding
    from swarmabs_bag.realtime_world import RealtimeWorld
    from swarmabs_config.scenario import PlaneScenario

LATE = "it was received too late to be checked"
MEASURED = "it was measured, not computed"


class RealtimeVerification(Verification):
    """Verifies a run in real time, where each message names its inputs.

    `world` defines the mapping from time to steps, and what was simulated: the motion of other robots or of another
    plane is not checked. The state of the plane may differ by the tolerance `of_plane`, if that is larger.
    """

    def __init__(
        self, scenario: PlaneScenario, world: RealtimeWorld, *, tolerance: float = 0.0, of_plane: float = 0.0
    ) -> None:
        super().__init__(tolerance)
        self._world = world
        self._schedule = schedule = world.schedule
        self._history = history = History()
        standby = StandbyHistory(history)
        self._judged: int | None = None
        self._newest = -1
        starts = {agent.id: (agent.position, agent.velocity) for agent in scenario.agents if agent.id in world.robots}
        check = PeerRobotCheck if scenario.decentralised else RobotCheck
        self._robots = {
            config.agent_id: check(
                config,
                history,
                tolerance,
                starts.get(config.agent_id),
                standby=standby,
                own_limits=config.agent_id in world.own_limits,
            )
            for config in configure.agent_configs(scenario, schedule)
        }
        self._plane = PlaneCheck(configure.plane_config(scenario, schedule), history, max(tolerance, of_plane))
        peers = {i: robot for i, robot in self._robots.items() if isinstance(robot, PeerRobotCheck)}
        self._peers = PeerChecks(scenario, schedule, history, peers, tolerance) if scenario.decentralised else None
        observer = configure.observer_config(scenario, schedule)
        controller = configure.controller_config(scenario, schedule)
        self._coordinators = [
            (
                ObserverCheck(observer, of, tolerance),
                ControllerCheck(
                    controller, of, tolerance, lambda: lockstep.parent_controller(scenario), (history, standby)
                ),
            )
            for of in (history, standby)
        ]

    @property
    def step(self) -> int:
        """The first step that is not verified yet, initially 0."""
        return max(0, self._judged or 0)

    def _take(self, stored: Record | Difference) -> None:
        if isinstance(stored, Difference):
            self.result.difference = stored
            return
        now = self._schedule.step(stored.time or 0)
        self._newest = max(self._newest, now)
        stamp = max(0, stored.message.stamp)  # a bag has no time before 1970
        if stored.published not in {None, stamp}:
            self.result.difference = Difference.of(stored.message, PUBLISH_TIME, stored.published, stamp)
            return
        self.result.difference = self._keep(stored, now)
        if self._judged is None:
            self._judged = now - MEMORY
        self._judge_until(self._newest - WAIT)

    def finish(self, *, whole: bool = True) -> None:  # noqa: ARG002 - a bag in real time may end anywhere
        """Judge the remaining messages at the end of the bag."""
        self._judge_until(max(self._history.steps, default=-1) + 1)
        disputes = self._history.disputes
        self.result.second_senders = disputes.spans(SECOND_WRITER, self._newest)
        self.result.notes = tuple(
            f"{TWO_MESSAGES} on {of}, steps {first} to {last}: the bag has only the first of each"
            for of, (first, last) in disputes.spans(TWO_MESSAGES, self._newest).items()
        )

    def _keep(self, stored: Record, now: int) -> Difference | None:
        message = stored.message
        if wrong := wrong_padding(stored):
            return wrong
        if stored.topic is not EVENTS:
            if abs(message.step - now) > MEMORY:
                return Difference.of(message, "step", message.step, now, "when received")
            if isinstance(message, (DesiredAbstractState, Basis)) and (
                wrong := wrong_stamp(message, self._schedule, MEMORY)
            ):
                return wrong
            if self._judged is not None and message.step < self._judged:
                self.result.not_checkable[LATE] += 1
                return None
        if self._history.add(stored):
            return None
        return surplus(stored, message.step, "the recorder keeps one message per step")

    def _judge_until(self, end: int) -> None:
        """Judge all steps before `end`, without delay even if the clock was set far forward."""
        begin = self._judged or 0
        if begin >= end:
            return
        few = end - begin <= len(self._history.steps)
        steps = range(begin, end) if few else sorted(s for s in self._history.steps if begin <= s < end)
        for step in steps:
            if self.result.difference is None:
                self._judge_step(step)
        self._judged = end

    def _judge_step(self, step: int) -> None:
        """Judge the messages of a step, in the order in which the nodes tick."""
        judged = self._judge(self._findings(step))
        if self.result.difference is None:
            self.result.steps += judged > 0
            self._history.forget(step)

    def _findings(self, step: int) -> Iterator[Finding]:
        if self._peers is not None:
            yield from self._peers.read(step)
        for agent_id, stored in sorted(self._history.on(AGENT_STATE, step).items()):
            robot = self._robots.get(agent_id)
            if robot is None:
                yield surplus(stored, step, "the scenario does not have this robot")
            else:
                yield robot.check(stored)
        if self._world.plane:
            yield from self._plane.check(step)
        else:
            yield from [MEASURED] * len(self._history.on(PLANE_STATE, step))
        if self._peers is not None:
            yield from self._peers.spoken(step)
            return
        for checks in self._coordinators[: 1 + self._history.paired]:
            for check in checks:
                yield from check.check(step)
