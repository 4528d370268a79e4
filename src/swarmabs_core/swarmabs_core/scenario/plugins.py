"""Configurations of parts that other packages may bring: their models are derived from the settings they declare.

So the author of a parent controller or of a swarm law writes one table, and scenario, schema and ROS parameters follow.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, create_model

from swarmabs_core.controllers import ALL_CONTROLLERS, TRAJECTORY
from swarmabs_core.law_registry import ALL_LAWS
from swarmabs_core.parameters import Parameter, Scalar
from swarmabs_core.registry import Part, Registry

from .controllers import (
    CONTROLLER_CONFIGS,
    DEFAULT_TRAJECTORY,
    TRAJECTORY_CONFIGS,
    ControllerConfig,
    SineTrajectory,
    TrajectoryConfig,
)
from .errors import show
from .fields import LARGEST, Model, Tagged, WithoutNegativeZero, as_tuple, problem

_LARGEST_INTEGER = 2**63 - 1


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

    def __init__(self, given: Mapping[str, type[Model]], registry: Registry[Any], base: type[Model]) -> None:
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


ALL_CONTROLLER_CONFIGS: Mapping[str, type[Model]] = _Configs(CONTROLLER_CONFIGS, ALL_CONTROLLERS, ControllerConfig)
"""The model of each ``controller.type``, those of installed packages too."""
ALL_LAW_CONFIGS: Mapping[str, type[Model]] = _Configs(LAW_CONFIGS, ALL_LAWS, LawConfig)
"""The model of each ``swarm.law.type``, those of installed packages too."""


@cache
def derived(part: Part, base: type[Model]) -> type[Model]:
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
    return _model(f"{name}Config", base, [(setting.name, setting) for setting in settings], type=tag)


def _model(title: str, base: type[Model], settings: Iterable[tuple[str, Parameter]], **fields: Any) -> type[Model]:
    """Return a model of settings, each given with the rest of its name below this model."""
    by_head: dict[str, list[tuple[str, Parameter]]] = {}
    for name, setting in settings:
        head, _, rest = name.partition(".")
        by_head.setdefault(head, []).append((rest, setting))
    for head, group in by_head.items():
        rest, setting = group[0]
        if rest:
            inner = _model(f"{title}_{head}", Model, group)
            field: Any = (inner, Field(default=inner(), alias=head, description=f"settings {head} of {title}"))
        else:
            field = (_annotation(setting), Field(default=setting.default, alias=head, description=setting.description))
        # The field's own name collides with nothing that pydantic's models have; files and dumps use the alias.
        fields[f"setting_{head}"] = field
    return create_model(title, __base__=base, **fields)


def _annotation(setting: Parameter) -> Any:
    """Return the type of a setting with its bounds."""
    default, length = setting.default, setting.length
    if not isinstance(default, tuple):
        return _scalar(setting, default)
    item = _scalar(setting, default[0] if default else "")
    array: Any = tuple  # mypy cannot follow types that are made at run time
    annotated: Any = Annotated
    if length is not None:
        return annotated[array[(item,) * length], BeforeValidator(as_tuple(length))]
    if not default:
        return annotated[array[item, ...], BeforeValidator(as_tuple(None))]
    # A ROS parameter that is empty counts as not given, and would have its default in the node.
    return annotated[array[item, ...], AfterValidator(_not_empty), BeforeValidator(as_tuple(None))]


def _scalar(setting: Parameter, model: Scalar) -> Any:
    low, high, above = setting.minimum, setting.maximum, setting.above
    if isinstance(model, bool):
        return bool
    if isinstance(model, str):
        return Literal[setting.choices] if setting.choices else Annotated[str, AfterValidator(_printable)]
    if isinstance(model, int):
        least = -_LARGEST_INTEGER if low is None else low
        most = _LARGEST_INTEGER if high is None else high
        return Annotated[int, Field(ge=least, le=most, gt=above)]
    least = -LARGEST if low is None else low
    return Annotated[float, Field(ge=least, le=LARGEST if high is None else high, gt=above), WithoutNegativeZero]


def _not_empty(values: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    if not values:
        raise problem("expected a list of at least one value, found an empty one", "leave the key out for its default")
    return values


def _printable(text: str) -> str:
    if not text.isprintable():
        raise problem(f"{show(text)} has characters that cannot be printed", "give a text in one line")
    return text
