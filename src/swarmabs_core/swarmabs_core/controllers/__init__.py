"""Parent controllers: plane state in, torque that the swarm should exert out."""

from dataclasses import dataclass, field

from swarmabs_core.controllers.arise import ARISE
from swarmabs_core.controllers.base import ControllerType, ParentContext, ParentController, Trajectory
from swarmabs_core.controllers.feedback import LQR, PD
from swarmabs_core.controllers.reference import TRAJECTORY, make_trajectory
from swarmabs_core.declaration import choice, same
from swarmabs_core.friction import Friction
from swarmabs_core.manifold import Manifold
from swarmabs_core.parameters import Settings
from swarmabs_core.plant import Plane
from swarmabs_core.registry import Registry

CONTROLLERS = Registry(
    "parent controller", "swarmabs.parent_controllers", ControllerType, (PD, LQR, ARISE), ("torque", "reference")
)


@dataclass(frozen=True, slots=True)
class ParentLaw:
    """Which law controls the plane, and what it is told of the plane."""

    controller: str = choice(CONTROLLERS.find, CONTROLLERS.built_in, PD.name, "control law of the plane")
    controller_settings: Settings = field(default_factory=dict, hash=False)
    inertia: float = same(Plane, "inertia", name="plane.inertia")
    friction: Friction = same(Plane, "friction", name="plane.friction")

    def make(self, period: float, manifold: Manifold) -> ParentController:
        """Return the law at its beginning, for a control period (s) and the curve on which the swarm is held."""
        context = ParentContext(period, self.inertia, self.friction, manifold)
        return CONTROLLERS.make(self.controller, self.controller_settings, context)


__all__ = [
    "CONTROLLERS",
    "TRAJECTORY",
    "ControllerType",
    "ParentContext",
    "ParentController",
    "ParentLaw",
    "Trajectory",
    "make_trajectory",
]
