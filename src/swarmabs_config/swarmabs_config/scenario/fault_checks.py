"""Checks of a scenario's faults: their robots and steps must exist, and faults must not contradict each other."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_config.model.fields import Finding, Location
from swarmabs_core.controllers import OffsetController
from swarmabs_core.declaration import LONGEST_TIME
from swarmabs_core.faults import (
    ClockOffsetFault,
    FalsifiedStateFault,
    Fault,
    JoinFault,
    MembershipFault,
    MessageFault,
    ReferenceFault,
    RobotFault,
    SettingFault,
    SingleRobotFault,
)
from swarmabs_core.membership import UNPLANNED

if TYPE_CHECKING:
    from swarmabs_config.model.scenario import PlaneScenario, Scenario, SystemScenario


@dataclass(frozen=True, slots=True)
class _Span:
    """A fault with its location, its robots, and the steps in which it acts, from `first` until before `end`."""

    fault: Fault
    here: Location
    robots: set[int]
    first: int
    end: float


def faults(scenario: "Scenario") -> Iterator[Finding]:
    """Check each fault alone, then those of the same robots or the same setting."""
    ids = {agent.id for agent in scenario.agents}
    spans: list[_Span] = []
    for index, fault in enumerate(scenario.faults):
        here: Location = ("faults", index)
        named = _named(fault)
        missing = [(place, agent) for place, agent in named if agent not in ids]
        if missing:
            yield from (_unknown_robot((*here, *place), agent, ids) for place, agent in missing)
            continue
        begin, end = scenario.fault_steps(fault)
        span = _Span(fault, here, {agent for _, agent in named} or ids, begin, math.inf if end is None else end)
        yield from _within_run(span, scenario)
        spans.append(span)
    yield from _memberships([span for span in spans if isinstance(span.fault, MembershipFault)])
    for number, span in enumerate(spans):
        yield from _second(span, spans[:number], ids)


def _within_run(span: _Span, scenario: "Scenario") -> Iterator[Finding]:
    fault, (begin, end) = span.fault, span.fault.when
    if span.first > scenario.steps and fault.at is not None:
        yield Finding.of(
            (*span.here, begin),
            f"{fault.at!r} s is step {span.first}, after the last step {scenario.steps}",
            f"use a time within the duration of {scenario.duration!r} s",
        )
    elif span.first >= span.end:
        yield Finding.of(
            (*span.here, end), f"the fault begins and ends at step {span.first}", "make it last at least one step"
        )
    elif isinstance(fault, ClockOffsetFault) and scenario.duration + fault.offset > LONGEST_TIME:
        yield Finding.of(
            (*span.here, "offset"), "time stamps would exceed the range of a message", "use a smaller offset"
        )


def _memberships(spans: list[_Span]) -> Iterator[Finding]:
    """Check the joins and ends of robots: each robot joins at most once, then ends at most once."""
    joined: dict[int, _Span] = {}
    gone: dict[int, _Span] = {}
    for span in spans:
        (robot,) = span.robots
        joins = isinstance(span.fault, JoinFault)
        first = (joined if joins else gone).setdefault(robot, span)
        if first is not span:
            what = "joins twice" if joins else "is killed, frozen or leaves twice"
            yield Finding.of(span.here, f"robot {robot} {what}", "keep one of them", see=first.here)
    for robot in sorted(joined.keys() & gone.keys()):
        join, end = joined[robot], gone[robot]
        if join.first == UNPLANNED:
            yield Finding.of(
                end.here,
                f"robot {robot} joins at an unplanned time, so its end cannot be planned",
                "remove this fault, or give the time at which the robot joins",
                see=join.here,
            )
        elif join.first > end.first:
            yield Finding.of(
                (*join.here, "at"),
                f"robot {robot} joins at step {join.first}, but is gone from step {end.first} on",
                "let it join at an earlier step",
                see=end.here,
            )


def _second(span: _Span, others: list[_Span], ids: set[int]) -> Iterator[Finding]:
    """Check that at most one fault of a kind acts on a robot, or on a setting, at a time."""
    kind = span.fault.kind
    for other in others:
        if other.fault.kind != kind:
            continue
        both = span.robots & other.robots
        if isinstance(span.fault, SettingFault):
            # One without an end holds until the next; one with an end must be over by then.
            earlier, later = sorted((span, other), key=lambda fault_span: fault_span.first)
            if earlier.first == later.first or later.first < earlier.end < math.inf:
                problem, remedy = f"a second {kind} at the same time", "end one before the other begins"
                yield Finding.of(span.here, problem, remedy, see=other.here)
                return
        elif isinstance(span.fault, RobotFault) and both and span.first < other.end and other.first < span.end:
            whom = "" if both == ids else f" for robot {min(both)} at the same time"
            remedy = "" if both == ids else ", or end one ('to') before the other begins ('from')"
            yield Finding.of(span.here, f"a second {kind}{whom}", f"keep one {kind}{remedy}", see=other.here)
            return


def offset_law(scenario: "PlaneScenario") -> Iterator[Finding]:
    """Check that the parent controller's reference can be offset, if a fault does so."""
    index = next((index for index, fault in enumerate(scenario.faults) if isinstance(fault, ReferenceFault)), None)
    if index is not None and not isinstance(configure.parent_controller(scenario), OffsetController):
        yield Finding.of(
            ("faults", index),
            f"the reference of controller {scenario.controller.type!r} cannot be offset",
            "remove this fault, or add a method offset_torque to the controller's law",
            see=("controller",),
        )


def system_settings(scenario: "SystemScenario") -> Iterator[Finding]:
    """Check that the parent system supports the faults that offset its reference or disturb it, and false masses."""
    largest = configure.largest_requests(scenario)
    for index, fault in enumerate(scenario.faults):
        if isinstance(fault, SettingFault) and not largest[fault.kind]:
            method = "offset_ask of its controller" if isinstance(fault, ReferenceFault) else "disturbed"
            yield Finding.of(
                ("faults", index),
                f"the parent system {scenario.system.type!r} has no method {method}, which a {fault.kind} needs",
                "remove this fault, or add the method",
            )
        elif isinstance(fault, FalsifiedStateFault) and fault.mass_factor != 1.0:
            yield Finding.of(
                ("faults", index, "mass_factor"),
                "only coordinates can be falsified on a parent system other than the plane",
                "use position_offset or position_factor",
            )


def _named(fault: Fault) -> list[tuple[Location, int]]:
    """Return the robots that a fault names and their locations; none if it affects all robots."""
    if isinstance(fault, MembershipFault | SingleRobotFault):
        return [(("agent",), fault.agent)]
    agents = fault.agents if isinstance(fault, MessageFault) else None
    return [(("agents", place), agent) for place, agent in enumerate(agents or ())]


def _unknown_robot(where: Location, agent: int, ids: Iterable[int]) -> Finding:
    near = min(ids, key=partial(_distance, agent), default=1)
    return Finding.of(where, f"there is no robot {agent}", f"name an existing one, e.g. {near}")


def _distance(wanted: int, agent_id: int) -> tuple[int, int]:
    return abs(agent_id - wanted), agent_id
