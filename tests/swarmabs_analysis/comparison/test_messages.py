"""Two runs message by message: what is found is what was changed, by a brute-force count."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable, Iterable, Iterator

import numpy as np
import pytest
from tests.swarmabs_bag.sample_run import AGENTS, changed, make_run, make_step

from swarmabs_analysis.comparison import compare_steps, recorded_steps
from swarmabs_analysis.comparison.messages import FieldDeviation, MessageComparison, TopicComparison
from swarmabs_analysis.difference import Difference
from swarmabs_bag.errors import DamagedBagError
from swarmabs_core.messages import AgentState, EventKind, Message, PlaneState, SwarmEvent
from swarmabs_core.record import Record


def of_bag(run: Iterable[Message]) -> Iterator[Record]:
    """Return what `BagReader.records` yields of a bag of the run."""
    return map(Record.of, run)


def compare(a: Iterable[Message], b: Iterable[Message]) -> MessageComparison:
    return compare_steps(recorded_steps(of_bag(a), "A"), recorded_steps(of_bag(b), "B"))


def shown(found: MessageComparison) -> str:
    assert found.first is not None
    return found.first.side_by_side()


def topic(found: MessageComparison, name: str) -> TopicComparison:
    return next(one for one in found.topics if one.topic == name)


def agent_state(run: Iterable[Message], step: int, agent: int) -> AgentState:
    return next(m for m in run if isinstance(m, AgentState) and (m.step, m.agent_id) == (step, agent))


def plane_state(run: Iterable[Message], step: int) -> PlaneState:
    return next(m for m in run if isinstance(m, PlaneState) and m.step == step)


def test_equal_runs_are_equal_and_every_message_is_counted() -> None:
    found = compare(make_run(), make_run())
    assert found.equal
    assert [(one.topic, one.compared, one.differing, one.fields) for one in found.topics] == [
        ("swarm/agent_state", 63, 0, ()),
        ("plane/state", 21, 0, ()),
        ("swarm/abstract_state", 21, 0, ()),
        ("swarm/auxiliary_state", 21, 0, ()),
        ("swarm/desired_abstract_state", 21, 0, ()),
        ("swarm/events", 1, 0, ()),
    ]


def test_one_bit_is_found_and_named() -> None:
    run = make_run()
    state = agent_state(run, 11, 2)
    other = math.nextafter(state.command, math.inf)
    found = compare(run, changed(run, state, command=other))
    assert found.first == Difference("swarm/agent_state", 11, 2, "command", state.command, other)
    assert shown(found) == (f"/swarm/agent_state step 11 agent 2: command is {state.command!r} in A, {other!r} in B")
    assert topic(found, "swarm/agent_state").differing == 1
    assert sum(one.differing for one in found.topics) == 1


def test_the_first_difference_is_first_by_step_topic_robot_and_field() -> None:
    run = make_run()
    other = changed(run, plane_state(run, 5), angle=9.0)
    assert shown(compare(run, other)).startswith("/plane/state step 5: angle")
    for agent in (7, 2):
        other = changed(other, agent_state(other, 5, agent), velocity=9.0, position=8.0)
        assert shown(compare(run, other)).startswith(f"/swarm/agent_state step 5 agent {agent}: position")


def test_deviations_are_those_of_numpy() -> None:
    run = make_run()
    draw = np.random.default_rng(5)
    other = [m._replace(position=m.position + draw.normal()) if isinstance(m, AgentState) else m for m in run]
    apart = {
        (m.step, m.agent_id): abs(m.position - n.position)
        for m, n in zip(run, other, strict=True)
        if isinstance(m, AgentState) and isinstance(n, AgentState)
    }
    (field,) = topic(compare(run, other), "swarm/agent_state").fields
    worst = max(apart, key=lambda place: apart[place])
    assert (field.field, field.differing, field.undefined) == ("position", 63, 0)
    assert (field.step, field.agent, field.largest) == (*worst, apart[worst])
    assert field.rms == pytest.approx(np.sqrt(np.mean(np.square(list(apart.values())))))


def test_nan_equals_itself_and_differs_from_numbers_without_a_deviation() -> None:
    run = make_run()
    nan = changed(run, plane_state(run, 4), angle=math.nan)
    assert compare(nan, nan).equal
    found = compare(nan, changed(run, plane_state(run, 6), angle=plane_state(run, 6).angle + 0.5))
    assert topic(found, "plane/state").fields == (
        FieldDeviation("angle", 2, 0.5, 6, 0, pytest.approx(math.sqrt(0.25 / 20)), 1),
    )
    assert found.first is not None
    assert found.first[:4] == ("plane/state", 4, None, "angle")


def test_zeros_of_other_sign_and_infinities_differ() -> None:
    run = make_run()
    state = plane_state(run, 4)
    zero, minus, infinite = (changed(run, state, angle=angle) for angle in (0.0, -0.0, math.inf))
    assert topic(compare(zero, minus), "plane/state").fields == (FieldDeviation("angle", 1, 0.0, 4, 0, 0.0, 0),)
    assert compare(infinite, infinite).equal
    assert topic(compare(zero, infinite), "plane/state").fields == (
        FieldDeviation("angle", 1, None, None, None, None, 1),
    )


def test_whole_numbers_are_counted_but_have_no_deviation() -> None:
    run = make_run()
    found = compare(run, changed(run, agent_state(run, 4, 1), status=2))
    assert topic(found, "swarm/agent_state").fields == (FieldDeviation("status", 1, None, None, None, None, 0),)


def test_what_one_run_lacks_is_said_of_both_sides() -> None:
    short, few = make_run(15), make_run(20, AGENTS[:2])
    found = compare(short, few)
    agents = topic(found, "swarm/agent_state")
    assert (agents.compared, agents.missing_in_a, agents.missing_in_b) == (32, 10, 16)
    planes = topic(found, "plane/state")
    assert (planes.compared, planes.missing_in_a, planes.missing_in_b) == (16, 5, 0)
    assert found.first == Difference("swarm/agent_state", 0, 7, "message", "message", None)
    assert shown(found) == "/swarm/agent_state step 0 agent 7: missing in B"
    assert shown(compare(make_run(20), make_run(15))) == "/swarm/agent_state step 16 agent 1: missing in B"


def test_a_missing_message_in_the_middle_is_named() -> None:
    run = make_run()
    lost = plane_state(run, 9)
    found = compare([m for m in run if m != lost], run)
    assert found.first == Difference("plane/state", 9, None, "message", None, "message")


def test_events_are_brought_together_wherever_they_stand() -> None:
    run = make_run()
    event = next(message for message in run if isinstance(message, SwarmEvent))
    rest = [message for message in run if message != event]
    assert compare([event, *rest], [*rest, event]).equal
    found = compare(run, changed(run, event, value=0.5))
    assert found.first == Difference("swarm/events", 3, 7, "value", 1 / 3, 0.5)
    second = SwarmEvent(50_000_000, 5, 1, EventKind.JOINED, 0.0, "")
    found = compare(run, [*run, second])
    assert found.first == Difference("swarm/events", 5, 1, "message", None, "message")


def test_another_period_is_a_difference_in_the_stamps_alone() -> None:
    found = compare(make_run(), make_run(period=20_000_000))
    assert {field.field for one in found.topics for field in one.fields} == {"stamp"}
    assert shown(found) == "/swarm/agent_state step 1 agent 1: stamp is 10000000 in A, 20000000 in B"


def test_topics_may_overlap_but_only_so_far() -> None:
    run = make_run()
    late = plane_state(run, 5)
    at = run.index(late)
    rest = [m for m in run if m != late]
    assert compare([*rest[: at + 30], late, *rest[at + 30 :]], run).equal
    with pytest.raises(DamagedBagError, match="A: /plane/state at step 5 stands behind step 20, out of order"):
        compare([*rest, late], run)


def test_a_message_that_is_there_twice_is_refused() -> None:
    run = make_run()
    state = agent_state(run, 5, 7)
    with pytest.raises(DamagedBagError, match="B: /swarm/agent_state of agent 7 at step 5 is there twice"):
        compare(run, [*run[: run.index(state)], state, *run[run.index(state) :]])


def test_a_fraction_of_the_runs_is_in_memory() -> None:
    def measured(work: Callable[[], object]) -> int:
        tracemalloc.start()
        result = work()
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        del result
        return most

    def run(angle: float) -> Iterator[Message]:
        for message in (m for step in range(2000) for m in make_step(step)):
            yield message._replace(angle=angle) if isinstance(message, PlaneState) else message

    assert measured(lambda: compare(run(0.1), run(0.2))) < 0.1 * measured(lambda: [*run(0.1), *run(0.2)])
