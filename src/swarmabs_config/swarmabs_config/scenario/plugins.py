"""Models of parent controllers and swarm laws, built-in or of a package: derived from the settings they declare.

So the author of one writes these in one place, and scenario, schema and ROS parameters follow.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from pydantic import Field

from swarmabs_core.controllers import ARISE, CONTROLLERS, LQR, PD, TRAJECTORY
from swarmabs_core.declaration import tree_of
from swarmabs_core.law_registry import LAWS, PAPER
from swarmabs_core.registry import Part, Registry
from swarmabs_core.trajectory import Constant, QuinticStep, Sine

from .controllers import DEFAULT_TRAJECTORY, TRAJECTORY_CONFIGS, ControllerConfig, CsvTrajectory
from .declared import model_of_table
from .fields import Model, Tagged


class LawConfig(Model):
    """Base of the swarm laws' configurations."""

    type: str = Field(description="name of the swarm law")


Trajectory: TypeAlias = Annotated[
    Sine | Constant | QuinticStep | CsvTrajectory, Tagged("type", TRAJECTORY_CONFIGS, DEFAULT_TRAJECTORY)
]


class TrackingConfig(ControllerConfig):
    """Base of the derived models of controllers that follow a trajectory."""

    trajectory: Trajectory = Field(
        default=Sine(),
        description="reference of the plane's angle",
        json_schema_extra={"default": {"type": Sine.type, **tree_of(Sine())}},  # type: ignore[dict-item]  # plain data
    )


class _Configs(Mapping[str, type[Model]]):
    """Models by name, each derived when it is asked for."""

    def __init__(self, registry: Registry[Any, Any], base: type[Model]) -> None:
        self._registry = registry
        self._base = base

    def __getitem__(self, name: str) -> type[Model]:
        return derived(self._registry[name], self._base)

    def __iter__(self) -> Iterator[str]:
        return iter(self._registry)

    def __len__(self) -> int:
        return len(self._registry)


CONTROLLER_CONFIGS: Mapping[str, type[Model]] = _Configs(CONTROLLERS, ControllerConfig)
"""The model of each ``controller.type``, those of installed packages too."""
LAW_CONFIGS: Mapping[str, type[Model]] = _Configs(LAWS, LawConfig)
"""The model of each ``swarm.law.type``, those of installed packages too."""


ModelT = TypeVar("ModelT", bound=Model)


@cache
def derived(part: Part[Any, Any], base: type[ModelT]) -> type[ModelT]:
    """Return the model of a part's settings: dotted names become nested mappings, `TRAJECTORY` a trajectory.

    Parameters
    ----------
    part : Part
        What a package brings.
    base : type of Model
        What the model is derived from.
    """
    settings = part.settings
    last: dict[str, Any] = {}
    if base is ControllerConfig and set(TRAJECTORY) <= set(settings):
        settings = tuple(setting for setting in settings if setting not in TRAJECTORY)
        if part.name in CONTROLLERS.built_in:  # its text has always ended with the trajectory
            last = {"trajectory": (Trajectory, TrackingConfig.model_fields["trajectory"])}
        else:
            base = TrackingConfig  # type: ignore[assignment]  # a ControllerConfig, as is asked for
    name = "".join(word.capitalize() for word in part.name.split("_"))
    described = part.description or f"the {part.name} of an installed package"
    tag = (Literal[part.name], Field(default=part.name, description=described))
    return model_of_table(f"{name}Config", base, settings, last, type=tag)


PdConfig = derived(PD, ControllerConfig)
LqrConfig = derived(LQR, ControllerConfig)
AriseConfig = derived(ARISE, ControllerConfig)
"""The models of the built-in parent controllers."""
PaperLaw = derived(PAPER, LawConfig)
DEFAULT_LAW = PAPER.name
