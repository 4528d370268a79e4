"""What a parent controller is to the rest of the system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from swarmabs_core.friction import Friction
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import PlaneState
from swarmabs_core.registry import Part


@dataclass(frozen=True, slots=True)
class ParentContext:
    """What a parent controller may know of the system that it controls.

    Parameters
    ----------
    period : float
        Control period, s.
    inertia : float
        Moment of inertia of the plane alone, kg m^2.
    friction : Friction
        Model of the bearing's friction.
    manifold : Manifold
        Curve on which the desired abstract state lies.
    """

    period: float
    inertia: float
    friction: Friction
    manifold: Manifold


class Trajectory(Protocol):
    """Reference of the plane's angle."""

    def derivatives(self, time: float) -> tuple[float, float, float, float, float]:
        """Return th_d and its first four derivatives (rad, rad/s, ... rad/s^4) at a time in s."""
        ...


class ParentController(Protocol):
    """A control law for the plane. It may keep a state, so it is asked once per step, in order."""

    def torque(self, time: float, plane: PlaneState) -> float:
        """Return the torque tau_raw (N m) wanted at a time (s), before it is limited and filtered.

        Raises
        ------
        RunError
            If the law is not defined in this state of the plane.
        """
        ...

    def reference(self, time: float) -> float:
        """Return the angle (rad) that the plane should have at a time (s)."""
        ...


@runtime_checkable
class OffsetController(Protocol):
    """What a parent controller has besides, if its reference can be offset: no duty."""

    def offset_torque(self, time: float, plane: PlaneState, offset: float) -> float:
        """Return what `torque` returns, for a reference that is higher by an offset (rad).

        It is asked instead of `torque` in the steps in which there is an offset.
        """
        ...


class ControllerType(Part[ParentContext, ParentController]):
    """A parent controller; `name` is the value of ``controller.type`` in a scenario."""
