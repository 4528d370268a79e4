"""Node ``recorder``: puts the messages of a run in order and writes them to a bag."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.recording import RunCollector
from swarmabs_bag.splitting import Split
from swarmabs_config import configure
from swarmabs_config.scenario import load_scenario
from swarmabs_core.behaviours.base import UnexpectedMessageError
from swarmabs_core.errors import InputError
from swarmabs_core.membership import Change, with_ends
from swarmabs_core.messages import (
    AGENT_STATE,
    EVENTS,
    MAIN_TOPICS,
    NEVER,
    RECORDING_PROGRESS,
    STEERING,
    Action,
    Message,
    Messages,
    RecordingProgress,
    Steering,
    Topic,
)
from swarmabs_core.parameters import Parameter
from swarmabs_ros.qos import requested
from swarmabs_ros.runner import INTERRUPTED, STEERED, NodeSpec, Settings, run_node
from swarmabs_ros.status import StatusChannel

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from swarmabs_bag.recording import RecordedStep
    from swarmabs_config.scenario import Scenario

PARAMETERS = (
    Parameter("scenario_file", "", "file of the resolved scenario"),
    Parameter("bag", "", "folder of the bag; empty: nothing is written, digest and figures are computed"),
    Parameter("max_bag_size", 0, "size in bytes after which the bag goes on in a new file; 0: never", minimum=0),
    Parameter("max_bag_duration_ns", 0, "simulated time in ns that a file of the bag spans; 0: all", minimum=0),
    Parameter("logs", "", "folder whose log files are attached at the end"),
    Parameter("replay", "", "what of which bag is replayed, as JSON for the provenance; empty: nothing"),
    Parameter("ends", (), "ends of robots that the replayed run's scenario had not planned, each 'KIND AGENT STEP'"),
    STEERED,
)

CREDITS = 10
"""Reports of how far the recording is in as many steps as the run may be ahead of it."""
REPORT_SECONDS = 0.1
"""Time between two reports to the orchestrator, s."""
GATHER_SECONDS = 0.005
"""Time for which messages gather, s: waking up for each costs more than recording it, and the run waits for nothing
here as long as the credit of 100 steps lasts."""


class Recorder:
    """Records complete steps, and tells the parent controller how far it is.

    Parameters
    ----------
    scenario : Scenario
        The resolved scenario.
    recording : Recording
        Where the steps go.
    on_step : callable
        Told the number of steps recorded.
    ends : iterable of Change
        Ends of robots that the scenario does not plan.
    steered : bool
        Whether the run is steered.
    """

    def __init__(
        self,
        scenario: Scenario,
        recording: Recording,
        on_step: Callable[[int], None],
        ends: Iterable[Change] = (),
        *,
        steered: bool = False,
    ) -> None:
        self._period_ns = scenario.step_ns
        self._recording = recording
        self._on_step = on_step
        schedule = with_ends(configure.schedule(scenario), ends)
        self._collector = RunCollector(configure.members(scenario), schedule, scenario.steps, steered=steered)
        self._topics = (STEERING, *_EVERYTHING) if steered else _EVERYTHING
        self._credit_every = max(1, configure.recording_window(scenario) // CREDITS)
        self._credited = -1
        self._newest = -1

    def start(self) -> Messages:
        """Say that nothing is written yet."""
        return (self._credit(),)

    def handle(self, message: Message) -> Messages:
        """Take a message of the run; now and then answer with the progress.

        A recorder that lacks a message while the run goes on says so again and again: it has not stalled. What it
        lacks is repeated at the latest when the run stands still because the recorder's credit is used up.
        """
        if isinstance(message, RecordingProgress):
            raise UnexpectedMessageError("recorder", message)
        steps = self._steer(message) if isinstance(message, Steering) else self._collector.add(message)
        if not steps:
            return self._still_here(message.step)
        for step in steps:
            self._recording.add(step)
        written = self._collector.step - 1
        self._on_step(self._collector.step)
        if written - self._credited < self._credit_every and not self._collector.finished:
            return ()
        self._credited = written
        return (self._credit(),)

    def _steer(self, order: Steering) -> list[RecordedStep]:
        orders, steps = self._collector.steer(order)
        for known in orders:
            if known.action == Action.REFERENCE:
                self._recording.offset(known.step, known.value)
        return steps

    def _still_here(self, step: int) -> Messages:
        newer, self._newest = step > self._newest, max(step, self._newest)
        return (self._credit(),) if newer and step - self._collector.step >= self._credit_every else ()

    def _credit(self) -> RecordingProgress:
        written = self._credited
        if written < 0:
            return RecordingProgress(0, 0, NEVER)
        return RecordingProgress(written * self._period_ns, written, written)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for everything until the run is complete."""
        return () if self._collector.finished else self._topics

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the first incomplete step and what it lacks."""
        return self._collector.step, self._collector.missing()

    @property
    def finished(self) -> bool:
        """Whether the run is complete."""
        return self._collector.finished


_EVERYTHING = (EVENTS, *MAIN_TOPICS)


def log_text(folder: str) -> bytes:
    """Return all log files of the run, one after the other."""
    if not folder:
        return b""
    parts = []
    for path in sorted(Path(folder).glob("*.log")):
        text = path.read_bytes()
        if text:
            parts.append(b"==> %b <==\n%b\n" % (path.name.encode(), text))
    return b"".join(parts)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:
    """Return behaviour and endpoints.

    Raises
    ------
    InputError
        If there is no scenario, or the bag cannot be written where it shall be.
    """
    if not settings.text("scenario_file"):
        raise InputError("parameter scenario_file: give the file of the resolved scenario")
    scenario = load_scenario(Path(settings.text("scenario_file")))
    bag = settings.text("bag")
    split = Split(settings.integer("max_bag_size"), settings.integer("max_bag_duration_ns"))
    replay = settings.text("replay")
    recording = Recording(
        scenario,
        Path(bag) if bag else None,
        driver="lockstep",
        namespace=settings.namespace,
        split=split,
        replay=json.loads(replay) if replay else None,
        steered=settings.flag(STEERED.name),
    )
    planned = {change.step for change in configure.schedule(scenario)}
    reported = time.monotonic()

    def report(steps: int) -> None:
        nonlocal reported
        now = time.monotonic()
        if now - reported >= REPORT_SECONDS or steps - 1 in planned or steps > scenario.steps:
            reported = now
            latest, seen = recording.latest, recording.summary()
            if latest is not None and seen is not None:
                status.send("progress", step=latest.step, angle=latest.angle, error=latest.error, robots=seen.report())

    ends = [Change.parse(text) for text in settings.texts("ends")]
    steered = settings.flag(STEERED.name)
    recorder = Recorder(scenario, recording, report, ends, steered=steered)

    def finish(problem: str | None) -> None:
        log = {"run.log": log_text(settings.text("logs"))}
        complete = recorder.finished and problem in {None, INTERRUPTED}
        figures = recording.close(log) if complete else recording.abort(problem or "stopped before the end", log)
        status.send("done", complete=complete, problem=None if problem == INTERRUPTED else problem, figures=figures)

    # What may be under way, and the step that is being recorded.
    depth = max(1000, (configure.recording_window(scenario) + 1) * len(scenario.agents))
    subscriptions = {
        # Acknowledgements cost each coordinator a thread that is woken several times per step.
        topic: requested(topic, depth=depth if topic is AGENT_STATE else 1000, reliable=topic is EVENTS)
        for topic in (_EVERYTHING if not steered else (STEERING, *_EVERYTHING))
    }
    return NodeSpec(
        recorder,
        (RECORDING_PROGRESS,),
        subscriptions,
        on_exit=finish,
        lingers=False,
        gather=GATHER_SECONDS,
        on_idle=recording.poll,  # else what a run that stands still has recorded would not reach the disk
    )


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node("recorder", PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
