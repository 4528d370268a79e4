"""Arrays hold what was recorded, at the right places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from swarmabs_bag import arrays
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.errors import BagTooLargeError, DamagedBagError, NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.writer import BagWriter
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError
from swarmabs_core.messages import (
    EVENTS,
    MAIN_TOPICS,
    PLANE_STATE,
    TOPIC_OF,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    Message,
    PlaneState,
)


def of(run: list[Message], kind: type[Message]) -> list[Message]:
    return [message for message in run if type(message) is kind]


def column(messages: Sequence[Message], name: str) -> list[float]:
    return [getattr(message, name) for message in messages]


def test_every_value_is_at_its_step(bag: Path, run: list[Message]) -> None:
    loaded = load_arrays(bag)
    assert loaded.step.tolist() == list(range(41))
    assert loaded.time.tolist() == [step / 100 for step in range(41)]
    plane = of(run, PlaneState)
    assert loaded.angle.tolist() == column(plane, "angle")
    assert loaded.angular_velocity.tolist() == column(plane, "angular_velocity")
    for kind, part in (
        (AbstractState, loaded.abstract),
        (AuxiliaryState, loaded.auxiliary),
        (DesiredAbstractState, loaded.desired),
    ):
        for name in kind._fields[2:]:
            assert getattr(part, name).tolist() == column(of(run, kind), name), name


def test_agents_are_columns_in_order_of_their_ids(bag: Path, run: list[Message]) -> None:
    agents = load_arrays(bag).agents
    assert agents.ids.tolist() == [1, 2, 7]
    for number, agent in enumerate(agents.ids):
        states = [state for state in of(run, AgentState) if isinstance(state, AgentState) and state.agent_id == agent]
        for name in ("kind", "status", "mass", "damping", "position", "velocity", "command"):
            assert getattr(agents, name)[:, number].tolist() == column(states, name), name


def test_what_was_not_recorded_is_nan(tmp_path: Path, run: list[Message], write_bag: Callable[..., Path]) -> None:
    gone = [
        message
        for message in run
        if not (isinstance(message, AgentState) and message.agent_id == 2 and message.step >= 30)
        and not (isinstance(message, (PlaneState, AbstractState)) and message.step == 5)
    ]
    loaded = load_arrays(write_bag(tmp_path / "bag", gone))
    assert np.isnan(loaded.agents.position[30:, 1]).all()
    assert not np.isnan(loaded.agents.position[:30, 1]).any()
    assert (loaded.agents.status[30:, 1] == 0).all()
    assert np.flatnonzero(np.isnan(loaded.angle)).tolist() == [5]
    assert loaded.abstract.agent_count[5] == 0
    assert loaded.time[5] == 0.05


def test_order_of_the_messages_does_not_matter(
    tmp_path: Path, bag: Path, run: list[Message], write_bag: Callable[..., Path]
) -> None:
    one, other = load_arrays(bag), load_arrays(write_bag(tmp_path / "bag", list(reversed(run))))
    assert one.agents.command.tolist() == other.agents.command.tolist()
    assert one.time.tolist() == other.time.tolist()


def test_part_of_the_steps_is_that_of_all_steps(bag: Path) -> None:
    whole, part = load_arrays(bag), load_arrays(bag, every=7)
    assert part.step.tolist() == list(range(0, 41, 7))
    assert part.angle.tolist() == whole.angle[::7].tolist()
    assert part.agents.command.tolist() == whole.agents.command[::7].tolist()
    assert part.desired.torque.tolist() == whole.desired.torque[::7].tolist()


def test_arrays_that_do_not_fit_are_refused_before_anything_is_read(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = 123 * 92 + 41 * (52 + 76 + 100 + 108)
    monkeypatch.setattr(arrays, "available_memory", lambda: int(2.5 * size))
    load_arrays(bag)
    monkeypatch.setattr(arrays, "available_memory", lambda: int(2.5 * size / 3) + 1)
    with pytest.raises(
        BagTooLargeError, match=r"bag_0\.mcap: its arrays take about 0 MB, .* load_arrays.*every=3"
    ) as why:
        load_arrays(bag)
    assert isinstance(why.value, InputError)
    load_arrays(bag, every=3)


def test_payload_padded_by_dds_is_read(tmp_path: Path, run: list[Message]) -> None:
    with BagWriter(tmp_path / "bag", topics=MAIN_TOPICS, attachments={}) as writer:
        for message in run:
            if TOPIC_OF[type(message)] is not EVENTS:
                writer.write(TOPIC_OF[type(message)], message.stamp, encode(message) + b"\0")
    assert load_arrays(tmp_path).angle.tolist() == column(of(run, PlaneState), "angle")


@pytest.mark.parametrize(
    ("payload", "problem"),
    [
        (b"\0\1\0\0", "4 bytes, expected 52"),
        (b"\0\0" + bytes(50), "message 42: its encapsulation is not that"),
        (b"\0\1" + bytes(50), "message 42: its frame is not that"),
        (encode(PlaneState(0, 2**63, 0.0, 0.0)), "has a step beyond 2\\^63"),
    ],
)
def test_message_that_is_none_of_ours_is_named(
    payload: bytes, problem: str, tmp_path: Path, run: list[Message]
) -> None:
    with BagWriter(tmp_path / "bag", topics=(*MAIN_TOPICS, EVENTS), attachments={}) as writer:
        for message in run:
            writer.write(TOPIC_OF[type(message)], message.stamp, encode(message))
        writer.write(PLANE_STATE, 0, payload)
    with pytest.raises(DamagedBagError, match=f"/plane/state.*{problem}"):
        load_arrays(tmp_path)


def test_missing_topic_is_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", topics=MAIN_TOPICS[1:], attachments={}):
        pass
    with pytest.raises(NotABagError, match=r"no bag of a swarm: it has no topic swarm/agent_state$"):
        load_arrays(tmp_path)


def test_bag_without_messages_has_no_rows(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", topics=MAIN_TOPICS, attachments={}):
        pass
    loaded = load_arrays(tmp_path)
    assert loaded.time.shape == loaded.angle.shape == (0,)
    assert loaded.agents.position.shape == (0, 0)


def test_bag_that_was_cut_off_is_loaded_on_request(tmp_path: Path, bag: Path) -> None:
    third = open_bag(bag).index.chunks[2].chunk_start_offset
    (tmp_path / "cut.mcap").write_bytes((bag / "bag_0.mcap").read_bytes()[: third + 100])
    with pytest.raises(DamagedBagError):
        load_arrays(tmp_path)
    loaded = load_arrays(tmp_path, damaged=True)
    assert 0 < len(loaded.time) < 41
    assert loaded.angle[0] == load_arrays(bag).angle[0]


def test_hostile_steps_cannot_ask_for_more_memory_than_their_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrays, "_SPARSE", 1000)
    with BagWriter(tmp_path / "bag", topics=MAIN_TOPICS, attachments={}) as writer:
        for number in range(1, 100):
            state = AgentState(0, number * 10**15, 0, number, 1, 1, 1.0, 0.0, 0.0, 0.0, 0.0)
            writer.write(TOPIC_OF[AgentState], 0, encode(state))
    with pytest.raises(DamagedBagError, match="99 states of 99 agents over 99 steps: too sparse to load"):
        load_arrays(tmp_path)
