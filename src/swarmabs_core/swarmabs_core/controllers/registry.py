"""Parent controllers by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.controllers.arise import ARISE
from swarmabs_core.controllers.feedback import LQR, PD
from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Settings, resolve

if TYPE_CHECKING:
    from swarmabs_core.controllers.base import ControllerType, ParentContext, ParentController

CONTROLLERS: dict[str, ControllerType] = {entry.name: entry for entry in (PD, LQR, ARISE)}


def controller_type(name: str) -> ControllerType:
    """Look up a parent controller.

    Raises
    ------
    InputError
        If there is none of this name.
    """
    try:
        return CONTROLLERS[name]
    except KeyError:
        raise InputError(f"no parent controller {name!r}; there are {', '.join(sorted(CONTROLLERS))}") from None


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
        If the type is unknown or a setting is refused.
    """
    entry = controller_type(name)
    return entry.make(resolve(entry.settings, settings, owner=f"parent controller {name!r}"), context)
