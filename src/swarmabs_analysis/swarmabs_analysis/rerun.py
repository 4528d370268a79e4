"""Repetition of a recorded run: whether it is possible, what has changed, and whether the digest is the same."""

from __future__ import annotations

import platform
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

from swarmabs_analysis.comparison.messages import side_by_side
from swarmabs_bag.attached import (
    SCHEMA_VERSION,
    arithmetic_of,
    attached_provenance,
    attached_scenario,
    is_realtime,
    supply_scenario,
    versions,
    was_steered,
)
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run.digest import Digest
from swarmabs_bag.run.ordering import recorded_steps
from swarmabs_config import configure
from swarmabs_config.model.errors import printable, shorten, show
from swarmabs_config.scenario.steered import as_planned
from swarmabs_core.arithmetic import ARITHMETIC
from swarmabs_core.errors import InputError
from swarmabs_core.events import EventCode, code_of
from swarmabs_core.membership import Change, ChangeKind

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from swarmabs_bag.reader import BagReader
    from swarmabs_bag.run.step import Step
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import SwarmEvent
    from swarmabs_run.run import Outcome

_REPEATABLE = ("lockstep", "simulate")
_REMEDY = "run the scenario.yaml of its folder instead"


class Rerun(TypedDict):
    """The result of a repetition, ``rerun_of`` in ``summary.json``; `same` is None if the runs were not compared."""

    bag: str
    digest: str | None
    last_step: int
    same: bool | None
    compared: Literal["digest", "prefix"] | None
    differences: list[str]


@dataclass(frozen=True, slots=True)
class RepeatableRun:
    """A recorded run that can be repeated.

    The scenario includes the changes for the new run. Digest and last step are those of the messages, None and -1 if
    there are none; the run is complete if that step is the last one of the scenario and no step is missing. Each of the
    `differences` is a sentence on what has changed since the recording, or cannot be repeated. The digest is not
    `comparable` with that of a repetition if the arithmetic of its numbers was another.
    """

    bag: Path
    scenario: Scenario
    digest: str | None
    last_step: int
    complete: bool
    differences: tuple[str, ...]
    comparable: bool

    def judge(self, outcome: Outcome, bag: Path, *, changed: bool) -> Rerun:
        """Return the result of the repetition, for ``rerun_of`` in ``summary.json``.

        The bag of the new run may be missing. Runs of a `changed` scenario are not compared.
        """
        same: bool | None = None
        compared: Literal["digest", "prefix"] | None = None
        if self.comparable and not changed and self.digest is not None:
            same, compared = self._reached(outcome, bag)
        return {
            "bag": str(self.bag),
            "digest": self.digest,
            "last_step": self.last_step,
            "same": same,
            "compared": compared,
            "differences": list(self.differences),
        }

    def _reached(self, outcome: Outcome, bag: Path) -> tuple[bool | None, Literal["digest", "prefix"] | None]:
        if outcome.figures.get("digest") == self.digest:
            return True, "digest"
        if self.complete:
            return (None, None) if outcome.status == "interrupted" else (False, "digest")
        try:
            same = self._continued_by(open_bag(bag))
        except (NotABagError, DamagedBagError):  # there is no bag, or the disk was full
            return None, None
        return (None, None) if same is None and outcome.status == "interrupted" else (bool(same), "prefix")

    def _continued_by(self, bag: BagReader) -> bool | None:
        """Return whether another bag contains the messages of this one, None if it ends before them.

        Messages and steps may be missing here, if the bag is incomplete or was repaired.
        """
        for step, other in side_by_side(_main_steps(open_bag(self.bag)), _main_steps(bag)):
            if step is None:
                continue
            if other is None:
                return None
            if not {payload for *_, payload in step.stored()} <= {payload for *_, payload in other.stored()}:
                return False
        return True


def recorded_run(path: Path | str, overrides: Sequence[str] = (), *, scenario: str | None = None) -> RepeatableRun:
    """Read the recorded run that is to be repeated from its bag; `scenario` supplies the one that a bag lacks.

    Raises
    ------
    NotABagError
        If it is not a bag.
    InputError
        If the run cannot be repeated, with the reason; or if a change is invalid.
    DamagedBagError
        If the end of the bag is missing.
    """
    bag = open_bag(path, several=True)
    if len(bag.swarms) > 1:
        raise InputError(f"{bag.path} contains several swarms, but a run has only one; {_REMEDY}")
    supply_scenario(bag, scenario)
    recorded = attached_scenario(bag)
    changed = attached_scenario(bag, overrides) if overrides else recorded
    provenance = attached_provenance(bag)
    _check_repeatable(bag, provenance)
    differences = [*_differences(provenance, recorded)]
    digest, last_step, steps = Digest(), -1, 0
    ends: list[Change] = []
    try:
        for step in recorded_steps(bag.steps(), str(bag.path)):
            differences += _unrepeatable(bag, step, ends)
            if step.tables:
                digest.update(step)
                last_step = step.step
                steps += len(step)
    except DamagedBagError as error:
        differences.append(f"the bag can only be compared in part: {error}")
    there = set(configure.members(changed))
    ends = [end for end in ends if end.agent_id in there and 0 <= end.step <= changed.steps]
    return RepeatableRun(
        Path(path),
        as_planned(changed, (), ends=ends, source=str(bag.path)),
        digest.hexdigest() if last_step >= 0 else None,
        last_step,
        last_step == recorded.steps == steps - 1,
        tuple(differences),
        _same_arithmetic(provenance),
    )


def _check_repeatable(bag: BagReader, provenance: Mapping[str, object]) -> None:
    schema, driver = provenance.get("schema", SCHEMA_VERSION), provenance.get("driver", _REPEATABLE[0])
    if schema != SCHEMA_VERSION:
        raise InputError(
            f"{bag.path}: its provenance has schema {show(schema)}, but this version reads {SCHEMA_VERSION}; "
            "update swarmabs"
        )
    if is_realtime(bag):
        raise InputError(
            f"{bag.path} was recorded in real time: the messages that each robot received depended on the wall clock "
            f"and cannot be repeated; {_REMEDY}"
        )
    if driver not in _REPEATABLE:
        raise InputError(f"{bag.path} was made by {show(driver)}, which run and simulate cannot repeat; {_REMEDY}")
    if "replay" in provenance:
        raise InputError(f"{bag.path} is the replay of another bag, not a run; {_REMEDY}")


def _unrepeatable(bag: BagReader, step: Step, ends: list[Change]) -> Iterator[str]:
    """Yield disturbances of a run that its scenario does not contain, and collect unplanned ends of robots.

    Requests from outside are already part of the scenario, unless the run was not steerable.
    """
    steered = was_steered(bag)
    for event in step.events:
        if not steered and code_of(event) is EventCode.STEERING:
            raise InputError(
                f"{bag.path}: a setting was changed from outside at step {event.step} ({show(event.detail)}), "
                f"which cannot be repeated; {_REMEDY}"
            )
        end = _unplanned_end(event)
        if end is not None:
            ends.append(end)
            yield (
                f"in the bag robot {event.agent_id} fell silent at step {event.step} and was dropped, "
                "which is not part of the scenario: the repetition kills it at the step before"
            )


def _unplanned_end(event: SwarmEvent) -> Change | None:
    """Return the end of a robot if an event announces that it was dropped as silent."""
    if code_of(event) is EventCode.SILENT:
        return Change(event.step - 1, event.agent_id, ChangeKind.KILL)
    return None


def _differences(provenance: Mapping[str, object], scenario: Scenario) -> Iterator[str]:
    if not provenance:
        yield "the bag does not record its software versions: the digest may differ"
        return
    here: dict[str, object] = {"machine": platform.machine(), "byte order": sys.byteorder}
    there: dict[str, object] = {"machine": provenance.get("machine"), "byte order": provenance.get("byte_order")}
    made_with = provenance.get("versions")
    if isinstance(made_with, dict):
        there |= made_with
        here |= dict.fromkeys(made_with, "not installed") | versions(scenario)
    for name, value in there.items():
        if value is not None and value != here[name]:
            then = f"{_text(name)} {_text(value)}"
            yield f"the bag was made with {then}, here it is {here[name]}: the digest may differ"
    if not _same_arithmetic(provenance):
        yield (
            f"the bag was recorded under arithmetic {arithmetic_of(provenance)}, and this version computes with "
            f"{ARITHMETIC}: figures are close to those of its run, the digest is another"
        )


def _same_arithmetic(provenance: Mapping[str, object]) -> bool:
    return arithmetic_of(provenance) in {None, ARITHMETIC}


def _text(value: object) -> str:
    """Return text from a file as one short printable line."""
    return printable(shorten(str(value)))


def _main_steps(bag: BagReader) -> Iterator[Step]:
    """Yield the steps of a bag without its events, as far as it can be read."""
    try:
        for step in recorded_steps(bag.steps(), str(bag.path)):
            if step.tables:
                yield step
    except DamagedBagError:
        return
