"""Verification of runs in real time: right ones, changed bits, robots that cheat, and what cannot be known."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st
from tests.swarmabs_analysis.verification.test_lockstep import changed, find, flipped, place
from tests.swarmabs_core.helpers import builtin
from tests.swarmabs_core.realtime.bags import WORLDS, Stored, messages, record, world
from tests.virtual.fleet import EPOCH, VirtualFleet

from swarmabs_analysis.verification.base import VerificationResult
from swarmabs_analysis.verification.history import AMBIGUOUS, WAIT
from swarmabs_analysis.verification.realtime import RealtimeVerification
from swarmabs_analysis.verification.realtime_nodes import NO_ANSWER_BEFORE
from swarmabs_bag.realtime_world import RealtimeWorld
from swarmabs_bag.run.realtime_gatherer import RealtimeCollector
from swarmabs_config import realtime as configure
from swarmabs_config.configure import members
from swarmabs_config.graph import CONTROLLER, PLANE
from swarmabs_config.scenario import Scenario
from swarmabs_core import messages as msg
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.realtime import agent
from swarmabs_core.realtime.broadcasts import BroadcastInbox
from swarmabs_core.record import Record


def verify(scenario: Scenario, bag: Iterable[Stored], *, tolerance: float = 0.0, **differs: Any) -> VerificationResult:
    schedule = configure.schedule(scenario, EPOCH)
    simulated = replace(RealtimeWorld(schedule, members(scenario), plane=True), **differs)
    verification = RealtimeVerification(scenario, simulated, tolerance=tolerance)
    for stored in bag:
        verification.add(*stored)
    verification.finish()
    return verification.result


def judged(bag: Iterable[Stored]) -> int:
    return sum(stored.topic in {*msg.MAIN_TOPICS, msg.STANDING} for stored in bag)


SELDOM = ("operator on a bad network", "deaths on a bad network", "begun in a stop", "noisy plane", "end stop")
RECORDED = [
    pytest.param(name, {}, marks=[pytest.mark.system] * (name in SELDOM))
    for name in WORLDS
    if not name.startswith("brief")
]
LOST_OR_LATE = {"loss": 0.03, "jitter": 0.012}


@pytest.mark.parametrize(
    ("name", "way"),
    [
        *RECORDED,
        ("deaths", LOST_OR_LATE),
        *(pytest.param(name, LOST_OR_LATE, marks=pytest.mark.system) for name in ("adaptive", "operator", "clocks")),
    ],
)
def test_a_right_run_is_found_right_whatever_the_recorder_lost(name: str, way: dict[str, float]) -> None:
    scenario, bag, *_ = world(name, **way)
    # Bodies follow the clock of their node, but virtual ones that of the world: robot 1, whose clock is set, does not.
    result = verify(scenario, bag, robots=(2, 3, 4) if name == "clocks" else members(scenario))
    assert result.difference is None
    assert result.messages + result.not_checkable.total() == judged(bag)
    # Where robots stand for a moment, each desired state continues from the one before for seconds.
    unknown = result.not_checkable.total() - result.not_checkable[NO_ANSWER_BEFORE]
    if way:
        assert 0 < unknown < (0.6 if name == "clocks" else 0.5) * result.messages
    elif name == "clocks":  # where a clock is set back, steps come twice, and the bag has the first of each
        assert unknown <= 600
    else:
        assert result.not_checkable.total() == 0


@pytest.mark.parametrize("ended", [True, False])
def test_what_a_second_sender_may_have_changed_is_not_checked_and_no_bag_with_one_is_ok(*, ended: bool) -> None:
    """As the recorder reports it, with two events; without the second one it lasts until the end."""
    scenario, bag, *_ = world("quiet")
    kept = RealtimeCollector(members(scenario), configure.schedule(scenario, EPOCH))
    stored: list[Stored] = []
    for sent in bag:
        forged = 40 <= sent.message.step < 60 and sent.topic in {msg.PLANE_STATE, msg.BASIS}
        writer = sent.topic.name.encode()
        for message, of in ((sent.message, writer), *([(sent.message._replace(stamp=1), b"forger")] if forged else [])):
            records = kept.add(Record.of(message), sent.time, of)
            stored += [Stored(record.topic, sent.time, record.payload) for record in records]
    events = [place for place, sent in enumerate(stored) if b"second sender" in sent.payload]
    assert len(events) == 2 * 4
    if not ended:
        stored = [sent for sent in stored if b"up to this step" not in sent.payload]
    result = verify(scenario, stored)
    last = 59 if ended else max(sent.message.step for sent in bag)
    whose = ("/plane/state", *(f"/recording/basis of the {name}" for name in ("controller", "observer", "plane")))
    assert {of: steps[1] for of, steps in result.second_senders.items()} == dict.fromkeys(whose, last)
    assert {steps[0] for steps in result.second_senders.values()} == {40}
    assert (result.difference, result.ok, result.complete) == (None, False, False)
    assert result.not_checkable[AMBIGUOUS] > 0
    checkable = result.messages / (result.messages + result.not_checkable.total())
    assert checkable > 0.8 if ended else checkable < 0.8


def renames_division(one: Stored, other: Stored) -> bool:
    """Return whether messages differ only in the step of the standing state that the controller names."""
    basis: Any = one.message
    if not isinstance(basis, msg.Basis) or basis.source != msg.Source.CONTROLLER:
        return False
    try:
        renamed: Any = other.message
    except MalformedMessageError:
        return False
    return renamed != basis and renamed._replace(state_steps=basis.state_steps) == basis


@settings(max_examples=50)
@given(st.data())
def test_a_changed_bit_anywhere_is_found(data: st.DataObject) -> None:
    recorded = world("brief")
    bag = list(recorded.bag)
    number = data.draw(
        st.sampled_from([n for n, s in enumerate(bag) if s.topic is not msg.EVENTS and s.message.step > 5])
    )
    bit = data.draw(st.integers(0, 8 * len(bag[number].payload) - 1))
    if bag[number].topic is msg.AGENT_STATE and 4 <= bit // 8 < 12:
        return  # when within its step a robot has measured, nobody knows
    original, bag[number] = bag[number], flipped(bag[number], bit)
    if renames_division(original, bag[number]):
        return  # of two that say the same, nobody knows which one was used
    result = verify(recorded.scenario, bag)
    if result.difference is None:  # a step or a time that now belongs to nothing: then something else lacks it
        assert result.not_checkable.total() > 0


# Robots and coordinators that cheat consistently


@contextmanager
def one_bit_off(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let all robots decide on a command that is one bit higher, of what they hear of step 60."""
    honest = agent.RealtimeLaw.decide

    def decide(self: agent.RealtimeLaw, position: float, velocity: float, heard: Any, moved: float = 0.0) -> Any:
        decision, limited = honest(self, position, velocity, heard, moved)
        higher = decision._replace(command=math.nextafter(decision.command, math.inf))
        return higher if heard.step == 60 else decision, limited

    with monkeypatch.context() as patch:
        patch.setattr(agent.RealtimeLaw, "decide", decide)
        yield


def test_a_robot_whose_command_is_one_bit_off_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = builtin("pd_het_4")
    with one_bit_off(monkeypatch):
        fleet = VirtualFleet(scenario)
        fleet.run(1.0)
    assert place(verify(scenario, record(fleet, scenario).bag).difference) == (msg.AGENT_STATE.name, 62, 1, "command")


@pytest.mark.parametrize(
    ("disturb", "robot", "reason"),
    [
        (lambda fleet: setattr(fleet.network, "cut", {"agent_002"}), 2, "11 steps old"),
        (lambda fleet: fleet.call(CONTROLLER, "stop"), 1, "requested STOP"),
    ],
)
def test_a_robot_that_follows_what_is_too_old_or_does_not_stop_is_found(
    monkeypatch: pytest.MonkeyPatch, disturb: Callable[[VirtualFleet], None], robot: int, reason: str
) -> None:
    scenario = builtin("pd_het_4")
    with monkeypatch.context() as patch:
        patch.setattr(BroadcastInbox, "problem", lambda inbox, _: "" if inbox.newest else "nothing heard")
        fleet = VirtualFleet(scenario)
        fleet.run(0.505)
        disturb(fleet)
        fleet.run(0.5)
    difference = verify(scenario, record(fleet, scenario).bag).difference
    assert place(difference)[2:] == (robot, "broadcast_step")
    assert difference is not None and reason in difference.reason


def edited(
    bag: Sequence[Stored], kind: type, of_step: int, source: msg.Source | None = None, **fields: object
) -> list[Stored]:
    """Return the bag with the first message of a class and step, if it is a basis of a source, changed."""
    wanted = (True, of_step, source)
    places = ((isinstance(m, kind), m.step, getattr(m, "source", None)) for m in messages(bag))
    number = next(n for n, what in enumerate(places) if what == wanted)
    return [*bag[:number], changed(bag[number], **fields), *bag[number + 1 :]]


@pytest.mark.parametrize(
    ("kind", "fields", "named"),
    [
        (msg.AgentState, {"status": 2}, "status"),
        (msg.AgentState, {"mass": 1.0}, "mass"),
        (msg.AgentState, {"position": 0.2}, "position"),
        (msg.PlaneState, {"angle": 0.1}, "angle"),
        (msg.PlaneState, {"stamp": EPOCH}, "stamp"),
        (msg.DesiredAbstractState, {"torque": 0.1}, "torque"),
        (msg.DesiredAbstractState, {"mode": msg.Mode.STOP}, "inertia"),
        (msg.Basis, {"source": msg.Source.OBSERVER, "state_steps": (100, 100, 100, 99)}, "torque"),
        (msg.Basis, {"source": msg.Source.OBSERVER, "state_steps": (100, 100, 100, 103)}, "state_steps"),
        (msg.Basis, {"source": msg.Source.OBSERVER, "agent_ids": (1, 2, 4, 3)}, "agent_ids"),
        (msg.Basis, {"source": msg.Source.PLANE, "state_steps": (100, 100, 100, 99)}, "angle"),
        (msg.Basis, {"source": msg.Source.OBSERVER, "standing": (0, 1, 0, 0)}, "torque_rate"),
        (msg.Basis, {"source": msg.Source.OBSERVER, "state_steps": (100, 50, 100, 100)}, "standing"),
        (msg.Basis, {"source": msg.Source.PLANE, "standing": (0, 1, 0, 0)}, "standing"),
        (msg.Basis, {"source": msg.Source.CONTROLLER, "agent_ids": (1,)}, "agent_ids"),
        (msg.Basis, {"source": msg.Source.CONTROLLER, "standing": (2,)}, "standing"),
        (msg.Basis, {"source": msg.Source.CONTROLLER, "state_steps": (50,)}, "state_steps"),
        (msg.StandingState, {"moving_count": 3}, "moving_count"),
        (msg.StandingState, {"moving_gram": (1.0, 0.0, 1.0)}, "moving_gram[0]"),
        (msg.Basis, {"source": msg.Source.PLANE, "begun": 50}, "begun"),
        (msg.Basis, {"source": msg.Source.PLANE, "begun": 100}, "begun"),
        (msg.AgentState, {"broadcast_step": msg.NEVER}, "status"),
        (msg.AgentState, {"agent_id": 9}, "message"),
        (msg.AgentState, {"step": 2**63}, "step"),
        (msg.AgentState, {"step": 5000}, "step"),
        (msg.AgentState, {"step": 50}, "message"),
    ],
)
def test_what_was_edited_is_named(kind: type, fields: dict[str, Any], named: str) -> None:
    recorded = world("quiet")
    difference = verify(recorded.scenario, edited(recorded.bag, kind, 100, **fields)).difference
    assert difference is not None
    assert difference.step in {100, 101, fields.get("step")}
    assert difference.field == named or (kind is msg.DesiredAbstractState and "mode" in fields)


@pytest.mark.parametrize(("step", "named"), [(101, "command"), (102, "status")])
def test_a_robot_may_hold_still_while_the_swarm_may_have_no_spread(step: int, named: str) -> None:
    recorded = world("quiet")
    held = edited(recorded.bag, msg.AgentState, 100, broadcast_step=msg.NEVER)
    bag = edited(held, msg.AuxiliaryState, step, s3=0.0)
    assert place(verify(recorded.scenario, bag).difference) == (msg.AGENT_STATE.name, 100, 1, named)


def test_a_message_that_stands_there_twice_is_found_and_with_a_tolerance_small_differences_pass() -> None:
    recorded = world("quiet")
    number = find(recorded.bag, msg.PLANE_STATE, 50)
    bag = [*recorded.bag[: number + 3], recorded.bag[number], *recorded.bag[number + 3 :]]
    assert place(verify(recorded.scenario, bag).difference) == (msg.PLANE_STATE.name, 50, None, "message")
    state: Any = recorded.bag[find(recorded.bag, msg.PLANE_STATE, 100)].message
    bag = edited(recorded.bag, msg.PlaneState, 100, angle=state.angle + 1e-12)
    assert verify(recorded.scenario, bag).difference is not None
    assert verify(recorded.scenario, bag, tolerance=1e-6).difference is None


# What cannot be known


def without(bag: Sequence[Stored], topic: msg.Topic, step: int) -> list[Stored]:
    number = find(bag, topic, step)
    return [*bag[:number], *bag[number + 1 :]]


def test_without_bases_only_the_robots_are_checked_and_what_was_measured_is_not_recomputed() -> None:
    recorded = world("quiet")
    result = verify(recorded.scenario, [s for s in recorded.bag if s.topic is not msg.BASIS])
    robots = sum(s.topic is msg.AGENT_STATE for s in recorded.bag)
    unknown = {"its provenance is not in the bag": judged(recorded.bag) - robots}
    assert (result.difference, result.messages, dict(result.not_checkable)) == (None, robots, unknown)
    bag = edited(recorded.bag, msg.PlaneState, 150, stamp=EPOCH)
    result = verify(recorded.scenario, bag, robots=(), plane=False)
    assert result.difference is None
    assert result.not_checkable["it was measured, not computed"] == sum(s.topic is msg.PLANE_STATE for s in bag)
    moved = edited(recorded.bag, msg.AgentState, 150, position=0.2)
    result = verify(recorded.scenario, moved, robots=(), plane=False)
    assert place(result.difference)[3] == "torque"
    left = edited(recorded.bag, msg.AgentState, 150, status=msg.Status.LEFT)
    result = verify(recorded.scenario, left, robots=(), plane=False)
    assert place(result.difference) == (msg.AGENT_STATE.name, 150, 1, "status")


def test_a_law_with_memory_is_followed_again_after_a_reset() -> None:
    adaptive = world("adaptive")
    lost = without(adaptive.bag, msg.PLANE_STATE, 50)
    answers = sum(s.topic is msg.DESIRED_ABSTRACT_STATE and s.message.step > 50 for s in lost)
    result = verify(adaptive.scenario, lost)
    assert result.difference is None
    assert result.not_checkable["the answer from which it continues is not in the bag"] >= answers
    # A law without memory is found again at once, and so is a plane whose true state is not recorded.
    for name in ("operator", "noisy plane"):
        recorded = world(name)
        result = verify(recorded.scenario, without(recorded.bag, msg.PLANE_STATE, 50))
        assert result.difference is None
        # With losses robots stand for a moment, and for seconds the desired state is on its way to its curve.
        continued = result.not_checkable[NO_ANSWER_BEFORE] if name == "noisy plane" else 0
        assert result.not_checkable.total() - continued <= 4


def test_what_a_robot_does_near_the_end_of_its_lane_while_its_sensor_is_silent_is_explained(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ages = ", ".join(f"{name}_age_limit: 0.5" for name in ("broadcast", "state", "plane"))
    scenario = builtin(
        "pd_het_4",
        "step=0.05",
        f"realtime={{{ages}, clock_tolerance: 0.1}}",
        "plane={end_stop: 0.5, angle: 0.4, angular_velocity: 3}",
    )
    fleet = VirtualFleet(scenario, start_mode=msg.Mode.STOP)
    fleet.run(1.2)
    fleet.call(CONTROLLER, "reset")
    fleet.run(1.0)
    for _ in range(20):
        for silent, lasting in ((True, 0.12), (False, 0.04)):
            for robot in (1, 2):
                fleet.drives[robot].blind = silent
            fleet.run(lasting)
    bag = record(fleet, scenario).bag
    assert verify(scenario, bag, robots=()).difference is None
    honest = agent.RealtimeLaw.decide
    monkeypatch.setattr(agent.RealtimeLaw, "decide", lambda self, *known: honest(self, *known[:3]))
    assert place(verify(scenario, bag, robots=()).difference)[3] == "command", "it counts how far a robot has moved"


def test_a_stop_after_an_answer_that_was_not_recorded_is_checked_against_the_next() -> None:
    recorded = world("operator")
    first = next(
        m.step for m in messages(recorded.bag) if isinstance(m, msg.DesiredAbstractState) and m.mode == msg.Mode.STOP
    )

    def standing(stored: Stored) -> Stored:
        asked: Any = stored.message
        stops = stored.topic is msg.DESIRED_ABSTRACT_STATE and asked.mode == msg.Mode.STOP
        return changed(stored, inertia=1.01 * asked.inertia) if stops else stored

    around = [*map(standing, without(recorded.bag, msg.DESIRED_ABSTRACT_STATE, first - 1))]
    result = verify(recorded.scenario, around)
    assert (result.difference, result.not_checkable[NO_ANSWER_BEFORE]) == (None, 1)
    for step, fields in ((first, {"torque_rate": 1.0}), (first + 1, {"torque": 0.1}), (first + 9, {"inertia": 0.03})):
        bag = edited(around, msg.DesiredAbstractState, step, **fields)
        assert place(verify(recorded.scenario, bag).difference)[:2] == (msg.DESIRED_ABSTRACT_STATE.name, step), fields
    # With the answer of the same step in the bag nothing is missing.
    bag = edited(recorded.bag, msg.DesiredAbstractState, first, step=first - 1, inertia=0.03)
    assert place(verify(recorded.scenario, bag).difference)[:2] == (msg.DESIRED_ABSTRACT_STATE.name, first - 1)


def test_where_a_plane_was_held_is_not_known_if_its_last_state_is_missing() -> None:
    scenario = builtin("pd_het_4")
    fleet = VirtualFleet(scenario)
    fleet.run(0.7)
    fleet.deactivate(PLANE)
    fleet.run(0.4)
    fleet.activate(PLANE)
    fleet.run(0.7)
    bag = record(fleet, scenario).bag
    steps = [stored.message.step for stored in bag if stored.topic is msg.PLANE_STATE]
    last, anew = next((k, n) for k, n in pairwise(steps) if n > k + 1)
    assert verify(scenario, bag).not_checkable.total() == 0
    of_plane = [m.step == last and getattr(m, "source", msg.Source.PLANE) == msg.Source.PLANE for m in messages(bag)]
    lost = [s for s, gone in zip(bag, of_plane, strict=True) if not gone or s.topic not in {msg.PLANE_STATE, msg.BASIS}]
    result = verify(scenario, lost)
    assert (result.difference, result.not_checkable[NO_ANSWER_BEFORE]) == (None, 1)
    for step, fields in ((anew, {"angular_velocity": 1.0}), (anew + 1, {"angle": 0.05}), (steps[0], {"angle": 0.05})):
        difference = verify(scenario, edited(bag, msg.PlaneState, step, **fields)).difference
        assert place(difference)[:2] == (msg.PLANE_STATE.name, step), fields


def test_what_comes_from_nowhere_gives_a_difference_and_no_error() -> None:
    recorded = world("quiet")
    draw = Random(1)
    for _ in range(60):
        bag = list(recorded.bag[:400])
        number = draw.randrange(400)
        bag[number] = bag[number]._replace(payload=draw.randbytes(draw.randrange(120)))
        assert place(verify(recorded.scenario, bag).difference)[3] == "payload"
    number = find(recorded.bag, msg.PLANE_STATE, 50)
    between = flipped(recorded.bag[number], 8 * 24)  # bytes between fields, which mean nothing
    bag = [*recorded.bag[:number], between, *recorded.bag[number + 1 :]]
    assert place(verify(recorded.scenario, bag).difference) == (msg.PLANE_STATE.name, 50, None, "padding")


def years_ahead(stored: Stored, steps: int = 10**10, period: int = 10**7) -> Stored:
    """Return a message as of a clock that was set forward by many steps of a period (ns)."""
    later = changed(stored, step=stored.message.step + steps, stamp=stored.message.stamp + steps * period)
    return later._replace(time=stored.time + steps * period)


def test_a_clock_that_is_set_years_ahead_takes_no_time() -> None:
    recorded = world("brief")
    moved = [years_ahead(stored) if stored.message.step >= 30 else stored for stored in recorded.bag]
    assert verify(recorded.scenario, moved).difference is not None  # nobody has said that the clock was set
    # What waits to be judged when the clock is set is judged.
    recorded = world("operator")
    last = recorded.bag[-1]
    step = configure.schedule(recorded.scenario, EPOCH).step(last.time) - WAIT
    bag = [*edited(recorded.bag, msg.AgentState, step, position=0.2), years_ahead(last)]
    difference = verify(recorded.scenario, bag).difference
    assert place(difference) == (msg.AGENT_STATE.name, step, 1, "position")
