"""Bag and figures of a run, in lockstep and in real time; shared by the recorder node and ``simulate``."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from swarmabs_bag.attached import attachments, provenance
from swarmabs_bag.errors import BagWriteError
from swarmabs_bag.realtime_world import RealtimeWorld
from swarmabs_bag.recorder.swarm_summary import SummaryTracker
from swarmabs_bag.run.figures import RealtimeFigures, RunFigures, tracking_of
from swarmabs_bag.run.realtime_gatherer import RealtimeCollector, recorded
from swarmabs_bag.run.writer import BagWriter
from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_config import configure
from swarmabs_config.graph import LOCKSTEP, OFFERED, REALTIME
from swarmabs_config.realtime import bounds
from swarmabs_config.scenario import PlaneScenario
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import EVENTS, STANDING, relay_topic
from swarmabs_core.realtime.base import Health, Level
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from swarmabs_bag.recorder.swarm_summary import SwarmSummary
    from swarmabs_bag.run.step import Step
    from swarmabs_config.graph import Qos
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Topic

F = TypeVar("F", RunFigures, RealtimeFigures)


class _Recording(Generic[F]):
    """The common part of recordings: figures, summary of the swarm, and optionally a bag."""

    def __init__(
        self,
        scenario: Scenario,
        folder: Path | None,
        run: F,
        stated: Mapping[str, object],
        *,
        topics: Sequence[Topic],
        qos: Mapping[Topic, Qos],
        namespace: str,
        split: Split,
    ) -> None:
        self.run: F = run
        self._tracker = SummaryTracker(configure.members(scenario), scenario.lane_length)
        self._writer: BagWriter | None = None
        if folder is not None:
            attached = attachments(scenario, stated)
            self._writer = BagWriter(
                folder, topics=topics, attachments=attached, namespace=namespace, qos=qos, split=split
            )

    def summary(self) -> SwarmSummary | None:
        """Return the current summary of the swarm; too expensive to call for every message."""
        return self._tracker.summary()

    def poll(self) -> None:
        """Pass chunks that are old enough to the operating system."""
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
        """Return the figures of the run so far, and its events as text."""
        return {**self.run.summary(), "events": self._tracker.events()}


class Recording(_Recording[RunFigures]):
    """Records the complete steps of a run, which must be in order.

    Parameters
    ----------
    folder : Path, optional
        Folder of the bag; None if only figures are needed.
    driver, packed, steered
        As for `swarmabs_bag.attached.provenance`.
    namespace, split
        As for `BagWriter`.

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
        packed: bool = False,
        steered: bool = False,
    ) -> None:
        self._reference = configure.reference(scenario)
        stated = provenance(scenario, driver=driver, packed=packed, steered=steered)
        figures, family = RunFigures(self._reference, tracking_of(scenario)), scenario.family
        divides = (STANDING,) if configure.may_change(scenario, steered=steered) else ()
        relays = map(relay_topic, configure.relaying(scenario))
        topics = (*family.once, *family.main, *family.further, *divides, EVENTS, *relays)
        super().__init__(
            scenario, folder, figures, stated, topics=topics, qos=OFFERED[LOCKSTEP], namespace=namespace, split=split
        )

    def add(self, step: Step) -> None:
        """Record the next step, or several; after a `BagWriteError`, call `abort` to complete the bag."""
        self.run.add(step)
        self._tracker.take(step)
        if self._writer is not None:
            self._writer.write_step(step)

    def offset(self, step: int, offset: float) -> None:
        """Set the offset of the reference, on the plane in rad, from a step on, for the figures."""
        self._reference.shift(step, offset)


class RealtimeRecording(_Recording[RealtimeFigures]):
    """Records the messages of a run as they arrive.

    The log time of a message is its time of receipt, the publish time the stamp of its header.

    Parameters
    ----------
    folder, namespace, split
        As for `Recording`.
    last_step : int, optional
        The last step to record, if the nodes continue beyond it.
    paired : bool
        Whether any coordinator has a standby, which publishes on topics of its own.

    Attributes
    ----------
    malformed : int
        Number of messages that could not be read, and are not recorded.
    """

    def __init__(
        self,
        scenario: PlaneScenario,
        folder: Path | None,
        world: RealtimeWorld,
        *,
        last_step: int | None = None,
        namespace: str = "/",
        split: Split = ONE_FILE,
        paired: bool = False,
    ) -> None:
        self._collector = RealtimeCollector(
            configure.members(scenario),
            world.schedule,
            bounds(scenario),
            scenario.realtime,
            each_robot=scenario.decentralised,
        )
        self.malformed = 0
        self._received = 0
        self._heard = self._heard_before = 0
        self._last_step = last_step
        stated = provenance(scenario, driver=REALTIME.value, realtime=world.provenance())
        figures = RealtimeFigures(configure.law_reference(scenario), world.schedule)
        super().__init__(
            scenario,
            folder,
            figures,
            stated,
            topics=recorded(paired=paired, relaying=configure.relaying(scenario)),
            qos=OFFERED[REALTIME],
            namespace=namespace,
            split=split,
        )

    def hear(self, topic: Topic, payload: bytes, now: int, writer: bytes = b"") -> None:
        """Record a serialized message, as `add`; one that cannot be read is only counted."""
        try:
            record = Record.heard(topic, payload)
        except MalformedMessageError:
            self.malformed += 1
        else:
            self.add(record, now, writer)

    def add(self, record: Record, now: int, writer: bytes = b"") -> None:
        """Record a message received at a time (ns since 1970) from a writer; errors as for `Recording.add`."""
        if self._last_step is not None and record.message.step > self._last_step:
            return
        self._heard += 1
        # Keeps the times in the file in order even if the clock is set back.
        self._received = max(self._received, now)
        self._keep(self._collector.add(record, now, writer))

    def _keep(self, records: Iterable[Record]) -> None:
        for kept in records:
            self.run.add(kept)
            self._tracker.hear(kept.message)
            if self._writer is not None:
                self._writer.write(kept.topic, self._received, kept.payload, max(0, kept.message.stamp))

    def close(self, attachments: Mapping[str, bytes] | None = None) -> dict[str, Any]:
        """Complete the bag and return the figures."""
        self._keep(self._collector.finish())
        return super().close(attachments)

    def abort(self, reason: str, attachments: Mapping[str, bytes] | None = None) -> dict[str, Any]:
        """Complete the bag of a run that failed, as far as possible, and return the figures so far."""
        with suppress(BagWriteError):  # it may be the reason
            self._keep(self._collector.finish())
        return super().abort(reason, attachments)

    def health(self) -> Health:
        """Return the health of the recording since the last call."""
        heard, self._heard_before = self._heard - self._heard_before, self._heard
        values = {"step": self.run.newest, "messages": self._heard, **self._dropped()}
        figures = tuple((name, str(value)) for name, value in values.items())
        if not heard:
            return Health(Level.WARN, "receives no messages of the swarm", figures)
        text = "recording" if self._writer is not None else "listening, without a bag"
        return self._collector.writers.warned(Health(Level.OK, text, figures))

    def figures(self) -> dict[str, Any]:
        """Return the figures of the run so far, and the numbers of dropped messages."""
        figures = super().figures()
        return {**figures, "realtime": {**figures["realtime"], "dropped": self._dropped()}}

    def _dropped(self) -> dict[str, int]:
        collector = self._collector
        return {"repeated": collector.repeated, "different": collector.different, "refused": collector.refused}
