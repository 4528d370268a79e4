"""What a message may say: finite numbers that a swarm on this plane can have. Anything else is refused."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite

from swarmabs_core.declaration import setting
from swarmabs_core.messages import (
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    Kind,
    Message,
    Mode,
    PlaneState,
    Status,
)

SLACK = 1.05
"""By how much a bound may be exceeded: a measured position is never exact."""
_ROUNDING = 1e-6
LEAST_DAMPING_TIME = 1e-3
"""Shortest time constant of a robot's own damping that is credible, in periods."""
FASTEST_TURN = 100.0
"""Largest credible angular velocity of the plane, rad/s: from one end stop to the other within three periods."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """What is known beforehand of a swarm and its plane.

    Parameters
    ----------
    gravity : float
        m/s^2.
    plane_length : float
        m.
    swarm_mass : float
        Mass of all robots that ever take part, kg; infinite if unknown.
    period : float
        Shortest time in which a robot may cross the plane, s: the control period.
    """

    gravity: float
    plane_length: float
    swarm_mass: float = setting(
        inf, "mass of all robots that ever take part, kg, which bounds what is believed", above=0.0, unset=0.0
    )
    period: float = 0.001

    @property
    def reach(self) -> float:
        """Largest credible distance of a robot from the axis, m."""
        return 0.5 * self.plane_length * SLACK

    @property
    def fastest(self) -> float:
        """Largest credible speed of a robot, m/s."""
        return self.plane_length / self.period * SLACK

    def exceeds(self, mass: float) -> bool:
        """Tell whether a mass (kg) is more than that of the whole swarm."""
        return mass > self.swarm_mass * (1.0 + _ROUNDING)

    def problem(self, message: Message) -> str:
        """Return why a message cannot be true; empty if it can."""
        if not all(isfinite(value) for value in message if isinstance(value, float)):
            return "not all of its numbers are finite"
        if isinstance(message, AbstractState):
            return self._abstract(message)
        if isinstance(message, AuxiliaryState):
            return self._sums(message)
        if isinstance(message, DesiredAbstractState):
            return "" if message.mode in tuple(Mode) else f"there is no mode {message.mode}"
        if isinstance(message, AgentState):
            return self._robot(message)
        if isinstance(message, PlaneState):
            return self._plane(message)
        return ""

    def _plane(self, state: PlaneState) -> str:
        if abs(state.angle) > 3.2:
            return f"an angle of {state.angle:.4g} rad"
        if abs(state.angular_velocity) > FASTEST_TURN:
            return f"an angular velocity of {state.angular_velocity:.4g} rad/s, at most {FASTEST_TURN:g} is credible"
        return ""

    def _abstract(self, state: AbstractState) -> str:
        mass, arm = self.swarm_mass * (1.0 + 2.0 * _ROUNDING), self.reach
        weight = self.gravity * mass
        if abs(state.torque) > weight * arm:
            return f"a torque of {state.torque:.4g} N m, more than the swarm can exert"
        if not 0.0 <= state.inertia <= mass * arm * arm:
            return f"an inertia of {state.inertia:.4g} kg m^2, which the swarm cannot have"
        rate, inertia_rate = abs(state.torque_rate), abs(state.inertia_rate)
        if rate > weight * self.fastest or inertia_rate > 2.0 * mass * arm * self.fastest:
            return f"rates of {state.torque_rate:.4g} N m/s and {state.inertia_rate:.4g} kg m^2/s: robots too fast"
        return ""

    def _sums(self, sums: AuxiliaryState) -> str:
        arm = self.reach
        if sums.s0 < 0.0 or sums.s2 < 0.0 or sums.s3 < 0.0 or sums.d0 < 0.0 or sums.d2 < 0.0 or sums.q < 0.0:
            return "a sum of squares is negative"
        if sums.s0 > self.swarm_mass * self.swarm_mass * SLACK:
            return f"S0 = {sums.s0:.4g} kg^2, more than the swarm's mass allows"
        if abs(sums.s1) > sums.s0 * arm or sums.s2 > sums.s0 * arm * arm:
            return "S1 or S2 puts robots off the plane"
        product = sums.s0 * sums.s2
        if abs(sums.s3 - (product - sums.s1 * sums.s1)) > _ROUNDING * product:
            return "S3 is not S0 S2 - S1^2"
        return ""

    def _robot(self, state: AgentState) -> str:
        if state.kind not in tuple(Kind) or state.status not in tuple(Status):
            return f"there is no kind {state.kind} or no status {state.status}"
        if not state.mass > 0.0 or state.damping < 0.0:
            return f"a mass of {state.mass:.4g} kg and a damping of {state.damping:.4g} N s/m"
        if abs(state.position) > self.reach:
            return f"a position of {state.position:.4g} m, which is off the plane"
        if self.exceeds(state.mass):
            return f"a mass of {state.mass:.4g} kg, more than the swarm's {self.swarm_mass:.4g} kg"
        if abs(state.velocity) > self.fastest:
            return f"a velocity of {state.velocity:.4g} m/s, at most {self.fastest:.4g} is credible"
        if state.damping * self.period * LEAST_DAMPING_TIME > state.mass:
            return f"a damping of {state.damping:.4g} N s/m, too much for a mass of {state.mass:.4g} kg"
        return ""
