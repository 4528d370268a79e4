"""Bag and figures of a run: the recorder node and ``simulate`` share this, and both ways to keep time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, TypeVar

from swarmabs_bag.attached import attachments, provenance
from swarmabs_bag.figures import RealtimeFigures, RunFigures
from swarmabs_bag.realtime import RECORDED, RealtimeCollector, RealtimeWorld
from swarmabs_bag.recorder.swarm_summary import SummaryTracker
from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_bag.writer import BagWriter
from swarmabs_config import configure
from swarmabs_config.graph import LOCKSTEP, OFFERED, REALTIME
from swarmabs_core.messages import EVENTS, MAIN_TOPICS
from swarmabs_core.realtime.base import Health, Level

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from swarmabs_bag.recorder.swarm_summary import SwarmSummary
    from swarmabs_bag.recording import Step
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.record import Record

_LOCKSTEP = (*MAIN_TOPICS, EVENTS)
F = TypeVar("F", RunFigures, RealtimeFigures)


class _Recording(Generic[F]):
    """What recordings have in common, whatever gathers their messages: figures, what people see, perhaps a bag."""

    def __init__(self, scenario: Scenario, folder: Path | None, run: F, made: Mapping[str, object], **bag: Any) -> None:
        self.run: F = run
        self._tracker = SummaryTracker(configure.members(scenario), scenario.plane.length)
        self._writer: BagWriter | None = None
        if folder is not None:
            self._writer = BagWriter(folder, attachments=attachments(scenario, made), **bag)

    def summary(self) -> SwarmSummary | None:
        """Return what people see of the robots now; it costs some time, so not for every message."""
        return self._tracker.summary()

    def poll(self) -> None:
        """Hand what is old enough to the operating system."""
        if self._writer is not None:
            self._writer.poll()

    def close(self, attachments: Mapping[str, bytes] | None = None) -> dict[str, Any]:
        """Complete the bag and return the figures."""
        if self._writer is not None:
            self._writer.close(attachments)
        return self.figures()

    def abort(self, reason: str, attachments: Mapping[str, bytes] | None = None) -> dict[str, Any]:
        """Complete the bag of a run that failed, as far as possible, and return the figures so far."""
        if self._writer is not None:
            self._writer.abort(reason, attachments)
        return self.figures()

    def figures(self) -> dict[str, Any]:
        """Return the figures of the run so far, and its events as people read them."""
        return {**self.run.summary(), "events": self._tracker.events()}


class Recording(_Recording[RunFigures]):
    """Takes the complete steps of a run in order.

    Parameters
    ----------
    folder : Path, optional
        Folder of the bag; none if only figures are wanted.
    driver, replay, steered
        As of `swarmabs_bag.attached.provenance`.
    namespace, split
        As of `BagWriter`.

    Raises
    ------
    InputError
        If the folder is not empty or cannot be written.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path | None,
        *,
        driver: str,
        namespace: str = "/",
        split: Split = ONE_FILE,
        replay: Mapping[str, object] | None = None,
        steered: bool = False,
    ) -> None:
        self._reference = configure.reference(scenario)
        made = provenance(scenario, driver=driver, replay=replay, steered=steered)
        figures = RunFigures(self._reference)
        super().__init__(
            scenario, folder, figures, made, topics=_LOCKSTEP, qos=OFFERED[LOCKSTEP], namespace=namespace, split=split
        )

    def add(self, step: Step) -> None:
        """Take the next step; after a `BagWriteError`, `abort` completes what is there."""
        self.run.add(step)
        self._tracker.take(step)
        if self._writer is not None:
            for topic, stamp, payload in step.stored():
                self._writer.write(topic, stamp, payload)

    def offset(self, step: int, offset: float) -> None:
        """Take note of an offset of the reference (rad) that holds from a step on, for the figures."""
        self._reference.shift(step, offset)


class RealtimeRecording(_Recording[RealtimeFigures]):
    """Takes the messages of a run as they arrive.

    Log time is when a message was received, publish time the stamp of its header.

    Parameters
    ----------
    folder, namespace, split
        As of `Recording`.
    last_step : int, optional
        The last step that is recorded, if the nodes go on beyond.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path | None,
        world: RealtimeWorld,
        *,
        last_step: int | None = None,
        namespace: str = "/",
        split: Split = ONE_FILE,
    ) -> None:
        self._collector = RealtimeCollector(configure.members(scenario), world.schedule)
        self._received = 0
        self._heard = self._heard_before = 0
        self._last_step = last_step
        made = provenance(scenario, driver=REALTIME.value, realtime=world.provenance())
        figures = RealtimeFigures(configure.parent_controller(scenario).reference, world.schedule)
        super().__init__(
            scenario, folder, figures, made, topics=RECORDED, qos=OFFERED[REALTIME], namespace=namespace, split=split
        )

    def add(self, record: Record, now: int) -> None:
        """Take a message that was received at a time (ns since 1970); errors as of `Recording.add`."""
        if self._last_step is not None and record.message.step > self._last_step:
            return
        self._heard += 1
        # Where the clock is set back, the order of the file stays that of its times.
        self._received = max(self._received, now)
        for kept in self._collector.add(record, now):
            self.run.add(kept)
            self._tracker.hear(kept.message)
            if self._writer is not None:
                self._writer.write(kept.topic, self._received, kept.payload, max(0, kept.message.stamp))

    def health(self) -> Health:
        """Return how the recording goes, since this was asked for the last time."""
        heard, self._heard_before = self._heard - self._heard_before, self._heard
        values = {"step": self.run.newest, "messages": self._heard, **self._dropped()}
        figures = tuple((name, str(value)) for name, value in values.items())
        if not heard:
            return Health(Level.WARN, "hears nothing of the swarm", figures)
        return Health(Level.OK, "records" if self._writer is not None else "listens, without a bag", figures)

    def figures(self) -> dict[str, Any]:
        """Return the figures of the run so far, and what was dropped."""
        found = super().figures()
        return {**found, "realtime": {**found["realtime"], "dropped": self._dropped()}}

    def _dropped(self) -> dict[str, int]:
        collector = self._collector
        return {"repeated": collector.repeated, "different": collector.different, "refused": collector.refused}
