r"""The tilting plane under a moving swarm (eq. newDynamics with eq. frictionModel).

.. math:: (J + J_s) \dot w = -\cos(\theta) \tau_s - \dot J_s w - f_f(w) - \tau_d(t), \qquad \dot\theta = w

The paper's masses are at the height of the axis. Robots at heights :math:`h_i` above it, and a plane of mass M whose
centre is at :math:`h_0`, add :math:`\sum m_i h_i^2` to the inertia and :math:`g H \sin\theta + \sum m_i h_i \dot v_i`
to the right-hand side, with :math:`H = \sum m_i h_i + M h_0`. Where the velocities of robots jump, the angular momentum
about the axis, :math:`(J + J_s + \sum m_i h_i^2) w - \sum m_i h_i v_i`, does not.

Within a control period each robot's path is a polynomial in time: a straight line for a single integrator, which holds
its velocity; the cubic Hermite interpolant of positions and velocities at both ends for a double integrator; a constant
for a robot at rest. Torque and inertia of the swarm are therefore polynomials of degree 3 and 6, summed once per
period.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from math import ceil, copysign, inf, isfinite
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

from swarmabs_core import runge_kutta
from swarmabs_core.declaration import part, setting
from swarmabs_core.elementary import cos, sin, sin_cos, tanh
from swarmabs_core.errors import RunError
from swarmabs_core.sensing import PlaneSensor
from swarmabs_core.summation import column_total, exact_total, term_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from swarmabs_core.runge_kutta import Acceleration, Floats

Quantity = TypeVar("Quantity", float, "Floats")
"""A number of one robot, or those of many as a column."""
Function: TypeAlias = "Callable[[Any], Any]"
Functions: TypeAlias = tuple[Function, Function, Function]

STEEPEST = 1.5
"""Angle of the plane, rad, at which a run fails: robots slide off, and the ARISE law divides by its cosine."""
DIVERGED = "the plane's motion is not finite at t = {:g} s; reduce plane.substep, or the gains"


class RobotPath(NamedTuple):
    """Mass (kg) and path of a robot over a period: p(s) = c0 + c1 s + c2 s^2 + c3 s^3 (m), s in [0, 1]."""

    mass: float
    c0: float
    c1: float
    c2: float
    c3: float


def standing(mass: float, position: float) -> RobotPath:
    """Return the path of a robot with a mass (kg) that stays at a position (m)."""
    return RobotPath(mass, position, 0.0, 0.0, 0.0)


def straight(mass: float, start: float, end: float) -> RobotPath:
    """Return the path of a robot with a mass (kg) that moves from `start` to `end` (m) at constant velocity."""
    return RobotPath(mass, start, end - start, 0.0, 0.0)


def hermite(mass: float, start: tuple[float, float], end: tuple[float, float], period: float) -> RobotPath:
    """Return the cubic path of a mass (kg) between two states (position in m, velocity in m/s) one period (s) apart."""
    p0, v0 = start
    p1, v1 = end
    d0, d1, rise = v0 * period, v1 * period, p1 - p0
    return RobotPath(mass, p0, d0, *bends(d0, d1, rise))


def bends(d0: Quantity, d1: Quantity, rise: Quantity) -> tuple[Quantity, Quantity]:
    """Return the coefficients of s^2 and s^3 of the cubic in s on [0, 1] with slopes d0 and d1 that rises by `rise`."""
    return 3.0 * rise - 2.0 * d0 - d1, d0 + d1 - 2.0 * rise


@dataclass(frozen=True, slots=True)
class HeightLoad:
    """What the swarm adds over a period because its masses are not at the height of the axis."""

    moment: float  # sum m h, kg m
    inertia: float  # sum m h^2, kg m^2
    reaction: tuple[float, float]  # sum m h v', N m: coefficients of s^0 and s^1
    impulse: float  # sum m h dv by the jumps dv of the velocities at the start, N m s


@dataclass(frozen=True, slots=True)
class SwarmLoad:
    """Torque (N m) and inertia (kg m^2) of the swarm over a period: coefficients of s in [0, 1], lowest power first.

    Without `height` all masses, also the plane's, are at the height of the axis.
    """

    torque: tuple[float, float, float, float]
    inertia: tuple[float, float, float, float, float, float, float]
    height: HeightLoad | None = None


def swarm_load(paths: Sequence[RobotPath], gravity: float) -> SwarmLoad:
    """Sum the loads of all robots on the plane, correctly rounded and so independent of order; gravity in m/s^2."""
    massless = [standing(0.0, 0.0)]
    curved = [path for path in paths if path.c2 or path.c3] or massless
    linear = term_columns((path[:3] for path in paths or massless), linear_terms)
    return summed_load(linear, term_columns(curved, cubic_terms), gravity)


def height_load(
    paths: Sequence[RobotPath], heights: Sequence[float], jumps: Sequence[float], period: float
) -> HeightLoad:
    """Return what the heights (m) of robots add over a period (s), correctly rounded.

    The jumps (m/s) are those of their velocities at the start of the paths.
    """
    level = [(path.mass, height, jump) for path, height, jump in zip(paths, heights, jumps, strict=True)]
    bent = [(path.mass, height, path.c2, path.c3) for path, height in zip(paths, heights, strict=True)]
    nothing = (0.0, 0.0, 0.0)
    return summed_height(
        term_columns(level or [nothing], height_terms),
        term_columns(bent or [(0.0, *nothing)], reaction_terms),
        period,
    )


def column_load(
    mass: Floats,
    start: Sequence[Floats],
    end: Sequence[Floats],
    curved: Any,
    constants: tuple[float, float],
    total: Callable[..., Any] = column_total,
    heights: Floats | None = None,
) -> SwarmLoad:
    """Return the load of robots given as columns, with the same bits as `swarm_load` of their paths.

    `curved` selects those on cubics; the others move at constant velocity, to which their velocity jumps. The constants
    are the period (s) and gravity (m/s^2); `total` is that of `summed_load`. With heights (m), which have the shape of
    the positions, `height_load` is included. All else is as for `hermite`.
    """
    (p0, v0), (p1, v1), (period, gravity) = start, end, constants
    rise = p1 - p0
    d0 = v0[curved] * period
    c2, c3 = bends(d0, v1[curved] * period, rise[curved])
    rise[curved] = d0
    cubics = cubic_terms(mass[curved], p0[curved], d0, c2, c3)
    load = summed_load(linear_terms(mass, p0, rise), cubics, gravity, total)
    if heights is None:
        return load
    jump = v1 - v0
    jump[curved] = 0.0
    level, bent = height_terms(mass, heights, jump), reaction_terms(mass[curved], heights[curved], c2, c3)
    return replace(load, height=summed_height(level, bent, period, total))


def linear_terms(m: Quantity, a: Quantity, b: Quantity) -> tuple[Quantity, ...]:
    """Return the contributions of mass, c0 and c1 of a path to torque/g (s^0, s^1) and inertia (s^0 to s^2)."""
    ma, mb = m * a, m * b
    return ma, mb, ma * a, 2.0 * ma * b, mb * b


def cubic_terms(m: Quantity, a: Quantity, b: Quantity, c: Quantity, d: Quantity) -> tuple[Quantity, ...]:
    """Return the further contributions of c2 and c3 of a path to torque/g (s^2, s^3) and inertia (s^2 to s^6)."""
    ma, mb, mc, md = m * a, m * b, m * c, m * d
    return mc, md, 2.0 * ma * c, 2.0 * (ma * d + mb * c), mc * c + 2.0 * mb * d, 2.0 * mc * d, md * d


def height_terms(m: Quantity, h: Quantity, jump: Quantity) -> tuple[Quantity, ...]:
    """Return the contributions of mass, height and jump of the velocity to moment, inertia and impulse."""
    mh = m * h
    return mh, mh * h, mh * jump


def reaction_terms(m: Quantity, h: Quantity, c: Quantity, d: Quantity) -> tuple[Quantity, ...]:
    """Return the contributions of mass, height, c2 and c3 of a path to the reaction (s^0, s^1), times period^2/2."""
    mh = m * h
    return mh * c, 3.0 * (mh * d)


def summed_load(
    linear: Iterable[Any], cubic: Iterable[Any], gravity: float, total: Callable[..., Any] = exact_total
) -> SwarmLoad:
    """Sum columns of the `linear_terms` of all paths and the `cubic_terms` of curved paths.

    Parameters
    ----------
    linear, cubic : iterable of columns
        One column for each term.
    gravity : float
        Acceleration of gravity, m/s^2.
    total : callable
        Returns the correctly rounded sum of the numbers in one or several columns.
    """
    t0, t1, j0, j1, j2 = linear
    t2, t3, j2_cubic, *higher = cubic
    x0, x1, x2, x3 = [gravity * total(column) for column in (t0, t1, t2, t3)]
    y0, y1, y3, y4, y5, y6 = map(total, (j0, j1, *higher))
    y2 = total(j2, j2_cubic)
    return SwarmLoad((x0, x1, x2, x3), (y0, y1, y2, y3, y4, y5, y6))


def summed_height(
    level: Iterable[Any], bent: Iterable[Any], period: float, total: Callable[..., Any] = exact_total
) -> HeightLoad:
    """Sum columns of the `height_terms` and `reaction_terms` of all paths over a period (s); `total` is as above."""
    moment, inertia, impulse = map(total, level)
    r0, r1 = [2.0 * total(column) / (period * period) for column in bent]
    return HeightLoad(moment, inertia, (r0, r1), impulse)


class Friction(NamedTuple):
    """Friction of the bearing (eq. frictionModel), f_f(w) = g1 (tanh(g2 w) - tanh(g3 w)) + g4 tanh(g5 w) + g6 w.

    The amplitudes g1 (Stribeck) and g4 (Coulomb) are in N m, the slopes g2, g3, g5 in s/rad, the viscous friction g6 in
    N m s/rad.
    """

    g1: float
    g2: float
    g3: float
    g4: float
    g5: float
    g6: float

    def torque(self, angular_velocity: Any, tangent: Function = tanh) -> Any:
        """Return the friction torque, N m, at an angular velocity, rad/s; of an array, `tangent` takes each element."""
        g1, g2, g3, g4, g5, g6 = self
        w = angular_velocity
        steep = tangent(g2 * w)
        coulomb = steep if g5 == g2 else tangent(g5 * w)
        return g1 * (steep - tangent(g3 * w)) + g4 * coulomb + g6 * w

    def slope_at_rest(self) -> float:
        """Return df_f/dw at w = 0, N m s/rad, which determines the stiffness of the equation near rest."""
        return self.g1 * (self.g2 - self.g3) + self.g4 * self.g5 + self.g6


@dataclass(frozen=True, slots=True)
class Disturbance:
    """The unmeasured torque on the plane, tau_d = amplitude sin(angular_frequency t)."""

    amplitude: float = setting(0.0, "amplitude of the disturbance torque", unit="N m")
    angular_frequency: float = setting(0.5, "angular frequency of the disturbance", unit="rad/s")

    def torque(self, time: Any, sine: Function = sin) -> Any:
        """Return the disturbance torque, N m, at a time in s; of an array, the sine takes each element."""
        return self.amplitude * sine(self.angular_frequency * time)

    def torque_from(self, time: Any, circle: Function = sin_cos) -> Function:
        """Return the disturbance torque, N m, by the time (s) that has passed since a time in s.

        `circle` gives sine and cosine, of an array those of each element. The torque is that of the sine of a sum, so
        that the steps of an integrator, which are the same in most periods, need no new sines.
        """
        a, w = self.amplitude, self.angular_frequency
        s, c = circle(w * time)

        def torque(passed: Any) -> Any:
            s1, c1 = circle(w * passed)
            return a * (s * c1 + c * s1)

        return torque


@dataclass(frozen=True, slots=True)
class Plane:
    """The tilting plane."""

    inertia: float = setting(0.5, "moment of inertia J without robots", unit="kg m^2", above=0.0)
    mass: float = setting(
        0.0, "mass M without robots, which matters if its centre is not on the axis", unit="kg", minimum=0.0
    )
    center_height: float = setting(0.0, "height of the plane's centre of mass above the axis at th = 0", unit="m")
    length: float = setting(1.0, "length L; robots stay within L/2 of the axis", unit="m", above=0.0)
    gravity: float = setting(9.81, "acceleration g of gravity", unit="m/s^2", above=0.0)
    friction: Friction = setting(
        Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0),
        "[g1, ..., g6] of g1 (tanh(g2 w) - tanh(g3 w)) + g4 tanh(g5 w) + g6 w: "
        "g1, g4 in N m, g2, g3, g5 in s/rad, g6 in N m s/rad",
        minimum=0.0,
        length=6,
        make=Friction._make,
        say=tuple,
    )
    substep: float = setting(
        inf,
        "longest step of the plane's integrator",
        unit="s",
        above=0.0,
        whole_nanoseconds=True,
        unset=0.0,
        null="as long as its error allows",
    )
    angle: float = setting(0.1, "initial angle", unit="rad", above=-STEEPEST, below=STEEPEST)
    angular_velocity: float = setting(0.0, "initial angular velocity", unit="rad/s")
    disturbance: Disturbance = part(Disturbance, "disturbance torque on the plane")
    robot_gravity: bool = setting(
        default=False,
        description="whether the plane's motion acts on the double integrators, force -m g sin(th) + m p w^2",
    )
    end_stop: float = setting(
        inf,
        f"angle of inelastic end stops on both sides, below {STEEPEST:g} {{unit}}",
        unit="rad",
        above=0.0,
        below=STEEPEST,
        unset=0.0,
    )
    sensor: PlaneSensor = part(PlaneSensor, "sensor of the plane's motion")

    @property
    def moment(self) -> float:
        """First moment M h0 of the plane without robots, kg m."""
        return self.mass * self.center_height


def substeps(period: float, longest: float) -> int:
    """Return the number of equal substeps of a period, both s, of which none is longer than the longest."""
    # Rounding must not add a substep to a period that is a multiple of the substep.
    return max(1, ceil(period / longest * (1.0 - 1e-12)))


class PlaneDynamics:
    """Moves the plane over one control period (s).

    The end stops are inelastic: the plane stops where it meets one, and stays as long as the net torque presses it
    against the stop.

    Attributes
    ----------
    impact : tuple of float or None
        First impact on an end stop in the last period: its time (s), and the angular velocity (rad/s) that is lost.
    """

    def __init__(self, plane: Plane, period: float) -> None:
        self._plane = plane
        self._period = period
        self._longest = 1.0 / substeps(period, plane.substep)
        self.impact: tuple[float, float] | None = None

    def advance(
        self, angle: float, angular_velocity: float, time: float, load: SwarmLoad, extra: float = 0.0
    ) -> tuple[float, float]:
        """Return angle (rad) and angular velocity (rad/s) one period after `time` (s).

        `extra` is a constant torque (N m) over the period, added to the disturbance.

        Raises
        ------
        RunError
            If the motion is not finite.
        """
        motion = acceleration(self._plane, self._period, load, time, extra, (sin_cos, cos, tanh))
        move = self._free if self._plane.end_stop == inf else self._between_stops
        rate = angular_velocity
        if load.height is not None:
            rate = rate + self._kick(load, load.height)
            if abs(angle) == self._plane.end_stop and rate * angle > 0.0:
                rate = 0.0  # the stop absorbs the jerk
        th, w, met = move(motion, angle, rate)
        if not (isfinite(th) and isfinite(w)):
            raise RunError(DIVERGED.format(time))
        self.impact = None if met is None else (time + met[0] * self._period, met[1])
        return th, w

    def advance_each(
        self, angles: Any, angular_velocities: Any, times: Any, load: SwarmLoad, extra: float, functions: Functions
    ) -> tuple[Any, Any]:
        """Return what `advance` does for many periods at once, given as arrays (K,), for a plane without end stops.

        The arrays contain the same bits, which are not finite where `advance` raises an error. The functions
        (`sin_cos`, `cos`, `tanh`) apply those of `elementary` to each element.
        """

        def motion(places: Any) -> Acceleration:
            def there(numbers: Sequence[Any]) -> Any:
                return tuple(number if isinstance(number, float) else number[places] for number in numbers)

            height = load.height
            if height is not None:
                moment, inertia = there((height.moment, height.inertia))
                height = HeightLoad(moment, inertia, there(height.reaction), 0.0)  # the impulse has acted before
            part = SwarmLoad(there(load.torque), there(load.inertia), height)
            return acceleration(self._plane, self._period, part, times[places], extra, functions)

        rates = angular_velocities
        if load.height is not None:
            rates = rates + self._kick(load, load.height)
        return runge_kutta.advance_each(motion, self._period, (angles, rates), self._longest)

    def _kick(self, load: SwarmLoad, height: HeightLoad) -> Any:
        """Return the jump of the angular velocity, rad/s, by the jumps of the robots' velocities at the start."""
        return height.impulse / (self._plane.inertia + load.inertia[0] + height.inertia)

    def _free(self, motion: Acceleration, th: float, w: float) -> tuple[float, float, None]:
        return runge_kutta.advance(motion, self._period, (th, w), self._longest)

    def _between_stops(
        self, motion: Acceleration, th: float, w: float
    ) -> tuple[float, float, tuple[float, float] | None]:
        """Move between the end stops; the first impact is that of `_met`."""
        stop, share = self._plane.end_stop, 0.0
        first: tuple[float, float] | None = None
        while share < 1.0:
            if abs(th) == stop and not w:
                share = self._departure(motion, th, share)
                if share >= 1.0:
                    break
            th, w, met = runge_kutta.advance(
                motion, self._period, (th, w), self._longest, share, partial(self._met, motion)
            )
            if met is None:
                break
            first = first or met
            share, th, w = max(met[0], share + runge_kutta.SHORTEST), copysign(stop, th), 0.0
        return th, w, first

    def _departure(self, motion: Acceleration, th: float, share: float) -> float:
        """Return the share of the period at which the net torque no longer presses a plane at rest against its stop."""
        side = copysign(1.0, th)

        def pressed(at: float) -> bool:
            return bool(side * motion(at, th, 0.0) >= 0.0)

        before = share
        if not pressed(before):
            return before
        for n in range(1, _LOOKS + 1):
            after = share + (1.0 - share) * n / _LOOKS
            if not pressed(after):
                return _switch(lambda at: not pressed(at), before, after)
            before = after
        return 1.0

    def _met(
        self,
        motion: Acceleration,
        share: float,
        length: float,
        start: tuple[float, float, float],
        end: tuple[float, float, float],
    ) -> tuple[float, float] | None:
        """Return where the plane meets a stop in a step: the share of the period and the angular velocity, or None."""
        stop, (th, w, _), (end_th, end_w, _) = self._plane.end_stop, start, end

        def state(part: float) -> tuple[float, float]:
            moved: tuple[float, float] = runge_kutta.step(motion, share, part, self._period, start)[:2]
            return moved

        reach = length
        if not abs(end_th) > stop:
            fastest = max(abs(w), abs(end_w)) * length * self._period
            if (w > 0.0) == (end_w > 0.0) or not abs(th) + fastest > stop:
                return None
            reach = _switch(lambda part: (state(part)[1] > 0.0) != (w > 0.0), 0.0, length)  # it turns back
            if not abs(state(reach)[0]) > stop:
                return None
        part = _switch(lambda part: abs(state(part)[0]) > stop, 0.0, reach)
        return share + part, state(part)[1]


_LOOKS = 16
"""Number of times in a period at which it is checked whether a plane at its stop is still pressed against it."""
_HALVINGS = 48
"""Number of halvings of an interval in which something switches."""


def _switch(switched: Callable[[float], bool], before: float, after: float) -> float:
    """Return where a condition that does not hold at one place begins to hold on the way to another one."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (before + after)
        before, after = (before, middle) if switched(middle) else (middle, after)
    return after


def acceleration(
    plane: Plane, period: float, load: SwarmLoad, time: Any, extra: float, functions: Functions
) -> Acceleration:
    """Return the plane's angular acceleration by share of the period, angle (rad) and angular velocity (rad/s).

    Parameters
    ----------
    plane : Plane
        The plane with friction and disturbance.
    period, time : float
        Length of the period and its start, s; of many periods `time` is an array (K,), as are the numbers of the load.
    load : SwarmLoad
        The swarm's load.
    extra : float
        A further torque, N m, as the disturbance.
    functions : tuple of callable
        Sine and cosine as a pair, cosine, and hyperbolic tangent; of arrays they take each element.
    """
    circle, cosine, tangent = functions
    friction = plane.friction
    disturbance = plane.disturbance.torque_from(time, circle) if plane.disturbance.amplitude else None
    t0, t1, t2, t3 = load.torque
    j0, j1, j2, j3, j4, j5, j6 = load.inertia
    total, height = plane.inertia + j0, load.height
    weight = r0 = r1 = 0.0
    if height is not None:
        total, weight = total + height.inertia, plane.gravity * (height.moment + plane.moment)
        r0, r1 = height.reaction
    k2, k3, k4, k5, k6 = 2.0 * j2, 3.0 * j3, 4.0 * j4, 5.0 * j5, 6.0 * j6

    place: Any = None
    torque: Any
    inertia: Any
    rate: Any
    other: Any

    def accelerated(s: Any, th: Any, w: Any) -> Any:
        nonlocal place, torque, inertia, rate, other
        if s is not place:  # the last two stages of a step are at the same one
            place = s
            torque = t0 + s * (t1 + s * (t2 + s * t3))
            inertia = total + s * (j1 + s * (j2 + s * (j3 + s * (j4 + s * (j5 + s * j6)))))
            rate = (j1 + s * (k2 + s * (k3 + s * (k4 + s * (k5 + s * k6))))) / period
            other = extra if disturbance is None else extra + disturbance(s * period)
            if height is not None:
                other = other - (r0 + s * r1)
        if height is None:
            tilting = -cosine(th) * torque
        else:
            sine_here, cosine_here = circle(th)
            tilting = weight * sine_here - cosine_here * torque
        return (tilting - rate * w - friction.torque(w, tangent) - other) / inertia

    return accelerated
