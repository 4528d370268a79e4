"""The paper's general method: any parent system, controlled by a swarm through an abstraction.

A parent system is an object with the interface `ParentSystem`, which an installed package provides. Its functions are
all that a run, its recording and its display need to know about it; the kernels of this package apply the method to it.
"""

from swarmabs_core.systems.interface import (
    PLANE_TABLES,
    SYSTEMS,
    Constant,
    Need,
    ParentController,
    ParentSystem,
    Quantity,
    Standing,
    SystemTables,
    SystemType,
    Tracked,
    Vector,
)

__all__ = [
    "PLANE_TABLES",
    "SYSTEMS",
    "Constant",
    "Need",
    "ParentController",
    "ParentSystem",
    "Quantity",
    "Standing",
    "SystemTables",
    "SystemType",
    "Tracked",
    "Vector",
]
