"""Whether control period and delay of a scenario are within the limits of its loops in sampled time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.controllers.arise import Arise
from swarmabs_core.controllers.feedback import StateFeedback
from swarmabs_core.messages import Kind
from swarmabs_core.theory import sampled_data
from swarmabs_core.theory.report import Condition, Form

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.theory.setting import Setting

Pair = tuple[float, float]


def sampled_conditions(setting: Setting) -> Iterator[Condition]:
    """Yield for each loop the limits of period and delay, and whether the scenario keeps them."""
    delay, step = setting.delay, setting.period
    for name, loop, note in _loops(setting):
        # Beyond the longest one no delay is within its limit, and the matrix of the loop may be too large.
        considered = min(delay, sampled_data.LONGEST_DELAY)
        period = sampled_data.largest_period(loop, considered)
        steps = sampled_data.largest_delay(loop, step)
        bound = sampled_data.LONGEST_PERIOD if period is None else period
        yield Condition(
            f"period, {name}",
            None,
            Form(f"step < limit with a delay of {considered}", step, bound, "<"),
            {"period": step, "largest_period": bound, "delay": considered},
            note if period is not None else f"stable up to {bound:g} s; {note}",
        )
        longest = sampled_data.LONGEST_DELAY if steps is None else steps
        yield Condition(
            f"delay, {name}",
            None,
            Form(f"delay <= limit at {step:g} s, in steps", delay, longest, "<="),
            {"delay": delay, "largest_delay": longest, "period": step},
            note if steps is not None else f"stable up to {longest} steps; {note}",
        )
    if setting.has_double:
        yield _added_damping(setting)


def _loops(setting: Setting) -> Iterator[tuple[str, sampled_data.Loop, str]]:
    gains = setting.gains
    inertia = setting.plane.inertia + setting.manifold.offset
    kinds: list[tuple[str, float, float | None]] = []
    if setting.has_single:
        yield "SI errors", sampled_data.single_integrator_loop(max(gains.k)), "e[k+1] = e[k] - K h e[k-n], largest K"
        kinds.append(("SI", gains.k[0], None))
    if setting.has_double:
        for axis, kp, kd in zip(("torque", "inertia"), gains.kp, gains.kd, strict=True):
            if axis == "torque" or (kp, kd) != (gains.kp[0], gains.kd[0]):
                name = "DI errors" if gains.kp[0] == gains.kp[1] and gains.kd[0] == gains.kd[1] else f"DI {axis} error"
                yield name, sampled_data.double_integrator_loop(kp, kd), "e'' = -kp e - kd e', the acceleration held"
        kinds.append(("DI", gains.kp[0], gains.kd[0]))
    found = _linear_law(setting)
    if found is None:
        return
    feedback, integral, linearised = found
    for kind, gain, derivative in kinds:
        for where, slope in (("moving", setting.friction.g6), ("at rest", setting.friction.slope_at_rest())):
            loop = sampled_data.parent_loop(inertia, slope, feedback, integral, (gain, derivative))
            note = f"plane, {linearised}, filter and swarm, linearised at 0 with friction slope {slope:g} ({where})"
            yield f"plane {where}, {kind}", loop, note


def _linear_law(setting: Setting) -> tuple[Pair, Pair, str] | None:
    """Return proportional and integral gains of angle and rate of the law near 0, and its name."""
    law = setting.law
    if isinstance(law, StateFeedback):
        return (law.k1, law.k2), (0.0, 0.0), "state feedback"
    if isinstance(law, Arise):
        # e2 = -(w + alpha1 th) for a reference at rest, where Y_d and with it the adaptation vanish.
        g = law.gains
        rate = (g.ks + 1.0) * g.alpha2 + g.beta / g.smoothing
        return ((g.ks + 1.0) * g.alpha1, g.ks + 1.0), (rate * g.alpha1, rate), "ARISE without adaptation"
    return None


def _added_damping(setting: Setting) -> Condition:
    """Return the condition on the robots' own damping k_sd, which acts on the velocity of the step."""
    period, ksd = setting.period, setting.gains.ksd
    limits = []
    for robot in setting.robots:
        if robot.kind is Kind.DOUBLE_INTEGRATOR:
            limit = sampled_data.largest_period(sampled_data.added_damping_loop(robot.mass, robot.damping, ksd))
            limits.append((sampled_data.LONGEST_PERIOD if limit is None else limit, robot.agent_id))
    least, slowest = min(limits)
    return Condition(
        "period, added damping",
        None,
        Form("step < limit of the robot with the least", period, least, "<"),
        {"period": period, "largest_period": least, "ksd": ksd, "robot": slowest},
        "m v' = -c v - k_sd v[k]: motion that torque and inertia do not see",
    )
