"""The protocol between server and page of the view: JSON messages over a WebSocket, version 2.

Each message is an object with ``v`` and ``type``. Numbers are in SI units; unknown and non-finite values are null.
Numbers keep every bit: the page has the values of the bag.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Final, Literal, TypeAlias

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, models_json_schema

from swarmabs_bag.shown.swarm_state import RobotStatus
from swarmabs_core.messages import Kind, word

VERSION: Final = 2
"""Version of the protocol, raised when a message is removed or changes its meaning. The server may add messages and
fields: a page ignores unknown ones."""

Number: TypeAlias = float | None
Phase: TypeAlias = Literal["waiting", "running", "paused", "silent", "ended", "recorded"]
FASTEST = 1000.0
"""Highest speed of a playback, as a multiple of real time."""


class Part(BaseModel):
    """A part of a message; unknown keys are rejected."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Message(Part):
    """A message of the server."""

    v: Literal[2] = 2


class Row(Part):
    """A number of the parent system or its swarm; a reference has the name of the quantity that follows it."""

    role: Literal["parent", "reference", "abstract", "desired", "further", "robot", "constant"]
    name: str
    unit: str
    scale: float = Field(default=1.0, description="a typical magnitude")
    low: Number = Field(default=None, description="the least value, null if there is none")


class RobotKind(Part):
    """How robots of a kind are named and drawn."""

    name: str = Field(json_schema_extra={"enum": [*map(word, Kind)]})
    words: str = Field(description="in a table of robots")
    legend: str
    colour: str = Field(description="red, green and blue as #rrggbb, on light ground")
    shape: Literal["circle", "square", "diamond"]
    commands: list[str] = Field(
        description="units of a command, in the order of a robot's coordinates; empty if the kind does not fit them"
    )


class System(Part):
    """The parent system, as its description states it."""

    name: str
    rows: list[Row] = Field(description="in the order of values, then of a robot's coordinates, then of its constants")
    kinds: list[RobotKind] = Field(description="all kinds of robots, also those that are not there")
    placed: bool = Field(description="whether the system itself places the robots in the picture, which is then in m")
    disturbance_unit: str = Field(description="empty if it is not known")


class RobotInfo(Part):
    """The constant properties of a robot."""

    id: int
    kind: str = Field(json_schema_extra={"enum": [*map(word, Kind)]})
    constants: list[Number] = Field(description="in the order of the rows")
    body: list[list[list[float]]] = Field(
        default=[], description="the filled lines that draw it around its position; empty: a symbol"
    )
    joins: bool = Field(default=False, description="whether it takes part only after it joins")


class Plane(Part):
    """The plane."""

    length: float = Field(description="m")
    inertia: float = Field(description="kg m^2")
    gravity: float = Field(description="m/s^2")
    heights: dict[int, float] = Field(default={}, description="m, of robots whose mass is not at the axis, by id")


class Manifold(Part):
    """The curve J = curvature tau^2 + offset on which the desired abstract state lies, for |tau| <= torque_max."""

    curvature: float = Field(description="kg m^2/(N m)^2")
    offset: float = Field(description="kg m^2")
    torque_max: float = Field(description="N m")


class Regions(Part):
    """Boundaries of the sets of abstract states over the torque; null where there is no such state.

    Positions are those of the robots that the law commands; dead robots stay where they are.
    """

    torque: list[float] = Field(description="N m")
    smallest: list[Number] = Field(description="J_min, kg m^2: below, no positions give the state")
    admissible: list[Number] = Field(description="J_A, kg m^2: up to this, all such positions are on the plane (A_A)")
    reachable: list[Number] = Field(description="J_max, kg m^2, or a lower bound: up to this, some are (A_P)")


class Hello(Message):
    """The first message: describes what is shown. A further one replaces everything."""

    type: Literal["hello"] = "hello"
    source: Literal["bag", "run", "swarm"]
    title: str
    place: str = Field(description="bag, folder of the run, or namespace")
    period: Number = Field(description="s")
    last_step: int | None
    system: System
    robots: list[RobotInfo] = Field(description="in the order of the arrays of a frame")
    plane: Plane | None = Field(description="null if it is not known, or for another parent system")
    manifold: Manifold | None = Field(description="as for the plane")
    regions: Regions | None = Field(description="sets of the initial robots")
    playback: bool = Field(description="whether the page can control the playback: play, pause, seek, speed")


class Robots(Part):
    """States of all robots in the order of the hello, empty for robots without data and robots that left.

    A dead robot stays where its event says.
    """

    position: list[list[float] | None] = Field(
        description="in the picture, along a line or in two dimensions; a third number turns the body, rad"
    )
    coordinates: list[list[Number]]
    velocities: list[list[Number]]
    command: list[list[Number]]
    status: list[RobotStatus | None]


class Frame(Message):
    """The current step."""

    type: Literal["frame"] = "frame"
    step: int
    time: float = Field(description="s")
    values: list[Number] = Field(description="in the order of the rows")
    outline: list[list[list[float]]] = Field(description="lines of the picture of the system, each by its points")
    robots: Robots
    step_rate: Number = Field(description="steps per second of wall time")


class Sets(Message):
    """The sets for the robots that take part now; sent when these change."""

    type: Literal["sets"] = "sets"
    moving: list[int] = Field(description="robots that the law commands")
    standing: list[int] = Field(description="dead robots that are still on the plane")
    regions: Regions | None = Field(description="null if fewer than two are commanded, or their masses are unknown")


class Curves(Message):
    """Points of the curves, which are appended to the earlier ones or replace them."""

    type: Literal["curves"] = "curves"
    replace: bool
    time: list[float] = Field(description="s")
    values: list[list[Number]] = Field(description="over time, in the order of the rows")


class Positions(Message):
    """Positions over time, which are appended to the earlier ones or replace them.

    A line is a robot or, for many robots, a percentile of the robots that start on one side of the
    axis. There are so many lines for each coordinate.
    """

    type: Literal["positions"] = "positions"
    replace: bool
    bands: bool
    labels: list[str] = Field(description="of the lines")
    time: list[float] = Field(description="s")
    lines: list[list[Number]] = Field(
        description="in the unit of the coordinate; null for a robot that does not act on the parent"
    )


class Event(Part):
    """An event of the swarm."""

    step: int
    time: float = Field(description="s")
    agent: int = Field(description="id of a robot, or 0")
    kind: str
    words: str = Field(description="what happened, as in the logs")
    value: Number
    unit: str = Field(default="", description="unit of the value, 'command' if it is that of the robot's commands")
    detail: str


class Events(Message):
    """Events, which are appended to the earlier ones or replace them."""

    type: Literal["events"] = "events"
    replace: bool
    events: list[Event]
    left_out: int = Field(default=0, description="number of earlier events that are not sent")


class Process(Part):
    """A process of the run."""

    name: str
    pid: int
    state: str = Field(description="state by the operating system, such as running, sleeping, stopped; or gone")
    cpu: Number = Field(description="percent of one core")
    memory: int | None = Field(description="bytes of resident memory")


class Health(Message):
    """All processes of the run."""

    type: Literal["health"] = "health"
    processes: list[Process]


class Coordinator(Part):
    """What one of a pair of coordinators does now."""

    role: str = Field(description="such as leads, stands by, listens, records, is silent, is lost")
    seconds: int | None = Field(description="for how long, s: by the clock, in lockstep of simulated time")
    ok: bool = Field(description="whether it is there")


class CoordinatorPair(Part):
    """A coordinator and its standby."""

    name: str
    primary: Coordinator
    standby: Coordinator


class Coordinators(Message):
    """Coordinators that have a standby; not sent if none has one."""

    type: Literal["coordinators"] = "coordinators"
    pairs: list[CoordinatorPair]


class LinkedRobot(Part):
    """What a robot knows of the others, by its diagnostics."""

    id: int
    silent: bool = Field(description="whether its diagnostics are missing, so that the rest is not known")
    hears: list[int] = Field(description="ids of the neighbours that it hears")
    neighbours: int = Field(description="number of robots that it should hear")
    oldest: int | None = Field(description="age of the oldest state that it uses, steps")
    lacks: list[int] = Field(description="ids of the robots of which it knows no state, or only one that is too old")
    majority: bool = Field(description="whether it hears a majority; otherwise it stops")


class Links(Message):
    """Who hears whom, at most once a second; not sent unless each robot sums up the swarm by itself."""

    type: Literal["links"] = "links"
    robots: list[LinkedRobot] = Field(description="by id")


class State(Message):
    """State of the source; sent at least once a second, so that silence means a lost connection."""

    type: Literal["state"] = "state"
    phase: Phase
    text: str
    playing: bool | None = None
    speed: Number = None


class Steering(Message):
    """Current settings of a steerable run and bounds of requests; sent when they change."""

    type: Literal["steering"] = "steering"
    open: bool = Field(description="whether the run accepts requests now")
    reference: float = Field(default=0.0, description="offset of the reference")
    disturbance: float = Field(default=0.0, description="constant disturbance")
    largest_reference: float = Field(default=0.0, description="0: the law's reference cannot be offset")
    largest_disturbance: float = Field(default=0.0, description="0: there are no disturbances")
    members: list[int] = Field(default=[], description="robots that take part")
    absent: list[int] = Field(default=[], description="robots that can be added")
    paused: bool = Field(default=False, description="whether the run is held until it is resumed")
    push_time: float = Field(default=0.0, description="duration of a push, s")
    restarts: bool = Field(default=False, description="whether another run starts when a page asks for it")


class Answer(Message):
    """The answer to a request of the page."""

    type: Literal["answer"] = "answer"
    request: str = Field(description="the name given by the page")
    ok: bool
    known: bool = Field(default=True, description="whether the token was right")
    restarts: bool = Field(default=False, description="whether the next run takes the place of this one")
    text: str = Field(description="the step from which it applies, or why it was rejected")


def _no_other_one(version: object) -> object:
    """Reject values such as 2.0 that equal the integer 2."""
    if type(version) is not int:
        raise ValueError("not an integer")
    return version


class Request(Part):
    """A message of a page, with its version; types are not converted."""

    model_config = ConfigDict(strict=True)

    v: Annotated[Literal[2], BeforeValidator(_no_other_one)]


class Play(Request):
    """Start the playback or continue it; at the end it starts again."""

    type: Literal["play"]


class Pause(Request):
    """Pause the playback."""

    type: Literal["pause"]


class Seek(Request):
    """Show a step."""

    type: Literal["seek"]
    step: int = Field(ge=0, lt=2**63)


class Speed(Request):
    """Play faster or slower than real time."""

    type: Literal["speed"]
    speed: float = Field(gt=0.0, le=FASTEST, allow_inf_nan=False)


class Unlock(Request):
    """Check a token, without any other effect."""

    type: Literal["unlock"]
    token: str = Field(max_length=100)


class Steer(Request):
    """Change the run; needs the token. Values are those of the run's socket (docs/how-to/steering.md)."""

    type: Literal["steer"]
    token: str = Field(max_length=100)
    request: str = Field(min_length=1, max_length=100, description="a name; a request is performed once per name")
    action: Literal[
        "reference",
        "disturbance",
        "push",
        "kill",
        "freeze",
        "remove",
        "add",
        "pause",
        "resume",
        "restart",
        "restart_beside",
    ]
    value: float | None = Field(
        default=None, allow_inf_nan=False, description="reference, disturbance or push, in its unit"
    )
    agent: int | None = Field(default=None, ge=1, le=65535, description="robot, for what concerns one")


Control: TypeAlias = Play | Pause | Seek | Speed | Unlock | Steer
"""The requests of a page."""

CONTROL: TypeAdapter[Control] = TypeAdapter(Annotated[Control, Field(discriminator="type")])

FROM_SERVER: tuple[type[Message], ...] = (
    *(Hello, Frame, Sets, Curves, Positions, Events),
    *(Health, Coordinators, Links, State, Steering, Answer),
)
FROM_PAGE: tuple[type[Request], ...] = (Play, Pause, Seek, Speed, Unlock, Steer)


class _Untitled(GenerateJsonSchema):
    """Leaves out the titles, which only repeat the names of the fields."""

    def field_title_should_be_set(self, schema: object) -> bool:  # noqa: ARG002 - of the base class
        return False


def _short(part: dict[str, Any]) -> dict[str, Any]:
    """Return a part of a schema with alternatives of simple types in one list."""
    if all(choice.keys() == {"type"} for choice in part.get("anyOf", [{}])):
        part["type"] = [choice["type"] for choice in part.pop("anyOf")]
    return part


def json_schema() -> dict[str, object]:
    """Return the JSON Schema of all messages, by direction in ``from_server`` and ``from_page`` of its ``$defs``."""
    _, schema = models_json_schema(
        [(model, "serialization") for model in (*FROM_SERVER, *FROM_PAGE)], schema_generator=_Untitled
    )
    definitions = json.loads(json.dumps(schema["$defs"]), object_hook=_short)
    for name, models in (("from_server", FROM_SERVER), ("from_page", FROM_PAGE)):
        definitions[name] = {"oneOf": [{"$ref": f"#/$defs/{model.__name__}"} for model in models]}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"swarmabs view messages, version {VERSION}",
        "anyOf": [{"$ref": "#/$defs/from_server"}, {"$ref": "#/$defs/from_page"}],
        "$defs": definitions,
    }
