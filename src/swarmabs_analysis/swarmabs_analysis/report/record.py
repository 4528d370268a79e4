"""The data of a report: a bag, what is known of its run, and the distances to its constraints."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from swarmabs_analysis.figures.runs import RecordedRun
from swarmabs_analysis.report.formatting import tolerated
from swarmabs_analysis.report.subject import Subject
from swarmabs_analysis.step_response import StepResponse, step_response
from swarmabs_bag.arrays import arrays_since, digest_of, load_messages
from swarmabs_bag.attached import attached_provenance, is_realtime, supply_scenario
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import realtime_figures
from swarmabs_bag.run.figures import RunFigures, Tracking, tracking_of
from swarmabs_bag.shown.recorded_swarm import recorded_swarm
from swarmabs_config import configure
from swarmabs_config.scenario import PlaneScenario, on_plane
from swarmabs_core.messages import EVENTS, STANDING, EventKind
from swarmabs_core.steering import DISTURBANCE
from swarmabs_core.theory.constraint_sets import ConstraintSets
from swarmabs_core.theory.general_theorems import clearance

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from swarmabs_bag.shown.recorded_swarm import RecordedSwarm
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.arrays import RunArrays
    from swarmabs_core.plant import Plane
    from swarmabs_core.systems import SystemTables

    Floats = NDArray[np.float64]

_LONGEST_JSON = 2**20
_MOST_ROWS = 10_000
"""Most steps for which the distance to A_A's boundary is computed; longer runs are subsampled."""


@dataclass(frozen=True, slots=True)
class Margins:
    """Distances of a run to its constraints; negative beyond them.

    At all steps: `end`, from the outermost robot to the plane's end, m; `spread`, S3/S0^2, m^2, which is 0 where the
    swarm is singular. At `rows`: the distance of the `actual` and the `desired` abstract state to the upper boundary
    J_A of A_A.
    """

    end: Floats
    spread: Floats
    rows: NDArray[np.int64]
    actual: Floats
    desired: Floats


class Setting(NamedTuple):
    """A value that someone set during a run, and the time for which it held, s."""

    begin: float
    end: float
    value: float


@dataclass(frozen=True)
class Recorded:
    """A bag, prepared for a report.

    The metrics are those of `summary.json` and the digest, computed from the bag's messages; `counts` are messages by
    topic. The provenance is empty if the bag contains none. The summary is the ``summary.json`` of the run folder if
    it belongs to this run; the note says where the timing comes from, or why there is none. `realtime` is the entry of
    that name in the summary of a run in real time.
    """

    swarm: RecordedSwarm
    metrics: Mapping[str, float | int | str | None]
    counts: Mapping[str, int]
    provenance: Mapping[str, Any]
    summary: Mapping[str, Any] | None
    summary_note: str
    realtime: Mapping[str, Any] | None = None

    @property
    def run(self) -> RecordedRun:
        """Scenario and arrays of a run on the plane, as the figures of the paper take them."""
        return RecordedRun(on_plane(self.scenario, "a figure of the paper"), self.arrays)

    @property
    def scenario(self) -> Scenario:
        """The scenario of the run."""
        return self.swarm.scenario

    @property
    def arrays(self) -> RunArrays:
        """The recorded steps."""
        return self.swarm.arrays

    @property
    def tables(self) -> SystemTables:
        """Names and units of the numbers."""
        return self.swarm.tables

    @property
    def plane(self) -> Plane | None:
        """The plane, if it is the parent system: what only the plane has is shown if it is there."""
        return self.scenario.plane if isinstance(self.scenario, PlaneScenario) else None

    @cached_property
    def tracking(self) -> Tracking:
        """What of the parent's state follows the reference."""
        return tracking_of(self.scenario)

    @property
    def within(self) -> str:
        """The errors below which what is tracked counts as settled, in words."""
        tolerances = sorted(set(self.tracking.tolerances))
        return " or ".join(tolerated(tolerance, self.tracking.unit) for tolerance in tolerances)

    @cached_property
    def subject(self) -> Subject:
        """What to say of the parent system and its robots."""
        return Subject(self.tables)

    @property
    def tracked(self) -> Floats:
        """The numbers of the parent's state that follow the reference, (n+1, T)."""
        return self.swarm.arrays.parent[:, self.tracking.followed]

    @property
    def references(self) -> Floats:
        """Their references, (n+1, T)."""
        return self.swarm.arrays.references

    @cached_property
    def coordinates(self) -> Floats:
        """Coordinates of the robots as recorded, (n+1, N, d)."""
        return self.swarm.arrays.agents.vector("coordinates")

    def settings(self, name: str) -> list[Setting]:
        """Return the values of a setting of the whole run (`DISTURBANCE` or `REFERENCE`) that was changed in it."""
        events = [event for event in self.swarm.events if event.kind == EventKind.STEERING and event.detail == name]
        times = [*map(self.swarm.time_of, events), float(self.arrays.time[-1])]
        return [Setting(begin, end, event.value) for event, begin, end in zip(events, times, times[1:], strict=False)]

    @property
    def disturbances(self) -> list[Setting]:
        """The constant disturbances, without the times in which there was none."""
        return [setting for setting in self.settings(DISTURBANCE) if setting.value]

    @property
    def reference_unit(self) -> str:
        """Unit of the reference; empty if several quantities follow one."""
        return self.tracking.unit if len(self.tracking.followed) == 1 else ""

    @property
    def steps(self) -> int:
        """Number of steps of the parent."""
        return max(len(self.swarm) - 1, 0)

    @property
    def drawable(self) -> bool:
        """Whether the recording spans any time."""
        return len(self.arrays.time) > 1 and float(self.arrays.time[-1]) > 0.0

    @cached_property
    def error(self) -> Floats:
        """Reference minus recorded angle at each step, rad; of several tracked numbers, the norm of the errors."""
        errors: Floats = self.references - self.tracked
        return errors[:, 0] if errors.shape[1] == 1 else np.asarray(np.linalg.norm(errors, axis=1))

    @cached_property
    def step_response(self) -> StepResponse | None:
        """Response to the last step of the reference; None without one, and if several numbers are tracked."""
        if self.tracked.shape[1] != 1:
            return None
        return step_response(self.arrays.time, self.tracked[:, 0], self.references[:, 0])

    @cached_property
    def masses(self) -> Floats:
        """Masses of the robots, kg, (N,)."""
        agents = self.arrays.agents
        return np.asarray(np.nanmax(np.where(agents.kind > 0, agents.mass, -np.inf), axis=0, initial=-np.inf))

    @property
    def torque(self) -> Floats:
        """The torque of the weights on the plane at each step, N m; dead robots count, robots that left do not."""
        gravity = self.run.scenario.plane.gravity
        return np.asarray(np.nansum(self.masses * self.swarm.coordinates[..., 0], axis=1) * gravity)

    def spans(self) -> Iterator[tuple[int, int, tuple[float, ...]]]:
        """Yield spans of rows [begin, end) with the same robots on the plane, and their masses, kg."""
        there = self.swarm.on_plane
        if not len(there):
            return
        changes = np.flatnonzero((there[1:] != there[:-1]).any(axis=1)) + 1
        begins = [0, *changes.tolist()]
        for begin, end in zip(begins, [*begins[1:], len(there)], strict=True):
            yield begin, end, tuple(self.masses[there[begin]].tolist())

    @cached_property
    def margins(self) -> Margins:
        """The distances to the constraints; A_A is that of all robots on the plane."""
        arrays, plane = self.run.arrays, self.run.scenario.plane
        rows = np.arange(0, len(arrays.step), max(1, -(-len(arrays.step) // _MOST_ROWS)))
        actual, desired = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
        for begin, end, masses in self.spans():
            if len(masses) < 2 or not min(masses) > 0:
                continue
            sets = ConstraintSets(masses, plane.length, plane.gravity)
            chosen = np.flatnonzero((rows >= begin) & (rows < end))
            for distances, state in ((actual, arrays.abstract), (desired, arrays.desired)):
                pairs = zip(state.torque[rows[chosen]].tolist(), state.inertia[rows[chosen]].tolist(), strict=True)
                distances[chosen] = [
                    clearance(sets, torque, inertia).upper if np.isfinite(torque) and np.isfinite(inertia) else np.nan
                    for torque, inertia in pairs
                ]
        positions = np.abs(self.swarm.coordinates[..., 0])
        reach = np.where(self.swarm.on_plane, positions, -np.inf).max(axis=1, initial=-np.inf)
        end_margin = plane.length / 2.0 - np.where(np.isfinite(reach), reach, np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = arrays.auxiliary.s3 / arrays.auxiliary.s0**2
        return Margins(end_margin, np.where(np.isfinite(spread), spread, np.nan), rows, actual, desired)

    @cached_property
    def rank_margin(self) -> Floats:
        """Smallest eigenvalue of the scaled Gram matrix by its largest diagonal entry; not for the plane."""
        scales = np.array([row.scale for row in self.tables.abstract])
        rows, columns = np.tril_indices(len(scales))
        matrix = np.zeros((len(self.arrays.step), len(scales), len(scales)))
        scaled = np.nan_to_num(self.arrays.auxiliary.gram) / (scales[rows] * scales[columns])
        matrix[:, rows, columns] = matrix[:, columns, rows] = scaled
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.linalg.eigvalsh(matrix)[:, 0] / np.diagonal(matrix, axis1=1, axis2=2).max(axis=1)

    @property
    def estimated(self) -> bool:
        """Whether the recorded torque of the swarm is an estimate from the plane's motion."""
        return self.plane is not None and self.run.scenario.observer.type == "parent_response"

    @property
    def falsified_note(self) -> str:
        """Name the robots that publish a falsified state; empty if there are none."""
        ids = sorted({fault.agent_id for fault in configure.falsifications(self.scenario)})
        if not ids:
            return ""
        who = f"Robot {ids[0]} publishes" if len(ids) == 1 else f"Robots {', '.join(map(str, ids))} publish"
        return (
            f"{who} a falsified state (an injected fault): {self.subject.falsified}, and everything computed from "
            "them, are the published ones."
        )

    @property
    def measured(self) -> bool:
        """Whether the recorded motion of the plane comes from an imperfect sensor."""
        return self.plane is not None and not self.plane.sensor.perfect

    @property
    def sensed(self) -> bool:
        """Whether robots on the plane measure their states with imperfect sensors."""
        return self.plane is not None and not self.run.scenario.swarm.sensor.perfect


def read_recorded(path: Path, *, namespace: str | None = None, scenario: str | None = None) -> Recorded:
    """Read a bag for a report, an incomplete one as far as it goes; errors as for `make_report`."""
    bag = open_bag(path, namespace=namespace, damaged=True)
    supply_scenario(bag, scenario)
    messages = load_messages(bag)
    tables = messages.tables
    arrays, _ = arrays_since(bag, messages)
    swarm = recorded_swarm(bag, messages, arrays)
    realtime = realtime_figures(bag, swarm.scenario) if is_realtime(bag) else None
    if realtime is None:
        count = sum(map(len, tables.values())) + messages.divided + len(swarm.events) + len(bag.family.once)
        figures = _metrics(swarm, arrays)
        unknown = figures["final_error"] is None and tracking_of(swarm.scenario).followed
        metrics = {**figures, "messages": count, "digest": None if unknown else digest_of(tables)}
    else:
        metrics = {**realtime.figures(), "digest": None}
    counts = {topic.name: len(rows) for topic, rows in tables.items()}
    if messages.divided:
        counts[STANDING.name] = messages.divided
    summary, note = _summary(bag.path, metrics["digest"])
    return Recorded(
        swarm=swarm,
        metrics=metrics,
        counts=counts | {EVENTS.name: len(swarm.events)},
        provenance=attached_provenance(bag),
        summary=summary,
        summary_note=note,
        realtime=None if realtime is None else realtime.realtime(),
    )


def _metrics(swarm: RecordedSwarm, arrays: RunArrays) -> dict[str, float | int | None]:
    """Return the figures of the run, by the same arithmetic as during the recording.

    Numbers that cannot be drawn count, too, so the arrays are those of the bag, and not of the swarm.
    """
    figures = RunFigures(configure.reference(swarm.scenario), tracking_of(swarm.scenario))
    states = zip(arrays.time.tolist(), arrays.step.tolist(), arrays.parent.tolist(), strict=True)
    for time, step, state in states:
        if not np.isnan(state[0]):
            figures.follow(step, round(time * 1e9) / 1e9, tuple(state))
    for event in swarm.events:
        figures.strays.hear(event, event.stamp / 1e9)
    coordinates = np.abs(arrays.agents.vector("coordinates"))
    there = coordinates[arrays.agents.kind > 0]
    if there.size:
        figures.reach(float(there.max()))
    return figures.figures()


def _summary(bag: Path, digest: object) -> tuple[Mapping[str, Any] | None, str]:
    """Return the summary of the run whose folder contains the bag, and a note on where the timing comes from."""
    file = bag.resolve().parent.parent / "summary.json"
    try:
        if bag.resolve().parent.name != "bag" or not file.is_file():
            return None, "not recorded: a bag contains no wall time, and the summary.json of its run is missing"
        with file.open("rb") as stream:
            summary = _mapping(stream.read(_LONGEST_JSON))
    except OSError as error:
        return None, f"not known: summary.json cannot be read ({error.strerror})"
    if summary.get("digest") != digest:
        return None, "not known: the digest in the run folder's summary.json differs, so it belongs to another run"
    return summary, "from summary.json of the run folder; the bag itself contains no wall time"


def _mapping(data: bytes) -> dict[str, Any]:
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}
