"""The messages of the swarm as immutable values, with their topics.

They correspond to the definitions in ``swarmabs_msgs`` but do not depend on ROS: the node behaviours exchange them, and
`swarmabs_core.cdr` converts them to the bytes that are sent over DDS and stored in bags. This is the only place in
Python that declares name, type, unit and meaning of each field. ``stamp`` is the header's time stamp in nanoseconds; in
lockstep it is exactly ``step`` times the control period.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Annotated, Literal, NamedTuple, TypeAlias, get_type_hints

from swarmabs_core.nodes import ROBOT_PREFIX, agent_name

NEVER = 2**64 - 1
"""A step field that refers to no step (``AgentState.broadcast_step``, ``RecordingProgress.written_step``)."""

FRAME_ID = "plane"
"""The only frame: origin at the plane's axis, positions along the plane."""


class Kind(IntEnum):
    """Dynamics of a robot (``AgentState.kind``, ``RobotState.kind``)."""

    SINGLE_INTEGRATOR = 1
    DOUBLE_INTEGRATOR = 2
    FIRST_ORDER_LAG = 3

    @classmethod
    def of(cls, name: str) -> Kind:
        """Return the kind with a word, as in scenarios, such as "double_integrator"."""
        return cls[name.upper()]

    @property
    def by_force(self) -> bool:
        """Whether its command is a force: it has a velocity of its own, a mass and a damping."""
        return self is Kind.DOUBLE_INTEGRATOR


class Status(IntEnum):
    """Status that a robot reports (``AgentState.status``, ``RobotState.status``)."""

    ACTIVE = 1
    SAFE_STOP = 2
    LEFT = 3
    LIMITED = 4


PLANE_KINDS = (Kind.SINGLE_INTEGRATOR, Kind.DOUBLE_INTEGRATOR)
PLANE_STATUSES = (Status.ACTIVE, Status.SAFE_STOP, Status.LEFT)
"""The kinds and statuses of robots on the plane."""


class Mode(IntEnum):
    """Mode that the parent controller commands (``DesiredAbstractState.mode``, ``SwarmDesired.mode``)."""

    RUN = 1
    STOP = 2
    RESET = 3


class EventKind(IntEnum):
    """Kind of an event (``SwarmEvent.kind``)."""

    JOINED = 1
    LEFT = 2
    DEAD = 3
    SAFE_STOP = 4
    RECOVERED = 5
    FAULT_INJECTED = 6
    LIMIT_HIT = 7
    STEERING = 8
    STALLED = 9
    MODE_CHANGED = 10
    REFUSED = 11
    HELD = 12
    LEADING = 13


class Source(IntEnum):
    """Node whose output a provenance message describes (``Basis.source``)."""

    OBSERVER = 1
    PLANE = 2
    CONTROLLER = 3


class Action(IntEnum):
    """Change to a run from outside (``Steering.action``)."""

    NONE = 0
    REFERENCE = 1
    DISTURBANCE = 2
    KILL = 3
    FREEZE = 4
    REMOVE = 5
    ADD = 6


def word(value: IntEnum) -> str:
    """Return the word for a constant of a message in tables and scenarios, such as "double_integrator"."""
    return value.name.lower()


def word_of(constants: Iterable[IntEnum], number: int) -> str:
    """Return the word for a number that a message contains for a constant; the digits if it is unknown."""
    return next((word(constant) for constant in constants if constant == number), str(number))


def said(value: IntEnum) -> str:
    """Return a constant of a message in words, such as "double integrator"."""
    return word(value).replace("_", " ")


FieldType = Literal[
    "time",
    "uint8",
    "uint16",
    "uint64",
    "float64",
    "string",
    "byte[]",
    "uint8[]",
    "uint16[]",
    "uint64[]",
    "float64[<=8]",
    "float64[<=16]",
    "float64[<=32]",
    "float64[<=136]",
]


class Field(NamedTuple):
    """The declaration of a field; CDR, arrays and tables follow from it, and a test compares it with the definition.

    Attributes
    ----------
    ros_type : str
        As in the definition; ``time`` for the stamp, which is in the header.
    unit : str
        SI unit, 1 for dimensionless numbers, empty for strings.
    meaning : str
        What the name does not express.
    constants : iterable of IntEnum, optional
        The allowed values.
    missing : int, optional
        The value that means none.
    """

    ros_type: FieldType
    unit: str = "1"
    meaning: str = ""
    constants: Iterable[IntEnum] | None = None
    missing: int | None = None


Stamp: TypeAlias = Annotated[int, Field("time", "ns", "time of creation, by the clock of the publisher")]
StepNumber: TypeAlias = Annotated[int, Field("uint64", meaning="number of the control period")]
EarlierStep: TypeAlias = Annotated[int, Field("uint64", meaning="a step", missing=NEVER)]
RobotId: TypeAlias = Annotated[int, Field("uint16", meaning="robot")]
SystemHash: TypeAlias = Annotated[int, Field("uint64", meaning="hash of the description of the parent system")]
Vector: TypeAlias = tuple[float, ...]
Coordinates: TypeAlias = Annotated[Vector, Field("float64[<=8]", "by system", "coordinate by coordinate")]
Rows: TypeAlias = Annotated[Vector, Field("float64[<=16]", "by system", "row by row of the abstract state")]


class PlaneState(NamedTuple):
    """Angle and angular velocity of the plane."""

    stamp: Stamp
    step: StepNumber
    angle: Annotated[float, Field("float64", "rad")]
    angular_velocity: Annotated[float, Field("float64", "rad/s")]


class AgentState(NamedTuple):
    """State of one robot, and the command that led to it.

    ``command`` is in m/s for a single integrator and in N for a double integrator. It was held over the period that
    ends at ``step`` and was computed from the broadcasts of ``broadcast_step``.
    """

    stamp: Stamp
    step: StepNumber
    broadcast_step: Annotated[int, Field("uint64", meaning="step of the broadcasts used", missing=NEVER)]
    agent_id: RobotId
    kind: Annotated[int, Field("uint8", constants=PLANE_KINDS)]
    status: Annotated[int, Field("uint8", constants=PLANE_STATUSES)]
    mass: Annotated[float, Field("float64", "kg")]
    damping: Annotated[float, Field("float64", "N s/m")]
    position: Annotated[float, Field("float64", "m")]
    velocity: Annotated[float, Field("float64", "m/s")]
    command: Annotated[
        float, Field("float64", "m/s or N", "held over the previous step; m/s for single, N for double integrators")
    ]


class AbstractState(NamedTuple):
    """Torque tau_s and moment of inertia J_s of the swarm on the plane, and their rates."""

    stamp: Stamp
    step: StepNumber
    agent_count: Annotated[int, Field("uint16", "1", "robots whose weight is in the sums")]
    torque: Annotated[float, Field("float64", "N m")]
    inertia: Annotated[float, Field("float64", "kg m^2")]
    torque_rate: Annotated[float, Field("float64", "N m/s")]
    inertia_rate: Annotated[float, Field("float64", "kg m^2/s")]


class AuxiliaryState(NamedTuple):
    """Sums over the swarm that a robot's law needs: S0, S1, S2, S3, D0, D1, D2, Q."""

    stamp: Stamp
    step: StepNumber
    s0: Annotated[float, Field("float64", "kg^2", "sum of m^2")]
    s1: Annotated[float, Field("float64", "kg^2 m", "sum of m^2 p")]
    s2: Annotated[float, Field("float64", "kg^2 m^2", "sum of m^2 p^2")]
    s3: Annotated[float, Field("float64", "kg^4 m^2", "s0 s2 - s1^2")]
    d0: Annotated[float, Field("float64", "kg^2/s", "sum of m (c + ksd)")]
    d1: Annotated[float, Field("float64", "kg^2 m/s", "sum of m (c + ksd) p")]
    d2: Annotated[float, Field("float64", "kg^2 m^2/s", "sum of m (c + ksd) p^2")]
    q: Annotated[float, Field("float64", "kg m^2/s^2", "sum of m v^2")]


class DesiredAbstractState(NamedTuple):
    """What the parent controller requests; fields that are not means hold the value at ``step``."""

    stamp: Stamp
    step: StepNumber
    mode: Annotated[int, Field("uint8", constants=Mode)]
    torque: Annotated[float, Field("float64", "N m")]
    inertia: Annotated[float, Field("float64", "kg m^2")]
    torque_rate: Annotated[float, Field("float64", "N m/s")] = 0.0
    inertia_rate: Annotated[float, Field("float64", "kg m^2/s")] = 0.0
    mean_torque_rate: Annotated[float, Field("float64", "N m/s", "mean over the step")] = 0.0
    mean_inertia_rate: Annotated[float, Field("float64", "kg m^2/s", "mean over the step")] = 0.0
    torque_acceleration: Annotated[float, Field("float64", "N m/s^2", "mean over the step")] = 0.0
    inertia_acceleration: Annotated[float, Field("float64", "kg m^2/s^2")] = 0.0


class SwarmEvent(NamedTuple):
    """An event: ``step`` is the first at which it holds, ``agent_id`` is 0 if it concerns no single robot."""

    stamp: Stamp
    step: StepNumber
    agent_id: RobotId
    kind: Annotated[int, Field("uint8", constants=EventKind)]
    value: Annotated[float, Field("float64", "by kind")]
    detail: Annotated[str, Field("string", "", "human-readable")]


class Removal(SwarmEvent):
    """An event by which an operator reports, in real time, that a silent robot was taken off the plane.

    It has a topic of its own, so that permissions can tell who may publish it.
    """

    __slots__ = ()


class RecordingProgress(NamedTuple):
    """Credit from the recorder: all steps up to ``written_step`` are on disk (`NEVER`: none yet)."""

    stamp: Stamp
    step: StepNumber
    written_step: EarlierStep


class Broadcast(NamedTuple):
    """The three broadcasts of a step in one message, for robots that request packed broadcasts."""

    stamp: Stamp
    step: StepNumber
    abstract: AbstractState
    auxiliary: AuxiliaryState
    desired: DesiredAbstractState


class SwarmStates(NamedTuple):
    """The robots' states of a step in one message, for nodes that need them all.

    `states` are their payloads in canonical CDR, each with encapsulation header, one after the other by ascending id.
    """

    stamp: Stamp
    step: StepNumber
    states: Annotated[bytes, Field("byte[]", "", "serialized states of the robots")]


class Basis(NamedTuple):
    """Provenance of a coordinator's output in real time: the data from which it was computed.

    ``since`` is the step of the output from which the coordinator continued (`NEVER`: it restarted). ``begun`` is the
    step in which the simulated plane was released (`NEVER`: it is held), or step 0 of the parent controller's law.
    ``agent_ids``, ascending, and ``state_steps`` identify the robots' states that entered it. ``standing`` is 1 for
    robots that the observer assumes to be at rest because they are silent, else 0.
    """

    stamp: Stamp
    step: StepNumber
    since: EarlierStep
    begun: EarlierStep
    source: Annotated[int, Field("uint8", constants=Source)]
    state_steps: Annotated[tuple[int, ...], Field("uint64[]", meaning="steps of the robots' states")]
    agent_ids: Annotated[tuple[int, ...], Field("uint16[]", meaning="robots")]
    standing: Annotated[tuple[int, ...], Field("uint8[]", meaning="1: assumed at rest, else 0")]


class Steering(NamedTuple):
    """A change from outside that takes effect at a step; ``request`` is its number, 0 if nothing changes."""

    stamp: Stamp
    step: StepNumber
    request: Annotated[int, Field("uint64", meaning="number of the request")]
    action: Annotated[int, Field("uint8", constants=Action)]
    agent_id: RobotId
    value: Annotated[float, Field("float64", "by action")]


class RobotState(NamedTuple):
    """State of one robot on any parent system, and the command that led to it.

    `command` was held over the period that ends at `step`; it is a velocity, a force or, for a lag, the value that the
    coordinate approaches. `constants` are those that the system names. `velocities` of a robot in status `LIMITED` are
    those with which it continues while it holds the limit.
    """

    stamp: Stamp
    step: StepNumber
    system: SystemHash
    broadcast_step: Annotated[int, Field("uint64", meaning="step of the broadcasts used", missing=NEVER)]
    agent_id: RobotId
    kind: Annotated[int, Field("uint8", constants=Kind)]
    status: Annotated[int, Field("uint8", constants=Status)]
    coordinates: Coordinates
    velocities: Coordinates
    command: Coordinates
    constants: Annotated[Vector, Field("float64[<=16]", "by system", "constants of the robot")]


class StandingState(NamedTuple):
    """How the abstract state divides between robots that stand and robots that follow the law.

    The rows are those of the abstract state; on the plane torque (N m) and inertia (kg m^2), with `system` 0. The
    constants are sums over the robots in the order of the system; on the plane the mass (kg).
    """

    stamp: Stamp
    step: StepNumber
    system: SystemHash
    standing_count: Annotated[int, Field("uint16", "1", "robots that contribute but do not follow the law")]
    moving_count: Annotated[int, Field("uint16", "1", "robots that follow the law")]
    standing: Annotated[Vector, Field("float64[<=16]", "by system", "contribution of robots that stand")]
    standing_constants: Annotated[Vector, Field("float64[<=16]", "by system", "sums of their constants")]
    moving: Annotated[Vector, Field("float64[<=16]", "by system", "contribution of robots that follow the law")]
    moving_rate: Annotated[Vector, Field("float64[<=16]", "by system", "its rate of change")]
    moving_curvature: Annotated[Vector, Field("float64[<=16]", "by system", "its acceleration at constant velocities")]
    moving_gram: Annotated[Vector, Field("float64[<=136]", "by system", "lower triangle of their Gram matrix, by rows")]
    moving_weight: Annotated[float, Field("float64", "by system", "sum of the weights of their motion, on the plane 1")]
    moving_constants: Annotated[Vector, Field("float64[<=16]", "by system", "sums of their constants")]


class ParentState(NamedTuple):
    """State x_p of a parent system."""

    stamp: Stamp
    step: StepNumber
    system: SystemHash
    state: Annotated[Vector, Field("float64[<=32]", "by system", "state of the parent system")]


class SwarmAbstract(NamedTuple):
    """Abstract state a of a swarm on any parent system, and its rate."""

    stamp: Stamp
    step: StepNumber
    system: SystemHash
    agent_count: Annotated[int, Field("uint16", "1", "robots that contribute")]
    value: Rows
    rate: Rows


class SwarmAuxiliary(NamedTuple):
    """Auxiliary state of a swarm on any parent system: Gram matrix S, drift r, and curvature h, empty if not needed."""

    stamp: Stamp
    step: StepNumber
    system: SystemHash
    gram: Annotated[Vector, Field("float64[<=136]", "by system", "lower triangle of S by rows")]
    drift: Annotated[Vector, Field("float64[<=16]", "by system", "rate of a that is not commanded")]
    curvature: Annotated[Vector, Field("float64[<=16]", "by system", "acceleration of a at constant velocities")]


class SwarmDesired(NamedTuple):
    """Abstract state that the controller of any parent system requests, with its derivatives."""

    stamp: Stamp
    step: StepNumber
    system: SystemHash
    mode: Annotated[int, Field("uint8", constants=Mode)]
    value: Rows
    rate: Rows
    mean_rate: Annotated[Vector, Field("float64[<=16]", "by system", "mean over the step")]
    end_rate: Annotated[Vector, Field("float64[<=16]", "by system", "at the end of the step")]
    mean_acceleration: Annotated[Vector, Field("float64[<=16]", "by system", "mean over the step")]


class SwarmBroadcast(NamedTuple):
    """The three broadcasts of a step on any parent system."""

    stamp: Stamp
    step: StepNumber
    abstract: SwarmAbstract
    auxiliary: SwarmAuxiliary
    desired: SwarmDesired


class Relay(NamedTuple):
    """What a robot passes on to its neighbours in a round of a step, where each robot sums up the swarm by itself.

    `swarmabs_core.relays` reads and writes the content.
    """

    stamp: Stamp
    step: StepNumber
    agent_id: RobotId
    round: Annotated[int, Field("uint16", meaning="round of the step, from 0 on")]
    complete: Annotated[int, Field("uint8", meaning="1: it knows all states of the step, else 0")]
    last: Annotated[int, Field("uint8", meaning="1: it passes on nothing more in this step, else 0")]
    content: Annotated[bytes, Field("byte[]", "", "states of robots and parent, in a compact form")]


class SystemDescription(NamedTuple):
    """Description of the parent system, sent once: JSON with names, units and scales; `system` is its hash."""

    stamp: Stamp
    step: StepNumber
    system: SystemHash
    description: Annotated[str, Field("string", "", "JSON")]


Message = (
    PlaneState
    | AgentState
    | AbstractState
    | AuxiliaryState
    | DesiredAbstractState
    | SwarmEvent
    | RecordingProgress
    | Broadcast
    | SwarmStates
    | Basis
    | Steering
    | RobotState
    | ParentState
    | SwarmAbstract
    | SwarmAuxiliary
    | SwarmDesired
    | SwarmBroadcast
    | SystemDescription
    | StandingState
    | Relay
)
"""Any message of the swarm."""

Messages = tuple[Message, ...]
"""Output of a node behaviour: the messages to publish, in this order."""


@dataclass(frozen=True, slots=True, eq=False)  # compared and hashed by identity, which is fast
class Topic:
    """A topic: its name relative to the swarm's namespace, its message class and the ROS name of the type.

    `agent_id` is the only robot whose messages it may carry, 0 if it is not a robot's own topic.
    """

    name: str
    message: type[Message]
    ros_type: str
    agent_id: int = 0

    @property
    def type_name(self) -> str:
        """The name of the type without its package."""
        return self.ros_type.rpartition("/")[2]

    @property
    def identifier(self) -> str:
        """Its name as that of a table or of arrays, such as ``plane_state``."""
        return self.name.replace("/", "_")

    def __deepcopy__(self, _: object) -> Topic:
        """Return the topic itself: a copy of a node is on the same topics."""
        return self


def fields_of(message: type[Message]) -> dict[str, Field | type[Message]]:
    """Return the declarations of a message's fields, in order; for a nested message, its class."""
    hints = get_type_hints(message, include_extras=True)
    return {name: getattr(hint, "__metadata__", (hint,))[0] for name, hint in hints.items()}


TYPES = "swarmabs_msgs/msg/"
"""What the names of the types of the swarm's messages begin with in ROS."""


def _topic(name: str, message: type[Message]) -> Topic:
    return Topic(name, message, f"{TYPES}{message.__name__}")


PLANE_STATE = _topic("plane/state", PlaneState)
AGENT_STATE = _topic("swarm/agent_state", AgentState)
ABSTRACT_STATE = _topic("swarm/abstract_state", AbstractState)
AUXILIARY_STATE = _topic("swarm/auxiliary_state", AuxiliaryState)
DESIRED_ABSTRACT_STATE = _topic("swarm/desired_abstract_state", DesiredAbstractState)
EVENTS = _topic("swarm/events", SwarmEvent)
RECORDING_PROGRESS = _topic("recording/progress", RecordingProgress)
BROADCAST = _topic("swarm/broadcast", Broadcast)
SWARM_STATES = _topic("swarm/states", SwarmStates)
BASIS = _topic("recording/basis", Basis)
STEERING = _topic("swarm/steering", Steering)
ROBOT_STATE = _topic("swarm/robot_state", RobotState)
PARENT_STATE = _topic("parent/state", ParentState)
SWARM_ABSTRACT = _topic("swarm/abstract", SwarmAbstract)
SWARM_AUXILIARY = _topic("swarm/auxiliary", SwarmAuxiliary)
SWARM_DESIRED = _topic("swarm/desired", SwarmDesired)
SWARM_BROADCAST = _topic("swarm/packed", SwarmBroadcast)
SYSTEM = _topic("parent/system", SystemDescription)
REMOVALS = Topic("swarm/removals", Removal, EVENTS.ros_type)
STANDING = _topic("swarm/standing", StandingState)
RELAY = _topic("swarm/relay", Relay)


OBSERVER_NODE, CONTROLLER_NODE, RECORDER_NODE = "abstraction_observer", "parent_controller", "recorder"
"""Names of the nodes that coordinate and record a swarm; that of the parent depends on the `Family`."""


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """The topics by which a swarm controls the plane, or any other parent system.

    `node` names the process of the simulated parent; `kinds` are those that robots may have. Topics in `once` have one
    message per run, in step 0, which a bag holds before the others. Topics in `further` have one message of a
    coordinator in each step, as the main ones have; they are recorded, but are no part of the digest. `vectors` has the
    fields that stand for a list, by its name, if messages have no lists.
    """

    node: str
    robot: Topic
    parent: Topic
    abstract: Topic
    auxiliary: Topic
    desired: Topic
    packed: Topic
    once: tuple[Topic, ...] = ()
    further: tuple[Topic, ...] = ()
    kinds: tuple[Kind, ...] = tuple(Kind)
    vectors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def main(self) -> tuple[Topic, ...]:
        """The five topics that make up a run, in the order in which a bag holds them within a step."""
        return (self.robot, self.parent, *self.broadcasts)

    @property
    def stepwise(self) -> tuple[Topic, ...]:
        """The topics with messages in every step, in the order in which a bag holds them within a step."""
        return (*self.main[:-1], *self.further, self.desired)

    @property
    def recorded(self) -> tuple[Topic, ...]:
        """The topics of a bag in lockstep but events, in its order within a step; `STANDING` is not in every step."""
        return (*self.once, *self.main[:-1], STANDING, *self.further, self.desired)

    @property
    def broadcasts(self) -> tuple[Topic, ...]:
        """All that a robot receives from the swarm."""
        return (self.abstract, self.auxiliary, self.desired)


PLANE_FAMILY = Family(
    "plane_sim",
    AGENT_STATE,
    PLANE_STATE,
    ABSTRACT_STATE,
    AUXILIARY_STATE,
    DESIRED_ABSTRACT_STATE,
    BROADCAST,
    kinds=PLANE_KINDS,
    vectors={
        "state": ("angle", "angular_velocity"),
        "value": ("torque", "inertia"),
        "coordinates": ("position",),
        "velocities": ("velocity",),
        "command": ("command",),
        "constants": ("mass", "damping"),
    },
)
SYSTEM_FAMILY = Family(
    "parent_system",
    ROBOT_STATE,
    PARENT_STATE,
    SWARM_ABSTRACT,
    SWARM_AUXILIARY,
    SWARM_DESIRED,
    SWARM_BROADCAST,
    (SYSTEM,),
)
FAMILIES = (PLANE_FAMILY, SYSTEM_FAMILY)

MAIN_TOPICS = PLANE_FAMILY.main
BROADCASTS = PLANE_FAMILY.broadcasts

AnyRobotState: TypeAlias = AgentState | RobotState
AnyParentState: TypeAlias = PlaneState | ParentState
AnyBroadcast: TypeAlias = Broadcast | SwarmBroadcast
ROBOT_STATES = (AgentState, RobotState)
PARENT_STATES = (PlaneState, ParentState)
ABSTRACT_STATES = (AbstractState, SwarmAbstract)
DESIRED_STATES = (DesiredAbstractState, SwarmDesired)


_OF_PLANE = tuple(topic.message for topic in PLANE_FAMILY.main)


def vector_of(message: Message, name: str) -> Vector:
    """Return a list of the messages of any parent system by its name; the plane's messages name its elements."""
    if not isinstance(message, _OF_PLANE):
        return getattr(message, name)  # type: ignore[no-any-return]
    return tuple(getattr(message, field) for field in PLANE_FAMILY.vectors[name])


def coordinates_of(state: AnyRobotState) -> Vector:
    """Return the coordinates of a robot; on the plane its position, m."""
    return (state.position,) if isinstance(state, AgentState) else state.coordinates


TOPICS = (
    *MAIN_TOPICS,
    *(EVENTS, RECORDING_PROGRESS, BROADCAST, SWARM_STATES, BASIS, STEERING),
    *(*SYSTEM_FAMILY.main, SWARM_BROADCAST, SYSTEM),
    *(REMOVALS, STANDING, RELAY),
)
TOPIC_OF: dict[type[Message], Topic] = {topic.message: topic for topic in TOPICS}
"""The topic on which a message of a class is published, unless nodes publish it on topics of their own."""


PARENT = 0
"""The `agent_id` in relays of the plane's node, which in a sealed swarm publishes its states with their signatures."""


@cache
def relay_topic(agent_id: int) -> Topic:
    """Return the topic on which a robot passes on what it knows to its neighbours; `PARENT`: that of the plane."""
    sender = "plane" if agent_id == PARENT else agent_name(agent_id)
    return Topic(f"{sender}/relay", Relay, RELAY.ros_type, agent_id)


def topic_of(message: Message) -> Topic:
    """Return the topic on which a message is published in lockstep."""
    return relay_topic(message.agent_id) if isinstance(message, Relay) else TOPIC_OF[type(message)]


_RELAY = re.compile(rf"(?:.*/)?{ROBOT_PREFIX}(\d{{3,5}})/relay")


def relay_topic_in(name: str) -> Topic | None:
    """Return the topic of a robot's relays with which a full name of a topic ends, None if it is none."""
    found = _RELAY.fullmatch(name)
    topic = None if found is None else relay_topic(int(found[1]))
    return topic if topic is not None and name.endswith(topic.name) else None
