"""Steps as arrays against their messages one by one, bit for bit."""

from functools import cache
from hashlib import sha256
from math import inf, nan
from random import Random
from typing import Any

import pytest
from tests.swarmabs_bag.test_systems import BEAM, LIFT, SHEET
from tests.swarmabs_core.helpers import agent_state, builtin, singly, together

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.recorder.swarm_summary import SummaryTracker
from swarmabs_bag.run.digest import Digest
from swarmabs_bag.run.figures import RunFigures, tracking_of
from swarmabs_bag.run.gatherer import RunCollector
from swarmabs_bag.run.ordering import recorded_steps
from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.scenario import parse_scenario
from swarmabs_core import messages as msg
from swarmabs_core.cdr import encode
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.record import Record
from swarmabs_run.simulation import Network, Simulation, nodes_in_process

pytestmark = pytest.mark.usefixtures("systems")

FAULTS = (
    "faults=[{at: 0.05, kind: leave, agent: 1}, {at: 0.08, kind: join, agent: 2}, {at: 0.11, kind: kill, agent: 3},"
    " {kind: loss, probability: 0.1}]"
)


@cache
def run(name: str) -> tuple[Any, list[Step]]:
    """Return a scenario and its steps: on the plane, with faults, and on other parent systems."""
    systems = {"sheet": SHEET, "beam": BEAM, "lift": LIFT}
    if name in systems:
        scenario = parse_scenario(systems[name]).resolved()
    else:
        scenario = builtin(name, "duration=0.2", *((FAULTS,) if name == "pd_di_4" else ()))
    return scenario, singly(Simulation(scenario).steps())


def at_random(steps: list[Step], random: Random) -> list[Step]:
    """Return steps with up to nine in one."""
    return list(together(steps, (random.randint(1, 9) for _ in steps)))


@cache
def sent(name: str) -> list[msg.Message]:
    """Return all messages of a run in the order in which a bag holds them, sorted without any step."""
    family = run(name)[0].family
    topics = [*family.once, *family.main[:-1], msg.STANDING, family.desired, msg.EVENTS]
    network = Network(nodes_in_process(run(name)[0]).values())
    network.start()

    def place(message: msg.Message) -> tuple[object, ...]:
        event = encode(message) if isinstance(message, msg.SwarmEvent) else b""
        return message.step, topics.index(msg.TOPIC_OF[type(message)]), event, getattr(message, "agent_id", 0)

    recorded = {place(message): message for message in network.deliver() if msg.TOPIC_OF[type(message)] in topics}
    return [recorded[where] for where in sorted(recorded)]


@pytest.mark.parametrize("name", ["pd_di_4", "pd_het_4", "arise_het_20", "sheet", "beam", "lift"])
def test_steps_hold_the_messages_of_a_run_however_many_are_in_one(name: str) -> None:
    scenario, steps = run(name)
    messages, step_ns = sent(name), scenario.step_ns
    expected = [(msg.TOPIC_OF[type(message)], message.step * step_ns, encode(message)) for message in messages]
    parts = at_random(steps, Random(7))
    assert any(len(part) > 2 for part in parts)
    for some in (steps, parts):
        assert [stored for step in some for stored in step.stored()] == expected
        assert sum(step.messages for step in some) == len(expected)
    assert singly(parts) == steps
    assert [record.message for step in parts for record in step.records] == messages
    main = [found for found in expected if found[0] in scenario.family.main]
    digest = sha256()
    for topic, _, payload in sorted(main, key=lambda found: (found[1], found[0].name)):  # robots are in order
        digest.update(topic.name.encode() + b"\0" + len(payload).to_bytes(4, "little") + payload)
    assert sha256(b"".join(part.digest_text() for part in parts)).hexdigest() == digest.hexdigest()


@pytest.mark.parametrize("name", ["pd_di_4", "arise_het_20", "sheet", "beam", "lift"])
def test_figures_and_summaries_do_not_depend_on_how_many_steps_are_in_one(name: str) -> None:
    scenario, steps = run(name)
    length = scenario.plane.length if scenario.family is msg.PLANE_FAMILY else None
    results = []
    for some in (steps, at_random(steps, Random(7))):
        figures = RunFigures(configure.reference(scenario), tracking_of(scenario))
        tracker, digest = SummaryTracker(configure.members(scenario), length), Digest()
        told = {}
        for step in some:
            figures.add(step)
            tracker.take(step)
            digest.update(step)
            told[step.step] = (figures.latest, figures.figures(), tracker.summary(), tracker.events())
        results.append((figures.summary(), digest.hexdigest(), told))
    assert results[0][:2] == results[1][:2]
    assert results[1][2].items() <= results[0][2].items(), "what is told after a step"


def test_steps_are_their_last_one_and_can_be_cut() -> None:
    _, steps = run("arise_het_20")
    (whole,) = together(steps, [len(steps)])
    assert (len(whole), len(whole.robots), whole.first, whole.step, whole.messages) == (21, 20, 0, 20, 21 * 24)
    for part in (whole, whole[3:7], whole[20:]):
        last = [message for message in sent("arise_het_20") if message.step == part.step]
        assert part.parent == next(message for message in last if isinstance(message, msg.PlaneState))
        assert list(part.states()) == [message for message in last if isinstance(message, msg.AgentState)]
    assert singly([whole[3:7]]) == steps[3:7]
    assert whole[3:7].times.tolist() == [30_000_000, 40_000_000, 50_000_000, 60_000_000]


def test_events_are_those_of_the_last_step() -> None:
    steps = run("pd_het_4")[1]
    event = msg.SwarmEvent(50_000_000, 5, 2, msg.EventKind.LIMIT_HIT, 1.5, "velocity")
    told = Step(5, steps[5].tables, (encode(event),))
    joined = steps[4].joined(told)
    assert (joined.events, joined[:1].events, joined[1:].events) == ((event,), (), (event,))
    assert list(joined.stored()) == [*steps[4].stored(), *steps[5].stored(), (msg.EVENTS, 50_000_000, encode(event))]
    late = Step(3, {}, told.told, 30_000_000)
    assert (len(late), late.step, late.parent, late.parents, list(late.states())) == (1, 3, None, (), [])
    assert [time for _, time, _ in late.stored()] == [30_000_000] * len(late.told)
    assert not late.digest_text()


def joined(steps: list[Step]) -> dict[msg.Topic, bytearray]:
    found: dict[msg.Topic, bytearray] = {}
    for topic, _, payload in (stored for step in steps for stored in step.stored()):
        found.setdefault(topic, bytearray()).extend(payload)
    return found


def test_the_largest_position_is_not_known_if_one_is_no_number() -> None:
    coordinators = run("pd_si_4")[1][0].records[-4:]
    largest = {(nan, 1.0): nan, (1.0, nan): nan, (-2.0, 1.0): 2.0, (nan, nan): nan, (inf, -inf): inf, (-0.0, 0.0): 0.0}
    for place, expected in largest.items():
        robots = [Record.of(agent_state(i, position=x)) for i, x in enumerate(place, start=1)]
        assert repr(Step.of(0, (*robots, *coordinators)).max_abs_positions) == repr((expected,))


def test_a_step_has_robots_in_order_whose_lists_are_equally_long() -> None:
    records = run("sheet")[1][1].records
    assert Step.of(1, reversed(records)).records == records
    robot: Any = records[1].message
    longer = Record.of(robot._replace(coordinates=(*robot.coordinates, 0.0)))
    with pytest.raises(MalformedMessageError, match="lists of different lengths in one step"):
        Step.of(1, (records[0], longer, *records[2:]))
    with pytest.raises(DamagedBagError, match=r"^bag: step 1: .*lists of different lengths in one step"):
        list(recorded_steps((records[0], longer, *records[2:]), "bag"))
    scenario = run("sheet")[0]
    family = scenario.family
    collector = RunCollector(configure.members(scenario), (), scenario.steps, family=family)
    assert not collector.add(records[0])
    with pytest.raises(MalformedMessageError, match="lists of other lengths than in the messages before it"):
        list(collector.add_all(family.robot, [longer.payload]))
    assert not collector.add(records[1]), "a rejected message changes nothing"
    assert collector.missing_agents() == tuple(configure.members(scenario))


@pytest.mark.parametrize("name", ["pd_het_4", "beam"])
def test_what_is_not_canonical_is_no_whole_step(name: str) -> None:
    payloads = joined(run(name)[1][1:5])
    steps = Step.whole(payloads)
    assert steps is not None
    assert Step.whole({topic: memoryview(data) for topic, data in payloads.items()}) is not None
    for topic, table in steps.tables.items():
        size, fixed = table.itemsize, {"encapsulation", "frame", "step"}
        for field, (kind, offset, *_) in table.dtype.fields.items():
            if field in fixed or field.startswith(("padding", "length")):
                for place in (*range(offset, offset + kind.itemsize), *range(-size + offset, -size + offset + 1)):
                    changed = bytearray(payloads[topic])
                    changed[place] ^= 1
                    assert Step.whole({**payloads, topic: changed}) is None, (topic.name, field, place)
        for left in (0, 1, size - 1, size, 3 * size + 1):
            assert Step.whole({**payloads, topic: payloads[topic][:left]}) is None


def test_what_does_not_go_on_are_no_whole_steps() -> None:
    steps = run("pd_het_4")[1]
    robots = msg.AGENT_STATE
    assert Step.whole(joined(steps[4:7])) is not None
    for wrong in ([steps[4], steps[6]], [steps[6], steps[5]], [steps[5], steps[5]]):
        assert Step.whole(joined(wrong)) is None
    one, size = joined(steps[5:6]), steps[5].tables[robots].itemsize
    states = [bytes(one[robots][place * size :][:size]) for place in range(4)]
    for wrong_states in ((1, 0, 2, 3), (0, 0, 1, 2, 3)):
        assert Step.whole({**one, robots: b"".join(states[place] for place in wrong_states)}) is None
    assert Step.whole({**joined(steps[4:6]), robots: joined(steps[4:5])[robots] + b"".join(states[1:])}) is None


@pytest.mark.parametrize("stamp", [-1, 10**9, 2 * 10**9 - 1])
def test_times_of_the_parent_are_those_of_all_messages(stamp: int) -> None:
    step = run("pd_si_4")[1][0]
    records = [
        Record.of(record.message._replace(stamp=stamp)) if record.topic is msg.PLANE_STATE else record
        for record in step.records
    ]
    payloads = joined([Step.of(0, records)])
    assert (Step.whole(payloads) is None) == (stamp < 0)
    assert {time for _, time, _ in Step.of(0, records).stored()} == {stamp}
    seconds = bytearray(records[-4].payload)
    seconds[8:12] = (10**9).to_bytes(4, "little")
    assert Step.whole({**joined([step]), msg.PLANE_STATE: seconds}) is None, "a second in the nanoseconds"
