"""A payload carried by rotors, each a robot that follows its commanded thrust with a lag; see README.md."""

from dataclasses import dataclass
from math import pi

from swarmabs_core.declaration import setting
from swarmabs_core.elementary import cos, sin
from swarmabs_core.systems import Constant, Need, Quantity, SystemType, Tracked, Vector

STEEPEST = 1.4  # rad


@dataclass(frozen=True)
class Payload:
    """A payload that flies under rotors."""

    mass: float = setting(12.0, "mass of the payload with its rotors, kg", above=0.0)
    inertias: tuple[float, ...] = setting((1.3, 1.3, 2.4), "moments of inertia, kg m^2", length=3, above=0.0)
    reaction: float = setting(0.016, "reaction torque per thrust, m; 0: coaxial pairs, yaw is left alone", minimum=0.0)
    drag: float = setting(0.4, "drag, N s/m", minimum=0.0)
    turning_drag: float = setting(0.05, "drag of rotation, N m s", minimum=0.0)
    wind: tuple[float, ...] = setting((3.0, 2.0, 1.0), "amplitudes of the wind's force, N", length=3)
    height: float = setting(2.0, "height to which it climbs from 0.5 s to 4 s, m")
    distance: float = setting(1.5, "distance that it flies along x from 3 s to 7 s, m")
    tilt_max: float = setting(0.25, "largest roll and pitch angle requested, rad", above=0.0, below=STEEPEST)
    request_max: tuple[float, ...] = setting(
        (300.0, 30.0, 30.0, 30.0), "limits of requests, N, N m", length=4, above=0.0
    )
    fading: float = setting(2.0, "rate at which thrusts that cancel each other fade away, 1/s", minimum=0.0)
    gravity: float = setting(9.81, "gravitational acceleration, m/s^2", above=0.0)
    substep: float = setting(0.005, "longest step of the integrator, s", above=0.0)

    names = (("x", "y", "z"), ("vx", "vy", "vz"), ("roll", "pitch", "yaw"), ("p", "q", "r"))
    parent = tuple(Quantity(x, u, 0.5) for xs, u in zip(names, ("m", "m/s", "rad", "rad/s"), strict=True) for x in xs)
    robot = (Quantity("thrust", "N"),)
    place = (Constant("x", "m"), Constant("y", "m"), Constant("spin", "1", 0.0))
    constants = (*place, Constant("time_constant", "s"), Constant("highest", "N"))
    tracked = tuple(Tracked(name, 0.3) for name in "xyz")
    columns = True
    initial = (0.0,) * 12

    @property
    def abstract(self) -> tuple[Quantity, ...]:
        """Thrust and torques of all rotors."""
        rows = (Quantity("lift", "N"), Quantity("torque_x", "N m", 0.5), Quantity("torque_y", "N m", 0.5))
        return (*rows, Quantity("torque_z", "N m", self.reaction)) if self.reaction else rows

    @property
    def needs(self) -> tuple[Need, ...]:
        """The same quantities, requested by the controller."""
        return tuple(Need(row.name, row.unit, -x, x) for row, x in zip(self.abstract, self.request_max, strict=False))

    def contribution(self, q: Vector, constants: Vector) -> Vector:
        """Return thrust and torques of a rotor with a thrust."""
        return tuple(q[0] * each for (each,) in self.jacobian(q, constants))

    def jacobian(self, q: Vector, constants: Vector) -> tuple[Vector, ...]:
        """Return its derivative by the thrust."""
        x, y, spin = constants[:3]
        return ((1.0,), (y,), (-x,), (self.reaction * spin,))[: len(self.abstract)]

    def weight(self, constants: Vector) -> float:
        """Return 1: all thrusts count alike."""
        return 1.0

    def own_motion(self, q: Vector, constants: Vector) -> Vector:
        """Return the rate at which a thrust fades away by itself."""
        return (-self.fading * q[0],)

    def limits(self, constants: Vector, _: str) -> tuple[Vector, Vector]:
        """Return the lowest and the highest thrust of a rotor."""
        return (0.0,), (constants[4],)

    def disturbed(self, time: float, state: Vector, abstract: Vector, _: Vector, value: float = 0.0) -> Vector:
        """Return the derivative with an additional force along x, N."""
        v, (roll, pitch, yaw), (p, q, r), (jx, jy, jz) = state[3:6], state[6:9], state[9:], self.inertias
        cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
        thrust, *torques = (*abstract, 0.0)[:4]
        up = (cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr)
        gusts = (sin(0.7 * time), sin(0.5 * time + 1.0), sin(0.9 * time))
        fx, fy, fz = (thrust * u + w * s - self.drag * x for u, w, s, x in zip(up, self.wind, gusts, v, strict=True))
        gyroscopic = ((jz - jy) * q * r, (jx - jz) * r * p, (jy - jx) * p * q)
        turn, rows = sr * q + cr * r, zip(torques, gyroscopic, (p, q, r), self.inertias, strict=True)
        spin_up = (*((torque - moment - self.turning_drag * w) / j for torque, moment, w, j in rows),)
        angle_rates = (p + sp / cp * turn, cr * q - sr * r, turn / cp)
        return (*v, (fx + value) / self.mass, fy / self.mass, fz / self.mass - self.gravity, *angle_rates, *spin_up)

    derivative = disturbed

    def complete(self, needs: Vector) -> Vector:
        """Return the needs: they are the abstract state."""
        return needs

    def path(self, time: float) -> tuple[Vector, Vector]:
        """Return position, velocity and acceleration along x and z."""
        return step(self.distance, (time - 3.0) / 4.0, 4.0), step(self.height, (time - 0.5) / 3.5, 3.5)

    def reference(self, time: float) -> Vector:
        """Return the reference position."""
        (x, *_), (z, *_) = self.path(time)
        return (x, 0.0, z)

    def controller(self, period: float) -> "Pilot":
        """Return the controller."""
        return Pilot(self)

    def failed(self, state: Vector) -> str:
        """Return why the run cannot continue if the payload has turned over."""
        return "the payload has turned over" if max(abs(state[6]), abs(state[7])) > STEEPEST else ""

    def robot_place(self, state: Vector, q: Vector, constants: Vector) -> Vector:
        """Return where a rotor is drawn: seen obliquely from the side, higher with more thrust."""
        x, y = constants[:2]
        return (x + 0.4 * y, 0.4 * y - x * sin(state[7]) + y * sin(state[6]) + 0.02 * q[0], -state[7])

    def robot_body(self, constants: Vector) -> tuple[tuple[Vector, ...], ...]:
        """Return disc and mast of a rotor."""
        disc = tuple((0.12 * cos(n * pi / 8.0), 0.04 * sin(n * pi / 8.0)) for n in range(17))
        return (disc, ((0.0, 0.0), (0.0, -0.12)))

    def outline(self, state: Vector) -> tuple[tuple[Vector, ...], ...]:
        """Return ring and arms, and the payload below them."""

        def line(*ends: Vector, below: float = 0.0) -> tuple[Vector, ...]:
            places = (self.robot_place(state, (0.0,), end) for end in ends)
            return tuple((x, y - below) for x, y, _ in places)

        ring = [(0.9 * cos(n * pi / 18.0), 0.9 * sin(n * pi / 18.0)) for n in range(37)]
        top = line((-0.25, -0.2), (0.25, -0.2), (0.25, 0.2), (-0.25, 0.2), (-0.25, -0.2), below=0.15)
        front = line((-0.25, -0.2), (0.25, -0.2), below=0.15) + line((0.25, -0.2), (-0.25, -0.2), below=0.4)
        side = line((0.25, -0.2), (0.25, 0.2), below=0.15) + line((0.25, 0.2), (0.25, -0.2), below=0.4)
        load = (top, (*front, front[0]), (*side, side[0]))
        arms = line((-0.9, 0.0), (0.9, 0.0)), line((0.0, -0.9), (0.0, 0.9))
        return (*load, *arms, line(*ring[:19]), line(*ring[18:]))  # the ring is not filled


@dataclass(frozen=True)
class Pilot:
    """Flies the payload along its path."""

    made: Payload

    def ask(self, time: float, state: Vector, desired: Vector, offset: float = 0.0) -> Vector:
        """Return thrust and torques; the reference of the height is offset (m)."""
        made, (x, y, z, vx, vy, vz, roll, pitch, yaw, p, q, r) = self.made, state
        (xd, xv, xa), (zd, zv, za) = made.path(time)
        lift = made.gravity + za + 3.6 * (zv - vz) + 4.0 * (zd + offset - z)
        ax, ay = xa + 1.6 * (xv - vx) + xd - x, -1.6 * vy - y
        ahead, left = cos(yaw) * ax + sin(yaw) * ay, cos(yaw) * ay - sin(yaw) * ax
        asked = [min(max(a / made.gravity, -made.tilt_max), made.tilt_max) for a in (-left, ahead)]
        tilt = (25.0 * (asked[0] - roll) - 9.0 * p, 25.0 * (asked[1] - pitch) - 9.0 * q, -1.5 * yaw - 2.2 * r)
        torques = (j * each for j, each in zip(made.inertias, tilt, strict=True))
        return (made.mass * lift / (cos(roll) * cos(pitch)), *torques)[: len(made.needs)]

    offset_ask = ask


def step(size: float, u: float, time: float) -> Vector:
    """Return a smooth step from 0 to a size within a time (s), with its derivatives; u goes from 0 to 1."""
    u = min(max(u, 0.0), 1.0)
    left = 1.0 - u
    rise, speed = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u), 30.0 * u * u * (left * left) / time
    return (size * rise, size * speed, size * 60.0 * u * left * (1.0 - 2.0 * u) / (time * time))


PAYLOAD = SystemType.of("payload", Payload)
