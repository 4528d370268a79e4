"""The two models: the plane of the paper, and any parent system of an installed package."""

from swarmabs_core.models.plane import ControllerConfig, ObserverConfig, PlaneConfig
from swarmabs_core.models.plane_robot import AgentConfig, RobotConfig
from swarmabs_core.models.systems import (
    SystemAgentConfig,
    SystemControllerConfig,
    SystemObserverConfig,
    SystemParentConfig,
)

__all__ = [
    "AgentConfig",
    "ControllerConfig",
    "ObserverConfig",
    "PlaneConfig",
    "RobotConfig",
    "SystemAgentConfig",
    "SystemControllerConfig",
    "SystemObserverConfig",
    "SystemParentConfig",
]
