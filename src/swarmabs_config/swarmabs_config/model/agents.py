"""The robots of a scenario, listed or generated."""

import math
import random
from collections.abc import Iterable
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    TypeAdapter,
    WithJsonSchema,
    create_model,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from swarmabs_core.heights import Body
from swarmabs_core.messages import Kind, said, word
from swarmabs_core.models import SystemAgentConfig
from swarmabs_core.models.plane_robot import RobotConfig
from swarmabs_core.systems.check import generated
from swarmabs_core.systems.interface import NamedSystem

from .declared import Like, like, measured
from .errors import show
from .fields import (
    LARGEST,
    AsPair,
    AsTuple,
    Finding,
    Location,
    Model,
    NonNegative,
    Number,
    OrNumber,
    Positive,
    problem,
    raise_findings,
)

LARGEST_ID = 65535
AUTO_INERTIA = 0.0288
"""Inertia of the robots with ``position: auto``, kg m^2: that of the paper's four robots."""

AgentId: TypeAlias = Annotated[int, Like(RobotConfig, "agent_id")]
Mass: TypeAlias = Annotated[float, Like(RobotConfig, "mass")]
Damping: TypeAlias = Annotated[float, Like(RobotConfig, "damping")]
Position: TypeAlias = Annotated[float, Like(RobotConfig, "position")]
Velocity: TypeAlias = Annotated[float, Like(RobotConfig, "velocity")]
CenterHeight: TypeAlias = Annotated[float, Like(Body, "center_height")]


def _offer_velocity(schema: dict[str, JsonValue]) -> None:
    """Let the schema accept what `SingleIntegratorAgent.tolerates` accepts."""
    properties = schema["properties"]
    if isinstance(properties, dict):
        properties["velocity"] = {"const": 0, "description": "accepted if 0, m/s: the robot moves by command only"}


class SingleIntegratorAgent(Model):
    """A robot whose command is its velocity, p' = u."""

    model_config = ConfigDict(json_schema_extra=_offer_velocity)

    id: AgentId = like(RobotConfig, "agent_id", required=True)
    kind: Literal["single_integrator"] = Field(default="single_integrator", description="p' = u")
    mass: Mass = like(RobotConfig, "mass", required=True)
    position: Position = like(RobotConfig, "position", required=True)
    center_height: CenterHeight = like(Body, "center_height")

    damping: ClassVar[float] = 0.0
    velocity: ClassVar[float] = 0.0

    @classmethod
    def tolerates(cls, key: str, value: object) -> bool:
        """Accept an initial velocity of 0, so that robots of both kinds can be written alike."""
        return key == "velocity" and isinstance(value, int | float) and not isinstance(value, bool) and value == 0

    @classmethod
    def unknown_key(cls, key: str) -> PydanticCustomError:
        """Explain which kind of robot has the key."""
        if key == "damping":
            return problem("a single integrator has no damping", "remove it, or use 'kind: double_integrator'")
        if key == "velocity":
            return problem(
                "a single integrator starts at velocity 0",
                "remove it, or use 'kind: double_integrator' with a damping",
            )
        return super().unknown_key(key)


class DoubleIntegratorAgent(Model):
    """A robot whose command is its force, m v' = u - c v."""

    id: AgentId = like(RobotConfig, "agent_id", required=True)
    kind: Literal["double_integrator"] = Field(default="double_integrator", description="m v' = u - c v")
    mass: Mass = like(RobotConfig, "mass", required=True)
    damping: Damping = like(RobotConfig, "damping", required=True)
    position: Position = like(RobotConfig, "position", required=True)
    velocity: Velocity = like(RobotConfig, "velocity")
    center_height: CenterHeight = like(Body, "center_height")


Agent: TypeAlias = SingleIntegratorAgent | DoubleIntegratorAgent

AGENT_KINDS: dict[str, type[Model]] = {
    "single_integrator": SingleIntegratorAgent,
    "double_integrator": DoubleIntegratorAgent,
}
"""The model of each ``kind`` of robot."""


Vector: TypeAlias = Annotated[tuple[Number, ...], AsTuple, OrNumber()]
Pair: TypeAlias = tuple[float, float]
Range: TypeAlias = Annotated[tuple[Number, Number], AsPair]
"""Smallest and largest value."""


class SystemAgent(Model):
    """A robot on a parent system of an installed package."""

    id: AgentId = like(RobotConfig, "agent_id", required=True)
    kind: Annotated[str, Like(SystemAgentConfig, "kind")] = like(SystemAgentConfig, "kind")
    coordinates: Vector = Field(description="initial coordinates, a list or one number")
    velocities: Vector = Field(default=(), description="initial velocities of a double integrator; none: at rest")
    constants: dict[str, Number] = Field(default={}, description="constants that the parent system names")

    @field_validator("constants")
    @classmethod
    def _sorted(cls, constants: dict[str, float]) -> dict[str, float]:
        """Order the constants by name, so that equal scenarios give equal texts."""
        return dict(sorted(constants.items()))


def _numbers(kinds: Iterable[Kind]) -> type[Model]:
    """Return a model with the number of robots of each kind."""
    fields: dict[str, Any] = {
        word(kind): (int, Field(default=0, ge=0, le=LARGEST_ID, description=f"number of {said(kind)} robots"))
        for kind in kinds
    }
    return create_model("Numbers", __base__=Model, **fields)


class SystemGenerate(_numbers(Kind)):  # type: ignore[misc]  # the fields are those of the kinds
    """A swarm on a parent system drawn at random: ids from 1, kind by kind in the order of the fields."""

    constants: dict[str, Range] = Field(
        default={}, description="[smallest, largest] of constants, uniformly distributed; others: default"
    )
    coordinates: Annotated[tuple[Range, ...], AsTuple] = Field(
        default=(),
        description="[smallest, largest] of each coordinate, uniformly distributed; "
        "none: by the method generated of the system",
    )
    seed: int = Field(default=1, ge=0, lt=2**63, description="seed of Python's random.Random")

    @field_validator("constants")
    @classmethod
    def _sorted(cls, constants: dict[str, Pair]) -> dict[str, Pair]:
        """Order the constants by name, in which they are drawn."""
        return dict(sorted(constants.items()))

    @model_validator(mode="after")
    def _check_ranges(self) -> "SystemGenerate":
        ranges: list[tuple[Location, Pair]] = [(("constants", name), ends) for name, ends in self.constants.items()]
        ranges += [(("coordinates", n), ends) for n, ends in enumerate(self.coordinates)]
        findings = [
            Finding.of(where, f"the smallest {low!r} exceeds the largest {high!r}", "write [smallest, largest]")
            for where, (low, high) in ranges
            if low > high
        ]
        raise_findings([*findings, *_too_many(len(self.kinds))])
        return self

    @property
    def kinds(self) -> list[str]:
        """The kinds of the robots by id."""
        return [kind for kind in map(word, Kind) for _ in range(getattr(self, kind))]

    def agents(self, named: NamedSystem) -> tuple[SystemAgent, ...]:
        """Draw the robots, in order of their ids 1, 2, ....

        With ``r = random.Random(seed)``, each robot takes its constants in the order of their names and then its
        coordinates from ``r.uniform(smallest, largest)``. Without ranges, coordinates come from the system.

        Raises
        ------
        InputError
            If the system cannot place the robots.
        """
        draw = random.Random(self.seed)  # noqa: S311 - reproducible, not secret
        kinds, agents = self.kinds, []
        for number, kind in enumerate(kinds, start=1):
            constants = {name: draw.uniform(*ends) for name, ends in self.constants.items()}
            if self.coordinates:
                coordinates = tuple(draw.uniform(*ends) for ends in self.coordinates)
            else:
                coordinates = generated(named, number, len(kinds), constants)
            agents.append(SystemAgent(id=number, kind=kind, coordinates=coordinates, constants=constants))
        return tuple(agents)


def _too_many(count: int) -> list[Finding]:
    """Return what is wrong with a number of robots to generate."""
    if count <= LARGEST_ID:
        return []
    text = f"{count} robots are more than the {LARGEST_ID} ids"
    return [Finding.of((), text, f"generate at most {LARGEST_ID} in all")]


_POSITIVE: TypeAdapter[float] = TypeAdapter(Positive)


def _auto_or_number(value: object) -> object:
    if value == "auto":
        return value
    if isinstance(value, str):
        raise problem(f"expected a number or auto, found the text {show(value)}", "write 'auto', or a number in m")
    return _POSITIVE.validate_python(value, strict=True)


class Generate(Model):
    """A swarm drawn at random: ids from 1, single integrators first, positions +p, -p alternating."""

    single_integrator: int = Field(default=0, ge=0, le=LARGEST_ID, description="number of single integrator robots")
    double_integrator: int = Field(default=0, ge=0, le=LARGEST_ID, description="number of double integrator robots")
    mass: Annotated[tuple[Positive, Positive], AsPair] = measured(
        (0.25, 0.75), "[smallest, largest] mass, uniformly distributed", "kg"
    )
    damping: Annotated[tuple[NonNegative, NonNegative], AsPair] = measured(
        (0.5, 1.5), "[smallest, largest] damping of a double integrator, uniformly distributed", "N s/m"
    )
    position: Annotated[
        float | Literal["auto"],
        BeforeValidator(_auto_or_number),
        WithJsonSchema({"anyOf": [{"const": "auto"}, {"type": "number", "exclusiveMinimum": 0, "maximum": LARGEST}]}),
    ] = measured("auto", "distance p of every robot from the axis, {unit}; auto: sqrt(0.0288/M), M = total mass", "m")
    center_height: CenterHeight = like(Body, "center_height")
    seed: int = Field(default=1, ge=0, lt=2**63, description="seed of Python's random.Random")

    @model_validator(mode="after")
    def _check_ranges(self) -> "Generate":
        findings = [
            Finding.of(
                (name,),
                f"the smallest {name} {low!r} exceeds the largest {high!r}",
                "write [smallest, largest]",
            )
            for name, (low, high) in (("mass", self.mass), ("damping", self.damping))
            if low > high
        ]
        raise_findings([*findings, *_too_many(self.single_integrator + self.double_integrator)])
        return self

    def agents(self) -> tuple[Agent, ...]:
        """Draw the robots, in order of their ids 1, 2, ...: single integrators first, odd ids at +p, even at -p.

        With ``r = random.Random(seed)``, each robot takes its mass from ``r.uniform(*mass)`` and then, if it is a
        double integrator, its damping from ``r.uniform(*damping)``. A single integrator has no damping and draws none.
        """
        draw = random.Random(self.seed)  # noqa: S311 - reproducible, not secret
        bodies: list[tuple[float, float | None]] = []
        for index in range(self.single_integrator + self.double_integrator):
            mass = draw.uniform(*self.mass)
            bodies.append((mass, None if index < self.single_integrator else draw.uniform(*self.damping)))
        if isinstance(self.position, float):
            distance = self.position
        else:
            distance = math.sqrt(AUTO_INERTIA / math.fsum(mass for mass, _ in bodies)) if bodies else 0.0
        agents: list[Agent] = []
        for number, (mass, damping) in enumerate(bodies, start=1):
            position = distance if number % 2 else -distance
            body: dict[str, Any] = {"mass": mass, "position": position, "center_height": self.center_height}
            if damping is None:
                agents.append(SingleIntegratorAgent(id=number, **body))
            else:
                agents.append(DoubleIntegratorAgent(id=number, damping=damping, **body))
        return tuple(agents)
