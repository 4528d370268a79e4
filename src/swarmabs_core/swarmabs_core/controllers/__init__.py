"""Parent controllers: plane state in, torque that the swarm should exert out."""

from swarmabs_core.controllers.base import ControllerType, ParentContext, ParentController, Trajectory
from swarmabs_core.controllers.reference import TRAJECTORY, make_trajectory
from swarmabs_core.controllers.registry import ALL_CONTROLLERS, CONTROLLERS, controller_type, make_controller

__all__ = [
    "ALL_CONTROLLERS",
    "CONTROLLERS",
    "TRAJECTORY",
    "ControllerType",
    "ParentContext",
    "ParentController",
    "Trajectory",
    "controller_type",
    "make_controller",
    "make_trajectory",
]
