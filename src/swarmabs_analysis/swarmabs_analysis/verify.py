"""Verifying a bag: what it holds follows from its scenario, message by message."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from swarmabs_analysis.difference import Difference
from swarmabs_analysis.verification.base import Verdict
from swarmabs_analysis.verification.lockstep import LockstepVerification
from swarmabs_analysis.verification.realtime import RealtimeVerification
from swarmabs_bag.attached import (
    PROVENANCE_FILE,
    SCENARIO_FILE,
    attached_provenance,
    attached_scenario,
    is_realtime,
    plugin_versions,
    supply_scenario,
    versions,
)
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime import RECORDED, realtime_world
from swarmabs_config import configure
from swarmabs_config.graph import REALTIME
from swarmabs_config.model.errors import show
from swarmabs_core.declaration import tree_of
from swarmabs_core.errors import InputError
from swarmabs_core.fingerprint import libm_fingerprints
from swarmabs_core.messages import EVENTS, MAIN_TOPICS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from swarmabs_analysis.verification.base import Verification
    from swarmabs_bag.reader import BagReader
    from swarmabs_config.scenario import Scenario

DRIVERS = ("lockstep", "simulate", REALTIME.value)
"""What moved the state machines of a bag that can be verified, as its provenance says."""
NOT_VERIFIED = "events, and when within its step a robot was measured, do not follow from other messages"
"""What is never verified of a run in real time."""


class BagToVerify:
    """A bag that was opened, and has what is needed to verify it; of several swarms in it, that of a namespace.

    A bag without a scenario is verified with the one named `scenario`.

    Raises
    ------
    InputError
        If it is no bag of a swarm, has no scenario, or it is not known how its messages were made.
    DamagedBagError
        If nothing of it can be read.
    """

    def __init__(self, path: Path, *, namespace: str | None = None, scenario: str | None = None) -> None:
        self._bag = open_bag(path, namespace=namespace, damaged=True)
        supply_scenario(self._bag, scenario)
        missing = [topic.name for topic in MAIN_TOPICS if topic not in self._bag.topics()]
        if missing and not self._bag.problem:
            raise NotABagError(f"{self._bag.path} is no bag of a swarm: it has no topic {', '.join(missing)}")
        self.scenario, self._from_outside = _scenario(self._bag)
        self._provenance = attached_provenance(self._bag)
        driver = self._provenance.get("driver", REALTIME.value if is_realtime(self._bag) else DRIVERS[0])
        if driver not in DRIVERS:
            raise InputError(
                f"{self._bag.path} was recorded by driver {show(driver)}, and it is not known how its messages follow "
                f"from each other; this version knows {', '.join(DRIVERS)}"
            )
        self._realtime = realtime_world(self._bag) if driver == REALTIME.value else None

    def verify(self, tolerance: float = 0.0, on_step: Callable[[int], None] | None = None) -> Verdict:
        """Verify the bag; damage does not raise, it is part of the answer.

        At every message `on_step` is told the first step that is not verified yet.
        """
        verification: Verification = (
            LockstepVerification(self.scenario, tolerance=tolerance)
            if self._realtime is None
            else RealtimeVerification(self.scenario, self._realtime, tolerance=tolerance)
        )
        found = verification.found
        found.bag, found.scenario = str(self._bag.path), self.scenario.name
        found.problem = self._follow(verification, on_step)
        cut = found.problem is not None
        if not cut:
            try:
                found.ended_early = self._bag.aborted()
                self._bag.check()
            except DamagedBagError as error:
                found.problem = str(error)
        verification.finish(whole=not cut and found.ended_early is None)
        if cut or found.difference is not None:
            found.digest = None
        elif found.digest is not None:
            found.difference = _other_digest(self._bag, found.digest)
        notes = self._not_recomputed() if self._realtime else (*self._from_outside, *self._unsaid())
        found.notes = (*notes, *(() if found.difference is None else self._elsewhere()))
        return found

    def _not_recomputed(self) -> tuple[str, ...]:
        """Return what of a run in real time is not verified."""
        assert self._realtime is not None  # noqa: S101 - asked only of such a run
        notes = [NOT_VERIFIED]
        if measured := sorted(set(configure.members(self.scenario)) - set(self._realtime.robots)):
            notes.append(f"not checked: the motion of robots {', '.join(map(str, measured))}, which was measured")
        if not self._realtime.plane:
            notes.append("not checked: the motion of the plane, which was measured")
        return tuple(notes)

    def _follow(self, verification: Verification, on_step: Callable[[int], None] | None) -> str | None:
        """Hand the bag's messages over, as long as they matter; return what is wrong with the file."""
        try:
            topics = RECORDED if self._realtime else (*MAIN_TOPICS, EVENTS)
            for topic, time, published, payload in self._bag.published(topics):
                verification.add(topic, time, payload, published)
                if verification.decided:
                    break
                if on_step is not None:
                    on_step(verification.step)
        except DamagedBagError as error:
            return str(error)
        return self._bag.problem

    def _unsaid(self) -> tuple[str, ...]:
        """Return what the bag does not say of its origin."""
        if self._provenance:
            return ()
        what = f"the bag has no {PROVENANCE_FILE} that can be read"
        return (f"{what}: it does not say with what it was made, and was taken for a run in lockstep",)

    def _elsewhere(self) -> tuple[str, ...]:
        """Return what was different where the bag was recorded and may explain a difference."""
        notes = []
        recorded, here = self._provenance.get("libm_fingerprint"), libm_fingerprints()
        if recorded is not None and recorded not in here:
            notes.append(
                f"the bag was recorded with another mathematical library (fingerprint {recorded}, here {here[0]}): "
                "bits may differ for that alone; --tolerance 1e-9 compares numbers instead"
            )
        then = self._provenance.get("versions")
        if isinstance(then, dict):
            now = versions() | plugin_versions(self.scenario)
            changed = [
                f"{name} {then[name]}, here {now.get(name, 'none')}" for name in then if then[name] != now.get(name)
            ]
            if changed:
                notes.append(f"the bag was recorded with {'; '.join(changed)}")
        return tuple(notes)


def open_to_verify(path: Path, *, namespace: str | None = None, scenario: str | None = None) -> BagToVerify | Verdict:
    """Open a bag; a file so damaged that nothing can be compared is a verdict already. Parameters as of `BagToVerify`.

    Raises
    ------
    InputError
        As of `BagToVerify`.
    """
    try:
        return BagToVerify(path, namespace=namespace, scenario=scenario)
    except DamagedBagError as error:
        return Verdict(str(path), problem=str(error))


def _scenario(bag: BagReader) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario of a bag, and a note on what of it was done from outside, which nothing can recompute."""
    if bag.problem is not None and bag.attachment(SCENARIO_FILE) is None:
        raise DamagedBagError(f"{bag.path}: {bag.problem}; with its end it has lost its scenario")
    planned = attached_scenario(bag, steered=False)
    try:
        scenario = attached_scenario(bag)
    except InputError:  # the events contradict the scenario: the first that does is a difference
        return planned, ()
    done = [fault for fault in scenario.faults if fault not in planned.faults]
    trees = ({"kind": fault.kind, **tree_of(fault)} for fault in done[:20])
    shown = "; ".join(
        " ".join(f"{name} {value}" for name, value in each.items() if value is not None) for each in trees
    )
    more = f" and {len(done) - 20} more" if len(done) > 20 else ""
    return scenario, (f"from outside, by the events in the bag: {shown}{more}",) if done else ()


def _other_digest(bag: BagReader, digest: str) -> Difference | None:
    """Return that the summary of the run, if the bag lies in its folder, tells another digest."""
    summary = bag.path.parent.parent / "summary.json"
    if bag.path.parent.name != "bag" or not summary.is_file():
        return None
    try:
        found = json.loads(summary.read_bytes())
        said = found["digest"]
    except (OSError, ValueError, RecursionError, KeyError, TypeError):
        return Difference("summary.json", None, None, "digest", None, digest, "it cannot be read")
    if said is None or said == digest:
        return None
    return Difference("summary.json", None, None, "digest", str(said), digest)
