"""A replay from a bag to a new one, over DDS or in this process."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.comparison import compare_steps
from swarmabs_analysis.replay.in_process import Replay
from swarmabs_analysis.replay.plan import replay_plan
from swarmabs_analysis.replay.source import recorded_steps
from swarmabs_bag.reader import open_bag
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.recording import Digest, RecordedStep
from swarmabs_core.messages import EVENTS
from swarmabs_core.publishers import publisher_of
from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.run import RunOptions
from swarmabs_run.simulated_run import record_steps

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from swarmabs_analysis.difference import Difference
    from swarmabs_analysis.replay.source import Source
    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.membership import Change
    from swarmabs_core.publishers import NodeName
    from swarmabs_run.orchestration.plan import ProcessPlan
    from swarmabs_run.run import Outcome, Progress


@dataclass(frozen=True, slots=True)
class ReplayRun:
    """A replay that is to be made.

    Parameters
    ----------
    source : Source
        What is replayed.
    nodes : tuple of NodeName
        The nodes under test.
    overrides : tuple of str
        What was changed for them, ``a.b=value`` each.
    scenario : Scenario
        With which settings they are made: `Source.scenario`.
    """

    source: Source
    nodes: tuple[NodeName, ...]
    overrides: tuple[str, ...]
    scenario: Scenario

    @property
    def _ends(self) -> tuple[Change, ...]:
        return tuple(change for change in self.source.ends if change.step <= self.scenario.steps)

    def provenance(self) -> dict[str, object]:
        """Return what the new bag says of the replay."""
        return {
            "of": self.source.digest,
            "nodes": [str(node) for node in self.nodes],
            "overrides": list(self.overrides),
        }

    def in_process(self, folder: RunFolder, on_progress: Callable[[Progress], None] | None = None) -> Outcome:
        """Replay in this process, as fast as possible.

        Parameters
        ----------
        folder : RunFolder
            An empty folder for the results.
        on_progress : callable, optional
            Told how it goes, some ten times a second.
        """
        folder.fill(self.scenario)
        recording = Recording(
            self.scenario,
            folder.bag,
            driver="simulate",
            namespace=self.source.namespace,
            replay=self.provenance(),
        )
        replay = Replay(self.scenario, self.nodes, self.source.steps(), self._ends)
        return record_steps(replay.steps(), self.scenario, recording, on_progress=on_progress)

    def live(self, folder: RunFolder, on_progress: Callable[[Progress], None] | None = None) -> Outcome:
        """Replay over DDS, the nodes under test as processes of their own; parameters as of `in_process`."""

        def arrange(processes: Sequence[ProcessPlan]) -> Sequence[ProcessPlan]:
            return replay_plan(processes, self.scenario, self.source, self.nodes, self.provenance())

        options = RunOptions(on_progress=on_progress, namespace=self.source.namespace)
        return LockstepRun(self.scenario, folder, options, arrange).run()

    def result(self, folder: RunFolder, digest: str | None) -> dict[str, Any]:
        """Return how the replay differs from the recording.

        Parameters
        ----------
        folder : RunFolder
            Its results.
        digest : str, optional
            Its digest, if it has one.
        """
        recorded = Digest()
        replayed = recorded_steps(open_bag(folder.path), self.scenario, self._ends)
        found = compare_steps(self._answers(self._recorded(recorded)), self._answers(replayed))
        first = found.first
        return {
            **self.provenance(),
            "same": digest == recorded.hexdigest(),
            "compared": sum(topic.compared for topic in found.topics),
            "first_difference": None if first is None else _told(first),
            "deviations": [{"topic": topic.topic, **asdict(field)} for topic in found.topics for field in topic.fields],
        }

    def _answers(self, steps: Iterable[RecordedStep]) -> Iterator[RecordedStep]:
        """Yield what the nodes under test have said, without events."""
        live = frozenset(self.nodes)
        for step in steps:
            answers = tuple(r for r in step.records if r.topic is not EVENTS and publisher_of(r.message) in live)
            if answers:
                yield RecordedStep(step.step, answers)

    def _recorded(self, digest: Digest) -> Iterator[RecordedStep]:
        """Yield the recorded steps that are replayed, and sum them up."""
        last = -1
        for step in self.source.steps():
            if step.step > self.scenario.steps:
                return
            if step.step > last:  # else an event that was late
                last = step.step
                digest.update(step)
            yield step


def _told(first: Difference) -> dict[str, Any]:
    """Return the first difference as data; a replay has no reasons."""
    found = first.to_dict("recorded", "replayed")
    del found["reason"]
    return {**found, "agent": first.agent or 0}
