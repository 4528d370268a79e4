"""The fleet file: robots, hosts, coordinators, network, security."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from functools import cached_property
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator

from swarmabs_config.fleet.parts import (
    LEVELS,
    Coordinators,
    Host,
    Installation,
    Namespace,
    NetworkConfig,
    Security,
    Time,
    TunnelSecurity,
)
from swarmabs_config.fleet.robots import ROBOT_KINDS, Robot
from swarmabs_config.model.errors import show
from swarmabs_config.model.fields import (
    AsTuple,
    Model,
    Name,
    Positive,
    Tagged,
    known_version,
    problem,
)
from swarmabs_config.scenarios import DEFAULT, DottedPath

_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ")
_UNIX = datetime(1970, 1, 1, tzinfo=timezone.utc)


class Fleet(Model):
    """A complete, valid fleet without its scenario. Build it with `load_fleet`, whose errors name file and line."""

    schema_version: Annotated[Literal[1], BeforeValidator(known_version)] = Field(
        alias="schema", description="version of this file format: 1"
    )
    name: Name = Field(default="fleet", description="name of the fleet, by default the file's stem")
    namespace: Namespace = Field(default="/", description="ROS namespace of the swarm")
    epoch: str = Field(
        default="2026-01-01T00:00:00Z", description="time of step 0 in UTC; the same on all hosts, in the past"
    )
    scenario: str = Field(
        default=DEFAULT,
        description="built-in scenario, or a file relative to this one: plane, controller, gains, real-time limits",
    )
    settings: dict[DottedPath, object] = Field(
        default={}, alias="set", description="overrides of the scenario's values, by dotted path"
    )
    hosts: Annotated[tuple[Host, ...], AsTuple] = Field(description="computers of the fleet")
    robots: Annotated[tuple[Annotated[Robot, Tagged("kind", ROBOT_KINDS)], ...], AsTuple] = Field(
        description="the robots; they replace those of the scenario"
    )
    swarm_mass: Positive | None = Field(
        default=None,
        description="mass of all robots that ever take part, kg, for validating data; null: that of the listed robots",
    )
    coordinators: Coordinators = Field(description="where plane, observer, controller and recorder run")
    network: NetworkConfig = Field(description="how the nodes find each other")
    security: Annotated[Security, Tagged("level", LEVELS)] = Field(
        description="protection of the traffic: {level: none}, {level: tunnel} or {level: sros2}"
    )
    time: Time = Field(default=Time(), description="how closely clocks must agree")
    installation: Installation = Field(default=Installation(), description="software and folders on the hosts")

    @field_validator("epoch")
    @classmethod
    def _check_epoch(cls, text: str) -> str:
        error = problem(f"{show(text)} is not a time in UTC", "write e.g. 2026-01-01T00:00:00Z")
        if not _TIME.fullmatch(text):
            raise error
        try:
            begin = datetime.fromisoformat(f"{text[:-1]}+00:00")
        except ValueError:
            raise error from None
        if begin < _UNIX:
            raise problem(f"{show(text)} is before 1970, the start of Unix time", "give a time between 1970 and now")
        if begin > datetime.now(timezone.utc):
            raise problem(
                f"{show(text)} is in the future by this machine's clock", "give a time in the past, or set the clock"
            )
        return text

    @cached_property
    def epoch_ns(self) -> int:
        """Time of step 0, Unix time in ns."""
        return (datetime.fromisoformat(f"{self.epoch[:-1]}+00:00") - _UNIX) // timedelta(seconds=1) * 10**9

    @cached_property
    def members(self) -> tuple[Robot, ...]:
        """The robots in order of their ids."""
        return tuple(sorted(self.robots, key=lambda robot: robot.id))

    @property
    def paired(self) -> bool:
        """Whether the observer or the parent controller has a standby, whose broadcasts others then read too."""
        parts = self.coordinators.observer, self.coordinators.controller
        return any(part is not None and part.standby is not None for part in parts)

    @property
    def decentralised(self) -> bool:
        """Whether each robot sums up and controls the swarm by itself: there is no observer and no controller."""
        return self.coordinators.controller is None

    def host(self, name: str) -> Host:
        """Return a host by name."""
        return next(host for host in self.hosts if host.name == name)

    def address(self, name: str) -> str:
        """Return the address at which DDS reaches a host: that in the tunnel, if there is one."""
        host = self.host(name)
        return host.tunnel_address if self.tunnel and host.tunnel_address else host.address

    def interface(self, name: str) -> str:
        """Return the interface that DDS uses on a host."""
        return self.tunnel.interface if self.tunnel else self.host_interface(name)

    def host_interface(self, name: str) -> str:
        """Return a host's interface in the fleet's network, which also carries the tunnel, if there is one."""
        return self.host(name).interface or self.network.interface or ""

    def user(self, name: str) -> str:
        """Return the account under which a host's nodes run."""
        return self.host(name).user or self.installation.user

    def ros(self, name: str) -> str:
        """Return where ROS 2 comes from on a host: ``wheels`` or ``sourced``."""
        return self.host(name).ros or self.installation.ros

    @property
    def own_topics(self) -> bool:
        """Whether each robot publishes on topics of its own, because permissions are granted by topic."""
        return self.security.level == "sros2"

    @property
    def sealed(self) -> bool:
        """Whether robots and plane sign their states: robots pass them on, and have keys."""
        return self.decentralised and self.security.level == "sros2"

    @property
    def tunnel(self) -> TunnelSecurity | None:
        """The tunnel, if there is one."""
        return self.security if isinstance(self.security, TunnelSecurity) else None
