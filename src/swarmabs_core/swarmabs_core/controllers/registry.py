"""Parent controllers by name: built-in ones, and those that installed packages bring."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from swarmabs_core.controllers.arise import ARISE
from swarmabs_core.controllers.base import ControllerType
from swarmabs_core.controllers.feedback import LQR, PD
from swarmabs_core.registry import Registry

if TYPE_CHECKING:
    from swarmabs_core.controllers.base import ParentContext, ParentController
    from swarmabs_core.parameters import Settings

CONTROLLERS: dict[str, ControllerType] = {entry.name: entry for entry in (PD, LQR, ARISE)}
"""The built-in ones."""

ALL_CONTROLLERS = Registry(
    "parent controller", "swarmabs.parent_controllers", ControllerType, CONTROLLERS, ("torque", "reference")
)
"""Those of installed packages too."""


def controller_type(name: str) -> ControllerType:
    """Look up a parent controller.

    Raises
    ------
    InputError
        If there is none of this name, or the package that brings it is unfit.
    """
    return ALL_CONTROLLERS.find(name)


def make_controller(name: str, settings: Settings, context: ParentContext) -> ParentController:
    """Make a parent controller.

    Parameters
    ----------
    name : str
        Its type, such as ``pd``.
    settings : Settings
        Its settings; those left out have their defaults.
    context : ParentContext
        The system that it shall control.

    Raises
    ------
    InputError
        If the type is unknown, a setting is refused, or the package that brings the type is unfit.
    """
    return cast("ParentController", ALL_CONTROLLERS.make(name, settings, context))
