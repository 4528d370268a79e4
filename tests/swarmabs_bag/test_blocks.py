"""Steps in blocks against the same steps message by message, bit for bit."""

from collections.abc import Iterator
from functools import cache
from math import inf, nan
from random import Random
from typing import Any

import pytest
from tests.swarmabs_bag.test_systems import BEAM, LIFT, SHEET
from tests.swarmabs_core.helpers import agent_state, builtin

from swarmabs_bag.recorder.swarm_summary import SummaryTracker
from swarmabs_bag.run import blocks
from swarmabs_bag.run.blocks import Block, gathered_steps
from swarmabs_bag.run.figures import RunFigures, tracking_of
from swarmabs_bag.run.recording import Digest, RecordedStep, Step
from swarmabs_config import configure
from swarmabs_config.scenario import parse_scenario
from swarmabs_core import messages as msg
from swarmabs_core.errors import RunError
from swarmabs_core.record import Record
from swarmabs_run.simulation import Simulation

pytestmark = pytest.mark.usefixtures("systems")

FAULTS = (
    "faults=[{at: 0.05, kind: leave, agent: 1}, {at: 0.08, kind: join, agent: 2}, {at: 0.11, kind: kill, agent: 3},"
    " {kind: loss, probability: 0.1}]"
)


@cache
def run(name: str) -> tuple[Any, list[RecordedStep]]:
    """Return a scenario and its steps: on the plane, with faults, and on other parent systems."""
    systems = {"sheet": SHEET, "beam": BEAM, "lift": LIFT}
    if name in systems:
        scenario = parse_scenario(systems[name]).resolved()
    else:
        scenario = builtin(name, "duration=0.2", *((FAULTS,) if name == "pd_di_4" else ()))
    return scenario, list(Simulation(scenario).steps())


def in_blocks(steps: list[RecordedStep], random: Random) -> list[Step]:
    """Return the steps in blocks of random lengths, single where they do not fit."""
    found: list[Step] = []
    while steps:
        size = random.randint(1, 9)
        while (block := Block.gathered(steps[:size])) is None and size > 1:
            size -= 1
        found.append(block or steps[0])
        steps = steps[size:]
    return found


@pytest.mark.parametrize("name", ["pd_di_4", "pd_het_4", "arise_het_20", "sheet", "beam", "lift"])
def test_blocks_give_what_their_steps_give(name: str) -> None:
    scenario, steps = run(name)
    parts = in_blocks(steps, Random(7))
    assert any(isinstance(part, Block) and len(part) > 2 for part in parts)
    assert b"".join(part.digest_text() for part in parts) == b"".join(step.digest_text() for step in steps)
    assert [stored for part in parts for stored in part.stored()] == [s for step in steps for s in step.stored()]
    assert [step for part in parts for step in (part.recorded() if isinstance(part, Block) else [part])] == steps
    length = scenario.plane.length if scenario.family is msg.PLANE_FAMILY else None
    results = []
    for each in (steps, parts):
        figures = RunFigures(configure.reference(scenario), tracking_of(scenario))
        tracker, digest = SummaryTracker(configure.members(scenario), length), Digest()
        told = {}
        for step in each:
            figures.add(step)
            tracker.take(step)
            digest.update(step)
            told[step.step] = (figures.latest, figures.figures(), tracker.summary(), tracker.events())
        results.append((figures.summary(), digest.hexdigest(), told))
    assert results[0][:2] == results[1][:2]
    assert results[1][2].items() <= results[0][2].items(), "what is told after a step"


@pytest.mark.parametrize("name", ["pd_di_4", "arise_het_20", "sheet"])
def test_steps_are_gathered_as_far_as_they_fit_and_those_before_an_error_come(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, steps = run(name)
    monkeypatch.setattr(blocks, "BLOCK_SECONDS", 60.0)
    found = list(gathered_steps(steps))
    assert [step for part in found for step in (part.recorded() if isinstance(part, Block) else [part])] == steps
    divided = sum(any(record.topic is msg.STANDING for record in step.records) for step in steps)  # always single
    assert len(found) - divided < (len(steps) - divided) / 2
    most = 4 * sum(len(record.payload) for record in steps[1].records)
    with monkeypatch.context() as small:
        small.setattr(blocks, "BLOCK_BYTES", most)
        for part in gathered_steps(steps):
            earlier = part[:-1] if isinstance(part, Block) and len(part) > 1 else None
            assert earlier is None or sum(len(payload) for *_, payload in earlier.stored()) < most
    monkeypatch.setattr(blocks, "BLOCK_SECONDS", 0.0)
    assert [part.step for part in gathered_steps(steps)] == [step.step for step in steps], "none is held back"

    def failing() -> Iterator[RecordedStep]:
        yield from steps[:10]
        raise RunError("over")

    monkeypatch.setattr(blocks, "BLOCK_SECONDS", 60.0)
    parts = gathered_steps(failing())
    while next(parts).step < 9:
        pass
    with pytest.raises(RunError, match="over"):
        next(parts)


def test_a_block_is_its_last_step_and_can_be_cut() -> None:
    _, steps = run("arise_het_20")
    block = Block.gathered(steps)
    assert block is not None
    assert (len(block), block.robots, block.first, block.step, block.messages) == (21, 20, 0, 20, 21 * 24)
    for part in (block, block[3:7], block[20:]):
        last = steps[part.step]
        assert (part.parent, list(part.states()), part.events) == (last.parent, list(last.states()), ())
    assert list(block[3:7].recorded()) == steps[3:7]
    assert block[3:7].digest_text() == b"".join(step.digest_text() for step in steps[3:7])
    assert block[3:7].times.tolist() == [30_000_000, 40_000_000, 50_000_000, 60_000_000]


def joined(steps: list[RecordedStep]) -> dict[msg.Topic, bytearray]:
    found: dict[msg.Topic, bytearray] = {}
    for record in (record for step in steps for record in step.records):
        found.setdefault(record.topic, bytearray()).extend(record.payload)
    return found


def test_the_largest_of_numbers_that_are_none_is_that_of_their_messages() -> None:
    coordinators = run("pd_si_4")[1][0].records[-4:]
    places = [(nan, 1.0), (1.0, nan), (-2.0, 1.0), (nan, nan), (inf, -inf), (-0.0, 0.0)]
    for place in places:
        robots = [Record.of(agent_state(i, position=x)) for i, x in enumerate(place, start=1)]
        step = RecordedStep(0, (*robots, *coordinators))
        block = Block.gathered([step])
        assert block is not None
        assert repr(block.max_abs_positions) == repr(step.max_abs_positions)


@pytest.mark.parametrize("name", ["pd_het_4", "beam"])
def test_what_is_not_canonical_is_no_block(name: str) -> None:
    payloads = joined(run(name)[1][1:5])
    block = Block.of(payloads)
    assert block is not None
    assert Block.of({topic: memoryview(data) for topic, data in payloads.items()}) is not None
    for topic, table in block.tables.items():
        size, fixed = table.itemsize, {"encapsulation", "frame", "step"}
        for field, (kind, offset, *_) in table.dtype.fields.items():
            if field in fixed or field.startswith(("padding", "length")):
                for place in (*range(offset, offset + kind.itemsize), *range(-size + offset, -size + offset + 1)):
                    changed = bytearray(payloads[topic])
                    changed[place] ^= 1
                    assert Block.of({**payloads, topic: changed}) is None, (topic.name, field, place)
        for left in (0, 1, size - 1, size, 3 * size + 1):
            assert Block.of({**payloads, topic: payloads[topic][:left]}) is None


def test_what_does_not_go_on_is_no_block() -> None:
    steps = run("pd_het_4")[1]
    one, *more = steps[5].records
    assert Block.gathered([]) is None
    assert Block.gathered(steps[4:7]) is not None
    for wrong in (
        [steps[4], steps[6]],
        [steps[6], steps[5]],
        [steps[5], steps[5]],
        [steps[4], RecordedStep(5, tuple(more))],
        [RecordedStep(5, (more[0], one, *more[1:]))],
        [RecordedStep(5, (one, one, *more))],
        [RecordedStep(5, (one, *more[:-1]))],
        [RecordedStep(5, (one, *more[:-1], more[-1]._replace(payload=b"")))],
        [RecordedStep(5, (one._replace(payload=one.payload + bytes(4)), *more))],
        [RecordedStep(5, more[-4:])],
    ):
        assert Block.gathered(wrong) is None
    events = [step for step in run("pd_di_4")[1] if step.events]
    assert len(events) > 3 and not any(Block.gathered([step]) for step in events)
    system = run("sheet")[1]
    assert Block.gathered(system[:1]) is None, "with the description of the system"
    assert Block.gathered(system[1:2]) is not None
    assert Block.gathered([steps[0], system[1]]) is None


@pytest.mark.parametrize("stamp", [-1, 10**9, 2 * 10**9 - 1])
def test_times_of_the_parent_are_those_of_all_messages(stamp: int) -> None:
    step = run("pd_si_4")[1][0]
    records = [
        Record.of(record.message._replace(stamp=stamp)) if record.topic is msg.PLANE_STATE else record
        for record in step.records
    ]
    block = Block.gathered([RecordedStep(0, tuple(records))])
    assert (block is None) == (stamp < 0)
    assert block is None or list(block.stored()) == list(RecordedStep(0, tuple(records)).stored())
    seconds = bytearray(records[-4].payload)
    seconds[8:12] = (10**9).to_bytes(4, "little")
    assert Block.of({**joined([step]), msg.PLANE_STATE: seconds}) is None, "a second in the nanoseconds"
