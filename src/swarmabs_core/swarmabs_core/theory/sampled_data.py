r"""Limits of the control period and of the age of broadcasts: linear loops in sampled time.

The paper's system is continuous; a run holds every command for a period h and may act on broadcasts that are n periods
old. Each loop is the exact discretisation of a linear system under held inputs,

.. math:: x_{k+1} = F x_k + G u_k, \qquad u_k = -H x_{k-n},

and is stable if the spectral radius of its companion matrix is below 1. The limits are found by bisection. They do not
cover large errors, limits of drives, lost broadcasts, or sums in which robots are missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from math import tan
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from swarmabs_core.controllers import Arise, Pid, StateFeedback
from swarmabs_core.desired_state import BANDWIDTH
from swarmabs_core.drive import DoubleIntegratorDrive
from swarmabs_core.theory.linear_algebra import Matrix, exponential
from swarmabs_core.theory.report import Condition, Form

if TYPE_CHECKING:
    from swarmabs_core.theory.setting import Setting

Pair: TypeAlias = tuple[float, float]
Loop: TypeAlias = Callable[[float, int], Matrix]
"""Maps period (s) and delay (periods) to the matrix of the loop."""

LONGEST_PERIOD = 10.0
LONGEST_DELAY = 100
"""Upper ends of the searches for the limits of period (s) and delay (steps); a result at this end means no limit."""


def companion(free: Matrix, entry: Matrix, feedback: Matrix, delay: int) -> Matrix:
    """Return the matrix of x' = free x + entry u, where u = -feedback x from `delay` steps ago.

    Its state consists of x and the delayed commands: shapes (n, n), (n, 1) and (1, n) yield (n + delay, n + delay).
    """
    if delay == 0:
        return free - entry @ feedback
    size = len(free)
    matrix = np.zeros((size + delay, size + delay))
    matrix[:size, :size] = free
    matrix[:size, -1:] = entry
    matrix[size, :size] = -feedback[0]
    matrix[size + 1 :, size:-1] = np.eye(delay - 1)
    return matrix


def is_stable(matrix: Matrix) -> bool:
    """Return whether the spectral radius is below 1; a matrix with overflow is not stable."""
    if matrix.size == 1:  # such as those of all robots
        return abs(float(matrix[0, 0])) < 1.0
    return bool(np.isfinite(matrix).all()) and bool(np.abs(np.linalg.eigvals(matrix)).max() < 1.0)


def largest_period(loop: Loop, delay: int = 0) -> float:
    """Return the period (s) above which the loop is unstable: 0 if none is stable, `LONGEST_PERIOD` if all are."""
    shortest = 1e-5
    periods = np.geomspace(shortest, LONGEST_PERIOD, 241)
    low = 0.0
    for high in map(float, periods):
        if not is_stable(loop(high, delay)):
            break
        low = high
    else:
        return LONGEST_PERIOD
    if low == 0.0:
        return 0.0
    while high - low > 1e-9 * high:
        middle = (low + high) / 2.0
        low, high = (middle, high) if is_stable(loop(middle, delay)) else (low, middle)
    return low


def largest_delay(loop: Loop, period: float) -> int:
    """Return the largest delay, in steps of `period` (s), up to which the loop is stable; -1 if it never is."""
    delays = range(LONGEST_DELAY + 1)
    return next((delay for delay in delays if not is_stable(loop(period, delay))), LONGEST_DELAY + 1) - 1


def single_integrator_loop(gain: float) -> Loop:
    """Return the loop of one axis of single integrators: e' = -K e, so e[k+1] = e[k] - K h e[k-n]."""

    def loop(period: float, delay: int) -> Matrix:
        return companion(np.eye(1), np.array([[period]]), np.array([[gain]]), delay)

    return loop


def double_integrator_loop(kp: float, kd: float) -> Loop:
    """Return the loop of one axis of double integrators: e'' = -kp e - kd e', with held acceleration."""

    def loop(period: float, delay: int) -> Matrix:
        free = np.array([[1.0, period], [0.0, 1.0]])
        return companion(free, np.array([[period * period / 2.0], [period]]), np.array([[kp, kd]]), delay)

    return loop


def added_damping_loop(mass: float, damping: float, ksd: float) -> Loop:
    """Return the loop of a double integrator's held damping force -k_sd v, which uses its current velocity.

    The mass is in kg, both dampings are in N s/m.
    """

    def loop(period: float, delay: int) -> Matrix:  # noqa: ARG001
        drive = DoubleIntegratorDrive.of(period, mass, damping)
        return np.array([[drive.decay - ksd * drive.force_to_velocity]])

    return loop


def parent_loop(
    inertia: float,
    slope: float,
    feedback: Pair,
    integral: Pair,
    swarm: tuple[float, float | None],
    heights: Pair = (0.0, 0.0),
) -> Loop:
    """Return the loop of plane, parent controller, command filter and swarm, linearised about rest at 0.

    The plane is I w' = -c w - tau_s. The controller requests k1 th + k2 w + z with z' = i1 th + i2 w (by Euler's
    method); the filter smooths this torque, and the swarm follows it by its law. The delay is that of the broadcasts to
    the robots.

    The inertia I is in kg m^2, the slope c of the friction in N m s/rad. `feedback` is k1 and k2 in N m/rad and
    N m s/rad, `integral` i1 and i2 in these units per s, `swarm` K and None for single integrators, kp and kd for
    double integrators. With masses above the axis, `heights` are their weight g H in N m, which adds g H th, and h/g
    (s^2), which adds h/g times the second derivative of tau_s; that of single integrators jumps.
    """
    gain, derivative = swarm
    second = derivative is not None
    weight, reaction = heights[0] / inertia, heights[1] / inertia
    # Plane and swarm: th, w, tau_s and, for double integrators, tau_s'; input: tau_s' or tau_s''.
    order = 4 if second else 3
    continuous = np.zeros((order + 1, order + 1))
    continuous[0, 1] = 1.0
    continuous[1, :3] = weight, -slope / inertia, -1.0 / inertia
    continuous[2:order, 3 : order + 1] = np.eye(order - 2)
    if second:
        continuous[1, order] = reaction
    jumping = bool(reaction) and not second
    command_filter = np.array([[0.0, 1.0, 0.0], [-(BANDWIDTH**2), -2.0 * BANDWIDTH, BANDWIDTH**2], [0.0, 0.0, 0.0]])

    def loop(period: float, delay: int) -> Matrix:
        held = exponential(continuous * period)
        filtered = exponential(command_filter * period)
        # State: plane and swarm, filter's value and rate, integral, and the last command if the plane feels its jumps.
        size = order + 3 + jumping
        value, rate, total = order, order + 1, order + 2
        command = np.zeros(size)
        command[0], command[1], command[total] = *feedback, 1.0
        free = np.eye(size)
        free[:order, :order] = held[:order, :order]
        free[value : rate + 1] = 0.0
        free[value : rate + 1, value : rate + 1] = filtered[:2, :2]
        free[value : rate + 1] += np.outer(filtered[:2, 2], command)
        free[total, 0], free[total, 1] = period * integral[0], period * integral[1]
        free[total, total] = float(any(integral))
        asked = -free[value] / period if not second else -free[rate] / period
        now = value if not second else rate
        asked[now] += 1.0 / period
        asked[value] -= gain
        asked[2] += gain
        if derivative is not None:
            asked[rate] -= derivative
            asked[3] += derivative
        entry = np.zeros((size, 1))
        entry[:order, 0] = held[:order, order]
        if jumping:
            kick = held[:order, 1] * reaction
            entry[:order, 0] += kick
            free[:order, -1], free[-1, -1], entry[-1, 0] = -kick, 0.0, 1.0
        return companion(free, entry, asked[np.newaxis], delay)

    return loop


def sampled_conditions(setting: Setting) -> Iterator[Condition]:
    """Yield conditions on period and delay for each loop."""
    yield from loop_conditions(_loops(setting), setting.delay, setting.period)
    if setting.has_double:
        yield _added_damping(setting)
    if setting.raised:
        yield from _heights(setting)


def _heights(setting: Setting) -> Iterator[Condition]:
    """Yield what masses above the axis require of the torque and of the controller's bandwidth."""
    needed = setting.plane.gravity * setting.moment * tan(setting.angle_max)
    largest = setting.manifold.torque_max
    yield Condition(
        "heights, torque",
        None,
        Form("torque_max > g H tan th_max", largest, needed),
        {"moment": setting.moment, "angle_max": setting.angle_max, "left": largest - needed},
        "beyond the angle at which they are equal, no law can stop the plane",
    )
    linear = _linear_law(setting)
    if linear is None:
        return
    gain, lag = linear[0][1], setting.robots[0].actuator_lag
    inertia = setting.body_inertia + setting.manifold.offset
    # s F(s)/(T s + 1), F the command filter, has the phase 0 where its gain is this; there positive feedback begins.
    bandwidth = 1.0 / (2.0 / BANDWIDTH + 2.0 * BANDWIDTH * lag * lag / (1.0 + 2.0 * BANDWIDTH * lag))
    yield Condition(
        "heights, reaction",
        None,
        Form(
            "bandwidth h k2/(g I) < 1",
            bandwidth * setting.reacting_height * gain / (setting.plane.gravity * inertia),
            1.0,
            "<",
        ),
        {"height": setting.reacting_height, "k2": gain, "inertia": inertia, "bandwidth": bandwidth},
        "robots that accelerate push the plane in the direction that they are to stop",
    )


def loop_conditions(loops: Iterable[tuple[str, Loop, str]], delay: int, step: float) -> Iterator[Condition]:
    """Yield conditions on period (s) and delay (steps) for loops, each with its name and a note."""
    for name, loop, note in loops:
        # A delay beyond the longest one exceeds any limit, and the matrix of the loop may be too large.
        considered = min(delay, LONGEST_DELAY)
        bound, longest = largest_period(loop, considered), largest_delay(loop, step)
        yield Condition(
            f"period, {name}",
            None,
            Form(f"step < limit with a delay of {considered}", step, bound, "<"),
            {"period": step, "largest_period": bound, "delay": considered},
            note if bound < LONGEST_PERIOD else f"stable up to {bound:g} s; {note}",
        )
        yield Condition(
            f"delay, {name}",
            None,
            Form(f"delay <= limit at {step:g} s, in steps", delay, longest, "<="),
            {"delay": delay, "largest_delay": longest, "period": step},
            note if longest < LONGEST_DELAY else f"stable up to {longest} steps; {note}",
        )


def _loops(setting: Setting) -> Iterator[tuple[str, Loop, str]]:
    gains, friction = setting.gains, setting.plane.friction
    inertia = setting.body_inertia + setting.manifold.offset
    gravity = setting.plane.gravity
    heights = gravity * setting.moment, setting.reacting_height / gravity if setting.raised else 0.0
    kinds: list[tuple[str, float, float | None]] = []
    if setting.has_single:
        yield "SI errors", single_integrator_loop(max(gains.k)), "e[k+1] = e[k] - K h e[k-n], largest K"
        kinds.append(("SI", gains.k[0], None))
    if setting.has_double:
        for axis, kp, kd in zip(("torque", "inertia"), gains.kp, gains.kd, strict=True):
            if axis == "torque" or (kp, kd) != (gains.kp[0], gains.kd[0]):
                name = "DI errors" if gains.kp[0] == gains.kp[1] and gains.kd[0] == gains.kd[1] else f"DI {axis} error"
                yield name, double_integrator_loop(kp, kd), "e'' = -kp e - kd e', with held acceleration"
        kinds.append(("DI", gains.kp[0], gains.kd[0]))
    linear = _linear_law(setting)
    if linear is None:
        return
    (k1, k2), integral, linearised = linear
    feedback = k1 + setting.compensated_weight, k2
    for kind, gain, derivative in kinds:
        for where, slope in (("moving", friction.g6), ("at rest", friction.slope_at_rest())):
            loop = parent_loop(inertia, slope, feedback, integral, (gain, derivative), heights)
            note = f"plane, {linearised}, filter and swarm, linearised at 0 with friction slope {slope:g} ({where})"
            yield f"plane {where}, {kind}", loop, note


def _linear_law(setting: Setting) -> tuple[Pair, Pair, str] | None:
    """Return proportional and integral gains of angle and rate of the law near 0, and its name."""
    law = setting.law
    if isinstance(law, StateFeedback):
        return (law.k1, law.k2), (0.0, 0.0), "state feedback"
    if isinstance(law, Pid):
        k1, k2, k3 = law.gains
        return (k1, k2), (k3, 0.0), "PID"
    if isinstance(law, Arise):
        # e2 = -(w + alpha1 th) for a reference at rest, where Y_d and therefore the adaptation vanish.
        g = law.gains
        rate = (g.ks + 1.0) * g.alpha2 + g.beta / g.smoothing
        return ((g.ks + 1.0) * g.alpha1, g.ks + 1.0), (rate * g.alpha1, rate), "ARISE without adaptation"
    return None


def _added_damping(setting: Setting) -> Condition:
    """Return the condition on the robots' added damping k_sd, which acts on the velocity of the step."""
    period, ksd = setting.period, setting.gains.ksd
    limits = [
        (largest_period(added_damping_loop(robot.mass, robot.damping, ksd)), robot.agent_id)
        for robot in setting.robots
        if robot.kind.by_force
    ]
    least, slowest = min(limits)
    return Condition(
        "period, added damping",
        None,
        Form("step < smallest limit of all robots", period, least, "<"),
        {"period": period, "largest_period": least, "ksd": ksd, "robot": slowest},
        "m v' = -c v - k_sd v[k]: motion that does not affect torque and inertia",
    )
