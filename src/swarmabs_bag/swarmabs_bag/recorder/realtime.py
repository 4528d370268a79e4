"""Node ``recorder`` in real time: writes the received messages to a bag. No node waits for it."""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray

from swarmabs_bag.realtime_world import RealtimeWorld
from swarmabs_bag.recorder.node import RecorderSettings, Reporter
from swarmabs_bag.recorder.recording import RealtimeRecording
from swarmabs_config import configure
from swarmabs_config.graph import DIAGNOSTICS, REALTIME, RECORDER
from swarmabs_config.scenario import on_plane
from swarmabs_core.declaration import part, same, setting
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import NEVER
from swarmabs_core.pair_role import RECORDS, role_values
from swarmabs_core.realtime.base import Health, Realtime, Schedule
from swarmabs_core.realtime.leadership import SINGLE, Pair
from swarmabs_core.settings import Run
from swarmabs_ros.endpoints import Receiver
from swarmabs_ros.lockstep import INTERRUPTED
from swarmabs_ros.managed import DIAGNOSTICS_PERIOD, diagnostic_array
from swarmabs_ros.realtime import arrived
from swarmabs_ros.runner import Settings, declared_settings
from swarmabs_ros.settings import RealtimeSettings, RobotTopics
from swarmabs_ros.start import SwarmNode, run_program
from swarmabs_ros.status import Heartbeat, notify

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rclpy.node import Node

    from swarmabs_config.graph import Qos
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Topic
    from swarmabs_ros.status import StatusChannel


@dataclass(frozen=True, slots=True)
class Clock:
    """When a run in real time is recorded."""

    last_step: int | None = same(Run, "last_step")
    schedule: Schedule = part(Schedule, name="")
    await_epoch: bool = same(RealtimeSettings, "await_epoch")
    clock_tolerance: float = same(Realtime, "clock_tolerance")


@dataclass(frozen=True, slots=True)
class Fleet:
    """What is recorded."""

    bags: str = setting("", "folder in which each start creates a new bag folder; used instead of bag")
    own_limits: tuple[int, ...] = setting(
        (), "ids of the robots with other limits than the scenario's", minimum=1, maximum=65535, item=0
    )
    driven: tuple[int, ...] = setting(
        (), "ids of the robots whose bodies are not simulated", minimum=1, maximum=65535, item=0
    )
    simulated_plane: bool = setting(default=True, description="whether the plane is simulated")
    pair: str = same(Pair, "rank")
    paired: bool = same(Pair, "paired")


PARAMETERS = (Clock, RecorderSettings, Fleet, RobotTopics)

SLICE = 0.1
"""Longest time between two checks whether the node must stop, s."""
GATHER_SECONDS = 0.005
"""Time for which messages accumulate, s: waking up for each one costs more than recording it, but the times of receipt
are later by as much."""
LINGER = 0.5
"""Time after the last step in which its messages may still arrive, s."""


class RealtimeRecorder:
    """The loop of the node: waits for messages, lets them accumulate, and records them.

    `rank` tells whether it is one of a pair.
    """

    def __init__(self, node: Node, subscriptions: Mapping[Topic, Qos], status: StatusChannel, rank: str) -> None:
        self._depths = {topic: qos.depth for topic, qos in subscriptions.items()}
        self._receiver = Receiver(node, subscriptions, identified=tuple(subscriptions))
        self._status = status
        self._name, self._rank = node.get_name(), rank
        self._begun = time.monotonic()
        self._diagnostics = node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self._diagnosed = 0.0
        self._told_fallen = False
        self._heart = Heartbeat()
        self._stopped = False
        self.interrupted = False

    def stop(self, number: int, *_: object) -> None:
        """End the loop because of a signal."""
        self._stopped = True
        self.interrupted = number == signal.SIGINT

    def run(self, recording: RealtimeRecording, reporter: Reporter, end_ns: int) -> bool:
        """Record until stopped, or until a time (ns since 1970); return whether that time was reached."""
        while time.time_ns() < end_ns:
            if self._stopped:
                self._drain(recording)
                return False
            if self._receiver.wait(tuple(self._depths), SLICE):
                time.sleep(GATHER_SECONDS)
                self._drain(recording)
            recording.poll()
            if reporter.progress() and recording.run.fallen and not self._told_fallen:
                self._told_fallen = True
                self._status.send("failed", reason=recording.run.fallen)
            self._diagnose(recording)
            self._heart.beat(time.monotonic_ns())
        return True

    def _diagnose(self, recording: RealtimeRecording) -> None:
        now = time.monotonic()
        if now - self._diagnosed >= DIAGNOSTICS_PERIOD:
            self._diagnosed = now
            level, text, values = recording.health()
            if self._rank != SINGLE:
                values += role_values(self._rank, RECORDS, now - self._begun)
            self._diagnostics.publish(diagnostic_array(self._name, Health(level, text, values), time.time_ns()))

    def _drain(self, recording: RealtimeRecording) -> None:
        for topic, payload, writer in arrived(self._receiver, self._depths):
            recording.hear(topic, payload, time.time_ns(), writer)


def _folder(bag: str, bags: str, scenario: Scenario) -> Path | None:
    """Return the folder of the bag; one of many is named after the time at which it is begun."""
    if bags:
        return Path(bags) / f"{scenario.name}-{datetime.now(timezone.utc):%Y%m%dT%H%M%S.%fZ}"
    return Path(bag) if bag else None


def _record(node: Node, settings: Settings, status: StatusChannel) -> None:
    own, clock, fleet = settings.declared(RecorderSettings), settings.declared(Clock), settings.declared(Fleet)
    scenario = on_plane(own.load(), "real time")
    members = configure.members(scenario)
    subscriptions = settings.endpoints(
        RECORDER, REALTIME, members=members, neighbours=configure.relaying(scenario)
    ).subscriptions
    recorder = RealtimeRecorder(node, subscriptions, status, fleet.pair)
    epoch = clock.schedule.epoch_ns
    if clock.await_epoch:
        status.send("ready")
        epoch = status.wait_for_epoch()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, recorder.stop)
    schedule = Schedule(scenario.step_ns, epoch)
    if clock.schedule.period_ns != scenario.step_ns:
        raise InputError(f"parameter period_ns does not match the scenario: set it to {scenario.step_ns}")
    last = clock.last_step
    robots = sorted(set(members) - set(fleet.driven))
    world = RealtimeWorld(schedule, tuple(robots), fleet.simulated_plane, fleet.own_limits)
    recording = RealtimeRecording(
        scenario,
        _folder(own.bag, fleet.bags, scenario),
        world,
        last_step=last,
        namespace=settings.namespace,
        split=own.split,
        paired=fleet.paired,
    )
    reporter = Reporter(recording, status, own.logs)
    status.send("ready")
    notify("READY=1\nSTATUS=recording")
    problem: str | None = "the node failed"
    over = False
    try:
        end = NEVER if last is None else schedule.begin(last + 1) + round(LINGER * 1e9)
        over = recorder.run(recording, reporter, end)
        # A run has a last step and fails with its plane. Without a last step, a fleet is recorded whatever happens.
        lost = recording.run.fallen if last is not None else None
        problem = lost or (INTERRUPTED if recorder.interrupted else None)
    except RunError as error:
        problem = str(error)
        raise
    finally:
        reporter.done(problem, complete=over or last is None)
        if recording.malformed:
            node.get_logger().warning(f"{recording.malformed} malformed messages were not recorded")


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT, SIGTERM or the end of `last_step`; return the exit code."""

    def body(node: Node, status: StatusChannel) -> None:
        _record(node, declared_settings(node, PARAMETERS), status)

    return run_program(RECORDER, SwarmNode, body, args)


if __name__ == "__main__":
    sys.exit(main())
