"""The orchestrator's knowledge of its processes and its conclusions: a state machine without clock or processes."""

from __future__ import annotations

import signal
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from swarmabs_config.graph import RECORDER, writers
from swarmabs_core.messages import EVENTS, FAMILIES, EventKind, word_of
from swarmabs_core.nodes import agent_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from swarmabs_ros.status import Report

RESTARTS = 2
"""Largest number of restarts of a robot's process that fails to start."""

PUBLISHER_OF = {topic.name: writers(topic)[0] for family in FAMILIES for topic in family.broadcasts}
PUBLISHER_OF |= {family.parent.name: family.node for family in FAMILIES}
"""The process that publishes a topic with a single publisher, by the name of the topic."""


@dataclass(frozen=True, slots=True)
class Stall:
    """The messages that a node waits for."""

    step: int
    missing: tuple[str, ...]
    silence: float


@dataclass(frozen=True, slots=True)
class Failure:
    """Reason for which a run has failed, and the processes whose logs give details."""

    reason: str
    culprits: tuple[str, ...] = ()


@dataclass(slots=True)
class Supervision:
    """Keeps track of a run's processes.

    Parameters
    ----------
    dispensable : frozenset of str
        Names of the processes whose end the run survives once it has started: the robots, if the scenario drops
        silent ones.
    hosts : mapping
        Process by robot: these may be restarted until the run has started.

    Attributes
    ----------
    paused : bool
        Whether the steering node holds the run back, so that silence is none.
    restart : str, optional
        The request that ends the run, so that another one starts.
    steered : list of tuple of str
        What was steered and is not noted yet: what to note, and the change of a robot's process that follows, if any.
    """

    names: tuple[str, ...]
    dispensable: frozenset[str] = frozenset()
    hosts: Mapping[int, str] = field(default_factory=dict)
    pids: dict[str, int] = field(default_factory=dict)
    ready: set[str] = field(default_factory=set)
    exited: dict[str, int] = field(default_factory=dict)
    stalls: dict[str, Stall] = field(default_factory=dict)
    expected_ends: set[str] = field(default_factory=set)
    started: bool = False
    lost: list[str] = field(default_factory=list)
    restarts: Counter[str] = field(default_factory=Counter)
    progress: Report | None = None
    done: Report | None = None
    failure: Failure | None = None
    timing: dict[str, Report] = field(default_factory=dict)
    steered: list[tuple[str, str]] = field(default_factory=list)
    paused: bool = False
    restart: str | None = None
    published: set[str] = field(default_factory=set)

    def take(self, report: Report) -> None:
        """Process a report of a node or of the launcher."""
        event, node = report["event"], report["node"]
        if event == "spawned":
            self.pids[report["name"]] = report["child"]
        elif event == "exited":
            self._exited(report["name"], report["code"])
        elif event == "ready":
            self.ready.add(node)
        elif event == "stalled":
            self.stalls[node] = Stall(report["step"], tuple(report["missing"]), report["silence"])
        elif event == "recovered":
            self.stalls.pop(node, None)
        elif event == "failed" and not self._survives(node):
            self._fail(Failure(f"{node}: {report['reason']}"))
        elif event == "progress":
            self.progress = report
        elif event == "timing":
            self.timing[node] = report
        elif event == "steered":
            self.steered.append((report["text"], report["change"]))
        elif event == "paused":
            self.paused = report["paused"]
            done = "paused" if self.paused else "resumed"
            self.steered.append((f"{done} at step {report['step']}", ""))
        elif event == "restart":
            self.restart = report["action"]
        elif event == "publishes":
            self.published.update(digest for digest, *_ in report["events"])
        elif event == "recorded":
            self._refuse_foreign(node, report["events"])
        elif event == "done":
            self.done = report
            if report["problem"]:
                self._fail(Failure(f"{node}: {report['problem']}"))

    def all_ready(self) -> bool:
        """Return whether every process has discovered its counterparts."""
        return len(self.ready) == len(self.names)

    def not_ready(self) -> tuple[str, ...]:
        """Return the processes that have not discovered all their counterparts."""
        return tuple(name for name in self.names if name not in self.ready)

    def expect_end(self, name: str) -> None:
        """Mark the end of a process as planned."""
        self.expected_ends.add(name)

    def _exited(self, name: str, code: int) -> None:
        self.exited[name] = code
        self.stalls.pop(name, None)
        if self._may_restart(name):
            self.lost.append(name)
            return
        finished = name == RECORDER and self.done is not None
        if name in self.expected_ends or self._survives(name) or finished:
            return
        self._fail(Failure(f"{name} (process {self.pids.get(name)}) {how_it_ended(code)}", (name,)))

    def _refuse_foreign(self, recorder: str, events: Iterable[tuple[str, int, int, int]]) -> None:
        """Fail if a recorder has recorded an event that no node of the run has reported before publishing it."""
        for digest, step, agent_id, kind in events:
            if digest not in self.published:
                of = f" of robot {agent_id}" if agent_id else ""
                what = f"an event '{word_of(EventKind, kind).replace('_', ' ')}'{of} of step {step}"
                self._fail(
                    Failure(
                        f"{recorder}: {EVENTS.name}: {what} that no node of this run has published; is a second swarm "
                        "in this namespace?"
                    )
                )

    def _survives(self, name: str) -> bool:
        """Return whether the run goes on without a process: never before all have been ready."""
        return self.started and name in self.dispensable

    def _may_restart(self, name: str) -> bool:
        return not self.started and name in self.hosts.values() and self.restarts[name] < RESTARTS

    def to_restart(self) -> tuple[str, ...]:
        """Return the processes that ended before the start and must be restarted; each is returned once per end."""
        names = tuple(self.lost)
        self.lost.clear()
        for name in names:
            self.restarts[name] += 1
            self.exited.pop(name, None)
            self.ready.discard(name)
        return names

    def hanging(self) -> tuple[str, ...]:
        """Return the robots' processes that hang while most others are ready, if they may be restarted."""
        robots = set(self.hosts.values())
        missing = tuple(name for name in self.not_ready() if name in robots)
        few = 2 * len(missing) < len(robots)
        return missing if few and all(self._may_restart(name) for name in missing) else ()

    def _fail(self, failure: Failure) -> None:
        # A node reports its failure before its end is reported, and the first failure causes the others.
        if self.failure is None:
            self.failure = failure

    def diagnose(self, states: Mapping[str, str]) -> Failure:
        """Conclude from the nodes' reports of stalls which processes do not answer.

        `states` holds the state of each process according to the operating system, such as ``stopped``.
        """
        culprits = self._silent()
        silence = max((stall.silence for stall in self.stalls.values()), default=0.0)
        step = min((stall.step for stall in self.stalls.values()), default=0)
        if not culprits:
            waits = "; ".join(
                f"{name} waits for {', '.join(s.missing[:5])}" for name, s in sorted(self.stalls.items())[:4]
            )
            return Failure(f"no progress at step {step} for {silence:g} s: {waits}")
        shown = ", ".join(
            f"{name.replace('agent_', 'agent ')} (process {self.pids.get(name)} is {states.get(name, 'gone')})"
            for name in culprits[:5]
        )
        more = f" and {len(culprits) - 5} more" if len(culprits) > 5 else ""
        verb = "has" if len(culprits) == 1 else "have"
        return Failure(f"{shown}{more} {verb} not answered step {step} for {silence:g} s", culprits)

    def _silent(self) -> tuple[str, ...]:
        """Return the processes that others wait for and that do not wait themselves."""
        wanted = {self._process_of(item) for stall in self.stalls.values() for item in stall.missing}
        return tuple(name for name in self.names if name in wanted and name not in self.stalls)

    def _process_of(self, item: str) -> str:
        """Return the process that has to send a missing item."""
        if item.startswith("agent "):
            agent_id = int(item.removeprefix("agent "))
            return self.hosts.get(agent_id, agent_name(agent_id))
        return PUBLISHER_OF.get(item, item)


def how_it_ended(code: int) -> str:
    """Describe how a process with this exit code (negative: signal) ended."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"was killed by signal {-code}"


def last_lines(texts: Iterable[tuple[str, str]], count: int = 8) -> str:
    """Return the last lines of logs, given as (name, text), for an error message."""
    parts = []
    for name, text in texts:
        lines = [line for line in text.splitlines() if line.strip()][-count:]
        if lines:
            parts.append("\n".join([f"last lines of {name}.log:", *(f"  {line}" for line in lines)]))
    return "\n".join(parts)
