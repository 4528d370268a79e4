"""Checks across several fields of a scenario, and warnings about valid but doubtful settings."""

import math
from collections.abc import Callable, Iterable, Iterator
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_config.model.fields import SMALLEST, Finding, Location
from swarmabs_core import behaviours
from swarmabs_core.cdr import SECOND
from swarmabs_core.controllers import PD, PID
from swarmabs_core.errors import InputError
from swarmabs_core.faults import JoinFault, MembershipFault
from swarmabs_core.membership import ChangeKind
from swarmabs_core.messages import PLANE_FAMILY, SYSTEM_FAMILY, Family, Kind
from swarmabs_core.parameters import SettingError
from swarmabs_core.swarm_law import LAWS
from swarmabs_core.systems.check import problems_of
from swarmabs_core.theory.error_dynamics import deepest_swing

from .fault_checks import faults, offset_law, system_settings

if TYPE_CHECKING:
    from swarmabs_config.model.agents import Agent
    from swarmabs_config.model.scenario import PlaneScenario, Scenario, SystemScenario
    from swarmabs_core.manifold import Manifold

SMALLEST_S3 = 1e-12
"""S3 in units of S0^2 L^2 with which a run may start: with less, all robots are at one point but for rounding."""


def findings(scenario: "Scenario") -> list[Finding]:
    """Return every error of a scenario whose individual fields are valid."""
    # A later check relies on the earlier ones, or matters only after them.
    for group in _CHECKS[scenario.family]:
        if errors := [finding for check in group for finding in check(scenario)]:
            return errors
    return []


def warnings_of(scenario: "Scenario") -> tuple[str, ...]:
    """Return one line for each setting that is valid but likely to cause trouble."""
    return tuple(text for warn in _WARNINGS[scenario.family] for text in warn(scenario))


def second_moments(agents: Iterable["Agent"]) -> tuple[float, float]:
    """Return S0 (kg^2) and S3 = S0 sum m^2 (p - S1/S0)^2 (kg^4 m^2) of `agents`, from centred positions."""
    members = [(agent.mass * agent.mass, agent.position) for agent in agents]
    s0 = math.fsum(square for square, _ in members)
    centre = math.fsum(square * position for square, position in members) / s0
    return s0, s0 * math.fsum(square * (position - centre) ** 2 for square, position in members)


def _timing(scenario: "Scenario") -> Iterator[Finding]:
    if scenario.duration_ns % scenario.step_ns:
        below = scenario.duration_ns // scenario.step_ns * scenario.step_ns
        near = [ns for ns in (below, below + scenario.step_ns) if ns > 0]
        yield Finding.of(
            ("duration",),
            f"the duration {scenario.duration!r} s is not a multiple of the step {scenario.step!r} s",
            f"use a duration of {' or '.join(repr(ns / SECOND) for ns in near)} s, or another step",
            see=("step",),
        )


def _links(scenario: "Scenario") -> Iterator[Finding]:
    if not scenario.decentralised:
        return
    try:
        configure.links(scenario)
    except InputError as error:
        yield Finding.of(("links",), error.problem, error.remedy)


def _generated(scenario: "SystemScenario") -> Iterator[Finding]:
    """Draw the robots, which the other checks need."""
    if scenario.swarm.generate is None:
        return
    try:
        _ = scenario.agents
    except InputError as error:
        yield Finding.of(("swarm", "generate"), error.problem, error.remedy)


def _system(scenario: "SystemScenario") -> Iterator[Finding]:
    present = {agent.id for agent in scenario.initial_agents}
    later = {agent.id for agent in scenario.agents} - present
    listed, gains, requests = scenario.swarm.agents, scenario.swarm.gains, scenario.requests
    robots = scenario.agents if listed is None else listed
    for where, problem, remedy in problems_of(
        scenario.named, robots, gains, scenario.period, later=later, requests=requests, sensor=scenario.sensor
    ):
        generated = listed is None and where[:2] == ("swarm", "agents")
        yield Finding.of(("swarm", "generate") if generated else where, problem, remedy)


def _number(scenario: "PlaneScenario") -> Iterator[Finding]:
    count = len(scenario.agents)
    if count < 2:
        yield Finding.of(
            _swarm_location(scenario),
            f"a swarm needs at least two robots, found {count}",
            "add robots: one robot cannot control torque and inertia independently",
        )


def _ids(scenario: "Scenario") -> Iterator[Finding]:
    first: dict[int, Location] = {}
    for index, agent in enumerate(scenario.swarm.agents or ()):
        location: Location = ("swarm", "agents", index, "id")
        if agent.id in first:
            free = next(number for number in range(1, 65537) if number not in first)
            yield Finding.of(
                location,
                f"robot {agent.id} is listed twice",
                f"give every robot its own id, e.g. {free}",
                see=first[agent.id],
            )
        first.setdefault(agent.id, location)


def _positions(scenario: "PlaneScenario") -> Iterator[Finding]:
    half = scenario.plane.length / 2
    placed: list[tuple[Location, float]] = [
        (("swarm", "agents", index, "position"), agent.position)
        for index, agent in enumerate(scenario.swarm.agents or ())
    ]
    if scenario.swarm.generate is not None:
        farthest = max((abs(agent.position) for agent in scenario.agents), default=0.0)
        placed = [(("swarm", "generate", "position"), farthest)]
    for location, position in placed:
        if abs(position) > half:
            yield Finding.of(
                location,
                f"{position!r} m is off the plane, whose half length is {half!r} m",
                f"keep it within +-{half!r} m, or lengthen the plane ('plane.length')",
            )


def _plane(scenario: "PlaneScenario") -> Iterator[Finding]:
    plane = scenario.plane
    if abs(plane.angle) > plane.end_stop:
        yield Finding.of(
            ("plane", "angle"),
            f"{plane.angle!r} rad is beyond the end stop at {plane.end_stop!r} rad",
            "start between the end stops, or move them",
            see=("plane", "end_stop"),
        )
    least = plane.mass * plane.center_height * plane.center_height
    if plane.inertia < least:
        yield Finding.of(
            ("plane", "inertia"),
            f"{plane.inertia!r} kg m^2 is less than mass center_height^2 = {least:.4g} kg m^2",
            "give the moment of inertia about the axis, which contains this",
            see=("plane", "center_height"),
        )
    if plane.robot_gravity and not plane.sensor.perfect:
        yield Finding.of(
            ("plane", "sensor"),
            "robot_gravity uses the plane's true angle and cannot be combined with sensor noise or resolution",
            "remove one of them",
            see=("plane", "robot_gravity"),
        )


def _distinct_positions(scenario: "PlaneScenario") -> Iterator[Finding]:
    where = _swarm_location(scenario)
    present = scenario.initial_agents
    if len(present) < 2:
        yield Finding.of(
            where,
            f"a swarm needs at least two robots at step 0, found {len(present)}: the others join later",
            "let fewer robots join later, or add robots",
        )
        return
    s0, s3 = second_moments(present)
    if s3 <= SMALLEST_S3 * s0 * s0 * scenario.plane.length * scenario.plane.length:
        yield Finding.of(
            where,
            f"all robots are at one point (S3 = {s3:.3g} kg^4 m^2), "
            "where the swarm cannot control torque and inertia independently",
            "give them different positions, e.g. alternating +0.125 and -0.125",
        )


def _preimage(scenario: "PlaneScenario") -> Iterator[Finding]:
    # A tau^2 + B - tau^2/(g^2 M) is linear in tau^2, positive at 0: if negative anywhere, then at torque_max.
    manifold, mass = scenario.manifold, _total_mass(scenario.agents)
    if (failing := _empty_from(manifold, mass, scenario.plane.gravity)) is None:
        return
    weight = scenario.plane.gravity**2 * (manifold.curvature + manifold.offset / manifold.torque_max**2)
    yield Finding.of(
        ("manifold",),
        f"robots of {mass:.6g} kg in total cannot have the inertia curvature*tau^2 + offset "
        f"for |tau| > {failing:.6g} N m, but torque_max is {manifold.torque_max!r}",
        f"lower torque_max to {_rounded_down(failing)!r}, or use at least {_rounded_up(1 / weight)!r} kg of robots",
    )


def _empty_from(manifold: "Manifold", mass: float, gravity: float) -> float | None:
    """Return the torque (N m) above which the preimage of the manifold is empty, None if it never is."""
    curvature, offset, largest = (Fraction(x) for x in (manifold.curvature, manifold.offset, manifold.torque_max))
    needed = 1 / (Fraction(gravity) ** 2 * Fraction(mass))
    if curvature * largest**2 + offset >= needed * largest**2:
        return None
    return math.sqrt(offset / (needed - curvature))


def _rounded_down(value: float) -> float:
    return float(Context(prec=4, rounding=ROUND_FLOOR).create_decimal_from_float(value))


def _rounded_up(value: float) -> float:
    return float(Context(prec=4, rounding=ROUND_CEILING).create_decimal_from_float(value))


def _constructed(scenario: "PlaneScenario") -> Iterator[Finding]:
    """Construct the controller and any law of an installed package, so that settings they reject fail here."""
    constructors: list[tuple[Location, Callable[[], object]]] = []
    constructors.append((("controller",), partial(configure.parent_controller, scenario)))
    if scenario.swarm.law.type not in LAWS.built_in:
        constructors += [
            (("swarm", "law"), partial(behaviours.Agent, config)) for config in configure.agent_configs(scenario)
        ]
    for location, construct in constructors:
        try:
            construct()
        except SettingError as error:
            parts = (int(part) if part.isdigit() else part for part in error.name.split("."))
            yield Finding.of((*location, *parts), error.problem, error.remedy)
            return
        except InputError as error:
            yield Finding.of(location, error.problem, error.remedy or "see the documentation of its package")
            return


def _swarm_location(scenario: "Scenario") -> Location:
    return ("swarm", "agents" if scenario.swarm.agents is not None else "generate")


def _total_mass(agents: Iterable["Agent"]) -> float:
    return math.fsum(agent.mass for agent in agents)


def _underdamped(scenario: "PlaneScenario") -> Iterator[str]:
    if not any(Kind.of(agent.kind).by_force for agent in scenario.initial_agents):
        return
    kp, kd = scenario.swarm.gains.kp[1], scenario.swarm.gains.kd[1]
    initial = math.fsum(agent.mass * agent.position**2 for agent in scenario.initial_agents)
    undershoot = -deepest_swing(kp, kd, initial - scenario.manifold.offset, 0.0)
    if kd >= 2 * math.sqrt(kp) or initial <= scenario.manifold.offset:
        return
    if undershoot >= scenario.manifold.offset / 2:
        yield (
            f"swarm.gains: with Kd < 2 sqrt(Kp) the inertia, {initial:.4g} kg m^2 at the start, undershoots its "
            f"target {scenario.manifold.offset!r} by {undershoot:.3g}; near 0 the robots are driven far "
            f"apart; use a kd of at least {_rounded_up(2 * math.sqrt(kp))!r}, or smaller positions"
        )


def _wrong_feedback(scenario: "PlaneScenario") -> Iterator[str]:
    gains = configure.controller_settings(scenario).get("gains")
    if scenario.controller.type in {PD.name, PID.name} and isinstance(gains, tuple) and float(gains[0]) <= 0.0:
        yield f"controller.gains: k1 = {gains[0]!r} does not level the plane; use a positive gain"


def _membership(scenario: "PlaneScenario") -> Iterator[str]:
    """Warn if, after a fault, the remaining robots are too few, or too light for the manifold."""
    active = {agent.id for agent in scenario.initial_agents}
    heavy = set(active)
    by_step: dict[int, list[MembershipFault]] = {}
    for fault in scenario.faults_of(MembershipFault):
        # A robot that joins is present from the fault step on; one that leaves is present in it for the last time.
        first = scenario.fault_step(fault.at) + (not isinstance(fault, JoinFault))
        if first <= scenario.steps:
            by_step.setdefault(first, []).append(fault)
    states = [(0, len(active), frozenset(heavy))]
    for step in sorted(by_step):
        for change in by_step[step]:
            if isinstance(change, JoinFault):
                active.add(change.agent)
                heavy.add(change.agent)
            else:
                active.discard(change.agent)
                if not ChangeKind(change.kind).stays:
                    heavy.discard(change.agent)
        states.append((step, len(active), frozenset(heavy)))
    few = next(((step, count) for step, count, _ in states if count < 2), None)
    if few is not None:
        yield (
            f"faults: from step {few[0]} on, the number of active robots is {few[1]}; keep at least two to control "
            "torque and inertia"
        )
    for step, _, present in states:
        mass = _total_mass(agent for agent in scenario.agents if agent.id in present)
        failing = None if mass < SMALLEST else _empty_from(scenario.manifold, mass, scenario.plane.gravity)
        if failing is not None:
            yield (
                f"faults: from step {step} on, the robots present weigh {mass:.4g} kg, too little for the "
                f"manifold beyond |tau| = {failing:.4g} N m; lower manifold.torque_max, or keep more robots"
            )
            return


def _unstable(scenario: "SystemScenario") -> Iterator[str]:
    """Warn if the gain of robots that follow the law of velocity is too large for the control period."""
    swarm, largest = scenario.swarm, max(scenario.swarm.gains.k)
    by_velocity = swarm.force_law == "velocity" or not all(Kind.of(agent.kind).by_force for agent in scenario.agents)
    if by_velocity and largest * scenario.period >= 2.0:
        limit = _rounded_down(2.0 / scenario.period)
        yield (
            f"swarm.gains: k = {largest!r} 1/s is unstable at a step of {scenario.step!r} s; use less than {limit!r}"
        )


_CHECKS: dict[Family, tuple[tuple[Callable[..., Iterator[Finding]], ...], ...]] = {
    PLANE_FAMILY: (
        (_timing,),
        (_number, _ids, _positions, faults, _plane),
        (_distinct_positions,),
        (_preimage,),
        (_constructed, _links),
        (offset_law,),
    ),
    SYSTEM_FAMILY: ((_timing, _generated), (_ids, faults), (_system, _links), (system_settings,)),
}
"""The checks by what the scenario is about, in groups."""
_WARNINGS: dict[Family, tuple[Callable[..., Iterator[str]], ...]] = {
    PLANE_FAMILY: (_underdamped, _wrong_feedback, _membership),
    SYSTEM_FAMILY: (_unstable,),
}
