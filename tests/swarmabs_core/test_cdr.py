"""Bytes built by hand from the alignment rules of CDR, round trips, and everything that is no message."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from math import copysign

import pytest
from hypothesis import given, strategies as st

from swarmabs_core.cdr import agent_id_of, canonical, decode, encode
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import (
    NEVER,
    TOPICS,
    AbstractState,
    AgentState,
    AuxiliaryState,
    Basis,
    Broadcast,
    DesiredAbstractState,
    Message,
    PlaneState,
    RecordingProgress,
    Steering,
    SwarmEvent,
)

STAMP, STEP = 12_340_000_001, 1234
# Encapsulation; sec, nanosec; "plane" with its length, padded to a multiple of 8 after the encapsulation; step.
HEAD = (
    b"\x00\x01\x00\x00"
    b"\x0c\x00\x00\x00" + (340_000_001).to_bytes(4, "little") + b"\x06\x00\x00\x00plane\x00"
    b"\x00\x00\x00\x00\x00\x00"
    b"\xd2\x04\x00\x00\x00\x00\x00\x00"
)


@dataclass
class Case:
    """A message, its bytes after `HEAD`, and where those have padding (first offset, length), if they do."""

    message: Message
    body: bytes
    padding: tuple[int, int] | None = None


def doubles(*values: float) -> bytes:
    return b"".join(struct.pack("<d", value) for value in values)


CASES = [
    Case(PlaneState(STAMP, STEP, 0.1, -0.25), doubles(0.1, -0.25)),
    Case(
        AgentState(STAMP, STEP, NEVER, 258, 2, 3, 0.5, 0.75, -0.125, 0.25, -1.5),
        b"\xff" * 8 + b"\x02\x01\x02\x03" + b"\x00" * 4 + doubles(0.5, 0.75, -0.125, 0.25, -1.5),
        (12, 4),
    ),
    Case(
        AbstractState(STAMP, STEP, 4, 1.0, 2.0, 3.0, 4.0),
        b"\x04\x00" + b"\x00" * 6 + doubles(1.0, 2.0, 3.0, 4.0),
        (2, 6),
    ),
    Case(AuxiliaryState(STAMP, STEP, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0), doubles(*range(1, 9))),
    Case(
        DesiredAbstractState(STAMP, STEP, 1, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0),
        b"\x01" + b"\x00" * 7 + doubles(*range(1, 9)),
        (1, 7),
    ),
    Case(
        SwarmEvent(STAMP, STEP, 7, 3, 0.5, "bé"),
        b"\x07\x00\x03" + b"\x00" * 5 + doubles(0.5) + b"\x04\x00\x00\x00b\xc3\xa9\x00",
        (3, 5),
    ),
    Case(RecordingProgress(STAMP, STEP, 1230), b"\xce\x04\x00\x00\x00\x00\x00\x00"),
    Case(
        Basis(STAMP, STEP, 1, NEVER, 2, (4, 5, 2**32), (1, 258, 65535), (0, 1, 0)),
        b"\x01" + b"\x00" * 7 + b"\xff" * 8 + b"\x02\x00\x00\x00" + b"\x03\x00\x00\x00"
        b"\x04" + b"\x00" * 7 + b"\x05" + b"\x00" * 7 + b"\x00\x00\x00\x00\x01\x00\x00\x00"
        b"\x03\x00\x00\x00" + b"\x01\x00\x02\x01\xff\xff" + b"\x00\x00" + b"\x03\x00\x00\x00" + b"\x00\x01\x00",
        (17, 3),
    ),
    Case(
        Steering(STAMP, STEP, 7, 1, 513, 1.0),
        b"\x07" + b"\x00" * 7 + b"\x01\x00\x01\x02" + b"\x00" * 4 + doubles(1.0),
        (12, 4),
    ),
]
PARTS = [CASES[2], CASES[3], CASES[4]]
CASES.append(
    Case(
        Broadcast(STAMP, STEP, *(case.message for case in PARTS)),  # type: ignore[arg-type]
        b"".join(HEAD[4:] + case.body for case in PARTS),
        (18, 6),
    )
)
each = pytest.mark.parametrize("case", CASES, ids=lambda case: type(case.message).__name__)

stamps = st.integers(0, (2**31 - 1) * 10**9)
u64, u16, u8 = (st.integers(0, 2**bits - 1) for bits in (64, 16, 8))
f64 = st.floats(allow_nan=False)
messages = st.one_of(
    st.builds(PlaneState, stamps, u64, f64, f64),
    st.builds(AgentState, stamps, u64, u64, u16, u8, u8, f64, f64, f64, f64, f64),
    st.builds(AbstractState, stamps, u64, u16, f64, f64, f64, f64),
    st.builds(AuxiliaryState, stamps, u64, *[f64] * 8),
    st.builds(DesiredAbstractState, stamps, u64, u8, *[f64] * 8),
    st.builds(SwarmEvent, stamps, u64, u16, u8, f64, st.text(max_size=30)),
    st.builds(RecordingProgress, stamps, u64, u64),
    st.lists(st.tuples(u16, u64), max_size=9).flatmap(
        lambda pairs: st.builds(
            *(Basis, stamps, u64, u64, u64, u8),
            *(
                st.just(tuple(part))
                for part in ([s for _, s in pairs], [i for i, _ in pairs], [i % 2 for i, _ in pairs])
            ),
        )
    ),
    st.builds(Steering, stamps, u64, u64, u8, u16, f64),
    st.builds(
        Broadcast,
        stamps,
        u64,
        st.builds(AbstractState, stamps, u64, u16, f64, f64, f64, f64),
        st.builds(AuxiliaryState, stamps, u64, *[f64] * 8),
        st.builds(DesiredAbstractState, stamps, u64, u8, *[f64] * 8),
    ),
)
message_types = st.sampled_from([topic.message for topic in TOPICS])


@each
def test_bytes_by_hand(case: Case) -> None:
    assert encode(case.message) == HEAD + case.body
    assert decode(type(case.message), HEAD + case.body) == case.message


def test_every_message_has_its_bytes_by_hand() -> None:
    assert {type(case.message) for case in CASES} == {topic.message for topic in TOPICS}


@each
def test_padding_is_ignored(case: Case) -> None:
    data = bytearray(HEAD + case.body)
    data[2:4] = b"\xaa\xbb"  # options of the encapsulation
    data[22:28] = b"\xcc" * 6
    if case.padding is not None:
        first, length = case.padding
        data[len(HEAD) + first : len(HEAD) + first + length] = b"\xdd" * length
    data += b"\xee" * 3  # Fast DDS rounds the size up
    found = decode(type(case.message), bytes(data))
    assert found == case.message
    assert encode(found) == HEAD + case.body
    assert canonical(type(case.message), bytes(data)) == HEAD + case.body


@given(messages)
def test_round_trip(message: Message) -> None:
    data = encode(message)
    assert decode(type(message), data) == message
    assert encode(decode(type(message), data)) == data
    assert canonical(type(message), data) == data


def test_round_trip_keeps_the_sign_of_zero_and_nan() -> None:
    nan = struct.unpack("<d", b"\x01\x02\x03\x04\x05\x06\xf8\xff")[0]
    data = encode(PlaneState(0, 0, -0.0, nan))
    assert data[-8:] == b"\x01\x02\x03\x04\x05\x06\xf8\xff"
    found = decode(PlaneState, data)
    assert isinstance(found, PlaneState)
    assert copysign(1.0, found.angle) == -1.0
    assert encode(found) == data


@each
def test_every_truncation_is_refused(case: Case) -> None:
    data = HEAD + case.body
    for length in range(len(data)):
        with pytest.raises(MalformedMessageError, match=f"malformed {type(case.message).__name__}: "):
            decode(type(case.message), data[:length])


@each
def test_trailing_bytes_are_refused(case: Case) -> None:
    with pytest.raises(MalformedMessageError, match="bytes, expected"):
        decode(type(case.message), HEAD + case.body + b"\x00" * 4)


@each
@pytest.mark.parametrize(
    ("offset", "put", "problem"),
    [
        (0, b"\x00\x00", "not little-endian CDR"),
        (0, b"\x00\x03", "not little-endian CDR"),
        (12, b"\x07", "frame_id is not 'plane'"),
        (16, b"plant", "frame_id is not 'plane'"),
        (21, b"x", "frame_id is not 'plane'"),
    ],
)
def test_wrong_head_is_refused(case: Case, offset: int, put: bytes, problem: str) -> None:
    data = bytearray(HEAD + case.body)
    data[offset : offset + len(put)] = put
    with pytest.raises(MalformedMessageError, match=problem):
        decode(type(case.message), bytes(data))


@pytest.mark.parametrize(
    ("tail", "problem"),
    [
        (b"\x02\x00\x00\x00\xff\x00", "`detail` is not UTF-8"),
        (b"\x02\x00\x00\x00ab", "cut off or not terminated"),
        (b"\x00\x00\x00\x00", "cut off or not terminated"),
        (b"\xff\xff\xff\xffab\x00", "cut off or not terminated"),
    ],
)
def test_wrong_detail_is_refused(tail: bytes, problem: str) -> None:
    with pytest.raises(MalformedMessageError, match=problem):
        decode(SwarmEvent, HEAD + b"\x07\x00\x03" + b"\x00" * 5 + doubles(0.5) + tail)


def test_a_basis_without_robots_ends_with_their_number() -> None:
    basis = Basis(STAMP, STEP, 1, 2, 3, (), (), ())
    data = HEAD + b"\x01" + b"\x00" * 7 + b"\x02" + b"\x00" * 7 + b"\x03" + b"\x00" * 15
    assert encode(basis) == data
    assert decode(Basis, data) == basis


@pytest.mark.parametrize(
    ("tail", "problem"),
    [
        (b"\xff\x00\x00\x00" + b"\x00" * 8, "bytes, expected"),
        (b"\xff\xff\xff\xff" + b"\x00" * 8, "4294967295 robots"),
        (
            b"\x01\x00\x00\x00" + b"\x00" * 8 + b"\x02\x00\x00\x00" + b"\x00" * 4 + b"\x01\x00\x00\x00\x00",
            "1 in `state_steps`, 2 in `agent_ids`, 1 in `standing`",
        ),
    ],
)
def test_wrong_numbers_of_robots_are_refused(tail: bytes, problem: str) -> None:
    with pytest.raises(MalformedMessageError, match=problem):
        decode(Basis, HEAD + b"\x00" * 16 + b"\x01\x00\x00\x00" + tail)


def test_a_basis_whose_lists_differ_in_length_cannot_be_sent() -> None:
    with pytest.raises(MalformedMessageError, match="2 in `state_steps`, 1 in `agent_ids`, 1 in `standing`"):
        encode(Basis(STAMP, STEP, 1, 2, 3, (1, 2), (3,), (0,)))


@given(message_types, st.binary(max_size=200))
def test_noise_gives_one_error_only(message_type: type[Message], data: bytes) -> None:
    with pytest.raises(MalformedMessageError):
        decode(message_type, data)


@given(messages, st.data())
def test_damaged_messages_are_read_or_refused(message: Message, data: st.DataObject) -> None:
    damaged = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(u8)
    try:
        found = decode(type(message), bytes(damaged))
    except MalformedMessageError:
        return
    assert type(found) is type(message)


@pytest.mark.parametrize(
    "message",
    [
        PlaneState(0, -1, 0.0, 0.0),
        PlaneState(2**31 * 10**9, 0, 0.0, 0.0),
        RecordingProgress(0, 0, 2**64),
        AgentState(0, 0, 0, 65536, 1, 1, 1.0, 0.0, 0.0, 0.0, 0.0),
        SwarmEvent(0, 0, -1, 1, 0.0, ""),
        SwarmEvent(0, 0, 1, 1, 0.0, "\udcff"),
    ],
)
def test_fields_that_do_not_fit_are_refused(message: Message) -> None:
    with pytest.raises(MalformedMessageError, match=f"malformed {type(message).__name__}: "):
        encode(message)


def test_robot_of_a_message() -> None:
    robots = {type(case.message).__name__: agent_id_of(case.message) for case in CASES}
    assert {name: robot for name, robot in robots.items() if robot} == {"AgentState": 258, "SwarmEvent": 7}
