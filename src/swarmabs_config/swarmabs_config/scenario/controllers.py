"""Reference trajectories, and what all parent controllers have in common; the models of these are in `plugins`."""

import itertools
from typing import Annotated, Literal, TypeAlias

from pydantic import ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from swarmabs_config.scenario.declared import model_of
from swarmabs_core.declaration import LONGEST_TIME
from swarmabs_core.plant import STEEPEST
from swarmabs_core.trajectory import SHORTEST, Constant, QuinticSpline, QuinticStep, Sine

from .fields import (
    AsTuple,
    Finding,
    Model,
    NonNegative,
    WithoutNegativeZero,
    problem,
    raise_findings,
)

MOST_ROWS = 2000
"""Most rows of a trajectory: they travel to the parent controller as parameters."""

Angle: TypeAlias = Annotated[float, Field(gt=-STEEPEST, lt=STEEPEST), WithoutNegativeZero]
"""An angle of the plane in rad."""


class CsvTrajectory(Model):
    """The smooth curve through the rows of a file, see `swarmabs_core.trajectory`.

    When a scenario is loaded its rows take the place of the file, so that a resolved scenario needs it no more.
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
                "a file beside rows, or in a scenario that is no file", "give 'file', or 'times' and 'angles'"
            )
        if len(self.times) != len(self.angles) or not 2 <= len(self.times) <= MOST_ROWS:
            raise problem(
                f"{len(self.times)} times and {len(self.angles)} angles",
                f"give 'file', or as many times as angles, 2 to {MOST_ROWS}",
            )
        for index, (earlier, later) in enumerate(itertools.pairwise(self.times), start=1):
            if not later - earlier >= SHORTEST:
                finding = Finding.of(
                    ("times", index),
                    f"{later!r} s follows {earlier!r} s",
                    f"let the times increase by at least {SHORTEST} s",
                )
                raise_findings("CsvTrajectory", [finding])
        curve = QuinticSpline(self.times, self.angles)
        for index, (earlier, later) in enumerate(itertools.pairwise(self.times)):
            for part in range(1, 16):
                time = earlier + (later - earlier) * part / 16
                if not abs(angle := curve.derivatives(time)[0]) < STEEPEST:
                    finding = Finding.of(
                        ("times", index),
                        f"the smooth curve through the rows is at {angle:.3g} rad at {time:.6g} s",
                        f"give rows closer together, such that it stays within +-{STEEPEST} rad",
                    )
                    raise_findings("CsvTrajectory", [finding])
        return self


DEFAULT_TRAJECTORY = "sine"
TRAJECTORY_CONFIGS: dict[str, type[Model]] = {
    **{each.type: model_of(each, tag="type") for each in (Sine, Constant, QuinticStep)},
    "csv": CsvTrajectory,
}
"""The model of each ``trajectory.type``."""


class ControllerConfig(Model):
    """Base of the parent controllers' configurations."""

    type: str = Field(description="name of the parent controller")

    @classmethod
    def unknown_key(cls, key: str) -> PydanticCustomError:
        """Say of a trajectory that this controller cannot follow one."""
        if key == "trajectory":
            return problem(
                f"the {cls.model_fields['type'].default} controller follows no trajectory",
                "remove 'trajectory', or use 'type: arise'",
            )
        return super().unknown_key(key)


DEFAULT_CONTROLLER = "pd"
