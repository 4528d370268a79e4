"""A plate on a universal joint, tilted about two axes by robots that drive on it; see README.md for the equations."""

from dataclasses import dataclass

from swarmabs_core.declaration import same, setting
from swarmabs_core.elementary import cos, sin
from swarmabs_core.plant import Friction, Plane
from swarmabs_core.systems import Constant, Need, Quantity, Standing, SystemType, Tracked, Vector

STEEPEST = 1.4  # rad


@dataclass(frozen=True)
class Plate:
    """A plate that tilts about two axes, with robots that drive on it."""

    inertias: tuple[float, ...] = setting(
        (3.3, 3.3, 6.6), "moments of inertia of the plate, kg m^2", length=3, above=0.0
    )
    friction: Friction = same(Plane, "friction")
    side: float = setting(2.0, "side of the plate, m", above=0.0)
    swarm_mass: float = setting(4.8, "mass M of all robots, kg", above=0.0)
    angles: tuple[float, ...] = setting((0.1, -0.08), "initial angles, rad", length=2, above=-STEEPEST, below=STEEPEST)
    disturbances: tuple[float, ...] = setting((0.1, 0.1), "amplitudes of the disturbing torques, N m", length=2)
    amplitudes: tuple[float, ...] = setting((0.12, 0.1), "amplitudes of the reference, rad", length=2)
    frequencies: tuple[float, ...] = setting((0.4, 0.25), "angular frequencies of the reference, rad/s", length=2)
    angle_gain: float = setting(30.0, "Kp of the controller, N m/rad", above=0.0)
    rate_gain: float = setting(15.0, "Kd of the controller, N m s", minimum=0.0)
    torque_max: float = setting(6.0, "largest torque requested about each axis, N m", above=0.0)
    margin: float = setting(1.15, "A g^2 M of the completion, at which robots can do what is asked", above=1.0)
    offset: float = setting(0.15, "B of the completion, kg m^2", above=0.0)
    gravity: float = setting(9.81, "gravitational acceleration, m/s^2", above=0.0)
    substep: float = setting(0.005, "longest step of the integrator, s", above=0.0)

    angle = (Quantity("alpha", "rad", 0.1), Quantity("beta", "rad", 0.1))
    parent = (*angle, Quantity("momentum_alpha", "N m s", 0.5), Quantity("momentum_beta", "N m s", 0.5))
    moments = (Quantity("moment_x", "N m", 4.0), Quantity("moment_y", "N m", 4.0))
    abstract = (*moments, *(Quantity(f"inertia_{axes}", "kg m^2", 0.4) for axes in ("xx", "yy", "xy")))
    robot = (Quantity("x", "m"), Quantity("y", "m"))
    constants = (Constant("mass", "kg"), Constant("damping", "N s/m", 0.0))
    tracked = (Tracked("alpha", 0.01), Tracked("beta", 0.01))
    columns = True

    @property
    def needs(self) -> tuple[Need, ...]:
        """The moments that the controller requests."""
        return tuple(Need(row.name, row.unit, -self.torque_max, self.torque_max) for row in self.moments)

    @property
    def initial(self) -> Vector:
        """The plate at rest at step 0."""
        return (*self.angles, 0.0, 0.0)

    def contribution(self, q: Vector, constants: Vector) -> Vector:
        """Return (g m x, g m y, m x^2, m y^2, m x y) of a robot."""
        (x, y), m = q, constants[0]
        return (self.gravity * m * x, self.gravity * m * y, m * x * x, m * y * y, m * x * y)

    def jacobian(self, q: Vector, constants: Vector) -> tuple[Vector, ...]:
        """Return its derivative by (x, y)."""
        (x, y), m, g = q, constants[0], self.gravity
        return ((g * m, 0.0), (0.0, g * m), (2.0 * m * x, 0.0), (0.0, 2.0 * m * y), (m * y, m * x))

    def weight(self, constants: Vector) -> float:
        """Return the mass: then the formation is always an affine image of the first one."""
        return constants[0]

    def own_motion(self, q: Vector, constants: Vector) -> Vector:
        """Return no motion."""
        return (0.0, 0.0)

    def spin(self, a: Vector, rate: Vector) -> float:
        """Return the angular momentum of the robots on the plate, kg m^2/s, if their velocities are affine in place."""
        mass, g = self.swarm_mass, self.gravity
        x, y, u, v = a[0] / g, a[1] / g, rate[0] / g, rate[1] / g
        xx, yy, xy = a[2] - x * x / mass, a[3] - y * y / mass, a[4] - x * y / mass
        p, q, r = 0.5 * rate[2] - x * u / mass, 0.5 * rate[3] - y * v / mass, rate[4] - (x * v + y * u) / mass
        size = xx * yy - xy * xy
        orbit = (x * v - y * u) / mass
        if size <= 1e-12 * (xx + yy) * (xx + yy):  # all on one line
            return orbit
        shear = (r * xx * yy - xy * (p * yy + q * xx)) / ((xx + yy) * size)
        return orbit + shear * (xx - yy) + xy * ((q - shear * xy) / yy - (p - shear * xy) / xx)

    def rates(self, state: Vector, a: Vector, spin: float) -> Vector:
        """Return the angular velocities (alpha', beta'), rad/s."""
        c, s = cos(state[1]), sin(state[1])
        j1, j2, j3 = self.inertias
        m11, m12, m22 = c * c * (j1 + a[3]) + s * s * (j3 + a[2] + a[3]), -c * a[4], j2 + a[2]
        first, second = state[2] - s * spin, state[3]
        size = m11 * m22 - m12 * m12
        return ((m22 * first - m12 * second) / size, (m11 * second - m12 * first) / size)

    def disturbed(self, time: float, state: Vector, abstract: Vector, rate: Vector, value: float = 0.0) -> Vector:
        """Return the derivative of angles and momenta, with an additional torque about the first axis, N m."""
        (alpha, beta), (j1, _, j3), (d1, d2) = state[:2], self.inertias, self.disturbances
        c, s, spin = cos(beta), sin(beta), self.spin(abstract, rate)
        u, v = self.rates(state, abstract, spin)
        pull = -(abstract[1] * cos(alpha) + abstract[0] * sin(alpha) * s) + d1 * sin(0.5 * time) + value
        turn = abstract[0] * cos(alpha) * c + s * c * (j3 - j1 + abstract[2]) * u * u + d2 * cos(0.7 * time)
        turn += s * abstract[4] * u * v + c * spin * u
        return (u, v, pull - self.friction.torque(u), turn - self.friction.torque(v))

    derivative = disturbed

    def complete(self, needs: Vector, standing: Standing) -> Vector:
        """Return moments and moments of inertia: as those of a rigid formation, and a little wider.

        Robots that stand keep theirs. The others form the formation around the centre that supplies the rest of the
        moments; what they are wider shrinks with the square of their share of the mass.
        """
        squared, (x, y) = self.gravity * self.gravity, needs
        a = self.margin / (squared * self.swarm_mass)
        if not standing.robots or not standing.moving[0]:
            return (x, y, a * x * x + self.offset, a * y * y + self.offset, a * x * y)
        still_x, still_y, xx, yy, xy = standing
        moving = standing.moving[0]
        whole = moving + standing.constants[0]
        u, v, own = x - still_x, y - still_y, 1.0 / (squared * moving)
        share = moving / whole
        wider, least = max(0.0, a - 1.0 / (squared * whole)), share * share * self.offset
        return (
            x,
            y,
            xx + own * u * u + wider * x * x + least,
            yy + own * v * v + wider * y * y + least,
            xy + own * u * v + wider * x * y,
        )

    def reference(self, time: float) -> Vector:
        """Return the reference angles."""
        return tuple(size * sin(w * time) for size, w in zip(self.amplitudes, self.frequencies, strict=True))

    def controller(self, period: float) -> "TiltController":
        """Return the controller."""
        return TiltController(self)

    def failed(self, state: Vector) -> str:
        """Return why the run cannot continue if the plate is too steep."""
        return "the plate is too steep" if max(abs(state[0]), abs(state[1])) > STEEPEST else ""

    def outline(self, state: Vector) -> tuple[tuple[Vector, ...], ...]:
        """Return the edge of the plate and its axes, seen from above the plate."""
        h = self.side / 2.0
        return (((-h, -h), (h, -h), (h, h), (-h, h), (-h, -h)), ((-h, 0.0), (h, 0.0)), ((0.0, -h), (0.0, h)))


@dataclass(frozen=True)
class TiltController:
    """Makes both angles follow their references."""

    plate: Plate

    def ask(self, time: float, state: Vector, desired: Vector, offset: float = 0.0) -> Vector:
        """Return the moments that the swarm shall exert, N m; both references are offset (rad)."""
        plate, rates, torques = self.plate, self.plate.rates(state, desired, 0.0), []
        for n, (size, w) in enumerate(zip(plate.amplitudes, plate.frequencies, strict=True)):
            goal, rate = size * sin(w * time), size * w * cos(w * time)
            torque = plate.angle_gain * (goal + offset - state[n]) + plate.rate_gain * (rate - rates[n])
            inertia = plate.inertias[n] + plate.offset
            torques.append(torque - inertia * w * w * goal + plate.friction.torque(rate))
        (alpha, beta), (about_alpha, about_beta) = state[:2], torques
        x = about_beta / (cos(alpha) * cos(beta))
        return (x, -(about_alpha + x * sin(alpha) * sin(beta)) / cos(alpha))

    offset_ask = ask


PLATE = SystemType.of("plate", Plate)
