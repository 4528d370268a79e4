"""Parent systems for tests, and their installation as a package: a beam, a sheet, a lift, the plane, and faulty ones.

`installed` copies this module into a folder of the search path, so that other processes find the systems, too.
"""

from dataclasses import dataclass
from itertools import cycle
from math import cos as cosine, fsum, inf, nan, pi, sin as sine, tanh
from operator import imul
from pathlib import Path
from typing import Any

from swarmabs_core.declaration import setting
from swarmabs_core.errors import InputError
from swarmabs_core.systems import Constant, Need, Quantity, SystemType, Tracked

G = 9.81
BEAM_SCENARIO = """
schema: 1
system: {type: beam}
swarm:
  agents:
    - {id: 1, kind: single_integrator, coordinates: [0.125], constants: {mass: 0.36}}
    - {id: 2, kind: single_integrator, coordinates: [-0.13], constants: {mass: 0.35}}
    - {id: 3, kind: single_integrator, coordinates: [0.12], constants: {mass: 0.67}}
    - {id: 4, kind: single_integrator, coordinates: [-0.125], constants: {mass: 0.46}}
"""
"""A scenario of four robots on the beam."""
SATELLITE_SCENARIO = """
schema: 1
system: {type: satellite}
swarm:
  agents:
    - {id: 1, kind: single_integrator, coordinates: 0.0, constants: {spin_inertia: 2.0e-5}}
    - {id: 2, kind: single_integrator, coordinates: 0.0, constants: {spin_inertia: 2.0e-5}}
"""
"""A scenario of two reaction wheels on the satellite."""
Vector = tuple[float, ...]


class FirstAndSecondMoment:
    """Robots on a line: a = (g sum m p, sum m p^2), completed by J = A tau^2 + B."""

    parent = (Quantity("angle", "rad"), Quantity("rate", "rad/s"))
    abstract = (Quantity("torque", "N m", G), Quantity("inertia", "kg m^2", 1.0))
    robot = (Quantity("position", "m"),)
    constants = (Constant("mass", "kg"), Constant("damping", "N s/m", 0.0), Constant("time_constant", "s", 0.05))
    needs: tuple[Need, ...] = (Need("torque", "N m", -5.0, 5.0),)
    tracked = (Tracked("angle", 0.01),)
    substep = 0.002
    curvature = 0.0125
    offset = 0.025

    def contribution(self, q: Vector, constants: Vector) -> Vector:
        return G * constants[0] * q[0], constants[0] * q[0] * q[0]

    def jacobian(self, q: Vector, constants: Vector) -> Any:
        return ((G * constants[0],), (2.0 * constants[0] * q[0],))

    def weight(self, constants: Vector) -> float:
        return constants[0]

    def own_motion(self, q: Vector, constants: Vector) -> Vector:
        return (0.0,)

    def complete(self, needs: Vector) -> Vector:
        return needs[0], self.curvature * needs[0] * needs[0] + self.offset

    def reference(self, time: float) -> Vector:
        return (0.0,)


@dataclass
class Damping:
    """Asks for the torque of a damper (N m s/rad), and for one in proportion to the integral of the angle."""

    coefficient: float
    integral: float
    period: float
    total: float = 0.0

    def ask(self, time: float, state: Vector, desired: Vector) -> Vector:
        self.total += self.period * state[0]
        return (self.coefficient * state[1] + self.integral * self.total,)

    def offset_ask(self, time: float, state: Vector, desired: Vector, offset: float) -> Vector:
        return (self.coefficient * state[1] - 5.0 * offset,)


@dataclass(frozen=True)
class Integral:
    total: float = 0.0


@dataclass
class ReplacingDamping(Damping):
    """Keeps the integral in a frozen object, which it replaces."""

    kept: Integral = Integral()

    def ask(self, time: float, state: Vector, desired: Vector) -> Vector:
        self.kept = Integral(self.kept.total + self.period * state[0])
        return (self.coefficient * state[1] + self.integral * self.kept.total,)


@dataclass(frozen=True)
class Beam(FirstAndSecondMoment):
    """A sprung beam whose oscillation robots on it damp."""

    stiffness: float = setting(5.0, "stiffness, N m/rad", above=0.0)
    added: float = setting(2.0, "damping that the swarm adds, N m s/rad", minimum=0.0)
    integral: float = setting(0.0, "gain of the integral of the angle, N m/(rad s)")
    angle: float = setting(0.15, "initial angle, rad")
    limit: float = setting(100.0, "limit of the command, in its unit", above=0.0)
    far: float = setting(3.0, "inertia that robots can have, kg m^2", above=0.0)
    hit: float = setting(10.0, "angle at which the run fails, rad", above=0.0)

    @property
    def initial(self) -> Vector:
        return self.angle, 0.0

    def derivative(self, time: float, state: Vector, abstract: Vector, rate: Vector) -> Vector:
        return self.disturbed(time, state, abstract, rate, 0.0)

    def disturbed(self, time: float, state: Vector, abstract: Vector, rate: Vector, value: float) -> Vector:
        torque = -cosine(state[0]) * abstract[0] - self.stiffness * state[0] - value
        return state[1], (torque - (0.3 + rate[1]) * state[1]) / (0.8 + abstract[1])

    def controller(self, period: float) -> Damping:
        return Damping(self.added, self.integral, period)

    def failed(self, state: Vector) -> str:
        return "the beam hit the ground" if abs(state[0]) > self.hit else ""

    def limits(self, constants: Vector, kind: str) -> tuple[Vector, Vector]:
        return (-self.limit,), (self.limit,)

    def outline(self, state: Vector) -> tuple[tuple[Vector, ...], ...]:
        x, y = 1.5 * cosine(state[0]), 1.5 * sine(state[0])
        return (((-x, -y), (x, y)),)

    def robot_place(self, state: Vector, q: Vector, constants: Vector) -> Vector:
        return q[0] * cosine(state[0]), q[0] * sine(state[0]), state[0]

    def robot_body(self, constants: Vector) -> tuple[tuple[Vector, ...], ...]:
        w, h = 0.03, 0.02 + 0.01 * constants[0]
        return (((-w, 0.0), (w, 0.0), (w, h), (-w, h), (-w, 0.0)), ((0.0, 0.0), (0.0, -h)))

    def reach(self, abstract: Vector) -> bool:
        return abstract[1] < self.far


@dataclass(frozen=True)
class Axes:
    """PD for two axes, towards a reference."""

    made: Any

    def ask(self, time: float, state: Vector, desired: Vector) -> Vector:
        goal = self.made.reference(time)
        al, be = (30.0 * (state[i] - goal[i]) + 15.0 * state[i + 2] for i in (0, 1))
        return -be, al


@dataclass(frozen=True)
class Sheet:
    """A sheet on two decoupled axes, with robots that move in two dimensions."""

    amplitude: float = setting(0.1, "amplitude of the reference, rad")

    parent = (
        Quantity("al", "rad"),
        Quantity("be", "rad"),
        Quantity("al_rate", "rad/s"),
        Quantity("be_rate", "rad/s"),
    )
    abstract = (
        Quantity("moment_x", "N m", G),
        Quantity("moment_y", "N m", G),
        Quantity("inertia_xx", "kg m^2", 1.0),
        Quantity("inertia_yy", "kg m^2", 1.0),
        Quantity("inertia_xy", "kg m^2", 1.0),
    )
    robot = (Quantity("x", "m"), Quantity("y", "m"))
    constants = (Constant("mass", "kg"), Constant("damping", "N s/m", 0.0))
    needs = (Need("moment_x", "N m", -6.0, 6.0), Need("moment_y", "N m", -6.0, 6.0))
    tracked = (Tracked("al", 0.01), Tracked("be", 0.01))
    initial = (0.1, -0.08, 0.0, 0.0)
    substep = 0.005

    def contribution(self, q: Vector, constants: Vector) -> Vector:
        m, (x, y) = constants[0], q
        return G * m * x, G * m * y, m * x * x, m * y * y, m * x * y

    def jacobian(self, q: Vector, constants: Vector) -> Any:
        m, (x, y) = constants[0], q
        return (G * m, 0.0), (0.0, G * m), (2.0 * m * x, 0.0), (0.0, 2.0 * m * y), (m * y, m * x)

    def weight(self, constants: Vector) -> float:
        return constants[0]

    def own_motion(self, q: Vector, constants: Vector) -> Vector:
        return 0.0, 0.0

    def derivative(self, time: float, state: Vector, abstract: Vector, rate: Vector) -> Vector:
        al, be, p, q = state
        x, y, xx, yy, _ = abstract
        al_2 = (-y * cosine(al) - (0.3 + rate[3]) * p) / (3.3 + yy)
        be_2 = (x * cosine(be) - (0.3 + rate[2]) * q) / (3.3 + xx)
        return p, q, al_2, be_2

    def controller(self, period: float) -> Axes:
        return Axes(self)

    def complete(self, needs: Vector) -> Vector:
        x, y = needs
        a, b = 1.15 / (G * G * 4.8), 0.15
        return x, y, a * x * x + b, a * y * y + b, a * x * y

    def reference(self, time: float) -> Vector:
        return self.amplitude * sine(0.4 * time), self.amplitude * sine(0.25 * time)

    def generated(self, number: int, count: int, constants: Vector) -> Vector:
        angle = 2.0 * pi * number / count
        return 0.2 * cosine(angle) / constants[0], 0.2 * sine(angle)


@dataclass(frozen=True)
class Hover:
    """PD of height and tilt."""

    def ask(self, time: float, state: Vector, desired: Vector) -> Vector:
        z, tilt, climb, turn = state
        return 3.0 * (G + 4.0 * (1.0 - z) - 3.6 * climb), -25.0 * tilt - 9.0 * turn


@dataclass(frozen=True)
class Lift:
    """A lift under rotors with lag: inputs in the abstraction, which is linear."""

    parent = (Quantity("z", "m"), Quantity("tilt", "rad"), Quantity("climb", "m/s"), Quantity("turn", "rad/s"))
    abstract = (Quantity("force", "N", 1.0), Quantity("torque", "N m", 1.0))
    robot = (Quantity("thrust", "N"),)
    constants = (Constant("time_constant", "s", 0.05), Constant("place", "m"), Constant("top", "N", 15.0))
    needs = (Need("force", "N", 0.0, 60.0), Need("torque", "N m", -10.0, 10.0))
    tracked = (Tracked("z", 0.02),)
    initial = (0.0, 0.1, 0.0, 0.0)
    substep = 0.01

    def contribution(self, q: Vector, constants: Vector) -> Vector:
        return q[0], constants[1] * q[0]

    def jacobian(self, q: Vector, constants: Vector) -> Any:
        return ((1.0,), (constants[1],))

    def weight(self, constants: Vector) -> float:
        return 1.0

    def own_motion(self, q: Vector, constants: Vector) -> Vector:
        return (-2.0 * q[0],)

    def derivative(self, time: float, state: Vector, abstract: Vector, rate: Vector) -> Vector:
        _, tilt, climb, turn = state
        return climb, turn, abstract[0] * cosine(tilt) / 3.0 - G, abstract[1] - 0.1 * turn

    def controller(self, period: float) -> Hover:
        return Hover()

    def complete(self, needs: Vector) -> Vector:
        return needs

    def reference(self, time: float) -> Vector:
        return (1.0,)

    def limits(self, constants: Vector, kind: str) -> tuple[Vector, Vector]:
        return (0.0,), (constants[2],)


@dataclass(frozen=True)
class TiltingPlane(FirstAndSecondMoment):
    """The plane of the built-in scenarios with state feedback, through the general interface."""

    angle: float = setting(0.1, "initial angle, rad")
    k1: float = setting(3.1623, "gain of the angle, N m/rad")
    k2: float = setting(3.2859, "gain of the angular velocity, N m s/rad")

    substep = 0.001

    @property
    def initial(self) -> Vector:
        return self.angle, 0.0

    def weight(self, constants: Vector) -> float:
        return 1.0

    def derivative(self, time: float, state: Vector, abstract: Vector, rate: Vector) -> Vector:
        th, w = state
        friction = 0.01 * (tanh(1000.0 * w) - tanh(700.0 * w)) + 0.02 * tanh(1000.0 * w) + w
        return w, (-cosine(th) * abstract[0] - rate[1] * w - friction) / (0.5 + abstract[1])

    def controller(self, period: float) -> Any:
        return self

    def ask(self, time: float, state: Vector, desired: Vector) -> Vector:
        return (self.k1 * state[0] + self.k2 * state[1],)


@dataclass(frozen=True)
class Satellite:
    """A satellite that reaction wheels turn: it feels only the rate of the abstract state."""

    inertia: float = setting(1.0, "moment of inertia, kg m^2", above=0.0)
    gain: float = setting(1e-4, "gain of the angle, 1/s^2", minimum=0.0)
    rate_gain: float = setting(0.4, "gain of the rate, 1/s", minimum=0.0)
    push: float = setting(0.0, "torque that pushes it all the time, N m")

    parent = (Quantity("angle", "rad"), Quantity("rate", "rad/s"))
    abstract = (Quantity("momentum", "N m s", 2e-5),)
    robot = (Quantity("speed", "rad/s"),)
    constants = (Constant("spin_inertia", "kg m^2"),)
    needs = (Need("momentum", "N m s", -0.02, 0.02),)
    tracked: tuple[Tracked, ...] = ()
    initial = (0.1, 0.0)
    substep = 0.01

    def contribution(self, q: Vector, constants: Vector) -> Vector:
        return (constants[0] * q[0],)

    def jacobian(self, q: Vector, constants: Vector) -> Any:
        return ((constants[0],),)

    def weight(self, constants: Vector) -> float:
        return constants[0]

    def own_motion(self, q: Vector, constants: Vector) -> Vector:
        return (0.0,)

    def derivative(self, time: float, state: Vector, abstract: Vector, rate: Vector) -> Vector:
        return state[1], (self.push - rate[0]) / self.inertia

    def controller(self, period: float) -> Any:
        return self

    def ask(self, time: float, state: Vector, desired: Vector) -> Vector:
        return (desired[0] + self.inertia * (self.gain * state[0] + self.rate_gain * state[1]),)

    def complete(self, needs: Vector) -> Vector:
        return needs

    def reference(self, time: float) -> Vector:
        return ()


def _far_out(_: object, q: Vector, constants: Vector) -> Vector:
    if abs(q[0]) > 0.3:
        raise ValueError("too\nfar out")
    return G * constants[0] * q[0], constants[0] * q[0] * q[0]


def _refuse(*text: str) -> Any:
    raise InputError(*text)


def _in_turn(*values: Any) -> Any:
    """Return a method that returns these values in turn, whatever it is called with."""
    turn = cycle(values)
    return lambda *_: next(turn)


FAULTS: dict[str, dict[str, Any]] = {
    "impure_derivative": {"derivative": _in_turn((0.0, 0.0), (1e-15, 0.0))},
    "impure_weight": {"weight": _in_turn(1.0, 1.0 + 1e-15)},
    "impure_reference": {"reference": _in_turn((0.0,), (1e-15,))},
    "impure_reach": {"reach": _in_turn(True, False)},
    "impure_outline": {"outline": _in_turn((((0.0, 1.0),),), (((0.0, 2.0),),))},
    "shared_controller": {"controller": _in_turn(Damping(2.0, 1.0, 0.01))},
    "replacing": {"controller": lambda beam, period: ReplacingDamping(beam.added, beam.integral, period)},
    "offset_ask": {"controller": lambda *_: type("C", (), {"ask": lambda *_: (0.0,), "offset_ask": lambda *_: 0.0})()},
    "refuses": {"controller": lambda *_: _refuse("no wheel is left", "add a wheel")},
    "refuses_plainly": {"controller": lambda *_: _refuse("no wheel is left")},
    "limits_of_kinds": {"limits": lambda _, __, kind: {"double_integrator": ((-1.0,), (1.0,))}[kind]},
    "none": {},
    "columns": {"columns": True},
    "columns_power": {"columns": True, "contribution": lambda _, q, c: (G * c[0] * q[0], c[0] * q[0] ** 2)},
    "columns_function": {"columns": True, "own_motion": lambda _, q, c: (0.0 * sine(q[0]),)},
    "columns_branch": {"columns": True, "own_motion": lambda _, q, c: (0.0 if q[0] > 1.0 else -0.0,)},
    "columns_in_place": {"columns": True, "weight": lambda _, c: imul(c[0], 1.0)},
    "columns_joined": {"columns": True, "weight": lambda _, c: fsum((c[0], 0.0))},
    "jacobian": {"jacobian": lambda _, q, c: ((G * c[0],), (c[0] * q[0],))},
    "jacobian_shape": {"jacobian": lambda _, q, c: (G * c[0], 2.0 * c[0] * q[0])},
    "contribution_nan": {"contribution": lambda *_: (nan, 0.0)},
    "far_out": {"contribution": _far_out},
    "roaming": {"own_motion": lambda *_: (0.8,)},
    "contribution_size": {"contribution": lambda *_: (0.0,)},
    "contribution_raises": {"contribution": lambda *_: {}["no\nkey"]},
    "weight": {"weight": lambda *_: 0.0},
    "own_motion": {"own_motion": lambda *_: (0.0, 0.0)},
    "derivative_size": {"derivative": lambda *_: (0.0,)},
    "derivative_nan": {"derivative": lambda *_: (nan, 0.0)},
    "derivative_raises": {"derivative": lambda *_: 1 / 0},
    "derivative_text": {"derivative": lambda *_: ("0", 0.0)},
    "ask_missing": {"controller": lambda *_: object()},
    "ask_size": {"controller": lambda *_: type("C", (), {"ask": lambda *_: (0.0, 0.0)})()},
    "ask_number": {"controller": lambda *_: type("C", (), {"ask": lambda *_: 0.0})()},
    "ask_late": {"controller": lambda *_: type("C", (), {"ask": lambda _, time, *__: (1.0 / (time < 0.05),)})()},
    "ask_late_number": {
        "controller": lambda *_: type("C", (), {"ask": lambda _, time, *__: (1.0,) if time < 0.05 else 1.0})()
    },
    "contribution_moved": {
        "contribution": lambda _, q, c: (
            G * c[0] * q[0],
            c[0] * q[0] ** 2 / (round(abs(q[0]), 3) in {0.12, 0.125, 0.2}),
        )
    },
    "derivative_late": {"derivative": lambda _, time, *__: (0.0, 0.0 / (time < 0.05))},
    "derivative_late_size": {"derivative": lambda _, time, *__: (0.0, 0.0)[: 1 + (time < 0.05)]},
    "derivative_grows": {"derivative": lambda _, time, state, *__: (1e90 * state[0], 0.0 * state[0] ** 2)},
    "disturbed_late": {"disturbed": lambda *given: (0.0, 0.0 / (given[-1] == 0.0))},
    "failed_late": {"failed": lambda _, state: "" if state[0] == 0.15 else {}["x"]},
    "reference_late": {"reference": lambda _, time: (0.0 / (time < 0.05),)},
    "outline": {"outline": lambda *_: ((1.0, 2.0), (2.0, 3.0))},
    "robot_place": {"robot_place": lambda *_: (0.0, 0.0, 0.0, 0.0)},
    "no_constants": {"constants": (), "robot_body": lambda *_: (((0.0, 0.0), (0.1, 0.0)),)},
    "robot_body": {"robot_body": lambda *_: ((1.0, 2.0), (2.0, 3.0))},
    "impure_robot_body": {"robot_body": _in_turn((((0.0, 1.0),),), (((0.0, 2.0),),))},
    "controller_raises": {"controller": lambda *_: {}["x"]},
    "complete_size": {"complete": lambda _, t: t},
    "complete_at_end": {"complete": lambda _, t: (t[0], inf if t[0] > 4.0 else 0.1)},
    "complete_at_zero": {"complete": lambda _, t: (t[0], 1.0 / t[0])},
    "unreachable": {"complete": lambda _, t: (t[0], 0.025 - 0.1 * abs(t[0]))},
    "never_reachable": {"complete": lambda _, t: (t[0], -0.1)},
    "reference": {"reference": lambda *_: (0.0, 0.0)},
    "limits": {"limits": lambda *_: ((1.0,), (-1.0,))},
    "limits_shape": {"limits": lambda *_: (-1.0, 1.0)},
    "initial_size": {"initial": (0.0,)},
    "initial_nan": {"initial": (nan, 0.0)},
    "fails_at_once": {"failed": lambda *_: "it leans"},
    "substep": {"substep": 0.0},
    "parent_empty": {"parent": ()},
    "parent_many": {"parent": tuple(Quantity(f"x{n}", "m") for n in range(33))},
    "parent_text": {"parent": ("angle", "rate")},
    "robot_none": {"robot": None},
    "name": {"robot": (Quantity("the position", "m"),)},
    "lane": {"robot": (Quantity("position", "m", low=-0.2, high=0.2),)},
    "ends": {"robot": (Quantity("position", "m", low=0.5, high=-0.5),)},
    "ends_text": {"robot": (Quantity("position", "m", high="0.5"),)},  # type: ignore[arg-type]
    "ends_of_parent": {"parent": (Quantity("angle", "rad", low=-1.0), Quantity("rate", "rad/s"))},
    "twice": {"parent": (Quantity("angle", "rad"), Quantity("angle", "rad/s"))},
    "scale": {"abstract": (Quantity("torque", "N m", 0.0), Quantity("inertia", "kg m^2"))},
    "scale_text": {"parent": (Quantity("angle", "rad", "0.1"), Quantity("rate", "rad/s"))},  # type: ignore[arg-type]
    "unit": {"robot": (Quantity("position", 1.0),)},  # type: ignore[arg-type]
    "no_method": {"weight": None},
    "need": {"needs": (Need("torque", "N m", 5.0, -5.0),)},
    "need_infinite": {"needs": (Need("torque", "N m", -inf, 5.0),)},
    "needs_empty": {"needs": ()},
    "tracked": {"tracked": (Tracked("angel", 0.01),)},
    "tolerance": {"tracked": (Tracked("angle", 0.0),)},
    "constant": {"constants": (Constant("mass", "kg", nan),)},
}
"""What a faulty beam has instead, by the value of ``system.fault``."""


@dataclass(frozen=True)
class Faulty(Beam):
    """A beam with one fault."""

    fault: str = setting("none", "its fault", choices=tuple(FAULTS))

    def __getattribute__(self, name: str) -> Any:
        find = super().__getattribute__
        if name.startswith("__") or name not in (instead := FAULTS[find("fault")]):
            return find(name)
        value = instead[name]
        return value.__get__(self) if callable(value) else value


BEAM = SystemType.of("beam", Beam)
SHEET = SystemType.of("sheet", Sheet)
LIFT = SystemType.of("lift", Lift)
TILTING_PLANE = SystemType.of("tilting_plane", TiltingPlane)
SATELLITE = SystemType.of("satellite", Satellite)
FAULTY = SystemType.of("faulty", Faulty)
ALL = (BEAM, SHEET, LIFT, TILTING_PLANE, SATELLITE, FAULTY)


def installed(folder: Path) -> None:
    """Install these systems as a package into a folder of the search path, which the fixture `packages` makes."""
    module = "systems_of_tests"
    folder.mkdir(exist_ok=True)
    (folder / f"{module}.py").write_text(Path(__file__).read_text(encoding="utf-8"), encoding="utf-8")
    metadata = folder / f"{module}-1.5.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: systems-of-tests\nVersion: 1.5\n")
    points = "".join(
        f"{name.lower()} = {module}:{name}\n"
        for name in ("BEAM", "SHEET", "LIFT", "TILTING_PLANE", "SATELLITE", "FAULTY")
    )
    (metadata / "entry_points.txt").write_text(f"[swarmabs.parent_systems]\n{points}", encoding="utf-8")
