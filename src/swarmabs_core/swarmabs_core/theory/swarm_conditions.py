"""Conditions on the robots' laws: K, epsilon of eq. DI_cond1 to DI_cond4, and the swing of the inertia towards 0."""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING

from swarmabs_core.theory.error_dynamics import deepest_swing, epsilon_bound, printed_epsilon_bound
from swarmabs_core.theory.report import Condition, Form

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.theory.setting import Setting

RESERVE = 0.5
"""Share of the manifold's least inertia that must remain."""


def swarm_conditions(setting: Setting) -> Iterator[Condition]:
    """Yield the conditions that the theorems put on the swarm's gains."""
    gains = setting.gains
    if setting.has_single:
        form = Form("K > 0", min(gains.k), 0.0)
        yield Condition("K", form, form, {"k": gains.k})
    if setting.has_double:
        pairs = list(zip(gains.kp, gains.kd, strict=True))
        yield Condition(
            "epsilon",
            Form("an eps > 0 below min(sqrt kp, kd - kd^2/(4 kp))", min(printed_epsilon_bound(*p) for p in pairs), 0.0),
            Form(
                "an eps > 0 below min(sqrt kp, kd, 4 kp kd/(4 kp + kd^2))", min(epsilon_bound(*p) for p in pairs), 0.0
            ),
            {"kp": gains.kp, "kd": gains.kd},
            "eq. DI_cond2 prints eps/4 kd^2 for eps^2/4 kd^2; the corrected set is never empty",
        )


def inertia_swing(setting: Setting) -> Condition | None:
    """Return the condition that the inertia stays away from 0, where S3 vanishes; None without double integrators.

    The excess x = J_s - J_sd obeys x'' + kd x' + kp x = 0. It swings below 0 if kd < 2 sqrt(kp), in proportion to its
    size at the start, and then J_s falls below the least inertia of the manifold.
    """
    if not setting.has_double:
        return None
    gains, offset = setting.gains, setting.manifold.offset
    kp, kd = gains.kp[1], gains.kd[1]
    excess, rate = -setting.initial_error[1], -setting.initial_error_rate[1]
    swing = deepest_swing(kp, kd, excess, rate)
    lowest = offset + swing if swing < min(excess, 0.0) else offset  # a start below J_sd is no swing
    return Condition(
        "inertia swing",
        None,
        Form("least Js of the error dynamics >= offset/2", lowest, RESERVE * offset, ">="),
        {
            "kp": kp,
            "kd": kd,
            "critical_kd": 2.0 * sqrt(kp),
            "initial_inertia": setting.initial.inertia,
            "swing": swing,
            "offset": offset,
        },
        "Kd < 2 sqrt(Kp) with a large Js(0): near Js = 0 also S3 vanishes and the swarm is flung apart; "
        f"kd >= {2.0 * sqrt(kp):.4g} cures it"
        if kd < 2.0 * sqrt(kp)
        else "",
    )
