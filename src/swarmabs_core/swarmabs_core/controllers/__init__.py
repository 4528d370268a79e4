"""Parent controllers: plane state in, torque that the swarm should exert out."""

from swarmabs_core.controllers.base import ControllerType, ParentContext, ParentController, Trajectory
from swarmabs_core.controllers.registry import CONTROLLERS, controller_type, make_controller

__all__ = [
    "CONTROLLERS",
    "ControllerType",
    "ParentContext",
    "ParentController",
    "Trajectory",
    "controller_type",
    "make_controller",
]
