r"""The tilting plane under a moving swarm (eq. newDynamics with eq. frictionModel).

.. math:: (J + J_s) \dot w = -\cos(\theta) \tau_s - \dot J_s w - f_f(w) - \tau_d(t), \qquad \dot\theta = w

Within a control period each robot's path is a polynomial in time: a straight line for a single integrator, which holds
its velocity; the cubic Hermite interpolant of positions and velocities at both ends for a double integrator; a constant
for a robot at rest. Torque and inertia of the swarm are therefore polynomials of degree 3 and 6, summed once per
period.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, copysign, cos, inf, isfinite, sin, tanh
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from swarmabs_core.declaration import part, setting
from swarmabs_core.errors import RunError
from swarmabs_core.sensing import PlaneSensor
from swarmabs_core.summation import column_total, exact_total, term_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

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


def bends(d0: float, d1: float, rise: float) -> tuple[float, float]:
    """Return the coefficients of s^2 and s^3 of the cubic in s on [0, 1] with slopes d0 and d1 that rises by `rise`."""
    return 3.0 * rise - 2.0 * d0 - d1, d0 + d1 - 2.0 * rise


@dataclass(frozen=True, slots=True)
class SwarmLoad:
    """Torque (N m) and inertia (kg m^2) of the swarm over a period: coefficients of s in [0, 1], lowest power first."""

    torque: tuple[float, float, float, float]
    inertia: tuple[float, float, float, float, float, float, float]


def swarm_load(paths: Sequence[RobotPath], gravity: float) -> SwarmLoad:
    """Sum the loads of all robots on the plane, correctly rounded and so independent of order; gravity in m/s^2."""
    curved = [path for path in paths if path.c2 or path.c3]
    return summed_load(
        term_columns((path[:3] for path in paths), linear_terms), term_columns(curved, cubic_terms), gravity
    )


def column_load(
    mass: Any,
    start: Sequence[Any],
    end: Sequence[Any],
    curved: Any,
    constants: tuple[float, float],
    total: Callable[..., Any] = column_total,
) -> SwarmLoad:
    """Return the load of robots given as columns, with the same bits as `swarm_load` of their paths.

    `curved` selects those on cubics; the others move at constant velocity. The constants are the period (s) and gravity
    (m/s^2); `total` is that of `summed_load`. All else is as for `hermite`.
    """
    path: Any = hermite
    (p0, v0), (p1, v1), (period, gravity) = start, end, constants
    cubics = path(mass[curved], (p0[curved], v0[curved]), (p1[curved], v1[curved]), period)
    rise = p1 - p0
    rise[curved] = cubics.c1
    linear: Any = linear_terms
    return summed_load(linear(mass, p0, rise), cubic_terms(*cubics), gravity, total)


def linear_terms(m: float = 0.0, a: float = 0.0, b: float = 0.0) -> tuple[float, ...]:
    """Return the contributions of mass, c0 and c1 of a path to torque/g (s^0, s^1) and inertia (s^0 to s^2)."""
    ma, mb = m * a, m * b
    return ma, mb, ma * a, 2.0 * ma * b, mb * b


def cubic_terms(m: float = 0.0, a: float = 0.0, b: float = 0.0, c: float = 0.0, d: float = 0.0) -> tuple[float, ...]:
    """Return the further contributions of c2 and c3 of a path to torque/g (s^2, s^3) and inertia (s^2 to s^6)."""
    ma, mb, mc, md = m * a, m * b, m * c, m * d
    return mc, md, 2.0 * ma * c, 2.0 * (ma * d + mb * c), mc * c + 2.0 * mb * d, 2.0 * mc * d, md * d


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

    def torque(self, angular_velocity: float) -> float:
        """Return the friction torque, N m, at an angular velocity in rad/s."""
        w = angular_velocity
        return self.g1 * (tanh(self.g2 * w) - tanh(self.g3 * w)) + self.g4 * tanh(self.g5 * w) + self.g6 * w

    def slope_at_rest(self) -> float:
        """Return df_f/dw at w = 0, N m s/rad, which determines the stiffness of the equation near rest."""
        return self.g1 * (self.g2 - self.g3) + self.g4 * self.g5 + self.g6


@dataclass(frozen=True, slots=True)
class Disturbance:
    """The unmeasured torque on the plane, tau_d = amplitude sin(angular_frequency t)."""

    amplitude: float = setting(0.0, "amplitude of the disturbance torque", unit="N m")
    angular_frequency: float = setting(0.5, "angular frequency of the disturbance", unit="rad/s")

    def torques(self, times: Sequence[Any], sin: Function = sin) -> list[Any]:
        """Return the disturbance torque, N m, at times in s; of arrays, the sine takes each element."""
        if not self.amplitude:
            return [0.0] * len(times)
        return [self.amplitude * sin(self.angular_frequency * time) for time in times]


@dataclass(frozen=True, slots=True)
class Plane:
    """The tilting plane."""

    inertia: float = setting(0.5, "moment of inertia J without robots", unit="kg m^2", above=0.0)
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
        0.001, "longest step of the plane's integrator", unit="s", above=0.0, whole_nanoseconds=True
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


def substeps(period: float, longest: float) -> int:
    """Return the number of equal substeps of a period, both s, of which none is longer than the longest."""
    # Rounding must not add a substep to a period that is a multiple of the substep.
    return max(1, ceil(period / longest * (1.0 - 1e-12)))


class PlaneDynamics:
    """Integrates the plane over one control period (s) by the classical Runge-Kutta method with fixed substeps.

    The period is divided into equal substeps; 0.5 to 1 ms suit the paper's friction, whose slope at rest makes the
    equation stiff. The end stops are inelastic: a substep that leads beyond a stop ends at the stop, at rest. The plane
    stays there while each further substep leads beyond.

    Attributes
    ----------
    impact : tuple of float or None
        First impact on an end stop in the last period, unless the plane rested there at its start: the end of the
        substep (s), and the angular velocity (rad/s) that is lost.
    """

    def __init__(self, plane: Plane, period: float) -> None:
        self._plane = plane
        self._period = period
        self._count = substeps(period, plane.substep)
        self._shares = [n / (2 * self._count) for n in range(2 * self._count + 1)]
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
        end_stop = self._plane.end_stop
        rests = abs(angle) == end_stop and not angular_velocity
        self.impact = None

        def stopped(th: float, w: float, end: float) -> tuple[float, float]:
            if not abs(th) > end_stop:
                return th, w
            if not rests:
                self.impact = self.impact or (time + end, w)
            return copysign(end_stop, th), 0.0

        sampled = self._sample(time, load, extra, sin)
        try:
            th, w = self._integrate(
                (angle, angular_velocity), sampled, (cos, tanh), stopped if end_stop < inf else None
            )
        except (ValueError, OverflowError) as error:  # cos(inf)
            raise RunError(DIVERGED.format(time)) from error
        if not (isfinite(th) and isfinite(w)):
            raise RunError(DIVERGED.format(time))
        return th, w

    def advance_each(
        self, angles: Any, angular_velocities: Any, times: Any, load: SwarmLoad, extra: float, functions: Functions
    ) -> tuple[Any, Any]:
        """Return what `advance` does for many periods at once, given as arrays (K,), for a plane without end stops.

        The arrays contain the same bits, which are not finite where `advance` raises an error, if the functions (sine,
        cosine, hyperbolic tangent) apply those of `math` to each element, with their errors.
        """
        sine, cosine, tangent = functions
        sampled = self._sample(times, load, extra, sine)
        return self._integrate((angles, angular_velocities), sampled, (cosine, tangent), None)

    def _integrate(
        self, state: tuple[Any, Any], sampled: tuple[list[Any], ...], functions: tuple[Function, Function], stop: Any
    ) -> tuple[Any, Any]:
        """Return the state after a period; `stop` changes the state at the end of a substep (s after the start)."""
        torque, inertia, inertia_rate, disturbance = sampled
        cos, tanh = functions
        g1, g2, g3, g4, g5, g6 = self._plane.friction

        def acceleration(th: Any, w: Any, n: int) -> Any:
            friction = g1 * (tanh(g2 * w) - tanh(g3 * w)) + g4 * tanh(g5 * w) + g6 * w
            return (-cos(th) * torque[n] - inertia_rate[n] * w - friction - disturbance[n]) / inertia[n]

        h = self._period / self._count
        half = 0.5 * h
        th, w = state
        for n in range(0, 2 * self._count, 2):
            a1 = acceleration(th, w, n)
            w2 = w + half * a1
            a2 = acceleration(th + half * w, w2, n + 1)
            w3 = w + half * a2
            a3 = acceleration(th + half * w2, w3, n + 1)
            w4 = w + h * a3
            a4 = acceleration(th + h * w3, w4, n + 2)
            th = th + h / 6.0 * (w + 2.0 * (w2 + w3) + w4)
            w = w + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
            if stop is not None:
                th, w = stop(th, w, (n + 2) * half)
        return th, w

    def _sample(self, time: Any, load: SwarmLoad, extra: float, sin: Function) -> tuple[list[Any], ...]:
        """Evaluate torque, inertia, inertia rate and disturbance at the ends and midpoints of the substeps."""
        t0, t1, t2, t3 = load.torque
        j0, j1, j2, j3, j4, j5, j6 = load.inertia
        period, total = self._period, self._plane.inertia + j0
        k2, k3, k4, k5 = 2.0 * j2, 3.0 * j3, 4.0 * j4, 5.0 * j5
        disturbance = self._plane.disturbance.torques([time + s * period for s in self._shares], sin)
        return (
            [t0 + s * (t1 + s * (t2 + s * t3)) for s in self._shares],
            [total + s * (j1 + s * (j2 + s * (j3 + s * (j4 + s * (j5 + s * j6))))) for s in self._shares],
            [(j1 + s * (k2 + s * (k3 + s * (k4 + s * (k5 + s * 6.0 * j6))))) / period for s in self._shares],
            [value + extra for value in disturbance] if extra else disturbance,
        )
