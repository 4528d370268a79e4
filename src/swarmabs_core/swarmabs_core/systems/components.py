"""Names and units of the components of the vectors in messages of any parent system."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from swarmabs_core.messages import Field, ParentState, fields_of
from swarmabs_core.systems.interface import Quantity

if TYPE_CHECKING:
    from swarmabs_core.messages import Message
    from swarmabs_core.systems.interface import SystemTables

_TABLES = {
    "state": ("parent", 0),
    "coordinates": ("robot", 0),
    "velocities": ("robot", 1),
    "command": ("robot", 0),
    "constants": ("constants", 0),
    "value": ("abstract", 0),
    **dict.fromkeys(("rate", "drift", "mean_rate", "end_rate"), ("abstract", 1)),
    **dict.fromkeys(("curvature", "mean_acceleration"), ("abstract", 2)),
}
"""The table of the system that names the components of a field, and how often they are derived by time."""
MAIN_FIELDS = ("state", "coordinates", "constants", "value")
"""Fields whose components are the quantities themselves."""
REFERENCE = "reference"


def components(system: SystemTables, message: type[Message]) -> dict[str, tuple[Quantity, ...]]:
    """Return the components of each vector of a class of messages, with the quantities' names and their own units.

    A component of the Gram matrix has the names of its row and column. The state of the parent also has the field
    `REFERENCE`, the references of what is tracked.
    """
    units = {row.name: row.unit for row in system.parent}
    named = {}
    if message is ParentState:
        named[REFERENCE] = tuple(Quantity(tracked.name, units[tracked.name]) for tracked in system.tracked)
    for field, declared in fields_of(message).items():
        if field == "gram" and isinstance(declared, Field):
            names = [row.name for row in system.abstract]
            named[field] = tuple(
                Quantity(f"{row}_{column}", declared.unit)
                for number, row in enumerate(names)
                for column in names[: number + 1]
            )
        elif isinstance(declared, Field) and field in _TABLES and declared.ros_type.startswith("float64["):
            table, times = _TABLES[field]
            unit = "by kind" if field == "command" else ""
            rows = getattr(system, table)
            named[field] = tuple(Quantity(row.name, unit or derived(row.unit, times)) for row in rows)
    return named


def derived(unit: str, times: int = 1) -> str:
    """Return the unit of a derivative by time, such as ``N m/s`` for ``N m`` and ``m/s^2`` for ``m/s``."""
    if not times:
        return unit
    base, power = re.fullmatch(r"(.*?)(?:/s(?:\^(\d+))?)?", unit).groups()  # type: ignore[union-attr]  # always matches
    times += 0 if base == unit else int(power or 1)
    return f"{base}/s" if times == 1 else f"{base}/s^{times}"
