"""Configurations of parts that other packages may bring: their models are derived from the settings they declare.

So the author of a parent controller or of a swarm law writes one table, and scenario, schema and ROS parameters follow.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import Field

from swarmabs_core.controllers import CONTROLLERS, TRAJECTORY
from swarmabs_core.law_registry import LAWS
from swarmabs_core.registry import Part, Registry

from .controllers import (
    CONTROLLER_CONFIGS,
    DEFAULT_TRAJECTORY,
    TRAJECTORY_CONFIGS,
    ControllerConfig,
    SineTrajectory,
    TrajectoryConfig,
)
from .declared import model_of_table
from .fields import Model, Tagged


class LawConfig(Model):
    """Base of the swarm laws' configurations."""

    type: str = Field(description="name of the swarm law")


class PaperLaw(LawConfig):
    """The paper's laws, each robot by its kind; their gains are ``swarm.gains``."""

    type: Literal["paper"] = Field(default="paper", description="the paper's laws, each robot by its kind")


DEFAULT_LAW = "paper"
LAW_CONFIGS: dict[str, type[LawConfig]] = {"paper": PaperLaw}
"""The model of each built-in ``swarm.law.type``."""


class TrackingConfig(ControllerConfig):
    """Base of the derived models of controllers that follow a trajectory."""

    trajectory: Annotated[TrajectoryConfig, Tagged("type", TRAJECTORY_CONFIGS, DEFAULT_TRAJECTORY)] = Field(
        default=SineTrajectory(), description="reference of the plane's angle"
    )


class _Configs(Mapping[str, type[Model]]):
    """Models by name: given ones, then those derived for what installed packages bring, each when it is asked for."""

    def __init__(self, given: Mapping[str, type[Model]], registry: Registry[Any, Any], base: type[Model]) -> None:
        self._given = given
        self._registry = registry
        self._base = base

    def __getitem__(self, name: str) -> type[Model]:
        if name in self._given:
            return self._given[name]
        return derived(self._registry[name], self._base)

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self._given, *self._registry)))

    def __len__(self) -> int:
        return sum(1 for _ in self)


ALL_CONTROLLER_CONFIGS: Mapping[str, type[Model]] = _Configs(CONTROLLER_CONFIGS, CONTROLLERS, ControllerConfig)
"""The model of each ``controller.type``, those of installed packages too."""
ALL_LAW_CONFIGS: Mapping[str, type[Model]] = _Configs(LAW_CONFIGS, LAWS, LawConfig)
"""The model of each ``swarm.law.type``, those of installed packages too."""


@cache
def derived(part: Part[Any, Any], base: type[Model]) -> type[Model]:
    """Return the model of a part's settings: dotted names become nested mappings, `TRAJECTORY` a trajectory.

    Parameters
    ----------
    part : Part
        What a package brings.
    base : type of Model
        What the model is derived from.
    """
    settings = part.settings
    if base is ControllerConfig and set(TRAJECTORY) <= set(settings):
        base = TrackingConfig
        settings = tuple(setting for setting in settings if setting not in TRAJECTORY)
    name = "".join(word.capitalize() for word in part.name.split("_"))
    tag = (Literal[part.name], Field(default=part.name, description=f"the {part.name} of an installed package"))
    return model_of_table(f"{name}Config", base, settings, type=tag)
