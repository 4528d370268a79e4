"""What a node in lockstep makes of messages that come twice, or are not of this swarm."""

import pytest

from swarmabs_core.behaviours.base import ConflictError
from swarmabs_core.cdr import encode, step_of
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import (
    AGENT_STATE,
    EVENTS,
    NEVER,
    PLANE_STATE,
    RECORDING_PROGRESS,
    STEERING,
    Action,
    AgentState,
    PlaneState,
    RecordingProgress,
    Steering,
    SwarmEvent,
    Topic,
)
from swarmabs_ros.inputs import Inputs


def plane(step: int, angle: float = 0.1) -> bytes:
    return encode(PlaneState(step, step, angle, 0.0))


def robot(agent_id: int, position: float) -> bytes:
    return encode(AgentState(0, 3, NEVER, agent_id, 1, 1, 0.5, 0.0, position, 0.0, 0.0))


def misframed(data: bytes) -> bytes:
    """Return a message with another frame_id, of which every field stands elsewhere."""
    return data[:12] + b"\x05\x00\x00\x00base\x00" + bytes(3) + data[24:]


def test_a_message_is_compared_with_the_first_in_its_place_for_as_many_steps_as_are_kept() -> None:
    inputs = Inputs(3)
    for step in range(3):
        inputs.compare(PLANE_STATE, plane(step))
    with pytest.raises(ConflictError, match="plane/state: two different messages of step 0"):
        inputs.compare(PLANE_STATE, plane(0, 0.2))
    inputs.compare(PLANE_STATE, plane(0))
    inputs.compare(PLANE_STATE, plane(1) + b"\xee")  # the middleware rounds sizes up
    inputs.compare(PLANE_STATE, plane(3))
    inputs.compare(PLANE_STATE, plane(0, 0.2))  # nobody repeats this step any more


def test_robots_have_places_of_their_own_and_events_and_progress_none() -> None:
    inputs = Inputs(3)
    inputs.compare(AGENT_STATE, robot(1, 0.1))
    inputs.compare(AGENT_STATE, robot(258, 0.2))
    with pytest.raises(ConflictError, match="swarm/agent_state of agent 258: two different messages of step 3"):
        inputs.compare(AGENT_STATE, robot(258, 0.1))
    for value in (1.0, 2.0):
        inputs.compare(EVENTS, encode(SwarmEvent(0, 3, 1, 7, value, "")))
        inputs.compare(RECORDING_PROGRESS, encode(RecordingProgress(0, 3, int(value))))


def test_a_step_has_one_order_whichever_robot_it_names() -> None:
    inputs = Inputs(3)
    inputs.compare(STEERING, encode(Steering(0, 3, 1, Action.KILL, 2, 0.0)))
    with pytest.raises(ConflictError, match=r"^swarm/steering: two different messages of step 3"):
        inputs.compare(STEERING, encode(Steering(0, 3, 0, Action.NONE, 0, 0.0)))


def test_the_step_of_a_message_of_another_frame_is_not_read() -> None:
    with pytest.raises(MalformedMessageError, match="malformed PlaneState: frame_id is not 'plane'"):
        Inputs(3).compare(PLANE_STATE, misframed(plane(4)))
    with pytest.raises(MalformedMessageError, match="not little-endian"):
        step_of(b"\x00\x00" + plane(4)[2:])


def test_topics_of_a_users_own_nodes_are_compared_too() -> None:
    inputs = Inputs(3)
    link = Topic("/upper/swarm/agent_state", AgentState, AGENT_STATE.ros_type)
    for number in (1, 2):
        inputs.compare(link, robot(number, 0.1))
    with pytest.raises(ConflictError, match="/upper/swarm/agent_state of agent 2"):
        inputs.compare(link, robot(2, 0.2))
