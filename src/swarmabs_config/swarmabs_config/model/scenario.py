"""The scenario: everything a run depends on."""

from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias, TypeVar

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, model_validator

from swarmabs_core.cdr import SECOND
from swarmabs_core.declaration import setting_of
from swarmabs_core.errors import InputError
from swarmabs_core.faults import FAULTS, Fault, JoinFault, SystemReferenceFault
from swarmabs_core.links import EACH_ROBOT, Coordination, LinkSettings
from swarmabs_core.manifold import Manifold
from swarmabs_core.membership import UNPLANNED
from swarmabs_core.messages import PLANE_FAMILY, SYSTEM_FAMILY, Family
from swarmabs_core.models import SystemAgentConfig
from swarmabs_core.parent_response import ParentResponse, SumObserver
from swarmabs_core.plant import Plane
from swarmabs_core.realtime.base import Realtime
from swarmabs_core.robot_controller import Limits
from swarmabs_core.sensing import ParentSensor, RobotSensor
from swarmabs_core.settings import Lockstep, Run
from swarmabs_core.steering import REFERENCE
from swarmabs_core.swarm_law import SwarmGains
from swarmabs_core.systems.desired import Requests
from swarmabs_core.systems.interface import PLANE_TABLES, SYSTEMS, NamedSystem, SystemTables
from swarmabs_core.systems.law import SystemGains

from .agents import AGENT_KINDS, Agent, Generate, SystemAgent, SystemGenerate
from .controllers import (
    CONTROLLER_CONFIGS,
    DEFAULT_CONTROLLER,
    DEFAULT_LAW,
    LAW_CONFIGS,
    SYSTEM_CONFIGS,
    ControllerConfig,
    LawConfig,
    PaperLaw,
    PdConfig,
    SystemConfig,
    settings_of,
)
from .declared import Declared, Like, declared_field, described_field, like, measured, model_of
from .errors import describe
from .fields import (
    AsTuple,
    Duration,
    Model,
    Tagged,
    known_version,
    nearest_step,
    problem,
    schema_of,
    to_nanoseconds,
)

if TYPE_CHECKING:
    from typing_extensions import Self

LONGEST_NAME = 60
FaultT = TypeVar("FaultT", bound=Fault)


DEFAULT_OBSERVER = "sum"
LINKS = "which robots hear each other, where each of them coordinates the swarm by itself"
OBSERVERS = {observer.type: model_of(observer, tag="type") for observer in (SumObserver, ParentResponse)}
"""The model of each ``observer.type``."""
FAULT_KINDS = {kind: model_of(fault, tag="kind") for kind, fault in FAULTS.items()}  # type: ignore[arg-type]  # classes are hashable
"""The model of each ``kind`` of fault."""
RETIRED_FAULTS = dict.fromkeys(
    ("kill_node", "freeze_node"),
    "remove it: only fleets have standby coordinators, in real time (docs/explanation/standby.md)",
)
"""The remedy for each ``kind`` of fault that no longer exists."""
_SYSTEM_FAULT_KINDS = {**FAULT_KINDS, REFERENCE: model_of(SystemReferenceFault, tag="kind")}
_FAULT, _SYSTEM_FAULT = (Tagged("kind", kinds, retired=RETIRED_FAULTS) for kinds in (FAULT_KINDS, _SYSTEM_FAULT_KINDS))


def is_name(text: str) -> bool:
    """Tell whether `text` can name a scenario and, with a number, the folder of a run."""
    return (
        0 < len(text) <= LONGEST_NAME
        and text.isprintable()
        and not set(text) & {"/", "\\"}
        and (text[0].isalnum() or text[0] == "_")
        and not text.endswith(" ")
    )


def _folder_name(name: str) -> str:
    if not is_name(name):
        raise problem(
            f"{describe(name)} cannot name a folder",
            f"use 1 to {LONGEST_NAME} printable characters, no / or \\, starting with a letter, a digit or _",
        )
    return name


FolderName: TypeAlias = Annotated[str, AfterValidator(_folder_name)]
"""A name with which the folder of a run or a sweep begins."""


class AnySwarm(Model):
    """The robots of a swarm: exactly one of `agents` and `generate` is given."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["agents"]}, {"required": ["generate"]}]})

    if TYPE_CHECKING:  # the subclasses determine the types, and the order in files
        agents: tuple[Agent | SystemAgent, ...] | None
        generate: Generate | SystemGenerate | None

    @model_validator(mode="after")
    def _check_one_source(self) -> "Self":
        if self.agents is not None and self.generate is not None:
            raise problem(
                "both 'agents' and 'generate' are given",
                "keep one of them; '--set swarm.agents=null' removes one",
            )
        if self.agents is None and self.generate is None:
            raise problem("no robots: neither 'agents' nor 'generate' is given", "list 'agents', or use 'generate'")
        return self


class Swarm(AnySwarm):
    """The robots and their gains: exactly one of `agents` and `generate` is given."""

    law: Annotated[LawConfig, Tagged("type", LAW_CONFIGS, DEFAULT_LAW)] = Field(
        default=PaperLaw(), description="the robots' control law"
    )
    gains: Annotated[SwarmGains, Declared()] = declared_field(SwarmGains, "gains of the robots' control laws")
    agents: Annotated[tuple[Annotated[Agent, Tagged("kind", AGENT_KINDS)], ...], AsTuple] | None = Field(
        default=None, description="list of the robots"
    )
    generate: Generate | None = Field(default=None, description="random swarm, instead of 'agents'")
    sensor: Annotated[RobotSensor, Declared()] = declared_field(RobotSensor, "how a robot measures its own motion")
    actuator_lag: Annotated[float, Like(Run, "actuator_lag")] = like(Run, "actuator_lag")


class SystemSwarm(AnySwarm):
    """The robots on a parent system, and their gains: exactly one of `agents` and `generate` is given."""

    gains: Annotated[SystemGains, Declared()] = declared_field(SystemGains, "gains of the robots' control laws")
    force_law: Annotated[str, Like(SystemAgentConfig, "force_law")] = like(SystemAgentConfig, "force_law")
    effort: Annotated[float | None, Like(SystemAgentConfig, "effort")] = described_field(
        setting_of(SystemAgentConfig, "effort").in_file, default=None
    )
    agents: Annotated[tuple[SystemAgent, ...], AsTuple] | None = Field(default=None, description="list of the robots")
    generate: SystemGenerate | None = Field(default=None, description="random swarm, instead of 'agents'")


class CommonScenario(Model):
    """What scenarios of all parent systems have in common."""

    family: ClassVar[Family]
    """The topics of the run."""

    schema_version: Annotated[Literal[1], BeforeValidator(known_version)] = Field(
        alias="schema", description="version of this file format: 1"
    )
    name: FolderName = Field(
        default="scenario",
        description="name of the scenario, by default the file's stem",
        json_schema_extra={"minLength": 1, "maxLength": LONGEST_NAME},
    )
    duration: Duration = measured(30.0, "simulated time, a multiple of step", "s")
    step: Duration = measured(0.01, "control period", "s")
    seed: Annotated[int, Like(Run, "seed")] = like(Run, "seed")

    if TYPE_CHECKING:  # the subclasses determine the types, and the order in files
        swarm: AnySwarm
        coordination: str
        links: LinkSettings
        lockstep: Lockstep
        faults: tuple[Fault, ...]

        @property
        def agents(self) -> tuple[Agent | SystemAgent, ...]:
            """The robots in order of their ids, whether they are listed or generated."""

    def resolved(self) -> "Self":
        """Return the same scenario with every robot listed, in order of ids, and nothing left to generate."""
        swarm = self.swarm.model_copy(update={"agents": self.agents, "generate": None})
        return self.model_copy(update={"swarm": swarm})

    @property
    def decentralised(self) -> bool:
        """Whether each robot sums up and controls the swarm by itself."""
        return self.coordination == EACH_ROBOT

    @cached_property
    def step_ns(self) -> int:
        """The control period in ns."""
        return to_nanoseconds(self.step)

    @cached_property
    def duration_ns(self) -> int:
        """The simulated time in ns."""
        return to_nanoseconds(self.duration)

    @property
    def steps(self) -> int:
        """The number n of control steps; steps 0 to n are recorded."""
        return self.duration_ns // self.step_ns

    @property
    def period(self) -> float:
        """The control period in s, as used in every computation."""
        return self.step_ns / SECOND

    @property
    def initial_agents(self) -> tuple[Any, ...]:
        """The robots present at step 0: all but those that join later."""
        later = {fault.agent for fault in self.faults if isinstance(fault, JoinFault) and self.fault_step(fault.at) > 0}
        return tuple(agent for agent in self.agents if agent.id not in later)

    def faults_of(self, sort: type[FaultT]) -> tuple[FaultT, ...]:
        """Return the faults of a sort: `MembershipFault`, `SettingFault` or `RobotFault`."""
        return tuple(fault for fault in self.faults if isinstance(fault, sort))

    def fault_steps(self, fault: Fault) -> tuple[int, int | None]:
        """Return the first step in which a fault acts, and the first after it, None if it acts to the end."""
        return self.fault_step(fault.at), None if fault.until is None else self.fault_step(fault.until)

    def fault_step(self, at: float | None) -> int:
        """Return the step of a fault at time `at` (s): round(at/step) of the exact decimals, ties to even.

        A fault without a time is not planned: `swarmabs_core.membership.UNPLANNED`.
        """
        return UNPLANNED if at is None else nearest_step(at, self.step_ns)


class PlaneScenario(CommonScenario):
    """A scenario on the plane."""

    family = PLANE_FAMILY
    named: ClassVar[None] = None
    """There is no other parent system."""
    system_hash: ClassVar[None] = None
    """The plane's messages carry no hash of a description."""
    tables: ClassVar[SystemTables] = PLANE_TABLES
    """Names and units of the numbers of the plane and its robots."""

    plane: Annotated[Plane, Declared()] = declared_field(Plane, "the tilting plane")
    manifold: Annotated[Manifold, Declared()] = declared_field(
        Manifold, "the curve Js(tau) to which the swarm is controlled"
    )
    controller: Annotated[ControllerConfig, Tagged("type", CONTROLLER_CONFIGS, DEFAULT_CONTROLLER)] = Field(
        default=PdConfig(), description="the parent controller"
    )
    swarm: Swarm = Field(description="the robots and their gains")
    observer: Annotated[SumObserver | ParentResponse, Tagged("type", OBSERVERS, DEFAULT_OBSERVER)] = Field(
        default=SumObserver(),
        description="how the abstract state of the robots is obtained",
        json_schema_extra={"default": {"type": DEFAULT_OBSERVER}},
    )
    limits: Annotated[Limits, Declared()] = declared_field(Limits, "limits of the robots' drives")
    coordination: Annotated[str, Like(Coordination, "coordination")] = like(Coordination, "coordination")
    links: Annotated[LinkSettings, Declared()] = declared_field(LinkSettings, LINKS)
    lockstep: Annotated[Lockstep, Declared()] = declared_field(Lockstep, "what happens when a robot does not answer")
    realtime: Annotated[Realtime, Declared()] = declared_field(Realtime, "settings of runs in real time")
    faults: Annotated[tuple[Annotated[Fault, _FAULT], ...], AsTuple] = Field(
        default=(), description="faults and membership changes"
    )

    @property
    def lane_length(self) -> float:
        """Length of the range of the robots' positions, m."""
        return self.plane.length

    @cached_property
    def agents(self) -> tuple[Agent, ...]:
        """The robots in order of their ids, whether they are listed or generated."""
        if self.swarm.generate is not None:
            return self.swarm.generate.agents()
        return tuple(sorted(self.swarm.agents or (), key=lambda agent: agent.id))


class SystemScenario(CommonScenario):
    """A scenario on a parent system of an installed package."""

    family = SYSTEM_FAMILY
    lane_length: ClassVar[None] = None
    """There is no lane, whatever the coordinates of the robots are."""

    system: Annotated[SystemConfig, Tagged("type", SYSTEM_CONFIGS)] = Field(description="the parent system")
    swarm: SystemSwarm = Field(description="the robots and their gains")
    sensor: Annotated[ParentSensor, Declared()] = declared_field(ParentSensor, "how the parent's state is measured")
    requests: Annotated[Requests, Declared()] = declared_field(Requests, "limits and filter of the controller's needs")
    coordination: Annotated[str, Like(Coordination, "coordination")] = like(Coordination, "coordination")
    links: Annotated[LinkSettings, Declared()] = declared_field(LinkSettings, LINKS)
    lockstep: Annotated[Lockstep, Declared()] = declared_field(Lockstep, "what happens when a robot does not answer")
    faults: Annotated[tuple[Annotated[Fault, _SYSTEM_FAULT], ...], AsTuple] = Field(
        default=(), description="faults and membership changes"
    )

    @cached_property
    def named(self) -> NamedSystem:
        """The parent system, with its settings."""
        return NamedSystem(self.system.type, settings_of(self.system))

    @property
    def system_hash(self) -> int:
        """Hash of the description of the parent system, which its messages carry."""
        return self.named.hash

    @cached_property
    def tables(self) -> SystemTables:
        """Names and units of the numbers of the parent system and its robots."""
        return SystemTables.read(self.named.description)

    @cached_property
    def agents(self) -> tuple[SystemAgent, ...]:
        """The robots in order of their ids, whether they are listed or generated."""
        if self.swarm.generate is not None:
            return self.swarm.generate.agents(self.named)
        return tuple(sorted(self.swarm.agents or (), key=lambda agent: agent.id))


Scenario: TypeAlias = PlaneScenario | SystemScenario
"""A complete description of a run, whose keys depend on the parent system.

Instances are immutable. `load_scenario` and `parse_scenario` read them and check what involves several keys; their
errors name file and line.
"""


def json_schema() -> dict[str, object]:
    """Return the JSON Schema (2020-12) of a scenario file, with the registered controllers and trajectories.

    If packages provide parent systems, it branches on the key ``system``. It covers names, types, units and ranges.
    Checks across fields are made when a scenario is loaded.
    """
    plane = {**schema_of(PlaneScenario, "swarmabs scenario"), "description": "A complete description of a run."}
    if not len(SYSTEMS):
        return plane
    system = schema_of(SystemScenario, "swarmabs scenario")
    definitions: dict[str, object] = {}
    for schema in (plane, system):
        definitions.update(schema.pop("$defs"))  # type: ignore[call-overload]  # a mapping
    head = {name: plane[name] for name in ("$schema", "title", "description")}
    return {**head, "$defs": definitions, "if": {"required": ["system"]}, "then": system, "else": plane}


def on_plane(scenario: Scenario, what: str) -> PlaneScenario:
    """Return a scenario on the plane; raise `InputError` for any other, which `what` does not support."""
    if isinstance(scenario, PlaneScenario):
        return scenario
    raise InputError(f"{what} supports only the plane, not the parent system {scenario.named.type!r}")
