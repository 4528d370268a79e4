"""Node ``recorder``: orders the messages of a run, writes them to a bag, and reports its progress."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.run.gatherer import RunCollector
from swarmabs_bag.run_folder import Split
from swarmabs_config import configure
from swarmabs_config.graph import LOCKSTEP, RECORDER
from swarmabs_core.behaviours.base import UnexpectedMessageError
from swarmabs_core.cdr import decode, encode
from swarmabs_core.declaration import setting
from swarmabs_core.messages import (
    EVENTS,
    NEVER,
    RECORDER_NODE,
    STANDING,
    STEERING,
    SWARM_STATES,
    TOPIC_OF,
    Action,
    Message,
    Messages,
    RecordingProgress,
    Steering,
    SwarmEvent,
    Topic,
    relay_topic,
    topic_of,
)
from swarmabs_ros.announcements import send_events
from swarmabs_ros.lockstep import INTERRUPTED, NodeSpec
from swarmabs_ros.runner import LockstepProgram, Settings
from swarmabs_ros.scenario_file import ScenarioFile
from swarmabs_ros.settings import Variant
from swarmabs_ros.status import StatusChannel

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from swarmabs_bag.recorder.recording import RealtimeRecording
    from swarmabs_bag.run.step import Step
    from swarmabs_config.scenario import Scenario


@dataclass(frozen=True, slots=True)
class RecorderSettings(ScenarioFile):
    """Settings of a recorder."""

    bag: str = setting("", "folder of the bag; empty: only digest and figures are computed")
    max_bag_size: int = setting(0, "size in bytes after which a new file begins; 0: never", minimum=0)
    max_bag_duration_ns: int = setting(0, "simulated time in ns after which a new file begins; 0: never", minimum=0)
    logs: str = setting("", "folder of the log files to attach at the end")

    @property
    def split(self) -> Split:
        """When the bag continues in a new file."""
        return Split(self.max_bag_size, self.max_bag_duration_ns)


REPORT_SECONDS = 0.1
"""Time between two reports to the orchestrator, s."""
GATHER_SECONDS = 0.005, 0.05
"""Shortest and longest time for which messages accumulate, s: a batch costs nearly the same whatever its size."""
BATCH = 0.25, 0.5
"""Steps of a batch, as parts of the window by which the run may be ahead of the recorder: it must not have to wait."""

PARAMETERS = (RecorderSettings, Variant)

CREDITS = 10
"""Progress messages per window of steps by which the run may be ahead of the recorder."""


def log_text(folder: str) -> bytes:
    """Return the concatenated log files of the run."""
    if not folder:
        return b""
    parts = []
    for path in sorted(Path(folder).glob("*.log")):
        text = path.read_bytes()
        if text:
            parts.append(b"==> %b <==\n%b\n" % (path.name.encode(), text))
    return b"".join(parts)


class Reporter:
    """Reports progress and result of a recording to the orchestrator, and attaches log files at the end."""

    def __init__(self, recording: Recording | RealtimeRecording, status: StatusChannel, logs: str) -> None:
        self._recording = recording
        self._status = status
        self._logs = logs
        self._reported = 0.0

    def progress(self, *, at_once: bool = False) -> bool:
        """Report the progress, at a limited rate or `at_once`; return whether it was reported."""
        run, now = self._recording.run, time.monotonic()
        if run.newest < 0 or (now - self._reported < REPORT_SECONDS and not at_once):
            return False
        self._reported = now
        latest, seen = run.latest, self._recording.summary()
        angle, error = (None, None) if latest is None else (latest.angle, latest.error)
        told = None if seen is None else seen._asdict()
        self._status.send("progress", step=run.newest, angle=angle, error=error, robots=told)
        return True

    def done(self, problem: str | None, *, complete: bool) -> None:
        """Complete the bag and report the figures; `problem` is an error, `INTERRUPTED`, or None."""
        log = {"run.log": log_text(self._logs)}
        complete = complete and problem in {None, INTERRUPTED}
        recording = self._recording
        figures = recording.close(log) if complete else recording.abort(problem or "stopped before the end", log)
        told = None if problem == INTERRUPTED else problem
        self._status.send("done", complete=complete, problem=told, figures=figures)


class Recorder:
    """Records complete steps, and reports its progress to the parent controller.

    Parameters
    ----------
    on_step : callable
        Receives the numbers of the steps that were recorded.
    packed : bool
        Whether it receives the robots' states as one message per step.
    steered : bool
        Whether the run is steerable.
    on_events : callable, optional
        Receives the events that were recorded.
    """

    def __init__(
        self,
        scenario: Scenario,
        recording: Recording,
        on_step: Callable[[range], None],
        *,
        packed: bool = False,
        steered: bool = False,
        on_events: Callable[[Sequence[SwarmEvent]], None] = lambda _: None,
    ) -> None:
        self._period_ns = scenario.step_ns
        self._recording = recording
        self._on_step, self._on_events = on_step, on_events
        family = scenario.family
        self._collector = RunCollector(
            configure.members(scenario),
            configure.schedule(scenario),
            scenario.steps,
            steered=steered,
            drops=scenario.lockstep.on_stall == "drop",
            division=configure.division(scenario),
            family=family,
            system=scenario.system_hash,
            relayed=scenario.decentralised,
        )
        states = SWARM_STATES if packed else family.robot
        # What robots act on is compared with what is recorded.
        self._packed = family.packed if packed else None
        broadcast = (family.packed,) if packed else ()
        self._topics = (
            *((STEERING,) if steered else ()),
            *(EVENTS, *broadcast, states, *family.stepwise[1:], *family.once),
            *((STANDING,) if configure.may_change(scenario, steered=steered) else ()),
            *map(relay_topic, configure.relaying(scenario)),
        )
        window = configure.recording_window(scenario)
        self._credit_every = max(1, window // CREDITS)
        self._batch = BATCH[0] * window, BATCH[1] * window
        self._gathering = GATHER_SECONDS[0]
        self._credited = -1
        self._newest = -1

    def start(self) -> Messages:
        """Report that nothing is written yet."""
        return (self._credit(),)

    def handle(self, message: Message) -> Messages:
        """Record a message created in this process; see `hear_all`."""
        topic = topic_of(message)
        if topic not in self._topics:
            raise UnexpectedMessageError(RECORDER_NODE, message)
        return self.hear_all(topic, [encode(message)])

    def hear_all(self, topic: Topic, payloads: Sequence[bytes]) -> Messages:
        """Record serialized messages of a topic; periodically return the progress.

        A recorder that lacks a message while the run continues repeats its progress, because it has not stalled. The
        missing message is repeated at the latest when the run stops because the recorder's credit is used up.
        """
        collector, recorded = self._collector, False
        first = collector.step
        for step in self._taken(topic, payloads):
            self._recording.add(step)
            self._on_events(step.events)
            recorded = True
        if not recorded:
            return self._still_here()
        self._on_step(range(first, collector.step))
        self._adapt(collector.step - first)
        written = collector.step - 1
        if written - self._credited < self._credit_every and not collector.finished:
            return ()
        self._credited = written
        return (self._credit(),)

    def _taken(self, topic: Topic, payloads: Sequence[bytes]) -> Iterator[Step]:
        """Take serialized messages, and yield the steps that are complete then; packed ones part by part."""
        if topic is STEERING:
            yield from self._steer(payloads)
        elif topic is self._packed:
            parts = zip(*(decode(topic.message, payload)[2:] for payload in payloads), strict=True)
            for messages in parts:
                yield from self._collector.add_all(TOPIC_OF[type(messages[0])], [encode(part) for part in messages])
        else:
            yield from self._collector.add_all(topic, payloads)

    def gathering(self) -> float:
        """Return the time for which messages accumulate now, s."""
        return self._gathering

    def _adapt(self, steps: int) -> None:
        """Gather for a longer or a shorter time, according to the number of steps in a batch."""
        shortest, longest = GATHER_SECONDS
        if steps < self._batch[0]:
            self._gathering = min(longest, 1.5 * self._gathering)
        elif steps > self._batch[1]:
            self._gathering = max(shortest, 0.5 * self._gathering)

    def _steer(self, payloads: Sequence[bytes]) -> Iterator[Step]:
        for payload in payloads:
            order = decode(Steering, payload)
            assert isinstance(order, Steering)  # noqa: S101 - `decode` returns this type
            orders, steps = self._collector.steer(order)
            for request in orders:
                if request.action == Action.REFERENCE:
                    self._recording.offset(request.step, request.value)
            yield from steps

    def _still_here(self) -> Messages:
        newest = self._collector.newest
        newer, self._newest = newest > self._newest, newest
        return (self._credit(),) if newer and newest - self._collector.step >= self._credit_every else ()

    def _credit(self) -> RecordingProgress:
        written = self._credited
        if written < 0:
            return RecordingProgress(0, 0, NEVER)
        return RecordingProgress(written * self._period_ns, written, written)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for all topics until the run is complete."""
        return () if self._collector.finished else self._topics

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the first incomplete step and its missing messages."""
        return self._collector.step, self._collector.missing()

    @property
    def finished(self) -> bool:
        """Whether the run is complete."""
        return self._collector.finished


def make(settings: Settings, status: StatusChannel) -> NodeSpec:
    """Return the behaviour, the endpoints, and the functions called on idle and on exit."""
    own, variant = settings.declared(RecorderSettings), settings.declared(Variant)
    scenario = own.load()
    recording = Recording(
        scenario,
        Path(own.bag) if own.bag else None,
        driver="lockstep",
        namespace=settings.namespace,
        split=own.split,
        packed=variant.packed,
        steered=variant.steered,
    )
    reporter = Reporter(recording, status, own.logs)
    planned = {change.step for change in configure.schedule(scenario)}

    def report(steps: range) -> None:
        reporter.progress(at_once=not planned.isdisjoint(steps) or steps.stop > scenario.steps)

    recorder = Recorder(
        scenario,
        recording,
        report,
        packed=variant.packed,
        steered=variant.steered,
        on_events=partial(send_events, status, "recorded"),
    )
    return NodeSpec(
        recorder,
        settings.endpoints(
            RECORDER,
            LOCKSTEP,
            *configure.options_for(scenario),
            robots=len(scenario.agents),
            neighbours=configure.relaying(scenario),
        ),
        on_exit=lambda problem: reporter.done(problem, complete=recorder.finished),
        lingers=False,
        gather=recorder.gathering,
        hear_all=recorder.hear_all,
        compares=True,
        on_idle=lambda _: recording.poll(),  # otherwise the last messages of a stalled run would not reach the disk
    )


main = LockstepProgram(RECORDER, PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())
