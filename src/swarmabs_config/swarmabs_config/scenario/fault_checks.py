"""Checks of a scenario's faults: that they hit robots and steps that there are, and do not contradict each other."""

import math
from collections.abc import Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_core.controllers import OffsetController
from swarmabs_core.declaration import LONGEST_TIME
from swarmabs_core.faults import (
    ClockOffsetFault,
    JoinFault,
    MembershipFault,
    MessageFault,
    ReferenceFault,
    RobotFault,
    SettingFault,
    SingleRobotFault,
)
from swarmabs_core.membership import UNPLANNED

from .fields import Finding, Location

if TYPE_CHECKING:
    from .model import Scenario


def faults(scenario: "Scenario") -> Iterator[Finding]:
    """Check the faults that end robots or let them join: each robot has at most one of both, in this order."""
    ids = {agent.id for agent in scenario.agents}
    joined: dict[int, tuple[int, Location]] = {}
    gone: dict[int, tuple[int, Location]] = {}
    for index, fault in enumerate(scenario.faults):
        here: Location = ("faults", index)
        if not isinstance(fault, MembershipFault):
            continue
        if fault.agent not in ids:
            yield _unknown_robot((*here, "agent"), fault.agent, ids)
            continue
        step = scenario.fault_step(fault.at)
        if fault.at is not None and step > scenario.steps:
            yield _too_late((*here, "at"), fault.at, step, scenario)
        kept = joined if isinstance(fault, JoinFault) else gone
        if fault.agent in kept:
            what = "joins twice" if isinstance(fault, JoinFault) else "is killed, frozen or leaves twice"
            yield Finding.of(here, f"robot {fault.agent} {what}", "keep one of them", see=kept[fault.agent][1])
        kept.setdefault(fault.agent, (step, here))
    for number in sorted(joined.keys() & gone.keys()):
        if joined[number][0] == UNPLANNED:
            yield Finding.of(
                gone[number][1],
                f"robot {number} is there only when it is added, and nobody knows when",
                "leave this fault out, or give the time at which the robot joins",
                see=joined[number][1],
            )
        elif 0 < joined[number][0] >= gone[number][0]:
            yield Finding.of(
                (*joined[number][1], "at"),
                f"robot {number} joins at step {joined[number][0]}, but is out from step {gone[number][0]}",
                "let it join at an earlier step",
                see=gone[number][1],
            )


def settings(scenario: "Scenario") -> Iterator[Finding]:
    """Check what is set at steps: of a kind one thing holds at a time."""
    known: dict[str, list[tuple[int, float, Location]]] = {}
    for index, fault in enumerate(scenario.faults):
        here: Location = ("faults", index)
        if not isinstance(fault, SettingFault):
            continue
        first = scenario.fault_step(fault.at)
        end = math.inf if fault.until is None else scenario.fault_step(fault.until)
        if first > scenario.steps:
            yield _too_late((*here, "at"), fault.at, first, scenario)
        elif first >= end:
            yield _too_short((*here, "until"), first)
        others = known.setdefault(fault.kind, [])
        for begun, until, there in others:
            # One without an end holds until the next; one with an end must be over by then.
            if first == begun or (begun < first < until < math.inf) or (first < begun < end < math.inf):
                yield Finding.of(
                    here, f"a second {fault.kind} at the same time", "let one end before the other begins", see=there
                )
                break
        others.append((first, end, here))


def offset_law(scenario: "Scenario") -> Iterator[Finding]:
    """Check that the parent controller's reference can be offset, if it shall be."""
    for index, fault in enumerate(scenario.faults):
        if isinstance(fault, ReferenceFault) and not isinstance(
            configure.parent_controller(scenario), OffsetController
        ):
            yield Finding.of(
                ("faults", index),
                f"the reference of controller {scenario.controller.type!r} cannot be offset",
                "leave it out, or add a method offset_torque to the controller's law",
                see=("controller",),
            )
            return


def lasting_faults(scenario: "Scenario") -> Iterator[Finding]:
    """Check the faults that act for a while: of a kind at most one acts on a robot at a time."""
    ids = {agent.id for agent in scenario.agents}
    known: dict[str, list[tuple[int, float, set[int], Location]]] = {}
    for index, fault in enumerate(scenario.faults):
        here: Location = ("faults", index)
        if not isinstance(fault, RobotFault):
            continue
        named = _named(fault)
        missing = [(place, agent) for place, agent in named if agent not in ids]
        if missing:
            yield from (_unknown_robot((*here, *place), agent, ids) for place, agent in missing)
            continue
        first, end = scenario.fault_steps(fault)
        last = math.inf if end is None else end
        if first > scenario.steps:
            yield _too_late((*here, "from"), fault.begin, first, scenario)
        elif first >= last:
            yield _too_short((*here, "to"), first)
        elif isinstance(fault, ClockOffsetFault) and scenario.duration + fault.offset > LONGEST_TIME:
            yield Finding.of((*here, "offset"), "stamps would be beyond what a message holds", "use a smaller offset")
        hit = {agent for _, agent in named} or ids
        others = known.setdefault(fault.kind, [])
        for begun, until, robots, there in others:
            if first < until and begun < last and (both := robots & hit):
                whom = "" if both == ids else f" for robot {min(both)} at the same time"
                remedy = "" if both == ids else ", or let it end ('to') before the other begins ('from')"
                yield Finding.of(here, f"a second {fault.kind}{whom}", f"keep one {fault.kind}{remedy}", see=there)
                break
        others.append((first, last, hit, here))


def _too_late(where: Location, time: float, step: int, scenario: "Scenario") -> Finding:
    problem = f"{time!r} s is step {step}, after the last step {scenario.steps}"
    return Finding.of(where, problem, f"use a time within the duration of {scenario.duration!r} s")


def _too_short(where: Location, step: int) -> Finding:
    return Finding.of(where, f"the fault begins and ends with step {step}", "let it last a step or more")


def _named(fault: RobotFault) -> list[tuple[Location, int]]:
    """Return the robots that a fault names, and where; none if it hits all."""
    if isinstance(fault, SingleRobotFault):
        return [(("agent",), fault.agent)]
    agents = fault.agents if isinstance(fault, MessageFault) else None
    return [(("agents", place), agent) for place, agent in enumerate(agents or ())]


def _unknown_robot(where: Location, agent: int, ids: Iterable[int]) -> Finding:
    near = min(ids, key=partial(_distance, agent), default=1)
    return Finding.of(where, f"there is no robot {agent}", f"name an existing one, e.g. {near}")


def _distance(wanted: int, known: int) -> tuple[int, int]:
    return abs(known - wanted), known
