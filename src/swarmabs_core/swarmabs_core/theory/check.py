"""Evaluation of the paper's theorems for a scenario before it runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.robot_controller import Limits
from swarmabs_core.theory.general_theorems import abstract_states, constrained_conditions, constraints
from swarmabs_core.theory.report import Report, Theorem, plain
from swarmabs_core.theory.theorems import SWARMS, parent_check, sampled_time, swarm_theorems

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.theory.general_theorems import Constraints
    from swarmabs_core.theory.report import ParentCheck
    from swarmabs_core.theory.setting import Setting


def check(setting: Setting) -> Report:
    """Evaluate the paper's theorems and the further conditions for sampled time; nothing is simulated."""
    parent = parent_check(setting)
    found = constraints(setting, parent.torque if parent else setting.manifold.torque_max)
    return Report(
        setting.scenario,
        setting.controller,
        SWARMS[setting.kind],
        setting.angle_max,
        (*swarm_theorems(setting, parent), *_general(setting, found, parent)),
        sampled_time(setting),
        {name: plain(value) for name, value in (parent.attraction if parent else {}).items()},
        {name: plain(value) for name, value in abstract_states(setting, found).items()},
        tuple(_notes(setting)),
    )


def _general(setting: Setting, found: Constraints, parent: ParentCheck | None) -> Iterator[Theorem]:
    names = (
        ("GeneralStability", "the set S of parent system and swarm"),
        ("GeneralConstrainedStability", "the set S_c within the constraints"),
    )
    if parent is None:
        for label, title in names:
            yield Theorem(label, title, note=f"no Lyapunov function is known for {setting.controller}")
        return
    (initial,) = [condition for condition in parent.conditions if condition.name == "initial state"]
    yield Theorem(*names[0], (parent.derivative, initial))
    yield Theorem(*names[1], constrained_conditions(setting, found, parent))


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
    if robot.limits != Limits():
        yield "the theorems do not consider the limits of the drives"
    if robot.feels_gravity and setting.has_double:
        yield "plane.robot_gravity: the theorems do not consider gravity along the plane, which is destabilising"
    if setting.faulty:
        yield (
            "the theorems do not consider faults, losses, or robots that join or leave; they cover the initial swarm "
            "and a delay"
        )
