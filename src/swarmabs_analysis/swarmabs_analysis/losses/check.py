"""Conditions on a swarm that loses robots, evaluated by simulation, for the report of the theory.

Planned losses (kill, freeze, leave, remove) are simulated as the scenario plans them. On request each robot and each
pair of robots is killed at the start, and when its contribution to the abstract state or its coordinates are largest.
Nothing is recorded.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, groupby
from math import inf
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swarmabs_analysis.losses.measures import Measures, Watch
from swarmabs_analysis.losses.rehearsal import Rehearsal
from swarmabs_config import configure
from swarmabs_core.faults import DriveFailureFault, MembershipFault
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import coordinates_of
from swarmabs_core.theory.report import Condition, Form, Loss, Report, Theorem, Verdict

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.faults import Fault
    from swarmabs_core.messages import AnyRobotState
    from swarmabs_core.theory.report import Number

AFTER_PLANNED, AFTER_ANY = 10.0, 5.0
"""Time, s, that is simulated after the last planned loss, and after each loss on request."""
FINAL = 1.0
"""Time, s, at the end of a simulation in which the parent must be settled and the law must act."""
MOST_STATES = 1_000_000
"""Most states of robots that are simulated after losses on request; half of them after losses of pairs."""
MOST_UNDISTURBED = 100_000
"""Most states of robots that are simulated without losses, where only limits require it."""


class Threshold(NamedTuple):
    """A condition on a simulation: its name, its inequality, the number in it, and the reason."""

    name: str
    form: str
    number: float
    reason: str


def _threshold(name: str, form: str, number: float, reason: str) -> Threshold:
    return Threshold(name, form.format(number, FINAL), number, reason)


RUN = _threshold(
    "run",
    "simulated time >= the planned time, s",
    0.0,
    "the parent must not fail, such as a plane that turns over",
)
REACH = _threshold(
    "reach",
    "coordinates of all robots within their ends",
    0.0,
    "a robot beyond an end of the plane is lost, as is one beyond an end that the parent system states for a "
    "coordinate, or else beyond an assumed one; without a stated end, the value is the number of such robots",
)
SPEED = _threshold(
    "speed",
    "largest speed <= the larger of {:g} times that without the loss, and 1 length or scale per s",
    5.0,
    "a nearly singular swarm is flung; one that only makes up for a robot moves little faster than before. The length "
    "is that of the plane, the scale that of the coordinate; first-order lags do not move",
)
SETTLED = _threshold(
    "settled",
    "largest error in the last {1:g} s, in tolerances <= the larger of 1, and {0:g} times that without the loss",
    2.0,
    "the parent must follow its reference again as well as it does without the loss, or be settled",
)
LIMITS = _threshold(
    "limits",
    "share of the last {1:g} s in which commands are limited and the parent is not settled, or all are limited < {0:g}",
    1.0,
    "a limit that acts for a moment, or for which other robots make up, does no harm",
)
LAW = _threshold(
    "law",
    "robots that brake at the end because the law is not defined <= {:g}",
    0.0,
    "a swarm that cannot follow the law does not control the parent",
)
THRESHOLDS = (RUN, REACH, SPEED, SETTLED, LIMITS, LAW)


def check_losses(scenario: Scenario, report: Report, *, any_loss: bool = False) -> Report:
    """Return a report of the theory with conditions on simulations, if robots are lost or their commands limited.

    Parameters
    ----------
    scenario : Scenario
        The scenario, whose planned losses are simulated.
    report : Report
        Its report, such as that of `swarmabs_config.theory.check_scenario`.
    any_loss : bool
        Whether to lose each robot and each pair of robots, too.

    Raises
    ------
    InputError
        If the nodes cannot be copied, which `any_loss` requires.
    """
    measures, planned = Measures(scenario), _ends(scenario)
    if not (any_loss or planned or measures.of.limits):
        return report
    steps, robots = scenario.steps, configure.members(scenario)
    end = min(steps, MOST_UNDISTURBED // len(robots))
    if any_loss:
        end = steps
    elif planned:
        end = min(steps, planned[-1].step + measures.steps(AFTER_PLANNED))
    normal = _Traced(measures, robots, end)
    Rehearsal(_without(scenario, planned)).advance(end, normal)
    title = f"simulated without losses until {end * measures.period:g} s"
    groups = [Theorem("undisturbed", title, tuple(_conditions(normal, end)))]
    losses, notes = list[Loss](), list[str]()
    for group, loss in _planned(scenario, planned, normal, end):
        groups.append(group)
        losses.append(loss)
    if any_loss:
        if planned:
            normal = _Traced(measures, robots, end)
            Rehearsal(scenario).advance(end, normal)
        for group, of_group, note in _on_request(scenario, normal):
            groups.append(group)
            losses += of_group
            notes += note
    losses.sort(key=lambda loss: (-len(loss.failed), -loss.speed, loss.time, loss.robots))
    return replace(report, simulated=tuple(groups), losses=tuple(losses), notes=(*report.notes, *notes))


def _ends(scenario: Scenario) -> list[Change]:
    """Return the planned ends of robots before the last step."""
    changes = configure.schedule(scenario)
    return [change for change in changes if change.kind is not ChangeKind.JOIN and change.step < scenario.steps]


def _without(scenario: Scenario, planned: Sequence[Change]) -> Scenario:
    """Return a scenario without the planned ends of robots, and without the failures of their drives."""
    lost = {change.agent_id for change in planned}

    def is_loss(fault: Fault) -> bool:
        ends = isinstance(fault, MembershipFault) and fault.kind != ChangeKind.JOIN.value
        return ends or (isinstance(fault, DriveFailureFault) and fault.agent in lost)

    return scenario.model_copy(update={"faults": tuple(fault for fault in scenario.faults if not is_loss(fault))})


class _Traced(Watch):
    """Also keeps the contributions and the largest coordinates of all robots."""

    def __init__(self, measures: Measures, robots: Sequence[int], end: int) -> None:
        super().__init__(measures, 0)
        self.ids = robots
        self._places = {robot: place for place, robot in enumerate(robots)}
        size = end + 1, len(robots)
        self.there = np.zeros(size, dtype=np.bool_)
        self.coordinates = np.zeros(size)
        self.contributions = np.zeros((*size, measures.of.rows))

    def take(self, state: AnyRobotState) -> None:
        """Take the state of a robot."""
        super().take(state)
        at = state.step, self._places[state.agent_id]
        self.there[at] = True
        self.contributions[at] = self._of.contribution(state)
        scaled = zip(coordinates_of(state), self._of.coordinates, strict=True)
        self.coordinates[at] = max(abs(x) / row.scale for x, row in scaled)


def _conditions(watch: Watch, end: int, normal: Watch | None = None, *, settled: bool = True) -> Iterator[Condition]:
    """Yield the conditions on a simulation until a step, compared with one without the loss."""
    measures, of = watch.measures, watch.measures.of
    done, asked = ((step - watch.first) * measures.period for step in (watch.newest, end))
    numbers: dict[str, Number] = {
        "largest_deviation": watch.deviation,
        "largest_coordinate": watch.farthest.value,
        "least_pivot": watch.pivot,
    }
    if of.limits:
        numbers["limited_share"] = watch.limited_share
    yield Condition(RUN.name, None, Form(RUN.form, done, asked, ">="), numbers, watch.failure)
    yield _reach(watch)
    if normal is not None and watch.speed.robot:
        bound = max(SPEED.number * normal.speed.value, of.ordinary_speed)
        form = Form(SPEED.form, watch.speed.value, bound, "<=")
        yield Condition(SPEED.name, None, form, {"without_the_loss": normal.speed.value}, watch.at(watch.speed))
    if not settled:
        return
    last = watch.last(FINAL)
    if normal is not None and measures.tracks:
        error, usual = (max(one.errors.get(step, 0.0) for step in last) for one in (watch, normal))
        form = Form(SETTLED.form, error, max(1.0, SETTLED.number * usual), "<=")
        yield Condition(SETTLED.name, None, form, {"without_the_loss": usual})
    if of.limits:
        share = sum(map(watch.overloaded, last)) / len(last)
        yield Condition(LIMITS.name, None, Form(LIMITS.form, share, LIMITS.number, "<"))
    yield Condition(LAW.name, None, Form(LAW.form, float(watch.braking[watch.newest]), LAW.number, "<="))


def _reach(watch: Watch) -> Condition:
    """Return the condition on the coordinate that comes closest to an end, or is farthest beyond it.

    Where no end is stated, no robot may fly off, beyond an end that is assumed.
    """
    if watch.outside.value == -inf:
        flown = watch.strays.flown
        form = Form(REACH.form, float(len(flown)), 0.0, "<=")
        return Condition(REACH.name, None, form, {}, flown[0].text if flown else "")
    row, value = watch.beyond
    above = row.high - value <= value - row.low
    form = Form(REACH.form, value, row.high if above else row.low, "<=" if above else ">=")
    return Condition(REACH.name, None, form, {}, f"{row.name} of {watch.at(watch.outside)}")


def _planned(scenario: Scenario, planned: Sequence[Change], normal: Watch, end: int) -> Iterator[tuple[Theorem, Loss]]:
    """Simulate planned losses; yield the conditions on what follows each, until the next one."""
    if not planned:
        return
    rehearsal, measures = Rehearsal(scenario), normal.measures
    begins = [(step, tuple(changes)) for step, changes in groupby(planned, key=lambda change: change.step)]
    rehearsal.advance(begins[0][0], Watch(measures, 0))
    for (step, changes), until in zip(begins, [*(step for step, _ in begins[1:]), end], strict=True):
        watch = Watch(measures, step)
        rehearsal.advance(until, watch)
        enough = until == end or until - step >= measures.steps(AFTER_ANY)
        conditions = tuple(_conditions(watch, until, normal, settled=enough))
        names = [f"{change.kind.value} {change.agent_id}" for change in changes]
        title = f"{', '.join(names)} at {step * measures.period:g} s, simulated until {until * measures.period:g} s"
        yield Theorem("_".join(names).replace(" ", "_"), title, conditions), _loss(watch, until, changes, conditions)
        if watch.failure:
            return


def _loss(watch: Watch, end: int, changes: Sequence[Change], conditions: Sequence[Condition]) -> Loss:
    period = watch.measures.period
    return Loss(
        tuple(change.agent_id for change in changes),
        "/".join(dict.fromkeys(change.kind.value for change in changes)),
        watch.first * period,
        (end - watch.first) * period,
        tuple(condition.name for condition in conditions if condition.verdict is Verdict.FAILS),
        watch.speed.value,
        watch.farthest.value,
        watch.deviation,
        watch.pivot,
        watch.limited_share,
        watch.failure,
    )


class _Case(NamedTuple):
    """The loss of robots at a step, on request."""

    step: int
    robots: tuple[int, ...]


def _on_request(scenario: Scenario, normal: _Traced) -> Iterator[tuple[Theorem, list[Loss], list[str]]]:
    """Kill each robot, and each pair of robots; yield the worst of each condition, all losses, and notes."""
    measures, count = normal.measures, len(normal.ids)
    window = min(measures.steps(AFTER_ANY), scenario.steps)
    most = max(1, MOST_STATES // (2 * window * count))
    chosen: dict[int, tuple[int, list[_Case]]] = {}
    for size in (1, 2):
        cases = list(_cases(normal, size, max(0, scenario.steps - window)))
        chosen[size] = len(cases), cases[:most]
    results = dict(_lost(scenario, normal, sorted({case for _, cases in chosen.values() for case in cases}), window))
    for size, (total, cases) in chosen.items():
        label, who = ("any_robot", "each robot") if size == 1 else ("any_pair", "each pair of robots")
        title = f"{who} is killed at the start and when it is worst, {len(cases)} losses, {AFTER_ANY:g} s each"
        conditions = tuple(_worst([(case, results[case][0]) for case in cases], measures))
        left_out = (
            f"{label}: {len(cases)} of {total} losses are simulated, those with the largest contributions to the "
            "abstract state"
        )
        missing = "" if cases else "too few robots"
        yield (
            Theorem(label, title, conditions, missing),
            [results[case][1] for case in cases],
            [left_out] if len(cases) < total else [],
        )


def _cases(normal: _Traced, size: int, latest: int) -> Iterator[_Case]:
    """Yield losses of some robots, those with the largest contributions first, in steps until the latest.

    At least one robot remains.
    """
    there, losses = normal.there[: latest + 1], list[tuple[float, tuple[int, ...], list[int]]]()
    if len(normal.ids) <= size:
        return
    for places in combinations(range(len(normal.ids)), size):
        together = there[:, places].all(axis=1)
        if not together.any():
            continue
        effect = np.linalg.norm(normal.contributions[: latest + 1, places].sum(axis=1), axis=1)
        distance = normal.coordinates[: latest + 1, places].max(axis=1)
        worst = [int(np.argmax(np.where(together, values, -1.0))) for values in (effect, distance)]
        steps = [int(np.argmax(together)), *(worst if size == 1 else worst[:1])]
        losses.append((float(effect[worst[0]]), places, sorted(set(steps))))
    losses.sort(key=lambda loss: (-loss[0], loss[1]))
    for _, places, steps in losses:
        yield from (_Case(step, tuple(normal.ids[place] for place in places)) for step in steps)


def _lost(
    scenario: Scenario, normal: _Traced, cases: Sequence[_Case], window: int
) -> Iterator[tuple[_Case, tuple[tuple[Condition, ...], Loss]]]:
    """Simulate losses, given by ascending steps, each for some steps; yield the conditions and numbers of each."""
    # Only with `drop` does a swarm expect that robots end which nothing ends.
    dropping = scenario.model_copy(update={"lockstep": replace(scenario.lockstep, on_stall="drop")})
    rehearsal, before = Rehearsal(dropping), Watch(normal.measures, 0)
    for step, at_once in groupby(cases, key=lambda case: case.step):
        rehearsal.advance(step, before)
        for case in at_once if not before.failure else ():
            watch = Watch(normal.measures, step)
            rehearsal.copy().advance(step + window, watch, case.robots)
            conditions = tuple(_conditions(watch, step + window, normal))
            changes = [Change(step, robot, ChangeKind.KILL) for robot in case.robots]
            yield case, (conditions, _loss(watch, step + window, changes, conditions))


def _worst(cases: Sequence[tuple[_Case, Sequence[Condition]]], measures: Measures) -> Iterator[Condition]:
    """Yield each condition as it is in the case with the smallest margin."""
    by_name: dict[str, tuple[_Case, Condition]] = {}
    for case, conditions in cases:
        for condition in conditions:
            worst = by_name.get(condition.name)
            if worst is None or condition.margin < worst[1].margin:
                by_name[condition.name] = case, condition
    for case, condition in by_name.values():
        lost = f"without {' and '.join(map(str, case.robots))} from {case.step * measures.period:g} s on"
        yield replace(condition, note=f"{lost}: {condition.note}" if condition.note else lost)
