"""Parent controllers, swarm laws and reference trajectories.

The models of controllers and laws, built in or from a package, are derived from the settings that these declare; so are
their ROS parameters.
"""

import itertools
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from swarmabs_core.controllers import ARISE, CONTROLLERS, LQR, PD, TRAJECTORY, ParentLaw
from swarmabs_core.declaration import LONGEST_TIME, tree_of
from swarmabs_core.parameters import Settings, Value
from swarmabs_core.plant import STEEPEST
from swarmabs_core.registry import Part, Registry
from swarmabs_core.swarm_law import LAWS, PAPER
from swarmabs_core.systems.interface import SYSTEMS
from swarmabs_core.trajectory import SHORTEST, Constant, QuinticSpline, QuinticStep, Sine

from .declared import Like, like, model_of, model_of_table
from .fields import (
    AsTuple,
    Finding,
    Model,
    NonNegative,
    Tagged,
    WithoutNegativeZero,
    as_error,
    problem,
)

MOST_ROWS = 2000
"""Maximum number of rows of a trajectory, which reach the parent controller as parameters."""

Angle: TypeAlias = Annotated[float, Field(gt=-STEEPEST, lt=STEEPEST), WithoutNegativeZero]
"""An angle of the plane in rad."""


class CsvTrajectory(Model):
    """The smooth curve through the rows of a file, see `swarmabs_core.trajectory`.

    Loading a scenario replaces the file by its rows, so a resolved scenario no longer needs the file.
    """

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["file"]}, {"required": ["times", "angles"]}]})

    type: Literal["csv"] = Field(default="csv", description="a quintic spline through rows, at rest at both ends")
    file: str | None = Field(
        default=None,
        exclude=True,
        description="CSV file with the header time,angle (s, rad), relative to the scenario's file",
    )
    times: Annotated[tuple[Annotated[NonNegative, Field(le=LONGEST_TIME)], ...], AsTuple] = Field(
        default=(), description="instead of a file: times of the rows, increasing, s"
    )
    angles: Annotated[tuple[Angle, ...], AsTuple] = Field(
        default=(), description="instead of a file: angles of the rows, rad"
    )

    @model_validator(mode="after")
    def _check_rows(self) -> "CsvTrajectory":
        if self.file is not None:
            raise problem(
                "'file' is given together with rows, or in a scenario that was not read from a file",
                "give either 'file', or 'times' and 'angles'",
            )
        if len(self.times) != len(self.angles) or not 2 <= len(self.times) <= MOST_ROWS:
            raise problem(
                f"{len(self.times)} times and {len(self.angles)} angles",
                f"give 'file', or as many times as angles, 2 to {MOST_ROWS}",
            )
        for index, (earlier, later) in enumerate(itertools.pairwise(self.times), start=1):
            if not later - earlier >= SHORTEST:
                raise as_error(
                    Finding.of(
                        ("times", index),
                        f"{later!r} s follows {earlier!r} s",
                        f"make each time at least {SHORTEST} s later than the one before",
                    )
                )
        curve = QuinticSpline(self.times, self.angles)
        for index, (earlier, later) in enumerate(itertools.pairwise(self.times)):
            for part in range(1, 16):
                time = earlier + (later - earlier) * part / 16
                if not abs(angle := curve.derivatives(time)[0]) < STEEPEST:
                    raise as_error(
                        Finding.of(
                            ("times", index),
                            f"the smooth curve through the rows reaches {angle:.3g} rad at {time:.6g} s",
                            f"add rows, so that the curve stays within +-{STEEPEST} rad",
                        )
                    )
        return self


DEFAULT_TRAJECTORY = "sine"
TRAJECTORY_CONFIGS: dict[str, type[Model]] = {
    **{shape.type: model_of(shape, tag="type") for shape in (Sine, Constant, QuinticStep)},
    "csv": CsvTrajectory,
}
"""The model of each ``trajectory.type``."""


HeightCompensation: TypeAlias = Annotated[bool, Like(ParentLaw, "height_compensation")]


class ControllerConfig(Model):
    """Base of the parent controllers' configurations."""

    type: str = Field(description="name of the parent controller")
    height_compensation: HeightCompensation = like(ParentLaw, "height_compensation")

    @classmethod
    def unknown_key(cls, key: str) -> PydanticCustomError:
        """Explain that this controller follows no trajectory."""
        if key == "trajectory":
            return problem(
                f"the {cls.model_fields['type'].default} controller follows no trajectory",
                "remove 'trajectory', or use 'type: arise'",
            )
        return super().unknown_key(key)


DEFAULT_CONTROLLER = "pd"


class LawConfig(Model):
    """Base of the swarm laws' configurations."""

    type: str = Field(description="name of the swarm law")


class SystemConfig(Model):
    """Base of the parent systems' configurations."""

    type: str = Field(description="name of the parent system")


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
    """Models by name, each derived on first use."""

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
"""The model of each ``controller.type``, including those of installed packages."""
LAW_CONFIGS: Mapping[str, type[Model]] = _Configs(LAWS, LawConfig)
"""The model of each ``swarm.law.type``, including those of installed packages."""
SYSTEM_CONFIGS: Mapping[str, type[Model]] = _Configs(SYSTEMS, SystemConfig)
"""The model of each ``system.type`` of an installed package."""


def settings_of(part: BaseModel) -> Settings:
    """Return the settings that a controller, law or system declares, nested names joined by dots."""
    settings: dict[str, Value] = {}

    def flatten(prefix: str, values: Mapping[str, object]) -> None:
        for key, value in values.items():
            if isinstance(value, dict):
                flatten(f"{prefix}{key}.", value)
            else:
                settings[prefix + key] = cast("Value", value)

    flatten("", part.model_dump(exclude={"type", "height_compensation"}, by_alias=True))
    return settings


ModelT = TypeVar("ModelT", bound=Model)


@cache
def derived(part: Part[Any, Any], base: type[ModelT]) -> type[ModelT]:
    """Return the model of a part's settings: dotted names become nested mappings, `TRAJECTORY` a trajectory."""
    settings = part.settings
    last: dict[str, object] = {}
    if base is ControllerConfig and set(TRAJECTORY) <= set(settings):
        settings = tuple(setting for setting in settings if setting not in TRAJECTORY)
        if part.name in CONTROLLERS.built_in:  # the canonical text ends with the trajectory
            last = {"trajectory": (Trajectory, TrackingConfig.model_fields["trajectory"])}
        else:
            base = TrackingConfig  # type: ignore[assignment]  # a subclass of ControllerConfig
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
