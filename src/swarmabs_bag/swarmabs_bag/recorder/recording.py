"""Digest, figures and bag of a run, whoever moves it: the recorder node and ``simulate`` share this."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_bag.provenance import provenance_json
from swarmabs_bag.recorder.swarm_summary import SummaryTracker
from swarmabs_bag.recording import Digest, Metrics
from swarmabs_bag.splitting import ONE_FILE, Split
from swarmabs_bag.writer import BagWriter
from swarmabs_config import configure
from swarmabs_config.scenario import dump_scenario
from swarmabs_core.messages import EVENTS, MAIN_TOPICS

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from swarmabs_bag.recorder.swarm_summary import SwarmSummary
    from swarmabs_bag.recording import Latest, Step
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Topic

Figures = dict[str, float | int | str | None]


class Recording:
    """Takes the complete steps of a run in order.

    Parameters
    ----------
    scenario : Scenario
        The resolved scenario; it is attached to the bag at once.
    folder : Path, optional
        Folder of the bag; none if only digest and figures are wanted.
    driver : str
        What moves the run, for the provenance.
    namespace : str
        Namespace of the swarm, which the bag's topics have.
    split : Split
        When the bag goes on in a new file, by default never.
    replay : mapping, optional
        What of which bag is replayed, for the provenance.
    topics : tuple of Topic
        What the bag holds.
    steered : bool
        Whether the run may be steered, for the provenance.

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
        topics: tuple[Topic, ...] = (*MAIN_TOPICS, EVENTS),
        steered: bool = False,
    ) -> None:
        self._digest = Digest()
        self._reference = configure.reference(scenario)
        self._metrics = Metrics(self._reference)
        self._tracker = SummaryTracker(configure.members(scenario), scenario.plane.length)
        self._writer = None
        if folder is not None:
            self._writer = BagWriter(
                folder,
                topics=topics,
                namespace=namespace,
                split=split,
                attachments={
                    "scenario.yaml": dump_scenario(scenario).encode(),
                    "provenance.json": provenance_json(scenario, driver=driver, replay=replay, steered=steered),
                },
            )

    @property
    def latest(self) -> Latest | None:
        """What the run looks like now."""
        return self._metrics.latest

    def summary(self) -> SwarmSummary | None:
        """Return what people see of the robots now; it costs some time, so not for every step."""
        return self._tracker.summary()

    def add(self, step: Step) -> None:
        """Record a step.

        Raises
        ------
        BagWriteError
            If the disk is full or fails; `abort` then completes what is there.
        """
        self._digest.update(step)
        self._metrics.update(step)
        self._tracker.take(step)
        if self._writer is not None:
            for topic, stamp, payload in step.stored():
                self._writer.write(topic, stamp, payload)

    def offset(self, step: int, offset: float) -> None:
        """Take note of an offset of the reference (rad) that holds from a step on, for the figures."""
        self._reference.shift(step, offset)

    def poll(self) -> None:
        """Hand what is old enough to the operating system."""
        if self._writer is not None:
            self._writer.poll()

    def close(self, attachments: Mapping[str, bytes] | None = None) -> Figures:
        """Complete the bag and return digest and figures."""
        if self._writer is not None:
            self._writer.close(attachments)
        return self.figures()

    def abort(self, reason: str, attachments: Mapping[str, bytes] | None = None) -> Figures:
        """Complete the bag of a run that failed, as far as possible, and return digest and figures so far."""
        if self._writer is not None:
            self._writer.abort(reason, attachments)
        return self.figures()

    def figures(self) -> Figures:
        """Return the figures of the run so far; there is no digest of a run that recorded nothing."""
        return {**self._metrics.summary(), "digest": self._digest.hexdigest() if self.latest is not None else None}
