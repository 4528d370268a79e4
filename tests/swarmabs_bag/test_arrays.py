"""Arrays hold what was recorded, at the right places."""

import hashlib
import itertools
import json
import math
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from tests.swarmabs_bag.mcap_files import rewritten
from tests.swarmabs_bag.sample_run import bag_writer, write_all

from swarmabs_analysis.comparison import compare_bags
from swarmabs_bag import arrays
from swarmabs_bag.arrays import digest_of, load_arrays, load_messages
from swarmabs_bag.errors import BagTooLargeError, DamagedBagError, NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run.writer import BagWriter
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError
from swarmabs_core.messages import (
    EVENTS,
    MAIN_TOPICS,
    NEVER,
    PARENT_STATE,
    PLANE_STATE,
    SYSTEM,
    SYSTEM_FAMILY,
    TOPIC_OF,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    Message,
    ParentState,
    PlaneState,
    RobotState,
    SwarmAbstract,
    SwarmAuxiliary,
    SwarmDesired,
    SystemDescription,
    Topic,
)
from swarmabs_core.systems import SystemTables


def of(run: list[Message], kind: type[Message]) -> list[Message]:
    return [message for message in run if type(message) is kind]


def column(messages: Sequence[Message], name: str) -> list[float]:
    return [getattr(message, name) for message in messages]


def test_every_value_is_at_its_step_and_agents_are_columns_in_order_of_their_ids(bag: Path, run: list[Message]) -> None:
    loaded = load_arrays(bag)
    assert loaded.step.tolist() == list(range(41))
    assert loaded.time.tolist() == [step / 100 for step in range(41)]
    parts = {AbstractState: loaded.abstract, AuxiliaryState: loaded.auxiliary, DesiredAbstractState: loaded.desired}
    for kind, part in (parts | {PlaneState: loaded}).items():
        for name in kind._fields[2:]:
            assert getattr(part, name).tolist() == column(of(run, kind), name), name
    agents = loaded.agents
    assert agents.ids.tolist() == [1, 2, 7]
    for number, agent in enumerate(agents.ids):
        states = [state for state in of(run, AgentState) if isinstance(state, AgentState) and state.agent_id == agent]
        for name in ("kind", "status", "mass", "damping", "position", "velocity", "command"):
            assert getattr(agents, name)[:, number].tolist() == column(states, name), name
    part = load_arrays(bag, stride=7)
    assert part.step.tolist() == list(range(0, 41, 7))
    assert part.angle.tolist() == loaded.angle[::7].tolist()
    assert part.agents.command.tolist() == agents.command[::7].tolist()
    assert part.desired.torque.tolist() == loaded.desired.torque[::7].tolist()


def test_what_was_not_recorded_is_nan(tmp_path: Path, run: list[Message], write_bag: Callable[..., Path]) -> None:
    gone = [
        message
        for message in run
        if not (isinstance(message, AgentState) and message.agent_id == 2 and message.step >= 30)
        and not (isinstance(message, (PlaneState, AbstractState)) and message.step == 5)
    ]
    loaded = load_arrays(write_bag(tmp_path / "bag", list(reversed(gone))))
    assert np.isnan(loaded.agents.position[30:, 1]).all()
    assert not np.isnan(loaded.agents.position[:30, 1]).any()
    assert (loaded.agents.status[30:, 1] == 0).all()
    assert np.flatnonzero(np.isnan(loaded.angle)).tolist() == [5]
    assert loaded.abstract.agent_count[5] == 0
    assert loaded.time[5] == 0.05


def test_arrays_that_do_not_fit_are_refused_before_anything_is_read(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = 123 * 92 + 41 * (52 + 76 + 100 + 108)
    events = 500 * len(load_arrays(bag).events)
    monkeypatch.setattr(arrays, "available_memory", lambda: int(2.5 * size) + events)
    load_arrays(bag)
    monkeypatch.setattr(arrays, "available_memory", lambda: int(2.5 * size / 3) + 1 + events)
    refusal = r"bag_0\.mcap: its arrays need about 0 MB, .* load_arrays.*stride=3"
    with pytest.raises(BagTooLargeError, match=refusal) as why:
        load_arrays(bag)
    assert isinstance(why.value, InputError)
    load_arrays(bag, stride=3)


@pytest.mark.parametrize(
    ("payload", "problem"),
    [
        (b"\0\1\0\0", "4 bytes, expected 52"),
        (b"\0\0" + bytes(50), "message 42: its encapsulation is not that"),
        (b"\0\1" + bytes(50), "message 42: its frame is not that"),
        (encode(PlaneState(0, 2**63, 0.0, 0.0)), "has a step beyond 2\\^63"),
    ],
)
def test_message_that_is_not_ours_is_named(payload: bytes, problem: str, tmp_path: Path, run: list[Message]) -> None:
    with bag_writer(tmp_path / "bag") as writer:
        write_all(writer, run)
        writer.write(PLANE_STATE, 0, payload)
    with pytest.raises(DamagedBagError, match=f"/plane/state.*{problem}"):
        load_arrays(tmp_path)


def test_bags_without_a_topic_or_without_messages_and_payload_padded_by_dds(tmp_path: Path, run: list[Message]) -> None:
    with BagWriter(tmp_path / "missing", topics=MAIN_TOPICS[1:], attachments={}):
        pass
    with pytest.raises(NotABagError, match=r"not the bag of a swarm: it lacks swarm/agent_state$"):
        load_arrays(tmp_path / "missing")
    with bag_writer(tmp_path / "empty"):
        pass
    loaded = load_arrays(tmp_path / "empty")
    assert loaded.time.shape == loaded.angle.shape == (0,)
    assert loaded.agents.position.shape == (0, 0)
    with BagWriter(tmp_path / "padded", topics=MAIN_TOPICS, attachments={}) as writer:
        for message in run:
            if TOPIC_OF[type(message)] is not EVENTS:
                writer.write(TOPIC_OF[type(message)], message.stamp, encode(message) + b"\0")
    assert load_arrays(tmp_path / "padded").angle.tolist() == column(of(run, PlaneState), "angle")


def test_hostile_steps_take_no_more_memory_than_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrays, "MOST_ABSENT", 1000)
    for robots in (33, 34):
        with BagWriter(tmp_path / str(robots), topics=MAIN_TOPICS, attachments={}) as writer:
            for number in range(1, robots + 1):
                state = AgentState(0, number * 10**15, 0, number, 1, 1, 1.0, 0.0, 0.0, 0.0, 0.0)
                writer.write(TOPIC_OF[AgentState], 0, encode(state))
    assert 33 * 33 <= 1000 + 4 * 33
    assert load_arrays(tmp_path / "33").agents.position.shape == (33, 33)
    with pytest.raises(DamagedBagError, match="34 states of 34 agents over 34 steps: too sparse to load"):
        load_arrays(tmp_path / "34")


# The digest of a run, computed here from the contract's words alone, does not depend on how the bag was written


PADDING = {
    "plane/state": [(22, 28)],
    "swarm/agent_state": [(22, 28), (48, 52)],
    "swarm/abstract_state": [(22, 28), (38, 44)],
    "swarm/auxiliary_state": [(22, 28)],
    "swarm/desired_abstract_state": [(22, 28), (37, 44)],
}
STEP = 28
AGENT_ID = 44


def digest(file: Path) -> str:
    """SHA-256 over (topic, 0x00, uint32 LE length, payload), sorted by (step, topic, agent_id)."""
    records = []
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            topic, data = channel.topic.removeprefix("/"), message.data
            if topic in PADDING:
                (step,) = struct.unpack_from("<Q", data, STEP)
                (agent,) = struct.unpack_from("<H", data, AGENT_ID) if topic == "swarm/agent_state" else (0,)
                record = topic.encode() + b"\0" + struct.pack("<I", len(data)) + data
                records.append((step, topic, agent, record))
    total = hashlib.sha256()
    for _, _, _, record in sorted(records):
        total.update(record)
    return total.hexdigest()


def test_digest_is_of_the_run(tmp_path: Path, bag: Path, run: list[Message], write_bag: Callable[..., Path]) -> None:
    expected = digest(bag / "bag_0.mcap")
    assert digest(write_bag(tmp_path / "order", list(reversed(run)), chunk_bytes=1) / "bag_0.mcap") == expected
    assert digest(write_bag(tmp_path / "less", run[:-1]) / "bag_0.mcap") != expected
    tables = load_messages(open_bag(bag)).tables
    assert digest_of(tables) == expected
    draw = np.random.default_rng(3)
    assert digest_of({topic: draw.permutation(rows) for topic, rows in tables.items()}) == expected
    assert digest_of({**tables, PLANE_STATE: tables[PLANE_STATE][:-1]}) != expected


def test_digest_of_loaded_messages_is_that_of_compare_whatever_the_padding(bag: Path, tmp_path: Path) -> None:
    """ROS leaves padding undefined, and so do the bags of other recorders."""

    def pad(topic: str, data: bytes) -> bytes:
        for begin, end in PADDING.get(topic.removeprefix("/"), []):
            data = data[:begin] + b"\xa5" * (end - begin) + data[end:]
        return data

    padded = rewritten(bag, tmp_path / "padded.mcap", pad)
    found = compare_bags(bag, padded)
    assert found.equal
    assert (
        digest(padded)
        != digest_of(load_messages(open_bag(padded)).tables)
        == found.b.digest
        == digest(bag / "bag_0.mcap")
    )


# Runs of any parent system: lists have lengths that follow from the messages


DESCRIPTION = {
    "name": "ship",
    "parent": [{"name": name, "unit": "rad", "scale": 1.0} for name in ("roll", "roll_rate", "wave")],
    "abstract": [{"name": name, "unit": "N m", "scale": 1.0} for name in ("torque", "inertia")],
    "robot": [{"name": name, "unit": "m", "scale": 1.0} for name in ("x", "y")],
    "constants": [{"name": "mass", "unit": "kg", "default": 1.0}],
    "needs": [{"name": "torque", "unit": "N m", "low": -1.0, "high": 1.0}],
    "tracked": [{"name": "roll", "tolerance": 0.01}],
    "settings": {"beam": 5.0},
}


def system_run(steps: int = 5, **changes: dict[str, object]) -> list[Message]:
    """Return a run of three robots with different numbers everywhere; changes are of the messages of step 3."""
    counter = itertools.count(1)

    def numbers(count: int) -> tuple[float, ...]:
        return tuple(math.sqrt(next(counter)) for _ in range(count))

    run: list[Message] = [SystemDescription(0, 0, 7, json.dumps(DESCRIPTION))]
    for step in range(steps + 1):
        head = (step * 10_000_000, step, 7)
        messages: list[Any] = [
            *(
                RobotState(*head, NEVER, robot, 2, 1, numbers(2), numbers(2), numbers(2), numbers(1))
                for robot in (9, 2, 5)
            ),
            ParentState(*head, numbers(3)),
            SwarmAbstract(*head, 3, numbers(2), numbers(2)),
            SwarmAuxiliary(*head, numbers(3), numbers(2), ()),
            SwarmDesired(*head, 1, *(numbers(2) for _ in range(5))),
        ]
        run += [one._replace(**changes.get(type(one).__name__, {})) if step == 3 else one for one in messages]
    return run


def system_bag(folder: Path, run: list[Message], *, without: tuple[Topic, ...] = ()) -> Path:
    topics = [topic for topic in (*SYSTEM_FAMILY.main, *SYSTEM_FAMILY.once) if topic not in without]
    with BagWriter(folder, topics=topics, attachments={}) as writer:
        for message in run:
            if TOPIC_OF[type(message)] in topics:
                writer.write(TOPIC_OF[type(message)], message.stamp, encode(message))
    return folder


def test_lists_are_the_last_axis_and_quantities_have_names(tmp_path: Path) -> None:
    run = system_run()
    loaded = load_arrays(system_bag(tmp_path / "bag", run))
    assert loaded.description == SystemTables.read(json.dumps(DESCRIPTION))
    assert loaded.time.tolist() == [step / 100 for step in range(6)]
    parts = {SwarmAbstract: loaded.abstract, SwarmAuxiliary: loaded.auxiliary, SwarmDesired: loaded.desired}
    for kind, part in parts.items():
        for name in kind._fields[3:]:
            assert [np.array(value).tolist() for value in getattr(part, name)] == [
                np.array(value).tolist() for value in column(of(run, kind), name)
            ]
    assert loaded.auxiliary.curvature.shape == (6, 0)
    assert loaded.agents.ids.tolist() == [2, 5, 9]
    assert np.isnan(loaded.agents.broadcast_step).all()
    for number, robot in enumerate(loaded.agents.ids):
        states = [state for state in of(run, RobotState) if isinstance(state, RobotState) and state.agent_id == robot]
        for name in ("coordinates", "velocities", "command", "constants"):
            assert getattr(loaded.agents, name)[:, number].tolist() == [list(getattr(one, name)) for one in states]
        assert loaded["y"][:, number].tolist() == [state.coordinates[1] for state in states]
        assert loaded["mass"][:, number].tolist() == [state.constants[0] for state in states]
    states = np.array(column(of(run, ParentState), "state"))
    assert loaded.parent.tolist() == states.tolist()
    assert loaded["roll_rate"].tolist() == states[:, 1].tolist()
    assert loaded["inertia"].tolist() == [value[1] for value in column(of(run, SwarmAbstract), "value")]
    assert loaded.reference.shape == (6, 1)
    assert np.isnan(loaded.reference).all(), "the bag has no scenario"
    with pytest.raises(KeyError, match="no quantity 'rol'"):
        _ = loaded["rol"]
    part = load_arrays(tmp_path / "bag", stride=2)
    assert part["torque"].tolist() == loaded["torque"][::2].tolist()


def test_the_digest_of_a_system_follows_the_same_contract(tmp_path: Path) -> None:
    run = system_run()
    tables = load_messages(open_bag(system_bag(tmp_path, run))).tables
    records = []
    for message in run[1:]:
        topic, payload = TOPIC_OF[type(message)].name, encode(message)
        text = topic.encode() + b"\0" + len(payload).to_bytes(4, "little") + payload
        records.append((message.step, topic, getattr(message, "agent_id", 0), text))
    total = hashlib.sha256(b"".join(text for *_, text in sorted(records)))
    assert digest_of(tables) == total.hexdigest()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"ParentState": {"state": (1.0, 2.0)}}, r"/parent/state at 0.03 s: 68 bytes, expected 76"),
        ({"ParentState": {"state": ()}}, r"/parent/state at 0.03 s: 48 bytes, expected 76"),
        (
            {"RobotState": {"coordinates": (1.0,), "velocities": (1.0, 2.0, 3.0)}},
            r"/swarm/robot_state, message 10: its length of list \d+ is not that of a swarm's message",
        ),
        ({"SwarmDesired": {"system": 8}}, r"/swarm/desired, message 4: its system is not that of a swarm's message"),
    ],
)
def test_lengths_and_system_do_not_change_in_a_run(
    changes: dict[str, dict[str, object]], problem: str, tmp_path: Path
) -> None:
    with pytest.raises(DamagedBagError, match=rf"bag_0\.mcap: {problem}$"):
        load_arrays(system_bag(tmp_path, system_run(**changes)))


def test_bags_of_a_system_without_messages_a_topic_or_a_description(tmp_path: Path) -> None:
    loaded = load_arrays(system_bag(tmp_path / "empty", system_run()[:1]))
    assert (loaded.time.shape, loaded.reference.shape) == ((0,), (0, 1))
    assert (loaded.parent.shape, loaded.agents.coordinates.shape) == ((0, 0), (0, 0, 0))
    with pytest.raises(NotABagError, match=r"it lacks parent/system$"):
        load_arrays(system_bag(tmp_path / "lacks", system_run(), without=(SYSTEM,)))
    for number, text in enumerate(("", "[]", "{}", '{"parent": 5}', "[" * 10**5)):
        run = [SystemDescription(0, 0, 7, text), *system_run()[1:]]
        with pytest.raises(DamagedBagError, match="malformed SystemDescription: its text lacks"):
            load_arrays(system_bag(tmp_path / str(number), run))
    first = encode(ParentState(0, 0, 7, ()))
    with BagWriter(tmp_path / "first", topics=(*SYSTEM_FAMILY.main, SYSTEM), attachments={}) as writer:
        writer.write(PARENT_STATE, 0, first[:-4] + b"\xff" * 4)
    with pytest.raises(DamagedBagError, match="/parent/state at 0 s: malformed ParentState: a list of 4294967295"):
        load_arrays(tmp_path / "first")
