"""What a message may say: finite numbers that a swarm on this plane can have. Anything else is refused."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite

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
    """

    gravity: float
    plane_length: float
    swarm_mass: float = inf

    @property
    def reach(self) -> float:
        """Largest credible distance of a robot from the axis, m."""
        return 0.5 * self.plane_length * SLACK

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
            return "" if abs(message.angle) <= 3.2 else f"an angle of {message.angle:.4g} rad"
        return ""

    def _abstract(self, state: AbstractState) -> str:
        weight, arm = self.gravity * self.swarm_mass, self.reach
        if abs(state.torque) > weight * arm:
            return f"a torque of {state.torque:.4g} N m, more than the swarm can exert"
        if not 0.0 <= state.inertia <= self.swarm_mass * arm * arm:
            return f"an inertia of {state.inertia:.4g} kg m^2, which the swarm cannot have"
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
        return ""
