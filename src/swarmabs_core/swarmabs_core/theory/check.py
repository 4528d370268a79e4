"""What the paper's theorems say of a scenario before it runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.robot_controller import Limits
from swarmabs_core.theory.arise_conditions import AriseCheck, check_arise
from swarmabs_core.theory.feedback_conditions import FeedbackCheck, check_feedback
from swarmabs_core.theory.general_conditions import abstract_states, constrained_conditions, constraints
from swarmabs_core.theory.report import Condition, Form, Report, Theorem
from swarmabs_core.theory.sampled_conditions import sampled_conditions
from swarmabs_core.theory.swarm_conditions import inertia_swing

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.theory.general_conditions import Constraints
    from swarmabs_core.theory.report import Document
    from swarmabs_core.theory.setting import Setting, SwarmKind

_SWARMS: dict[SwarmKind, str] = {
    "SI": "single integrators",
    "DI": "double integrators",
    "noHomo": "both kinds of robots",
}


def check(setting: Setting) -> Report:
    """Evaluate the paper's theorems, and what a run in sampled time needs beyond them; nothing is simulated."""
    feedback, arise = check_feedback(setting), check_arise(setting)
    found = constraints(setting, feedback.torque if feedback else setting.manifold.torque_max)
    parent: FeedbackCheck | AriseCheck | None = feedback or arise
    swing = inertia_swing(setting)
    attraction: dict[str, Document] = dict(parent.attraction) if parent else {}
    return Report(
        setting.scenario,
        setting.controller,
        _SWARMS[setting.kind],
        setting.angle_max,
        (*_six(setting, feedback, arise), *_general(setting, found, feedback, arise)),
        Theorem(
            "sampled_time",
            "what the paper leaves out: sampled time and the singularity S3 = 0",
            (*((swing,) if swing else ()), *sampled_conditions(setting)),
        ),
        attraction,
        abstract_states(setting, found),
        tuple(_notes(setting)),
    )


def _six(setting: Setting, feedback: FeedbackCheck | None, arise: AriseCheck | None) -> Iterator[Theorem]:
    """Yield the theorems of controllers and swarms in the paper's order."""
    controller = setting.controller
    order: tuple[tuple[str, SwarmKind], ...] = (
        ("LQR", "SI"),
        ("ARISE", "SI"),
        ("LQR", "DI"),
        ("ARISE", "DI"),
        ("LQR", "noHomo"),
        ("ARISE", "noHomo"),
    )
    for law, kind in order:
        check = feedback if law == "LQR" else arise
        title = f"{'state feedback' if law == 'LQR' else 'ARISE'} with {_SWARMS[kind]}"
        label = f"{law}_{kind}_sys"
        if check is None:
            yield Theorem(label, title, note=f"the parent controller is {controller}")
        elif kind != setting.kind:
            yield Theorem(label, title, note=f"the swarm has {_SWARMS[setting.kind]}")
        else:
            dropped = (
                "the proof takes the errors of both parts for independent and drops what damping does in the null space"
            )
            yield Theorem(label, title, check.conditions, dropped if kind == "noHomo" else "")


def _general(
    setting: Setting, found: Constraints, feedback: FeedbackCheck | None, arise: AriseCheck | None
) -> Iterator[Theorem]:
    names = (
        ("GeneralStability", "the set S of parent system and swarm"),
        ("GeneralConstrainedStability", "the set S_c within the constraints"),
    )
    parent = feedback or arise
    if parent is None:
        for label, title in names:
            yield Theorem(label, title, note=f"no Lyapunov function is known for {setting.controller}")
        return
    (initial,) = [condition for condition in parent.conditions if condition.name == "initial state"]
    yield Theorem(*names[0], (_definite(feedback, arise), initial))
    if feedback is not None:
        level, energy, growths, angle = feedback.level, feedback.energy, feedback.growths, 0.0
    else:
        assert arise is not None  # noqa: S101 - one of them is there
        # S is a ball: its function is the square of the norm.
        level, energy, growths, angle = arise.printed_square, initial.corrected.value, (1.0, 1.0), arise.largest_angle
    yield Theorem(
        *names[1],
        constrained_conditions(setting, found, largest_angle=angle, level=level, energy=energy, growths=growths),
    )


def _definite(feedback: FeedbackCheck | None, arise: AriseCheck | None) -> Condition:
    """Return the condition that the derivatives of the Lyapunov functions are negative and outweigh the coupling."""
    if feedback is not None:
        return Condition(
            "negative derivative",
            Form("V_p' negative definite: least eigenvalue of M's symmetric part > 0", feedback.eigenvalue, 0.0),
            Form("V' <= 0, and 0 on no trajectory but the origin: 4 kappa a D > 1", feedback.coupling, 1.0),
            {},
            "V' does not depend on th, so the theorem of LaSalle is needed where the paper asks for a definite V_p'",
        )
    assert arise is not None  # noqa: S101 - one of them is there
    return Condition(
        "negative derivative",
        Form("eta3 - c_max/(4 ks) > 0", arise.printed_decay, 0.0),
        Form("eta3 - c_max^2/(4 ks) > 0", arise.decay, 0.0),
        {},
    )


def _notes(setting: Setting) -> Iterator[str]:
    """Say what the theory leaves out of this scenario."""
    robot = setting.robots[0]
    yield (
        "all theorems are about continuous time without the command filter; the limits of sampled time are those of "
        "loops linearised at 0"
    )
    if robot.limits != Limits():
        yield "no theorem knows the limits of the drives"
    if robot.feels_gravity and setting.has_double:
        yield "plane.robot_gravity: the theorems leave out gravity along the plane, which destabilises"
    if setting.faulty:
        yield "no theorem knows faults, losses or changing members; only the initial swarm and a delay are checked"
