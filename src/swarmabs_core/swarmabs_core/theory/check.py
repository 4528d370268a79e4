"""Evaluation of the paper's theorems for a scenario before it runs, and of further conditions for sampled time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.robot_controller import Limits
from swarmabs_core.swarm_law import PAPER
from swarmabs_core.theory.arise import FRICTION_ALONE, check_arise
from swarmabs_core.theory.error_dynamics import inertia_swing
from swarmabs_core.theory.general_theorems import abstract_states, constrained_conditions, constraints
from swarmabs_core.theory.pid import check_pid
from swarmabs_core.theory.report import Report, Theorem, plain
from swarmabs_core.theory.sampled_data import sampled_conditions
from swarmabs_core.theory.state_feedback import check_feedback

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.theory.general_theorems import Constraints
    from swarmabs_core.theory.report import ParentCheck
    from swarmabs_core.theory.setting import Setting, SwarmKind

_SWARMS: dict[SwarmKind, str] = {
    "SI": "single integrators",
    "DI": "double integrators",
    "noHomo": "both kinds of robots",
}
_DROPPED = "the proof treats the errors of both parts as independent and omits the effect of damping in the null space"
_IMPLIED = {"ks, all terms at rest", "initial state"}
"""Conditions that cannot hold if the one on ks by friction alone does not."""
_SAID_BY_THE_SCENARIO = {"inertia swing", "k1"}
"""Conditions that `warnings_of` of a scenario already reports."""


def check(setting: Setting) -> Report:
    """Evaluate the paper's theorems and the further conditions for sampled time; nothing is simulated."""
    parent = _parent_check(setting)
    bounds = constraints(setting, parent.torque if parent else setting.manifold.torque_max)
    return Report(
        setting.scenario,
        setting.controller,
        _SWARMS[setting.kind],
        setting.angle_max,
        (*_swarm_theorems(setting, parent), *_general_theorems(setting, bounds, parent)),
        _sampled_time(setting),
        {name: plain(value) for name, value in (parent.attraction if parent else {}).items()},
        {name: plain(value) for name, value in abstract_states(setting, bounds).items()},
        tuple(_notes(setting)),
    )


def warnings(setting: Setting) -> Iterator[str]:
    """Yield a line if the theorem for this run does not cover it, and one for failed conditions of sampled time.

    The general theorems cause no warnings.
    """
    for theorem in _swarm_theorems(setting, _parent_check(setting)):
        if failures := _failures(theorem):
            yield f"theorem {theorem.label} is not fulfilled: {failures}; see the command check"
    if failures := _failures(_sampled_time(setting)):
        yield f"sampled time: {failures}; see the command check"


def _parent_check(setting: Setting) -> ParentCheck | None:
    """Evaluate the theorem for the plane under its parent controller; None if there is none for this controller."""
    return check_feedback(setting) or check_arise(setting)


def _swarm_theorems(setting: Setting, parent: ParentCheck | None) -> Iterator[Theorem]:
    """Yield the theorems for controllers and swarms in the paper's order, and what is proven of PID if it is used."""
    for kind, robots in _SWARMS.items():
        for name, law in (("LQR", "state feedback"), ("ARISE", "ARISE")):
            label, title = f"{name}_{kind}_sys", f"{law} with {robots}"
            if parent is None or parent.name != name:
                yield Theorem(label, title, note=f"the parent controller is {setting.controller}")
            elif setting.swarm_law != PAPER.name:
                yield Theorem(label, title, note=f"the swarm's law is {setting.swarm_law}")
            elif kind != setting.kind:
                yield Theorem(label, title, note=f"the swarm has {_SWARMS[setting.kind]}")
            else:
                yield Theorem(label, title, parent.conditions, _DROPPED if kind == "noHomo" else "")
    if setting.swarm_law == PAPER.name and (pid := check_pid(setting)):
        yield pid


def _general_theorems(setting: Setting, bounds: Constraints, parent: ParentCheck | None) -> Iterator[Theorem]:
    names = (
        ("GeneralStability", "the set S of parent system and swarm"),
        ("GeneralConstrainedStability", "the set S_c within the constraints"),
    )
    if parent is None or setting.swarm_law != PAPER.name:
        unknown = setting.controller if parent is None else setting.swarm_law
        for label, title in names:
            yield Theorem(label, title, note=f"no Lyapunov function is known for {unknown}")
        return
    (initial,) = [condition for condition in parent.conditions if condition.name == "initial state"]
    yield Theorem(*names[0], (parent.derivative, initial))
    yield Theorem(*names[1], constrained_conditions(setting, bounds, parent))


def _sampled_time(setting: Setting) -> Theorem:
    """Return the conditions that a run needs beyond the paper."""
    return Theorem(
        "sampled_time",
        "beyond the paper: sampled time and the singularity S3 = 0",
        (*inertia_swing(setting), *sampled_conditions(setting)),
    )


def _failures(theorem: Theorem) -> str:
    """Return the failed conditions that no other warning reports or implies."""
    names = {condition.name for condition in theorem.failed}
    silent = _SAID_BY_THE_SCENARIO | (_IMPLIED if FRICTION_ALONE in names else set())
    failures = []
    for condition in theorem.failed:
        form = condition.corrected
        if condition.name == FRICTION_ALONE:
            failures.append(condition.note)
        elif condition.name not in silent:
            failures.append(f"{condition.name}: {form.value:.4g} is not {form.relation} {form.bound:.4g}")
    return "; ".join(failures)


def _notes(setting: Setting) -> Iterator[str]:
    """Yield notes on properties of the scenario that the theory does not consider."""
    robot = setting.robots[0]
    yield (
        "the theorems assume continuous time and no command filter; the limits of sampled time are those of the loops "
        "linearised at 0"
    )
    manifold, torque_max = setting.manifold, setting.manifold.torque_max
    leaves = max(0.0, setting.sets.admissible_reach(manifold.curvature, manifold.offset))
    if leaves < torque_max:
        yield (
            f"manifold: for |tau| above {leaves:.4g} N m, which is below torque_max = {torque_max!r}, some positions "
            "with the desired torque and inertia are off the plane (the manifold leaves A_A); reduce torque_max, or "
            "use a longer plane"
        )
    if any(setting.heights.values()):
        yield (
            "heights: the proofs omit the reaction of robots above the axis to their accelerations; the loops of "
            "sampled time contain it, for the initial positions"
        )
    if setting.swarm_law != PAPER.name:
        yield f"the conditions of sampled time are those of the paper's law of the swarm, not of {setting.swarm_law}"
    if robot.limits != Limits():
        yield "the theorems do not consider the limits of the drives"
    if robot.feels_gravity and setting.has_double:
        yield "plane.robot_gravity: the theorems do not consider gravity along the plane, which is destabilising"
    if not (setting.plane.sensor.perfect and robot.sensor.perfect):
        yield "the theorems assume perfect sensors"
    if setting.faulty:
        yield (
            "the theorems do not consider faults, losses, or robots that join or leave; they cover the initial swarm "
            "and a delay"
        )
