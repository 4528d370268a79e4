"""Verification of a bag: each message must follow from the scenario and the messages before it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from swarmabs_analysis.difference import Difference
from swarmabs_analysis.verification.base import VerificationResult
from swarmabs_analysis.verification.earlier import are_earlier
from swarmabs_analysis.verification.lockstep import LockstepVerification
from swarmabs_analysis.verification.realtime import RealtimeVerification
from swarmabs_analysis.verification.trial import Trial
from swarmabs_bag.attached import (
    PROVENANCE_FILE,
    SCENARIO_FILE,
    arithmetic_of,
    attached_provenance,
    attached_scenario,
    events_in,
    is_realtime,
    lost,
    supply_scenario,
    versions,
)
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import realtime_world
from swarmabs_bag.run.realtime_gatherer import RECORDED
from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.graph import REALTIME, usual_topic
from swarmabs_config.model.errors import show
from swarmabs_config.scenario import on_plane
from swarmabs_core.arithmetic import ARITHMETIC, FORMER, FORMER_INTEGRATOR, FORMER_TOLERANCE, VERIFIED_FORMER
from swarmabs_core.declaration import tree_of
from swarmabs_core.errors import InputError
from swarmabs_core.messages import EVENTS, STANDING, Relay

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from swarmabs_analysis.verification.base import Verification
    from swarmabs_bag.reader import BagReader
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Topic
    from swarmabs_core.nodes import NodeName

DRIVERS = ("lockstep", "simulate", REALTIME.value)
"""The drivers, as recorded in the provenance, whose bags can be verified."""
NOT_VERIFIED = "not checked: events, and the time within its step at which a robot was measured"
"""Data that is never verified in a run in real time."""
_FORMER_NOTE = (
    f"recorded under the former arithmetic, which {VERIFIED_FORMER} verify bit by bit; here, numbers may differ by "
    f"{FORMER_TOLERANCE:g} (1 + |b|), those of the plane by {FORMER_INTEGRATOR:g} (1 + |b|)"
)


class BagToVerify:
    """An open bag with everything needed to verify it.

    `namespace` selects a swarm if the bag contains several; `scenario` supplies the one that a bag lacks.

    Raises
    ------
    InputError
        If it is not the bag of a swarm, has no scenario, or comes from an unknown driver or a later arithmetic.
    DamagedBagError
        If it is unreadable.
    """

    def __init__(self, path: Path, *, namespace: str | None = None, scenario: str | None = None) -> None:
        self._bag = open_bag(path, namespace=namespace, damaged=True)
        supply_scenario(self._bag, scenario)
        missing = [topic.name for topic in self._bag.family.main if topic not in self._bag.topics()]
        if missing and not self._bag.problem:
            raise NotABagError(f"{self._bag.path} is not the bag of a swarm: it lacks {', '.join(missing)}")
        self.scenario, self._from_outside = _scenario(self._bag)
        self._provenance = attached_provenance(self._bag)
        driver = self._provenance.get("driver", REALTIME.value if is_realtime(self._bag) else DRIVERS[0])
        if driver not in DRIVERS:
            raise InputError(
                f"{self._bag.path} was recorded by driver {show(driver)}, which cannot be verified; "
                f"this version verifies {', '.join(DRIVERS)}"
            )
        number = arithmetic_of(self._provenance)
        if number not in {None, FORMER, ARITHMETIC}:
            raise InputError(
                f"{self._bag.path} was recorded under arithmetic {number}, but this version computes with "
                f"{ARITHMETIC}; update swarmabs"
            )
        self._former = number == FORMER
        self._realtime = realtime_world(self._bag) if driver == REALTIME.value else None

    def trial(self, nodes: Sequence[NodeName], overrides: Sequence[str] = ()) -> Trial:
        """Return the trial of these nodes with changes of the scenario, each ``a.b=value``.

        Raises
        ------
        InputError
            As for `Trial`; or if the run was in real time, where answers depend on when messages arrive.
        """
        if self._realtime is not None:
            raise InputError(
                f"{self._bag.path} was recorded in real time: the answer of a node depends on when messages arrive, so "
                "no node can be tested against it; leave out --node"
            )
        return Trial(nodes, overrides, attached_scenario(self._bag, overrides), self.scenario)

    def verify(
        self,
        tolerance: float = 0.0,
        on_step: Callable[[int], None] | None = None,
        trial: Trial | None = None,
    ) -> VerificationResult:
        """Verify the bag, or in a `trial` only its nodes; damage does not raise but is part of the result.

        Numbers of a bag of the former arithmetic may differ by `FORMER_TOLERANCE`, the plane's state by
        `FORMER_INTEGRATOR`.

        After each message, or after several steps at once, `on_step` receives the first step that is not verified yet.
        """
        of_plane = 0.0
        if self._former and trial is None:
            tolerance, of_plane = max(tolerance, FORMER_TOLERANCE), FORMER_INTEGRATOR
        verification: Verification = (
            LockstepVerification(
                self.scenario,
                tolerance=tolerance,
                of_plane=of_plane,
                division=None if STANDING in self._bag.topics() else 0,
                absent=self._absent(),
                relayed=bool(self._relays()),
                earlier=are_earlier(events_in(self._bag), self.scenario),
                trial=trial,
            )
            if self._realtime is None
            else RealtimeVerification(
                on_plane(self.scenario, "real time"), self._realtime, tolerance=tolerance, of_plane=of_plane
            )
        )
        result = verification.result
        result.bag, result.scenario = str(self._bag.path), self.scenario.name
        result.problem = self._follow(verification, on_step)
        cut = result.problem is not None
        if not cut:
            try:
                result.ended_early = self._bag.aborted()
                self._bag.check()
            except DamagedBagError as error:
                result.problem = str(error)
        if self._realtime is not None:
            result.lost = lost(self._bag)
        verification.finish(whole=not cut and result.ended_early is None)
        if cut or result.difference is not None:
            result.digest = None
        elif result.digest is not None:
            result.difference = _other_digest(self._bag, result.digest)
        if self._former:
            result.notes = (*result.notes, _FORMER_NOTE)
        if trial is None:
            result.not_read = self._not_read()
        result.notes = (*result.notes, *self._notes(result))
        return result

    def _relays(self) -> list[Topic]:
        """Return the topics on which robots pass on what they know."""
        return [topic for topic in self._bag.topics() if topic.message is Relay] if self.scenario.decentralised else []

    def _absent(self) -> list[Topic]:
        """Return the further topics that the bag lacks."""
        return [topic for topic in self._bag.family.further if topic not in self._bag.topics()]

    def _not_read(self) -> tuple[str, ...]:
        """Return the names of the swarm's topics with messages that are not compared with anything."""
        further = self._bag.family.further
        read: set[Topic | None] = (
            {*self._bag.family.recorded, *self._relays(), EVENTS}
            if self._realtime is None
            else {*self._relays(), *(topic for topic in RECORDED if usual_topic(topic) not in further)}
        )
        return tuple(
            channel.name for channel in self._bag.of_swarm() if channel.message_count and channel.topic not in read
        )

    def _notes(self, result: VerificationResult) -> Iterator[str]:
        """Yield what was not verified, what the bag does not say and, if it differs, what may explain this."""
        yield from (f"not checked: {name}" for name in result.not_read)
        if self._realtime is not None:
            yield NOT_VERIFIED
            if measured := sorted(set(configure.members(self.scenario)) - set(self._realtime.robots)):
                yield f"not checked: the motion of robots {', '.join(map(str, measured))}, which was measured"
            if not self._realtime.plane:
                yield "not checked: the motion of the plane, which was measured"
        else:
            yield from self._from_outside
            yield from (f"not checked: {topic.name}, which the bag does not have" for topic in self._absent())
            if self.scenario.decentralised and not self._relays():
                yield "not checked: what the robots passed on, which the bag does not have"
            if not self._provenance:
                yield f"the bag has no readable {PROVENANCE_FILE}: its versions are unknown, and lockstep is assumed"
        then = self._provenance.get("versions")
        if result.difference is not None and isinstance(then, dict):
            now = versions(self.scenario)
            changed = [
                f"{name} {then[name]}, here {now.get(name, 'none')}" for name in then if then[name] != now.get(name)
            ]
            if changed:
                yield f"the bag was recorded with {'; '.join(changed)}"

    def _follow(self, verification: Verification, on_step: Callable[[int], None] | None) -> str | None:
        """Feed the bag's messages to the verification until it is decided; return the damage of the file, if any."""
        try:
            family = self.scenario.family
            topics = (*(RECORDED if self._realtime else (*family.recorded, EVENTS)), *self._relays())
            for part in self._bag.published(topics) if self._realtime else self._bag.whole_steps(topics):
                if isinstance(part, Step):
                    verification.add_steps(part)
                else:
                    # SQLite stores no publish times: bags converted from it have 0 there, and no provenance.
                    has_time = part.published or self._provenance
                    verification.add(part.topic, part.time, part.payload, part.published if has_time else None)
                if verification.decided:
                    break
                if on_step is not None:
                    on_step(verification.step)
        except DamagedBagError as error:
            return str(error)
        return self._bag.problem


def open_to_verify(
    path: Path, *, namespace: str | None = None, scenario: str | None = None
) -> BagToVerify | VerificationResult:
    """Open a bag, or return the result for one that is too damaged to compare. Parameters as for `BagToVerify`.

    Raises
    ------
    InputError
        As for `BagToVerify`.
    """
    try:
        return BagToVerify(path, namespace=namespace, scenario=scenario)
    except DamagedBagError as error:
        return VerificationResult(str(path), problem=str(error))


def _scenario(bag: BagReader) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario of a bag, and a note on requests from outside, which cannot be recomputed."""
    if bag.problem is not None and bag.attachment(SCENARIO_FILE) is None:
        raise DamagedBagError(f"{bag.path}: {bag.problem}; its scenario is lost with its end")
    planned = attached_scenario(bag, steered=False)
    try:
        scenario = attached_scenario(bag)
    except InputError:  # the events contradict the scenario: the first of them will be a difference
        return planned, ()
    done = [fault for fault in scenario.faults if fault not in planned.faults]
    trees = ({"kind": fault.kind, **tree_of(fault)} for fault in done[:20])
    shown = "; ".join(
        " ".join(f"{name} {value}" for name, value in tree.items() if value is not None) for tree in trees
    )
    more = f" and {len(done) - 20} more" if len(done) > 20 else ""
    return scenario, (f"requests from outside, taken from the events in the bag: {shown}{more}",) if done else ()


def _other_digest(bag: BagReader, digest: str) -> Difference | None:
    """Return a difference if the bag is in a run folder whose summary has another digest."""
    summary = bag.path.parent.parent / "summary.json"
    if bag.path.parent.name != "bag" or not summary.is_file():
        return None
    try:
        said = json.loads(summary.read_bytes())["digest"]
    except (OSError, ValueError, RecursionError, KeyError, TypeError):
        return Difference("summary.json", None, None, "digest", None, digest, "the file cannot be read")
    if said is None or said == digest:
        return None
    return Difference("summary.json", None, None, "digest", str(said), digest)
