"""The kinds of robots: how each moves under a command, what its command is, and how it is named and drawn.

A further kind is an object here and a constant `Kind`; laws, motion, checks, units and views follow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

from swarmabs_core.drive import DoubleIntegratorDrive, SingleIntegratorDrive
from swarmabs_core.elementary import exp, expm1
from swarmabs_core.messages import Kind
from swarmabs_core.systems.components import derived

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_core.drive import IdealDrive
    from swarmabs_core.messages import RobotState
    from swarmabs_core.systems.interface import NamedSystem, Vector


class RobotDynamics(NamedTuple):
    """The numbers of a robot that do not change: its constants, and how it moves over a control period.

    Attributes
    ----------
    constants : tuple of float
        In the order of the system.
    weight : float
        Weight W of its motion.
    mass, damping : float
        Of a double integrator, kg and N s/m.
    gain : float
        Of a double integrator, force per mean acceleration, kg; of a lag, step of the command per mean velocity, s.
    time_constant, decay : float
        Of a lag, s, and the share of its gap that remains after a period.
    drive : DoubleIntegratorDrive
        Of a double integrator.
    """

    constants: Vector
    weight: float
    mass: float = 1.0
    damping: float = 0.0
    gain: float = 1.0
    time_constant: float = 1.0
    decay: float = 0.0
    drive: DoubleIntegratorDrive = DoubleIntegratorDrive(1.0, 0.0, 0.0, 0.0)


class RobotKind:
    """A kind of robot, without state: this one is the single integrator, q' = u.

    Attributes
    ----------
    kind : Kind
        The constant that messages contain.
    short, words, legend : str
        Abbreviation, phrase in a table of robots, and entry of a legend.
    colour, shape : str
        Colour and shape of its symbol: circle, square or diamond.
    constant : str
        The constant of a robot that must be positive; empty if there is none.
    coordinates : tuple of str
        The unit of each coordinate that it needs, in order, such as m, m, rad; empty if it moves along any.
    """

    kind: ClassVar[Kind] = Kind.SINGLE_INTEGRATOR
    short: ClassVar[str] = "SI"
    words: ClassVar[str] = "velocity (SI)"
    legend: ClassVar[str] = "velocity-driven (SI)"
    colour: ClassVar[str] = "#56b4e9"
    shape: ClassVar[Literal["circle", "square", "diamond"]] = "circle"
    constant: ClassVar[str] = ""
    coordinates: ClassVar[tuple[str, ...]] = ()

    def fits(self, units: Sequence[str]) -> bool:
        """Return whether it can move along coordinates in these units."""
        return not self.coordinates or self.coordinates == tuple(units)

    def drive(self, period: float, mass: float, damping: float) -> IdealDrive:
        """Return the motion on the plane that the law expects; period in s, mass in kg, damping in N s/m."""
        del mass, damping
        return SingleIntegratorDrive(period)

    def dynamics(self, system: NamedSystem, constants: Vector, period: float) -> RobotDynamics:
        """Return the numbers of a robot for a control period, s."""
        del period
        return RobotDynamics(constants, system.instance.weight(constants))

    def command(self, own: RobotDynamics, q: Vector, velocity: Vector, rate: Vector) -> Vector:
        """Return the command (d,) that, held for a period, gives the rate of the law at coordinates and velocities."""
        del own, q, velocity
        return rate

    def brake(self, own: RobotDynamics, q: Vector, velocity: Vector, time: float) -> Vector:
        """Return the command (d,) that brings a robot to rest, a double integrator with a time constant (s)."""
        del own, velocity, time
        return (0.0,) * len(q)

    def advance(
        self, own: RobotDynamics, q: Vector, velocity: Vector, command: Vector, period: float
    ) -> tuple[Vector, Vector]:
        """Return coordinates and velocities, (d,) each, one period (s) later under a command (d,)."""
        del own, velocity
        return tuple(x + u * period for x, u in zip(q, command, strict=True)), command

    def slopes(self, system: NamedSystem, start: RobotState, end: RobotState, period: float) -> tuple[Vector, Vector]:
        """Return the velocities of a robot at both ends of a period (s), times the period."""
        del system, period
        moved = tuple(b - a for a, b in zip(start.coordinates, end.coordinates, strict=True))
        return moved, moved

    def command_units(self, units: Sequence[str]) -> tuple[str, ...]:
        """Return the unit of each number of a command, (d,), by the units of the coordinates, (d,)."""
        return tuple(derived(unit) for unit in units)


class DoubleIntegrator(RobotKind):
    """m q'' = u - c q': the command is a force."""

    kind, constant = Kind.DOUBLE_INTEGRATOR, "mass"
    short, words, legend = "DI", "force (DI)", "force-driven (DI)"
    colour, shape = "#e69f00", "square"

    def drive(self, period: float, mass: float, damping: float) -> IdealDrive:
        """Return the motion on the plane that the law expects; period in s, mass in kg, damping in N s/m."""
        return DoubleIntegratorDrive.of(period, mass, damping)

    def dynamics(self, system: NamedSystem, constants: Vector, period: float) -> RobotDynamics:
        """Return the numbers of a robot for a control period, s."""
        mass, damping = system.constant(constants, "mass", 1.0), system.constant(constants, "damping")
        z = damping * period / mass
        gain = mass * (z / -expm1(-z) if z else 1.0)
        drive = DoubleIntegratorDrive.of(period, mass, damping)
        return RobotDynamics(constants, system.instance.weight(constants), mass, damping, gain, drive=drive)

    def command(self, own: RobotDynamics, q: Vector, velocity: Vector, rate: Vector) -> Vector:
        """Return the force (d,) that, held for a period, gives the mean acceleration of the law."""
        del q
        return tuple(own.damping * v + own.gain * a for v, a in zip(velocity, rate, strict=True))

    def brake(self, own: RobotDynamics, q: Vector, velocity: Vector, time: float) -> Vector:
        """Return the force (d,) that brings a robot to rest with a time constant (s)."""
        del q
        return tuple(-own.mass * v / time for v in velocity)

    def advance(
        self, own: RobotDynamics, q: Vector, velocity: Vector, command: Vector, period: float
    ) -> tuple[Vector, Vector]:
        """Return coordinates and velocities, (d,) each, one period later under a force (d,)."""
        del period
        moved = [own.drive.advance(x, v, u) for x, v, u in zip(q, velocity, command, strict=True)]
        return tuple(x for x, _ in moved), tuple(v for _, v in moved)

    def slopes(self, system: NamedSystem, start: RobotState, end: RobotState, period: float) -> tuple[Vector, Vector]:
        """Return the velocities of a robot at both ends of a period (s), times the period."""
        del system
        return tuple(v * period for v in start.velocities), tuple(v * period for v in end.velocities)

    def command_units(self, units: Sequence[str]) -> tuple[str, ...]:
        """Return the unit of the force along each coordinate, (d,), by the units of the coordinates, (d,)."""
        return tuple("N" if unit == "m" else f"kg {derived(unit, 2)}" for unit in units)


class FirstOrderLag(RobotKind):
    """T q' = u - q: the command is the value that the coordinates approach."""

    kind, constant = Kind.FIRST_ORDER_LAG, "time_constant"
    short, words, legend = "lag", "lag", "with lag"
    colour, shape = "#cc79a7", "diamond"

    def dynamics(self, system: NamedSystem, constants: Vector, period: float) -> RobotDynamics:
        """Return the numbers of a robot for a control period, s."""
        time_constant = system.constant(constants, "time_constant", 1.0)
        ratio = -period / time_constant
        gain, weight = period / -expm1(ratio), system.instance.weight(constants)
        return RobotDynamics(constants, weight, gain=gain, time_constant=time_constant, decay=exp(ratio))

    def command(self, own: RobotDynamics, q: Vector, velocity: Vector, rate: Vector) -> Vector:
        """Return the value (d,) that, held for a period, gives the mean velocity of the law."""
        del velocity
        return tuple(x + own.gain * v for x, v in zip(q, rate, strict=True))

    def brake(self, own: RobotDynamics, q: Vector, velocity: Vector, time: float) -> Vector:
        """Return the coordinates (d,), at which the robot stays."""
        del own, velocity, time
        return q

    def advance(
        self, own: RobotDynamics, q: Vector, velocity: Vector, command: Vector, period: float
    ) -> tuple[Vector, Vector]:
        """Return coordinates and velocities, (d,) each, one period later under a command (d,)."""
        del velocity, period
        after = tuple(u + (x - u) * own.decay for x, u in zip(q, command, strict=True))
        return after, tuple((u - x) / own.time_constant for x, u in zip(after, command, strict=True))

    def slopes(self, system: NamedSystem, start: RobotState, end: RobotState, period: float) -> tuple[Vector, Vector]:
        """Return the velocities of a robot at both ends of a period (s), times the period."""
        gain = period / system.constant(end.constants, "time_constant", 1.0)
        first, last = (
            tuple(gain * (u - x) for u, x in zip(end.command, q, strict=True))
            for q in (start.coordinates, end.coordinates)
        )
        return first, last

    def command_units(self, units: Sequence[str]) -> tuple[str, ...]:
        """Return the units of the coordinates, (d,), which approach the command."""
        return tuple(units)


SINGLE_INTEGRATOR, DOUBLE_INTEGRATOR, FIRST_ORDER_LAG = RobotKind(), DoubleIntegrator(), FirstOrderLag()
KINDS: dict[int, RobotKind] = {one.kind: one for one in (SINGLE_INTEGRATOR, DOUBLE_INTEGRATOR, FIRST_ORDER_LAG)}
"""Every kind of robot by the constant in messages."""


def kind_of(number: int) -> RobotKind:
    """Return the kind that a message names; robots of which a recording tells an unknown kind move straight."""
    return KINDS.get(number, SINGLE_INTEGRATOR)
