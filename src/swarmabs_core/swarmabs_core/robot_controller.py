"""The decision of one robot: its state and the broadcasts in, a command within the limits of its drive out.

The caller selects the broadcasts: those of the step in lockstep, the newest in real time.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, inf, isfinite
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.abstraction import conditioned
from swarmabs_core.declaration import setting
from swarmabs_core.drive import SingleIntegratorDrive
from swarmabs_core.events import EventCode
from swarmabs_core.swarm_law import LAWS
from swarmabs_core.systems.kinds import KINDS

if TYPE_CHECKING:
    from swarmabs_core.messages import Broadcast
    from swarmabs_core.parameters import Settings
    from swarmabs_core.swarm_law import Robot

BRAKING_TIME = 0.1
"""Time constant of a double integrator's brake in a safe stop, s."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a robot's drive; null means no limit."""

    velocity: float = setting(inf, "largest speed of a robot", unit="m/s", above=0.0, unset=0.0)
    force: float = setting(inf, "largest force of a double integrator", unit="N", above=0.0, unset=0.0)


HELD = EventCode.NO_FOLLOWER.text.format(why=" (S0 vanishes)")
NOT_FINITE = "the law gives no finite command"
STOPPED = "stop commanded"
RESET = "reset commanded"
"""`SwarmEvent.detail` where a robot does not follow the broadcasts."""


class Decision(NamedTuple):
    """What a robot does in a step.

    The command (m/s or N) is that of the law, within the limits, or, if there is a problem, one that brakes the robot.
    `wanted` is the law's command without limits. A robot that is `held` waits until others follow the law.
    """

    command: float
    wanted: float
    problem: str = ""
    held: bool = False


class RobotController:
    """The law of one robot, its limits and its brake. It is stateless.

    The second moments of the swarm are compared with the length of the plane (m).

    Attributes
    ----------
    follow : callable
        Position (m), velocity (m/s) and the three broadcasts in, the command of the law (m/s or N) out.
    ideal : SingleIntegratorDrive or DoubleIntegratorDrive
        The motion that the law assumes.
    mass, braking_time : float
        Mass, kg, and time constant of the brake, s.

    Raises
    ------
    InputError
        If there is no such law, or its settings are invalid.
    """

    def __init__(self, robot: Robot, law: str, settings: Settings, limits: Limits, plane_length: float) -> None:
        self.follow = LAWS.make(law, settings, robot)
        self.ideal = KINDS[robot.kind].drive(robot.period, robot.mass, robot.damping)
        self.mass = robot.mass
        self.braking_time = max(BRAKING_TIME, robot.period)
        self._kind = robot.kind
        self._limits = limits
        self._length = plane_length

    def decide(self, position: float, velocity: float, heard: Broadcast) -> Decision:
        """Return the robot's decision at a position (m) with a velocity (m/s)."""
        if heard.auxiliary.s0 == 0.0:
            return Decision(self.brake(velocity), 0.0, HELD, held=True)
        sums = conditioned(heard.auxiliary, self._length)
        wanted = self.follow(position, velocity, heard.abstract, sums, heard.desired)
        if not isfinite(wanted):
            return Decision(self.brake(velocity), wanted, NOT_FINITE)
        return Decision(self.limit(velocity, wanted), wanted)

    def brake(self, velocity: float) -> float:
        """Return the command that brings the robot to rest: 0 m/s, or a force (N) against its velocity (m/s)."""
        if not self._kind.by_force:
            return 0.0
        return -copysign(self.braking_force(velocity), velocity)

    def braking_force(self, velocity: float) -> float:
        """Return the magnitude (N) of the force with which a double integrator brakes from a velocity (m/s)."""
        return min(self.mass * abs(velocity) / self.braking_time, self._limits.force)

    def limit(self, velocity: float, command: float) -> float:
        """Return the command (m/s or N) within the drive's limits, at a velocity (m/s)."""
        limits, ideal = self._limits, self.ideal
        if isinstance(ideal, SingleIntegratorDrive):
            return min(max(command, -limits.velocity), limits.velocity)
        if limits.velocity < inf:
            coast, gain = ideal.decay * velocity, ideal.force_to_velocity
            command = min(max(command, (-limits.velocity - coast) / gain), (limits.velocity - coast) / gain)
        return min(max(command, -limits.force), limits.force)  # last, because no drive can exceed it
