"""Configurations of the abstraction observer, looked up by their ``type``."""

from typing import Annotated, Literal

from pydantic import Field

from .fields import LARGEST, Model


class ObserverConfig(Model):
    """Base of the observers' configurations."""

    type: str = Field(description="where the swarm's torque comes from")


class SumObserver(ObserverConfig):
    """The sum over the robots' states."""

    type: Literal["sum"] = Field(default="sum", description="torque and inertia are summed up over the robots")


class ParentResponseObserver(ObserverConfig):
    """The torque estimated from the plane's angle and angular velocity, see docs/parent_response.md."""

    type: Literal["parent_response"] = Field(
        default="parent_response", description="the torque is estimated from the plane's motion"
    )
    bandwidth: Annotated[float, Field(gt=0, le=LARGEST)] = Field(
        default=50.0, description="bandwidth of the filter of the torque estimated from the plane's motion, rad/s"
    )


DEFAULT_OBSERVER = "sum"
OBSERVER_CONFIGS: dict[str, type[ObserverConfig]] = {"sum": SumObserver, "parent_response": ParentResponseObserver}
"""The model of each ``observer.type``."""
