"""Collection in batches against collection message by message, bit for bit, whatever arrives in whatever order."""

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import pytest
from hypothesis import given, settings, strategies as st
from tests.swarmabs_bag.test_recorder import parameters
from tests.swarmabs_bag.test_step import FAULTS
from tests.swarmabs_bag.test_systems import BEAM, LIFT, SHEET
from tests.swarmabs_core.helpers import agent_state, builtin, singly
from tests.swarmabs_ros.nodes import settings_from

from swarmabs_bag.recorder import node
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.run.gatherer import RunCollector
from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.graph import KEPT_STEPS
from swarmabs_config.scenario import parse_scenario
from swarmabs_core import messages as msg
from swarmabs_core.cdr import encode, places
from swarmabs_core.errors import MalformedMessageError, ProtocolError
from swarmabs_core.record import Record
from swarmabs_ros.status import StatusChannel
from swarmabs_run.simulation import Simulation

pytestmark = pytest.mark.usefixtures("systems")

NAMES = ("pd_di_4", "pd_het_4", "dropping", "sheet", "beam", "lift")


@cache
def run(name: str) -> tuple[Any, list[Step]]:
    systems = {"sheet": SHEET, "beam": BEAM, "lift": LIFT}
    if name in systems:
        scenario = parse_scenario(systems[name]).resolved()
    else:
        changes = {"pd_di_4": (FAULTS,), "dropping": ("lockstep={on_stall: drop}",)}
        known = "pd_het_4" if name == "dropping" else name
        scenario = builtin(known, "duration=0.2", *changes.get(name, ())).resolved()
    return scenario, singly(Simulation(scenario).steps())


def collector(scenario: Any, memory: int) -> RunCollector:
    family = scenario.family
    system = None if family is msg.PLANE_FAMILY else scenario.named.hash
    schedule = configure.schedule(scenario)
    return RunCollector(
        configure.members(scenario),
        schedule,
        scenario.steps,
        memory=memory,
        division=configure.division(scenario),
        family=family,
        system=system,
    )


class Arrived(NamedTuple):
    """Bytes on a topic, and the messages that they contain."""

    topic: msg.Topic
    data: bytes
    payloads: tuple[tuple[msg.Topic, bytes], ...]


def single(topic: msg.Topic, data: bytes) -> Arrived:
    return Arrived(topic, data, ((topic, data),))


def relayed(step: Step, robot: msg.Topic) -> Arrived:
    """Return the states of a step as the observer sends them in packed runs."""
    states = [record.payload for record in step.records if record.topic is robot]
    data = encode(msg.SwarmStates(0, step.step, b"".join(states)))
    return Arrived(msg.SWARM_STATES, data, tuple((robot, payload) for payload in states))


@cache
def padding(topic: msg.Topic) -> list[slice]:
    """Return where the padding is in a message without lists."""
    found, offset = [], 0
    for place in places(topic.message):
        offset += place.size
        if not place.name:
            found.append(slice(offset - place.size, offset))
    return found


def noisy(record: Record, random: Random, *, longer: bool) -> bytes:
    """Return the bytes of a message with any padding, and sometimes more bytes at the end."""
    data = bytearray(record.payload)
    for place in padding(record.topic) if record.topic not in (*msg.SYSTEM_FAMILY.main, msg.STANDING) else ():
        data[place] = random.randbytes(place.stop - place.start)
    return bytes(data) + random.randbytes(random.choice((0, 0, 0, 3)) if longer else 0)


def arriving(scenario: Any, steps: list[Step], random: Random) -> list[list[Arrived]]:
    """Return all messages in batches, late and early, with repeats, in the order in which the recorder takes them."""
    family, spread, packed = scenario.family, random.choice((0.5, 3.0, 20.0)), random.random() < 0.3
    noise, longer = random.choice((0.0, 0.1, 1.0)), random.random() < 0.3
    found: list[tuple[float, Arrived]] = []
    for step in steps:
        for _ in range(random.choice((1, 1, 1, 2, 3))):
            sent = [relayed(step, family.robot)] if packed else []
            for record in step.records:
                if not (packed and record.topic is family.robot):
                    noised = random.random() < noise
                    data = noisy(record, random, longer=longer) if noised else record.payload
                    sent.append(single(record.topic, data))
            found += [(step.step + spread * random.random(), each) for each in sent]
    found.sort(key=lambda timed: timed[0])
    order = (msg.EVENTS, msg.SWARM_STATES, *family.main, *family.once, msg.STANDING)
    batches: list[list[Arrived]] = []
    while found:
        size = random.choice((1, 5, 50, 500))
        batches.append(sorted((each for _, each in found[:size]), key=lambda each: order.index(each.topic)))
        del found[:size]
    return batches


def spoil(scenario: Any, steps: list[Step], random: Random) -> Arrived:
    """Return a message that no collector accepts."""
    family = scenario.family
    records = [record for record in random.choice(steps).records if record.topic in family.main]
    record = random.choice(records)
    message, payload = record.message, record.payload
    parent = next(each.message for each in records if each.topic is family.parent)
    robot = next(each.message for each in records if each.topic is family.robot)
    spoilt: list[bytes | msg.Message] = [
        payload[:-8],
        payload[:8] + (10**9).to_bytes(4, "little") + payload[12:],
        b"\x00\x00" + payload[2:],
        payload.replace(b"plane", b"world"),
        payload[:-1] + bytes([payload[-1] ^ 1]),
        message._replace(stamp=message.stamp + 1),
        parent._replace(stamp=-1),
        robot._replace(agent_id=9),
    ]
    if family is msg.SYSTEM_FAMILY:
        spoilt.append(parent._replace(system=1))
    found = random.choice(spoilt)
    if isinstance(found, bytes):
        return single(record.topic, found)
    return single(msg.TOPIC_OF[type(found)], encode(found))


def outcome(steps: Iterable[Step]) -> tuple[list[Step], str]:
    """Return the steps one by one until there is an error, and the error."""
    found: list[Step] = []
    try:
        for step in steps:
            found += step.singly()
    except (ProtocolError, MalformedMessageError) as error:
        return found, f"{type(error).__name__}: {error}"
    return found, ""


def one_by_one(book: RunCollector, batches: list[list[Arrived]]) -> Iterator[Step]:
    for batch in batches:
        for each in batch:
            for topic, payload in each.payloads:
                yield from book.add(Record.heard(topic, payload))


def all_at_once(book: RunCollector, batches: list[list[Arrived]]) -> Iterator[Step]:
    for batch in batches:
        for topic in dict.fromkeys(each.topic for each in batch):
            yield from book.add_all(topic, [each.data for each in batch if each.topic is topic])


@pytest.mark.parametrize("spoilt", [False, True])
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32), memory=st.sampled_from((2, 30, 250)))
def test_batches_give_the_steps_and_the_errors_of_their_messages(
    name: str, *, spoilt: bool, seed: int, memory: int
) -> None:
    scenario, steps = run(name)
    random = Random(seed)
    batches = arriving(scenario, steps, random)
    if spoilt:
        batches.insert(random.randint(0, len(batches)), [spoil(scenario, steps, random)])
    expected, found = collector(scenario, memory), collector(scenario, memory)
    some = batches[: random.randint(0, len(batches))]
    for part in (some, batches[len(some) :]):
        (wanted, error), (got, told) = outcome(one_by_one(expected, part)), outcome(all_at_once(found, part))
        assert told == error
        if error:  # a batch may hold further steps that are complete
            assert got[: len(wanted)] == wanted
            return
        assert got == wanted
        assert (found.step, found.missing(), found.newest) == (expected.step, expected.missing(), expected.newest)
    assert spoilt or expected.finished


def test_steps_of_the_same_robots_come_together_up_to_one_with_events() -> None:
    faults = "faults=[{at: 0.08, kind: join, agent: 2}, {at: 0.11, kind: kill, agent: 3}]"
    scenario = builtin("pd_di_4", "duration=2.3", faults).resolved()
    steps = singly(Simulation(scenario).steps())
    book, found = collector(scenario, 250), list[Step]()
    for part in (steps[:212], steps[212:]):
        by_topic: dict[msg.Topic, list[bytes]] = {}
        for topic, _, payload in (stored for step in part for stored in step.stored()):
            by_topic.setdefault(topic, []).append(payload)
        for topic in (msg.EVENTS, *msg.MAIN_TOPICS, msg.STANDING):
            found += book.add_all(topic, by_topic.get(topic, []))
    # The first 212 steps have arrived together. From those of step 12 on, 128 are held as arrays; for 2 s from the last
    # change on, the abstract state is divided.
    assert [(steps.step, steps.events != ()) for steps in found] == [
        *((7, False), (8, True), (11, False), (12, True), (140, False), (211, False)),
        (230, False),
    ]
    assert outcome(found)[0] == steps


def test_messages_of_far_ahead_are_kept() -> None:
    scenario = builtin("pd_si_4", f"duration={2 * KEPT_STEPS / 100}").resolved()
    steps = singly(Simulation(scenario).steps())
    book = collector(scenario, 250)
    for step in reversed(steps):
        for topic, _, payload in step.stored():
            last = outcome(book.add_all(topic, [payload]))
    assert last == (steps, "")


def test_a_robot_that_is_out_is_neither_recorded_nor_compared() -> None:
    scenario, _ = run("pd_di_4")
    book = collector(scenario, 250)
    early = [encode(agent_state(2, 0, position=position)) for position in (0.1, 0.2)]  # it joins later
    assert outcome(book.add_all(msg.AGENT_STATE, early)) == ([], "")
    assert 2 not in book.missing_agents()


@pytest.mark.parametrize("batch", [1, 3, 100])
@pytest.mark.parametrize("name", ["pd_di_4", "sheet"])
def test_the_bag_is_the_same_byte_for_byte_however_messages_arrive(
    name: str, batch: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(StatusChannel, "send", lambda *_, **__: None)
    scenario, steps = run(name)
    plain = Recording(scenario, tmp_path / "plain", driver="lockstep")
    for step in steps:
        plain.add(step)
    plain.close({"run.log": node.log_text(parameters(scenario, tmp_path)["logs"])})
    spec = node.make(settings_from(node.PARAMETERS, **given_folders(tmp_path)), StatusChannel("recorder"))
    hear_all: Callable[[msg.Topic, list[bytes]], object] | None = spec.hear_all
    assert hear_all is not None
    topics = (msg.EVENTS, *scenario.family.main, *scenario.family.once, msg.STANDING)
    for first in range(0, len(steps), batch):
        stored = [each for step in steps[first : first + batch] for each in step.stored()]
        for topic in topics:
            if payloads := [payload for found, _, payload in stored if found is topic]:
                hear_all(topic, payloads)
    spec.on_exit(None)
    assert (tmp_path / "bag" / "bag_0.mcap").read_bytes() == (tmp_path / "plain" / "bag_0.mcap").read_bytes()


def given_folders(folder: Path) -> dict[str, str]:
    return {
        "scenario_file": str(folder / "scenario.yaml"),
        "bag": str(folder / "bag"),
        "logs": str(folder / "logs"),
    }
