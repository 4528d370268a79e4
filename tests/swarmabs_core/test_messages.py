"""Padding, wrong lengths and heads, and everything that is no message."""

import struct

import pytest
from hypothesis import given, settings, strategies as st

from swarmabs_core import messages as msg
from swarmabs_core.cdr import canonical, decode, encode, split
from swarmabs_core.errors import InputError, MalformedMessageError
from swarmabs_core.nodes import NodeName
from swarmabs_core.record import Record

STAMP, STEP = 12_340_000_001, 1234
# Encapsulation; sec, nanosec; "plane" with its length, padded to a multiple of 8 after the encapsulation; step.
HEAD = (
    b"\x00\x01\x00\x00"
    b"\x0c\x00\x00\x00" + (340_000_001).to_bytes(4, "little") + b"\x06\x00\x00\x00plane\x00"
    b"\x00\x00\x00\x00\x00\x00"
    b"\xd2\x04\x00\x00\x00\x00\x00\x00"
)


AGENT = msg.AgentState(STAMP, STEP, msg.NEVER, 258, 2, 3, 0.5, 0.75, -0.125, 0.25, -1.5)
PARTS = (
    msg.AbstractState(STAMP, STEP, 4, 1.0, 2.0, 3.0, 4.0),
    msg.AuxiliaryState(STAMP, STEP, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0),
    msg.DesiredAbstractState(STAMP, STEP, 1, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0),
)
ROBOT = msg.RobotState(STAMP, STEP, 5, msg.NEVER, 258, 3, 4, (0.5, -1.0), (0.25, 0.0), (), (70.0,))
SWARM = (
    msg.SwarmAbstract(STAMP, STEP, 5, 4, (1.0, 2.0), (3.0, 4.0)),
    msg.SwarmAuxiliary(STAMP, STEP, 5, (1.0, 2.0, 3.0), (4.0, 5.0), ()),
    msg.SwarmDesired(STAMP, STEP, 5, 1, (1.0, 2.0), (3.0, 4.0), (5.0, 6.0), (7.0, 8.0), (9.0, 10.0)),
)
DIVIDED = msg.StandingState(
    STAMP, STEP, 5, 1, 3, (1.0, 2.0), (0.5,), (3.0, 4.0), (5.0, 6.0), (0.0, 7.0), (8.0, 9.0, 10.0), 3.0, (1.5,)
)
CASES: dict[msg.Message, tuple[int, int]] = {
    msg.PlaneState(STAMP, STEP, 0.1, -0.25): (0, 0),
    AGENT: (12, 4),
    PARTS[0]: (2, 6),
    PARTS[1]: (0, 0),
    PARTS[2]: (1, 7),
    msg.SwarmEvent(STAMP, STEP, 7, 3, 0.5, "bé"): (3, 5),
    msg.Removal(STAMP, STEP, 8, 2, 0.5, "bé"): (3, 5),
    msg.RecordingProgress(STAMP, STEP, 1230): (0, 0),
    msg.Basis(STAMP, STEP, 1, msg.NEVER, 2, (4, 5, 2**32), (1, 258, 65535), (0, 1, 0)): (17, 3),
    msg.Basis(STAMP, STEP, 1, 2, 3, (), (), ()): (17, 3),
    msg.SwarmStates(STAMP, STEP, b"\x00\xff\x01"): (0, 0),
    msg.Steering(STAMP, STEP, 7, 1, 513, 1.0): (12, 4),
    msg.Relay(STAMP, STEP, 513, 3, 1, 0, b"\x03\xff"): (6, 2),
    msg.Broadcast(STAMP, STEP, *PARTS): (18, 6),
    ROBOT: (44, 4),  # behind the length of the velocities
    msg.ParentState(STAMP, STEP, 5, (0.1, -0.25)): (12, 4),
    SWARM[0]: (10, 2),
    SWARM[1]: (12, 4),
    SWARM[2]: (9, 3),
    msg.SwarmBroadcast(STAMP, STEP, *SWARM): (18, 6),
    msg.SystemDescription(STAMP, STEP, 5, '{"name": "ship"}'): (0, 0),
    DIVIDED: (36, 4),
}
"""Messages, and where they have padding behind `HEAD`: first offset and length."""
each = pytest.mark.parametrize("message", CASES, ids=lambda message: type(message).__name__)


def doubles(*values: float) -> bytes:
    return b"".join(struct.pack("<d", value) for value in values)


def test_bytes_by_hand() -> None:
    """`tests/swarmabs_msgs` compares all messages with what ROS makes of them."""
    body = b"\xff" * 8 + b"\x02\x01\x02\x03" + b"\x00" * 4 + doubles(0.5, 0.75, -0.125, 0.25, -1.5)
    assert encode(AGENT) == HEAD + body
    assert decode(msg.AgentState, HEAD + body) == AGENT
    numbers = [
        doubles(0.5, -1.0),
        b"\x02" + b"\x00" * 7,
        doubles(0.25, 0.0),
        b"\x00" * 4 + b"\x01\x00\x00\x00",
        doubles(70.0),
    ]
    head = b"\x05" + b"\x00" * 7 + b"\xff" * 8 + b"\x02\x01\x03\x04" + b"\x02\x00\x00\x00"
    assert encode(ROBOT) == HEAD + head + b"".join(numbers)
    assert {type(message) for message in CASES} == {topic.message for topic in msg.TOPICS}


@each
def test_padding_is_ignored_and_records_hold_topic_robot_message_and_bytes(message: msg.Message) -> None:
    canon, topic = encode(message), msg.topic_of(message)
    data = bytearray(canon)
    data[2:4] = b"\xaa\xbb"  # options of the encapsulation
    first, length = CASES[message]
    for begin, size in ((22, 6), (len(HEAD) + first, length)):
        assert not any(canon[begin : begin + size])
        data[begin : begin + size] = b"\xcc" * size
    padded = bytes(data + b"\xee" * 3)  # Fast DDS rounds the size up
    assert decode(type(message), padded) == message
    assert canonical(type(message), padded) == canon
    made = Record(
        topic,
        {msg.AgentState: 258, msg.RobotState: 258, msg.SwarmEvent: 7, msg.Removal: 8, msg.Relay: 513}.get(
            type(message), 0
        ),
        message,
        canon,
    )
    assert Record.of(message) == Record.heard(topic, padded) == made
    assert Record.read(topic, 5, padded, 7) == made._replace(payload=padded, time=5, published=7)


def test_a_second_in_the_nanoseconds_is_carried_over() -> None:
    for nanoseconds in (10**9, 10**9 + 5, 2**32 - 1):
        data = encode(AGENT)[:8] + nanoseconds.to_bytes(4, "little") + encode(AGENT)[12:]
        stamped = AGENT._replace(stamp=12 * 10**9 + nanoseconds)
        assert decode(msg.AgentState, data) == stamped
        assert canonical(msg.AgentState, data) == encode(stamped) != data


def test_messages_that_follow_one_another_are_told_apart_and_the_last_may_be_cut_off() -> None:
    for messages in ([AGENT, AGENT._replace(agent_id=7)], [ROBOT, ROBOT._replace(constants=()), ROBOT]):
        payloads = [encode(message) for message in messages]
        assert split(type(messages[0]), b"".join(payloads)) == payloads
        assert split(type(messages[0]), b"".join(payloads)[:-1]) == [*payloads[:-1], payloads[-1][:-1]]
    assert split(msg.AgentState, b"") == []
    with pytest.raises(MalformedMessageError, match="a list of 4294967295 numbers, at most 8"):
        split(msg.RobotState, b"\xff" * 200)


@each
def test_every_other_length_and_head_is_refused(message: msg.Message) -> None:
    data = encode(message)
    for wrong in (*(data[:length] for length in range(len(data))), data + b"\x00" * 4):
        with pytest.raises(MalformedMessageError, match=f"malformed {type(message).__name__}: "):
            decode(type(message), wrong)
    for offset, put in ((0, b"\x00\x00"), (0, b"\x00\x03"), (12, b"\x07"), (16, b"plant"), (21, b"x")):
        problem = "frame_id is not 'plane'" if offset else "not little-endian CDR"
        with pytest.raises(MalformedMessageError, match=problem):
            decode(type(message), data[:offset] + put + data[offset + len(put) :])


EVENT = HEAD + b"\x07\x00\x03" + b"\x00" * 5 + doubles(0.5)
PACKED = encode(msg.SwarmBroadcast(STAMP, STEP, *SWARM))
SOURCES = HEAD + b"\x00" * 16 + b"\x01\x00\x00\x00"


@pytest.mark.parametrize(
    ("message_type", "data", "problem"),
    [
        (msg.SwarmEvent, EVENT + b"\x02\x00\x00\x00\xff\x00", "`detail` is not UTF-8"),
        (msg.SwarmEvent, EVENT + b"\x02\x00\x00\x00ab", "cut off or not terminated"),
        (msg.SwarmEvent, EVENT + b"\x00\x00\x00\x00", "cut off or not terminated"),
        (msg.SwarmEvent, EVENT + b"\xff\xff\xff\xffab\x00", "cut off or not terminated"),
        (msg.Basis, SOURCES + b"\xff\x00\x00\x00" + b"\x00" * 8, "bytes, expected"),
        (msg.Basis, SOURCES + b"\xff\xff\xff\xff" + b"\x00" * 8, "4294967295 robots"),
        (
            msg.Basis,
            SOURCES + b"\x01" + b"\x00" * 11 + b"\x02" + b"\x00" * 7 + b"\x01" + b"\x00" * 4,
            "1 in `state_steps`, 2 in `agent_ids`, 1 in `standing`",
        ),
        (msg.PlaneState, HEAD + doubles(0.1, -0.25, 0.0), "bytes, expected"),
        (
            msg.ParentState,
            HEAD + b"\x05" + b"\x00" * 7 + b"\x21" + b"\x00" * 7 + doubles(*range(33)),
            "33 .* at most 32",
        ),
        (msg.ParentState, HEAD + b"\x05" + b"\x00" * 7 + b"\xff" * 4 + b"\x00" * 4, "4294967295 numbers, at most 32"),
        (msg.ParentState, HEAD + b"\x05" + b"\x00" * 7 + b"\x02" + b"\x00" * 7 + doubles(0.1), "60 bytes, expected 68"),
        (msg.SwarmBroadcast, PACKED[:50] + b"X" + PACKED[51:], "frame_id is not 'plane'"),
    ],
)
def test_wrong_lengths_within_a_message_are_named(message_type: type[msg.Message], data: bytes, problem: str) -> None:
    with pytest.raises(MalformedMessageError, match=problem):
        decode(message_type, data)


@settings(max_examples=50)
@given(st.sampled_from([topic.message for topic in msg.TOPICS]), st.binary(max_size=200))
def test_noise_gives_one_error_only(message_type: type[msg.Message], data: bytes) -> None:
    with pytest.raises(MalformedMessageError):
        decode(message_type, data)


@pytest.mark.parametrize(
    "message",
    [
        msg.PlaneState(0, -1, 0.0, 0.0),
        msg.PlaneState(2**31 * 10**9, 0, 0.0, 0.0),
        msg.RecordingProgress(0, 0, 2**64),
        msg.AgentState(0, 0, 0, 65536, 1, 1, 1.0, 0.0, 0.0, 0.0, 0.0),
        msg.SwarmEvent(0, 0, -1, 1, 0.0, ""),
        msg.SwarmEvent(0, 0, 1, 1, 0.0, "\udcff"),
        msg.Basis(STAMP, STEP, 1, 2, 3, (1, 2), (3,), (0,)),
        msg.ParentState(STAMP, STEP, 2**64, ()),
        msg.ParentState(STAMP, STEP, 5, (0.0,) * 33),
        ROBOT._replace(coordinates=(0.0,) * 9),
        ROBOT._replace(constants=("heavy",)),
        SWARM[1]._replace(gram=(0.0,) * 137),
        msg.SwarmBroadcast(STAMP, STEP, SWARM[0], SWARM[1], SWARM[2]._replace(end_rate=(0.0,) * 17)),
    ],
)
def test_fields_that_do_not_fit_are_refused(message: msg.Message) -> None:
    with pytest.raises(MalformedMessageError, match=f"malformed {type(message).__name__}: "):
        encode(message)


def test_what_names_no_node_is_refused() -> None:
    for text in ("", "agent", "agent:", "agent:x", "agent:03", "plane:1", "parent:1", "robot:3", "observer:"):
        with pytest.raises(InputError, match=r"no node .*; use controller, observer, parent, or agent:N"):
            NodeName.parse(text)
    assert NodeName.parse("plane") == NodeName.parse("parent")
