"""A ship in roll, stabilised by trolleys that move on a beam across it; see README.md for the equations."""

from dataclasses import dataclass
from math import cos, exp, fsum, pi, sin

from swarmabs_core.declaration import setting
from swarmabs_core.systems import Constant, Need, Quantity, Standing, SystemType, Tracked, Vector

CAPSIZED = 1.2  # rad


@dataclass(frozen=True)
class Ship:
    """A ship in roll under waves, with trolleys on a beam across it."""

    inertia: float = setting(4e4, "moment of inertia J of the ship in roll, kg m^2", above=0.0)
    damping: float = setting(5.4e3, "damping c of the water, N m s", minimum=0.0)
    stiffness: float = setting(5e4, "righting moment k per angle, N m/rad", minimum=0.0)
    beam: float = setting(5.0, "length of the beam on which trolleys are drawn, m", above=0.0)
    swarm_mass: float = setting(1200.0, "mass of all trolleys, for the check of reachable states, kg", above=0.0)
    roll: float = setting(0.15, "initial roll angle, rad", above=-CAPSIZED, below=CAPSIZED)
    roll_rate: float = setting(0.0, "initial roll rate, rad/s")
    wave_moments: tuple[float, ...] = setting((1500.0, 2500.0, 1200.0), "moments of the three waves, N m", length=3)
    wave_frequencies: tuple[float, ...] = setting((0.11, 0.15, 0.19), "frequencies of the waves, Hz", length=3)
    wave_phases: tuple[float, ...] = setting((0.0, 1.0, 2.0), "phases of the waves, rad", length=3)
    wave_growth: float = setting(5.0, "time over which the waves grow, s", above=0.0)
    angle_gain: float = setting(0.0, "k1, moment per roll angle, N m/rad", minimum=0.0)
    rate_gain: float = setting(4e4, "k2, moment per roll rate, N m s", minimum=0.0)
    estimator: float = setting(10.0, "bandwidth L of the estimate of the waves, 1/s; 0: no estimate", minimum=0.0)
    torque_max: float = setting(8000.0, "largest moment requested from the swarm, N m", above=0.0)
    curvature: float = setting(1e-5, "A of J_s = A tau^2 + B, kg m^2/(N m)^2", minimum=0.0)
    offset: float = setting(100.0, "B of J_s = A tau^2 + B, kg m^2", above=0.0)
    gravity: float = setting(9.81, "gravitational acceleration, m/s^2", above=0.0)
    substep: float = setting(0.01, "longest step of the integrator, s", above=0.0)

    parent = (Quantity("roll", "rad", 0.1), Quantity("roll_rate", "rad/s", 0.1))
    abstract = (Quantity("moment", "N m", 1000.0), Quantity("inertia", "kg m^2", 500.0))  # 100 kg, half a beam
    robot = (Quantity("position", "m"),)
    constants = (Constant("mass", "kg"), Constant("damping", "N s/m", 0.0))
    tracked = (Tracked("roll", 0.02),)
    columns = True

    @property
    def needs(self) -> tuple[Need, ...]:
        """The moment that the controller requests."""
        return (Need("moment", "N m", -self.torque_max, self.torque_max),)

    @property
    def initial(self) -> Vector:
        """Roll angle and rate at step 0."""
        return (self.roll, self.roll_rate)

    def contribution(self, q: Vector, constants: Vector) -> Vector:
        """Return (g m p, m p^2) of a trolley."""
        (p,), mass = q, constants[0]
        return (self.gravity * mass * p, mass * p * p)

    def jacobian(self, q: Vector, constants: Vector) -> tuple[Vector, ...]:
        """Return its derivative by p."""
        (p,), mass = q, constants[0]
        return ((self.gravity * mass,), (2.0 * mass * p,))

    def weight(self, constants: Vector) -> float:
        """Return the mass: then the trolleys keep their order."""
        return constants[0]

    def own_motion(self, q: Vector, constants: Vector) -> Vector:
        """Return no motion."""
        return (0.0,)

    def waves(self, time: float) -> float:
        """Return the moment of the waves, N m."""
        parts = zip(self.wave_moments, self.wave_frequencies, self.wave_phases, strict=True)
        return min(time / self.wave_growth, 1.0) * fsum(a * sin(2.0 * pi * f * time + phase) for a, f, phase in parts)

    def disturbed(self, time: float, state: Vector, abstract: Vector, rate: Vector, value: float = 0.0) -> Vector:
        """Return the derivative of roll angle and rate, with an additional moment, N m."""
        roll, roll_rate = state
        moment = -cos(roll) * abstract[0] - self.waves(time) + value
        moment -= (rate[1] + self.damping) * roll_rate + self.stiffness * roll
        return (roll_rate, moment / (self.inertia + abstract[1]))

    derivative = disturbed

    def complete(self, needs: Vector, standing: Standing) -> Vector:
        """Return moment and moment of inertia of the swarm for a moment.

        Trolleys that stand keep theirs. The others must supply the rest of the moment, which takes the inertia of their
        centre of mass; their spread about it shrinks with the square of their share of the mass.
        """
        (moment,) = needs
        if not standing.robots or not standing.moving[0]:
            return (moment, self.curvature * moment * moment + self.offset)
        (still, inertia), moving = standing, standing.moving[0]
        whole, squared = moving + standing.constants[0], self.gravity * self.gravity
        spread = max(0.0, self.curvature - 1.0 / (squared * whole)) * moment * moment
        spread += (moving / whole) ** 2 * self.offset
        return (moment, inertia + (moment - still) ** 2 / (squared * moving) + spread)

    def reference(self, time: float) -> Vector:
        """Return the roll angle of an upright ship."""
        return (0.0,)

    def controller(self, period: float) -> "RollDamper":
        """Return the controller."""
        return RollDamper(self, period)

    def failed(self, state: Vector) -> str:
        """Return why the run cannot continue if the ship has capsized."""
        return f"the ship has capsized: its roll angle is {state[0]:.3g} rad" if abs(state[0]) > CAPSIZED else ""

    def reach(self, abstract: Vector) -> bool:
        """Return whether trolleys on the beam, with this total mass, can have an abstract state."""
        centre, mean_square = abstract[0] / (self.gravity * self.swarm_mass), abstract[1] / self.swarm_mass
        return centre * centre <= mean_square <= self.beam * self.beam / 4.0

    def outline(self, state: Vector) -> tuple[tuple[Vector, ...], ...]:
        """Return hull and beam of the rolled ship, seen from ahead."""
        half = self.beam / 2.0
        hull = zip(
            (-1.2, -1.15, -0.8, 0.0, 0.8, 1.15, 1.2, -1.2), (0.3, -0.4, -0.9, -1.1, -0.9, -0.4, 0.3, 0.3), strict=True
        )
        lines = (tuple((half * x, half * y) for x, y in hull), ((-half, 0.0), (half, 0.0)))
        return tuple(tuple(turned(x, y, state[0]) for x, y in line) for line in lines)

    def robot_place(self, state: Vector, q: Vector, constants: Vector) -> Vector:
        """Return where a trolley is, seen from ahead, and the roll angle by which it is turned."""
        return (*turned(q[0], 0.0, state[0]), state[0])

    def robot_body(self, constants: Vector) -> tuple[tuple[Vector, ...], ...]:
        """Return box and wheels of a trolley on the beam."""
        box = ((-0.2, 0.12), (0.2, 0.12), (0.2, 0.42), (-0.2, 0.42), (-0.2, 0.12))
        wheel = [(0.06 * cos(n * pi / 6.0), 0.06 + 0.06 * sin(n * pi / 6.0)) for n in range(13)]
        return (box, *(tuple((x + side, y) for x, y in wheel) for side in (-0.12, 0.12)))


class RollDamper:
    """Damps the roll rate, and compensates for the waves, estimated from the ship's momentum."""

    def __init__(self, ship: Ship, period: float) -> None:
        self.ship, self.decay = ship, exp(-ship.estimator * period)
        self.estimate = self.before = 0.0

    def ask(self, time: float, state: Vector, desired: Vector) -> Vector:
        """Return the moment that the swarm shall exert, N m."""
        ship, (roll, rate) = self.ship, state
        waves = 0.0
        if ship.estimator:
            momentum = (ship.inertia + desired[1]) * rate
            known = -ship.damping * rate - ship.stiffness * roll - cos(roll) * desired[0]
            now = momentum + known / ship.estimator
            if time:
                self.estimate += (1.0 - self.decay) * (0.5 * (self.before + now) - self.estimate)
            else:
                self.estimate = momentum
            self.before = now
            waves = ship.estimator * (self.estimate - momentum)
        return ((ship.angle_gain * roll + ship.rate_gain * rate - waves) / cos(roll),)


def turned(x: float, y: float, angle: float) -> Vector:
    """Return a point of the ship, turned by an angle (rad)."""
    return (x * cos(angle) - y * sin(angle), x * sin(angle) + y * cos(angle))


SHIP = SystemType.of("ship", Ship)
