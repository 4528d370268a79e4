"""The messages of the swarm as immutable values, with their topics.

These are the ROS-free twins of the definitions in ``swarmabs_msgs``: the node behaviours exchange them,
`swarmabs_core.cdr` turns them into the bytes that travel over DDS and that stand in a bag. All quantities are
in SI units. ``stamp`` is the header's time stamp in nanoseconds; in lockstep it is exactly ``step`` times the
control period.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

NEVER = 2**64 - 1
"""A step field that refers to no step (``AgentState.broadcast_step``, ``RecordingProgress.written_step``)."""

FRAME_ID = "plane"
"""The only frame: origin at the plane's axis, positions along the plane."""


class Kind(IntEnum):
    """Dynamics of a robot (``AgentState.kind``)."""

    SINGLE_INTEGRATOR = 1
    DOUBLE_INTEGRATOR = 2


class Status(IntEnum):
    """What a robot says of itself (``AgentState.status``)."""

    ACTIVE = 1
    SAFE_STOP = 2
    LEFT = 3


class Mode(IntEnum):
    """What the parent controller asks of the swarm (``DesiredAbstractState.mode``)."""

    RUN = 1
    STOP = 2
    RESET = 3


class EventKind(IntEnum):
    """What happened (``SwarmEvent.kind``)."""

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


class Source(IntEnum):
    """Whose answer a basis belongs to (``Basis.source``)."""

    OBSERVER = 1
    PLANE = 2
    CONTROLLER = 3


class Action(IntEnum):
    """What is changed in a run from outside (``Steering.action``)."""

    NONE = 0
    REFERENCE = 1
    DISTURBANCE = 2
    KILL = 3
    FREEZE = 4
    REMOVE = 5
    ADD = 6


def said(value: IntEnum) -> str:
    """Return a constant of a message in words, such as "double integrator"."""
    return value.name.lower().replace("_", " ")


class PlaneState(NamedTuple):
    """Angle (rad) and angular velocity (rad/s) of the plane."""

    stamp: int
    step: int
    angle: float
    angular_velocity: float


class AgentState(NamedTuple):
    """State of one robot: mass (kg), damping (N s/m), position (m), velocity (m/s), command that led here.

    ``command`` is in m/s for a single integrator and in N for a double integrator. It was held over the
    period that ends at ``step`` and was computed from the broadcasts of ``broadcast_step``.
    """

    stamp: int
    step: int
    broadcast_step: int
    agent_id: int
    kind: int
    status: int
    mass: float
    damping: float
    position: float
    velocity: float
    command: float


class AbstractState(NamedTuple):
    """Torque tau_s (N m) and moment of inertia J_s (kg m^2) of the swarm on the plane, and their rates."""

    stamp: int
    step: int
    agent_count: int
    torque: float
    inertia: float
    torque_rate: float
    inertia_rate: float


class AuxiliaryState(NamedTuple):
    """Sums over the swarm that a robot's law needs: S0 kg^2, S1 kg^2 m, S2 kg^2 m^2, S3 kg^4 m^2, D0..D2, Q.

    D0, D1, D2 are in kg N s/m, kg N s and kg N s m; Q is in kg m^2/s^2.
    """

    stamp: int
    step: int
    s0: float
    s1: float
    s2: float
    s3: float
    d0: float
    d1: float
    d2: float
    q: float


class DesiredAbstractState(NamedTuple):
    """What the parent controller asks for: torque (N m), inertia (kg m^2), their rates and accelerations.

    The ``mean_*_rate`` fields are means over the coming control period, the others are values at ``step``.
    """

    stamp: int
    step: int
    mode: int
    torque: float
    inertia: float
    torque_rate: float
    inertia_rate: float
    mean_torque_rate: float
    mean_inertia_rate: float
    torque_acceleration: float
    inertia_acceleration: float


class SwarmEvent(NamedTuple):
    """Something that happened: ``step`` is the first at which it holds, ``agent_id`` 0 if no robot did it."""

    stamp: int
    step: int
    agent_id: int
    kind: int
    value: float
    detail: str


class RecordingProgress(NamedTuple):
    """Credit from the recorder: it and all before ``written_step`` are on disk (`NEVER`: nothing yet)."""

    stamp: int
    step: int
    written_step: int


class Broadcast(NamedTuple):
    """The three broadcasts of a step in one message, for robots that ask for them so."""

    stamp: int
    step: int
    abstract: AbstractState
    auxiliary: AuxiliaryState
    desired: DesiredAbstractState


class Basis(NamedTuple):
    """From what a coordinator in real time computed its answer of a step.

    ``since`` is the step of the answer from which it went on (`NEVER`: it began anew). ``begun`` is the step in which
    the simulated plane was let go (`NEVER`: it is held), or the one with which the time of the parent controller's law
    began. ``state_steps`` and ``agent_ids``, ascending, say which robots' states entered it,
    and ``standing`` which of these robots the observer took to stand still, since they were silent (1, else 0).
    """

    stamp: int
    step: int
    since: int
    begun: int
    source: int
    state_steps: tuple[int, ...]
    agent_ids: tuple[int, ...]
    standing: tuple[int, ...]


class Steering(NamedTuple):
    """What is changed from outside from a step on; ``request`` is the number of the request, 0 if nothing is."""

    stamp: int
    step: int
    request: int
    action: int
    agent_id: int
    value: float


Message = (
    PlaneState
    | AgentState
    | AbstractState
    | AuxiliaryState
    | DesiredAbstractState
    | SwarmEvent
    | RecordingProgress
    | Broadcast
    | Basis
    | Steering
)
"""Any message of the swarm."""

Messages = tuple[Message, ...]
"""What a node behaviour answers: the messages to publish, in this order."""


@dataclass(frozen=True, slots=True, eq=False)  # compared and hashed by identity, which is fast
class Topic:
    """A topic: its name relative to the swarm's namespace, its message class and the ROS name of the type."""

    name: str
    message: type[Message]
    ros_type: str


PLANE_STATE = Topic("plane/state", PlaneState, "swarmabs_msgs/msg/PlaneState")
AGENT_STATE = Topic("swarm/agent_state", AgentState, "swarmabs_msgs/msg/AgentState")
ABSTRACT_STATE = Topic("swarm/abstract_state", AbstractState, "swarmabs_msgs/msg/AbstractState")
AUXILIARY_STATE = Topic("swarm/auxiliary_state", AuxiliaryState, "swarmabs_msgs/msg/AuxiliaryState")
DESIRED_ABSTRACT_STATE = Topic(
    "swarm/desired_abstract_state", DesiredAbstractState, "swarmabs_msgs/msg/DesiredAbstractState"
)
EVENTS = Topic("swarm/events", SwarmEvent, "swarmabs_msgs/msg/SwarmEvent")
RECORDING_PROGRESS = Topic("recording/progress", RecordingProgress, "swarmabs_msgs/msg/RecordingProgress")
BROADCAST = Topic("swarm/broadcast", Broadcast, "swarmabs_msgs/msg/Broadcast")
BASIS = Topic("recording/basis", Basis, "swarmabs_msgs/msg/Basis")
STEERING = Topic("swarm/steering", Steering, "swarmabs_msgs/msg/Steering")

MAIN_TOPICS = (AGENT_STATE, PLANE_STATE, ABSTRACT_STATE, AUXILIARY_STATE, DESIRED_ABSTRACT_STATE)
"""The five topics that make up a run, in the order in which a bag holds them within a step."""

BROADCASTS = (ABSTRACT_STATE, AUXILIARY_STATE, DESIRED_ABSTRACT_STATE)
"""All that a robot hears from the swarm."""

TOPICS = (*MAIN_TOPICS, EVENTS, RECORDING_PROGRESS, BROADCAST, BASIS, STEERING)
TOPIC_OF: dict[type[Message], Topic] = {topic.message: topic for topic in TOPICS}
"""The topic on which a message of a class is published."""
