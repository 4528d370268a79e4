"""Parent controllers: plane state in, torque that the swarm should exert out."""

from swarmabs_core.controllers.arise import ARISE
from swarmabs_core.controllers.base import ControllerType, ParentContext, ParentController, Trajectory
from swarmabs_core.controllers.feedback import LQR, PD
from swarmabs_core.controllers.reference import TRAJECTORY, make_trajectory
from swarmabs_core.registry import Registry

CONTROLLERS = Registry(
    "parent controller", "swarmabs.parent_controllers", ControllerType, (PD, LQR, ARISE), ("torque", "reference")
)

__all__ = [
    "CONTROLLERS",
    "TRAJECTORY",
    "ControllerType",
    "ParentContext",
    "ParentController",
    "Trajectory",
    "make_trajectory",
]
