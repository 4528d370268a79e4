"""What a report is about: a bag with everything that is known of its run, read once."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmabs_analysis.figures.runs import RecordedRun
from swarmabs_bag.arrays import arrays_of, load_tables
from swarmabs_bag.attached import attached_provenance, attached_scenario
from swarmabs_bag.digest import digest_of
from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime import is_realtime, law_begins, realtime_figures
from swarmabs_bag.recording import Metrics, Record, RecordedStep
from swarmabs_config import configure
from swarmabs_core.arrays import MessageArrays
from swarmabs_core.messages import AGENT_STATE, EVENTS, MAIN_TOPICS, PLANE_STATE, Kind, PlaneState, SwarmEvent

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from swarmabs_bag.reader import BagReader
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.arrays import RunArrays, Tables

    Floats = NDArray[np.float64]

_LONGEST_JSON = 2**20
_DRAWABLE = 1e100
"""Numbers beyond are not drawn: no axis of a picture holds them."""


@dataclass(frozen=True)
class Recorded:
    """A bag as a report shows it.

    Attributes
    ----------
    bag : Path
        The MCAP file.
    run : RecordedRun
        Scenario and arrays; what cannot be drawn, such as infinity, is NaN in them.
    events : tuple of SwarmEvent
        In the order of their steps.
    metrics : dict
        ``settled_at``, ``final_error``, ``rms_error``, ``max_abs_position``, ``messages`` as in ``summary.json``, and
        ``digest``; computed from the bag's messages.
    counts : dict
        Number of messages by topic.
    status, reason : str, str or None
        How the run ended, as far as the bag says.
    provenance : dict
        What the bag says of its origin, empty if nothing.
    summary : dict or None
        The ``summary.json`` beside the bag, if it is of this run.
    summary_note : str
        Where the timing comes from, or why there is none.
    law_time : ndarray, (n+1,)
        Time of the parent controller's law at each step, s; in real time it begins anew with each reset, and is NaN
        where the controller has not answered.
    realtime : dict or None
        Figures that only a run in real time has, as under ``realtime`` in ``summary.json``.
    swarm : str or None
        Namespace of the swarm; None where it is in none, and the bag holds no other.
    """

    bag: Path
    run: RecordedRun
    events: tuple[SwarmEvent, ...]
    metrics: Mapping[str, float | int | str | None]
    counts: Mapping[str, int]
    status: str
    reason: str | None
    provenance: Mapping[str, Any]
    summary: Mapping[str, Any] | None
    summary_note: str
    law_time: Floats
    realtime: Mapping[str, Any] | None = None
    swarm: str | None = None

    def time_of(self, event: SwarmEvent) -> float:
        """Return the time of an event's step, s: the clock that has stamped it may be wrong."""
        return event.step * self.scenario.period

    @property
    def scenario(self) -> Scenario:
        """What was run."""
        return self.run.scenario

    @property
    def arrays(self) -> RunArrays:
        """The recorded steps."""
        return self.run.arrays

    @property
    def steps(self) -> int:
        """How many steps the plane has made."""
        return max(len(self.arrays.step) - 1, 0)

    @property
    def drawable(self) -> bool:
        """Whether there is any time to draw something over."""
        return len(self.arrays.time) > 1 and float(self.arrays.time[-1]) > 0.0

    @cached_property
    def reference(self) -> Floats:
        """The angle wanted at each step, rad."""
        reference = configure.reference(self.scenario)
        return np.array([reference(t) if t == t else t for t in self.law_time.tolist()])  # noqa: PLR0124 - NaN stays

    @cached_property
    def error(self) -> Floats:
        """Wanted minus recorded angle at each step, rad."""
        return self.reference - self.arrays.angle

    @property
    def estimated(self) -> bool:
        """Whether the recorded torque of the swarm is an estimate from the plane's motion."""
        return self.scenario.observer.type == "parent_response"

    @property
    def lies_note(self) -> str:
        """Say whose positions and masses are not true, empty if all are."""
        ids = sorted({lie.agent_id for lie in configure.lies(self.scenario)})
        if not ids:
            return ""
        who = f"Robot {ids[0]} lies" if len(ids) == 1 else f"Robots {', '.join(map(str, ids))} lie"
        return (
            f"{who} by an injected fault: positions and masses are the published ones, and so is what is computed from "
            "them."
        )

    @property
    def measured(self) -> bool:
        """Whether the recorded motion of the plane is that of an imperfect sensor."""
        sensor = self.scenario.plane.sensor
        return any((*sensor.noise, *sensor.resolution))


def read_recorded(path: Path, *, namespace: str | None = None) -> Recorded:
    """Read a bag for a report; one that has lost its end too, as far as it goes.

    Raises
    ------
    InputError
        If it is no bag of a swarm, or holds no valid scenario.
    DamagedBagError
        If it cannot be read, or holds a robot of an unknown kind.
    """
    bag = open_bag(path, namespace=namespace, damaged=True)
    scenario = attached_scenario(bag)
    tables = load_tables(bag)
    _check_kinds(bag, tables)
    arrays, events = arrays_of(bag, tables), _events(bag)
    realtime = realtime_figures(bag, scenario) if is_realtime(bag) else None
    if realtime is None:
        metrics = {**_metrics(scenario, arrays), "messages": sum(map(len, tables.values())) + len(events)}
        metrics["digest"] = digest_of(tables) if metrics["final_error"] is not None else None
        law_time = arrays.time
    else:
        metrics = {**realtime.summary(), "digest": None}
        law_time = _law_time(bag, scenario, arrays)
        events = _since_first(events, tables)
    states = None if realtime is not None else len(tables[PLANE_STATE])
    status, reason = _ending(bag, scenario, states)
    summary, note = _summary(bag.path, metrics["digest"])
    return Recorded(
        bag=bag.path,
        run=RecordedRun(scenario, _drawable(arrays)),
        events=events,
        metrics=metrics,
        counts={topic.name: len(tables[topic]) for topic in MAIN_TOPICS} | {EVENTS.name: len(events)},
        status=status,
        reason=reason,
        provenance=attached_provenance(bag),
        summary=summary,
        summary_note=note,
        law_time=law_time,
        realtime=None if realtime is None else realtime.realtime(),
        swarm=_swarm(bag),
    )


def _swarm(bag: BagReader) -> str | None:
    if bag.namespace is None or (bag.namespace == "/" and len(bag.swarms) <= 1):
        return None
    return bag.namespace.rstrip("/") or "/"


def _check_kinds(bag: BagReader, tables: Tables) -> None:
    states = tables[AGENT_STATE]
    wrong = states[~np.isin(states["kind"], [kind.value for kind in Kind])]
    if len(wrong):
        first = wrong[0]
        raise DamagedBagError(
            f"{bag.path}: agent {first['agent_id']} at step {first['step']}: {first['kind']} is no kind of robot"
        )


def _events(bag: BagReader) -> tuple[SwarmEvent, ...]:
    found = [message for _, _, message in bag.decoded((EVENTS,)) if isinstance(message, SwarmEvent)]
    return tuple(sorted(found, key=lambda event: event.step))


def _metrics(scenario: Scenario, arrays: RunArrays) -> dict[str, float | int | str | None]:
    """Return the figures of the run, by the same arithmetic as while it is recorded."""
    metrics = Metrics(configure.reference(scenario))
    states = zip(arrays.time.tolist(), arrays.step.tolist(), arrays.angle.tolist(), strict=True)
    for time, step, angle in states:
        if not np.isnan(angle):
            state = PlaneState(round(time * 1e9), step, angle, 0.0)
            metrics.update(RecordedStep(step, (Record(PLANE_STATE, 0, state, b""),)))
    positions = np.abs(arrays.agents.position)
    there = positions[arrays.agents.kind > 0]
    reach = float(there.max()) if there.size else None
    finite = reach if reach is not None and np.isfinite(reach) else None
    return {**metrics.summary(), "max_abs_position": finite}


def _law_time(bag: BagReader, scenario: Scenario, arrays: RunArrays) -> Floats:
    begins = law_begins(bag)
    periods = [step - begins[step] if step in begins else np.nan for step in arrays.step.tolist()]
    return np.array(periods, dtype=np.float64) * scenario.period


def _since_first(events: tuple[SwarmEvent, ...], tables: Tables) -> tuple[SwarmEvent, ...]:
    """Return events at their times since the first message of a run, as the arrays have them."""
    first = min(
        (int(rows["sec"][0]) * 10**9 + int(rows["nanosec"][0]) for rows in tables.values() if len(rows)), default=0
    )
    return tuple(event._replace(stamp=max(0, event.stamp - first)) for event in events)


def _ending(bag: BagReader, scenario: Scenario, states: int | None) -> tuple[str, str | None]:
    """Return how the run ended; `states` of the plane are not counted where a step may have none."""
    if bag.problem is not None:
        return "damaged", f"the bag has lost its end: {bag.problem}"
    reason = bag.aborted()
    if reason is not None:
        return ("interrupted" if reason.startswith("interrupted") else "failed"), reason
    if states is not None and states != scenario.steps + 1:
        return "incomplete", f"{states} of {scenario.steps + 1} states of the plane are recorded"
    return "ok", None


def _summary(bag: Path, digest: object) -> tuple[Mapping[str, Any] | None, str]:
    """Return the summary of the run whose folder holds the bag, and what is to be said of it."""
    file = bag.resolve().parent.parent / "summary.json"
    try:
        if bag.resolve().parent.name != "bag" or not file.is_file():
            return None, "not recorded: a bag holds no wall time, and no summary.json of its run lies beside it"
        with file.open("rb") as stream:
            found = _mapping(stream.read(_LONGEST_JSON))
    except OSError as error:
        return None, f"not known: summary.json cannot be read ({error.strerror})"
    if found.get("digest") != digest:
        return None, "not known: the summary.json beside the bag has another digest, it is of another run"
    return found, "from summary.json beside the bag; the bag itself holds no wall time"


def _mapping(data: bytes) -> dict[str, Any]:
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _drawable(run: RunArrays) -> RunArrays:
    """Replace by NaN what no picture can show."""
    found = {field.name: getattr(run, field.name) for field in fields(run)}
    groups = {name: value for name, value in found.items() if isinstance(value, MessageArrays)}
    shown = {name: _finite(value) for name, value in found.items() if name not in groups}
    for name, group in groups.items():
        shown[name] = MessageArrays({field: _finite(column) for field, column in group.items()})
    return replace(run, **shown)


def _finite(column: Any) -> Any:
    if column.dtype.kind != "f":
        return column
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(column) < _DRAWABLE, column, np.nan)
