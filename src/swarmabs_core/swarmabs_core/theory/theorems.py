"""The paper's theorems for its controllers and swarms, and the further conditions for sampled time.

They alone decide about the warnings of a run. The general theorems, in `swarmabs_core.theory.check`, need optimisation,
which takes longer to load than a run takes to start.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.theory.arise import check_arise
from swarmabs_core.theory.error_dynamics import inertia_swing
from swarmabs_core.theory.report import Theorem, told
from swarmabs_core.theory.sampled_data import sampled_conditions
from swarmabs_core.theory.state_feedback import check_feedback

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.theory.report import ParentCheck
    from swarmabs_core.theory.setting import Setting, SwarmKind

SWARMS: dict[SwarmKind, str] = {
    "SI": "single integrators",
    "DI": "double integrators",
    "noHomo": "both kinds of robots",
}
_DROPPED = "the proof treats the errors of both parts as independent and omits the effect of damping in the null space"


def parent_check(setting: Setting) -> ParentCheck | None:
    """Evaluate the theorem for the plane under its parent controller; None if there is none for this controller."""
    return check_feedback(setting) or check_arise(setting)


def swarm_theorems(setting: Setting, parent: ParentCheck | None) -> Iterator[Theorem]:
    """Yield the theorems for controllers and swarms in the paper's order."""
    for kind, robots in SWARMS.items():
        for name, law in (("LQR", "state feedback"), ("ARISE", "ARISE")):
            label, title = f"{name}_{kind}_sys", f"{law} with {robots}"
            if parent is None or parent.name != name:
                yield Theorem(label, title, note=f"the parent controller is {setting.controller}")
            elif kind != setting.kind:
                yield Theorem(label, title, note=f"the swarm has {SWARMS[setting.kind]}")
            else:
                yield Theorem(label, title, parent.conditions, _DROPPED if kind == "noHomo" else "")


def sampled_time(setting: Setting) -> Theorem:
    """Return the conditions that a run needs beyond the paper."""
    return Theorem(
        "sampled_time",
        "beyond the paper: sampled time and the singularity S3 = 0",
        (*inertia_swing(setting), *sampled_conditions(setting)),
    )


def warnings(setting: Setting) -> Iterator[str]:
    """Yield a line if the theorem for this run does not cover it, and one for failed conditions of sampled time."""
    for theorem in swarm_theorems(setting, parent_check(setting)):
        if failed := told(theorem):
            yield f"theorem {theorem.label} is not fulfilled: {failed}; see the command check"
    if failed := told(sampled_time(setting)):
        yield f"sampled time: {failed}; see the command check"
