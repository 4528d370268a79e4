"""Bag and figures of a run in real time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from swarmabs_bag.provenance import provenance_json
from swarmabs_bag.realtime import DRIVER, RealtimeWorld
from swarmabs_bag.realtime_recording import RECORDED, RealtimeCollector, RealtimeFigures
from swarmabs_bag.recorder.swarm_summary import SummaryTracker
from swarmabs_bag.splitting import ONE_FILE, Split
from swarmabs_bag.writer import BagWriter
from swarmabs_config import configure
from swarmabs_config.scenario import dump_scenario
from swarmabs_core.cdr import encode
from swarmabs_core.messages import TOPIC_OF
from swarmabs_core.realtime.base import Health, Level
from swarmabs_ros.qos import REALTIME

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from swarmabs_bag.recorder.swarm_summary import SwarmSummary
    from swarmabs_bag.recording import Latest
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Message
    from swarmabs_core.realtime.base import Schedule


class RealtimeRecording:
    """Takes the messages of a run as they arrive.

    Log time is when a message was received, publish time the stamp of its header.

    Parameters
    ----------
    scenario : Scenario
        The resolved scenario; it is attached to the bag at once.
    folder : Path, optional
        Folder of the bag; none if only figures are wanted.
    schedule : Schedule
        How time becomes steps.
    simulated : iterable of int, optional
        Robots whose bodies are simulated, by default all.
    simulated_plane : bool
        Whether the plane is simulated.
    own_limits : iterable of int
        Robots whose limits are not those of the scenario.
    last_step : int, optional
        The last step that is recorded, if the nodes go on beyond.
    namespace : str
        Namespace of the swarm, which the bag's topics have.
    split : Split
        When the bag goes on in a new file, by default never.

    Raises
    ------
    InputError
        If the folder is not empty or cannot be written.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path | None,
        schedule: Schedule,
        *,
        simulated: Iterable[int] | None = None,
        simulated_plane: bool = True,
        own_limits: Iterable[int] = (),
        last_step: int | None = None,
        namespace: str = "/",
        split: Split = ONE_FILE,
    ) -> None:
        members = configure.members(scenario)
        self._collector = RealtimeCollector(members, schedule)
        self._figures = RealtimeFigures(configure.parent_controller(scenario).reference, schedule)
        self._tracker = SummaryTracker(members, scenario.plane.length)
        self._received = 0
        self._heard = self._heard_before = 0
        self._last_step = last_step
        self._writer = None
        if folder is not None:
            robots = tuple(members if simulated is None else simulated)
            world = RealtimeWorld(schedule, robots, simulated_plane, tuple(own_limits))
            self._writer = BagWriter(
                folder,
                topics=RECORDED,
                namespace=namespace,
                qos=REALTIME,
                split=split,
                attachments={
                    "scenario.yaml": dump_scenario(scenario).encode(),
                    "provenance.json": provenance_json(scenario, driver=DRIVER, realtime=world.provenance()),
                },
            )

    @property
    def latest(self) -> Latest | None:
        """What the run looks like now; None until the law of the parent controller has begun."""
        return self._figures.latest

    def summary(self) -> SwarmSummary | None:
        """Return what people see of the robots now; it costs some time, so not for every message."""
        return self._tracker.summary()

    @property
    def newest(self) -> int:
        """The newest step recorded, -1 if there is none."""
        return self._figures.newest

    @property
    def fallen(self) -> str:
        """When and why the swarm has lost the plane, and what helps; empty if it has not."""
        return self._figures.fallen

    def add(self, message: Message, now: int) -> None:
        """Take a message that was received at a time (ns since 1970).

        Raises
        ------
        BagWriteError
            If the disk is full or fails; `abort` then completes what is there.
        """
        if self._last_step is not None and message.step > self._last_step:
            return
        self._heard += 1
        # Where the clock is set back, the order of the file stays that of its times.
        self._received = max(self._received, now)
        for kept in self._collector.add(message, now):
            self._figures.add(kept)
            self._tracker.hear(kept)
            if self._writer is not None:
                self._writer.write(TOPIC_OF[type(kept)], self._received, encode(kept), max(0, kept.stamp))

    def health(self) -> Health:
        """Return how the recording goes, since this was asked for the last time."""
        heard, self._heard_before = self._heard - self._heard_before, self._heard
        values = {"step": self.newest, "messages": self._heard, **self._dropped()}
        figures = tuple((name, str(value)) for name, value in values.items())
        if not heard:
            return Health(Level.WARN, "hears nothing of the swarm", figures)
        return Health(Level.OK, "records" if self._writer is not None else "listens, without a bag", figures)

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
        """Return the figures of the run so far; it has no digest, since what arrives differs from run to run."""
        realtime = {**self._figures.realtime(), "dropped": self._dropped()}
        return {**self._figures.summary(), "digest": None, "realtime": realtime}

    def _dropped(self) -> dict[str, int]:
        collector = self._collector
        return {"repeated": collector.repeated, "different": collector.different, "refused": collector.refused}
