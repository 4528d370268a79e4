"""Robots in real time that compute the swarm by themselves: right runs, robots that cheat, and what cannot be known."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st
from tests.swarmabs_analysis.verification.test_lockstep import flipped, place
from tests.swarmabs_analysis.verification.test_realtime import one_bit_off, verify
from tests.swarmabs_core.helpers import builtin
from tests.swarmabs_core.realtime.bags import Recorded, Stored, record
from tests.virtual.fleet import Network, VirtualFleet

from swarmabs_config.graph import PLANE
from swarmabs_core import messages as msg
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime import agent, peer, relayed
from swarmabs_core.realtime.relayed import Told
from swarmabs_core.record import Record

HALF = Network(loss=0.5)


def ran(
    *settings: str,
    network: Network | None = None,
    story: Callable[[VirtualFleet], None] | None = None,
    loss: float = 0.0,
) -> Recorded:
    """Return what a recorder has of a fleet that has run for 1 s, and through a story."""
    scenario = builtin(settings[0], "coordination=each_robot", *settings[1:])
    fleet = VirtualFleet(scenario, network=network or Network())
    fleet.run(1.0)
    if story is not None:
        story(fleet)
    return record(fleet, scenario, loss=loss)


def deaths(fleet: VirtualFleet) -> None:
    """The speaker dies and returns, then another robot, then the plane."""
    for name in (agent_name(1), agent_name(3), PLANE):
        fleet.kill(name)
        fleet.run(0.5)
        fleet.revive(name)
        fleet.run(0.4)


def operator(fleet: VirtualFleet) -> None:
    fleet.call(agent_name(3), "stop")
    fleet.run(0.4)
    fleet.call(agent_name(2), "reset")
    fleet.run(1.5)
    fleet.call(agent_name(4), "leave")
    fleet.run(0.4)
    fleet.call(agent_name(4), "join")
    fleet.run(0.6)


def removal(fleet: VirtualFleet) -> None:
    fleet.kill(agent_name(4))
    fleet.run(0.3)
    removed = msg.Removal(fleet.now(PLANE), round(fleet.time * 100), 4, msg.EventKind.LEFT, 0.0, "")
    fleet.inject(removed, [agent_name(i) for i in (1, 2, 3)])
    fleet.published.append((round(fleet.time * 1e9), "operator", removed))
    fleet.run(0.4)


def cut(fleet: VirtualFleet) -> None:
    """The speaker hears nobody for a while, and another one speaks as well."""
    fleet.network.cut.add(agent_name(1))
    fleet.run(0.5)
    fleet.network.cut.clear()
    fleet.run(0.5)


def clocks(fleet: VirtualFleet) -> None:
    for offset in (0.004, 0.3, -0.3, 0.0):
        fleet.set_clock(agent_name(2), offset)
        fleet.run(0.4)


def halts(fleet: VirtualFleet) -> None:
    for robot in (2, 1):
        fleet.activity(agent_name(robot)).engine.behaviour.halt()
        fleet.run(0.4)


RING = "links={type: ring, sensing: [2]}"
RUNS: dict[str, tuple[tuple[str, ...], Network, Callable[[VirtualFleet], None]]] = {
    "half is lost": (("arise_het_4", "links={type: all, loss: 0.3}"), Network(loss=0.5), deaths),
    "ring": (("arise_het_4", RING), Network(loss=0.1), operator),
    "removal": (("pd_het_4",), Network(), removal),
    "cut": (("arise_het_4",), Network(), cut),
    "halts": (("arise_het_4",), Network(), halts),
    "jitter": (("pd_het_4",), Network(jitter=0.012, loss=0.1, duplication=0.1), deaths),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.system] * (name in {"half is lost", "jitter"})) for name in RUNS]
)
def test_a_right_run_is_found_right_and_everything_is_checked(name: str) -> None:
    named, network, story = RUNS[name]
    run = ran(*named, network=replace(network, cut=set()), story=story)
    result = verify(run.scenario, run.bag)
    assert result.difference is None
    judged = sum(stored.topic not in {msg.EVENTS, msg.BASIS, msg.REMOVALS} for stored in run.bag)
    assert result.messages + result.not_checkable.total() == judged
    assert result.not_checkable.total() <= 0.02 * judged
    assert run.collector.different == 0
    assert not result.second_senders


def test_a_robot_whose_clock_was_set_is_not_taken_for_a_forger() -> None:
    run = ran("pd_het_4", story=clocks)
    result = verify(run.scenario, run.bag, robots=(1, 3, 4))  # its body does not follow its clock
    assert result.difference is None
    assert result.not_checkable.total() < result.messages  # for its states of steps that came twice are ambiguous


def test_what_the_recorder_has_lost_is_counted_and_most_is_checked() -> None:
    run = ran("arise_het_4", network=Network(loss=0.2), story=deaths, loss=0.03)
    result = verify(run.scenario, run.bag)
    assert result.difference is None
    assert 0 < result.not_checkable.total() < 0.5 * result.messages


# Robots that cheat consistently


@pytest.fixture
def cheating(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[int, Told], Told]], None]:
    """Let robot 2 tell something else in its relays than it would."""
    honest = relayed.written

    def cheat(change: Callable[[int, Told], Told]) -> None:
        def written(step: int, told: Told, robots: int) -> bytes:
            own = bool(told.motions) and told.motions[0].rank == 1  # its own state is the first
            return honest(step, change(step, told) if own else told, robots)

        monkeypatch.setattr(peer, "written", written)

    return cheat


def passed_on(told: Told, rank: int, **changes: Any) -> Told:
    """Return what is told with another state of a robot."""
    return replace(told, motions=[m._replace(**changes) if m.rank == rank else m for m in told.motions])


def first_with(run: Recorded, rank: int, since: int) -> int:
    """Return the first step since one in which robot 2 passes on a state of another robot."""
    for stored in run.bag:
        relay = stored.message
        if (
            isinstance(relay, msg.Relay)
            and (relay.agent_id == 2 and relay.step >= since)
            and any(motion.rank == rank for motion in relayed.read(relay, 4).motions)
        ):
            return relay.step
    raise AssertionError


def test_a_state_that_is_forged_in_passing_on_names_sender_and_author(cheating: Any) -> None:
    cheating(lambda step, told: passed_on(told, 2, position=0.123) if step >= 60 else told)
    run = ran("pd_het_4", network=HALF)
    difference = verify(run.scenario, run.bag).difference
    step = first_with(run, 2, 60)
    assert place(difference) == ("agent_002/relay", step, 2, "robot_3.position")
    assert difference is not None
    assert "robot 3 never published that" in difference.reason


def test_a_state_of_another_step_in_passing_on_is_named(cheating: Any) -> None:
    def older(step: int, told: Told) -> Told:
        ages = [motion.age for motion in told.motions if motion.rank == 2]
        return passed_on(told, 2, age=ages[0] - 1) if ages and step >= 60 else told

    cheating(older)
    run = ran("pd_het_4", network=HALF)
    difference = verify(run.scenario, run.bag).difference
    assert difference is not None
    assert (difference.topic, difference.agent) == ("agent_002/relay", 2)
    assert difference.field.startswith("robot_3.")
    assert "that is the state of step" in difference.reason


def test_a_state_of_the_plane_that_is_forged_in_passing_on_is_named(cheating: Any) -> None:
    def tilted(step: int, told: Told) -> Told:
        plane = told.plane
        return told if plane is None or step < 60 else replace(told, plane=plane._replace(angle=plane.angle + 1e-9))

    cheating(tilted)
    run = ran("pd_het_4", "links={type: ring, sensing: [2]}")
    difference = verify(run.scenario, run.bag).difference
    assert difference is not None
    assert (difference.topic, difference.field) == ("agent_002/relay", "plane.angle")


def test_a_robot_that_has_summed_up_other_states_than_it_says_is_found(cheating: Any) -> None:
    def other(step: int, told: Told) -> Told:
        answers = [
            answer._replace(states={**answer.states, 2: answer.states[2] - 1}) if answer.states else answer
            for answer in told.answers
        ]
        return replace(told, answers=answers) if step == 60 else told

    cheating(other)
    run = ran("pd_het_4")
    difference = verify(run.scenario, run.bag).difference
    assert place(difference) == (msg.AGENT_STATE.name, 61, 2, "command")


def test_a_robot_that_lies_about_its_integrals_is_found(cheating: Any) -> None:
    def more(step: int, told: Told) -> Told:
        law = told.law
        memory = (law.memory[0] + 1e-6, *law.memory[1:]) if law.memory else ()
        return replace(told, law=law._replace(memory=memory)) if step == 60 else told

    cheating(more)
    run = ran("arise_het_4")
    difference = verify(run.scenario, run.bag).difference
    assert difference is not None
    assert difference.agent == 2
    assert 61 <= (difference.step or 0) <= 80


def test_a_robot_whose_command_is_one_bit_off_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    with one_bit_off(monkeypatch):
        run = ran("pd_het_4")
    assert place(verify(run.scenario, run.bag).difference) == (msg.AGENT_STATE.name, 62, 1, "command")


def test_a_robot_that_does_not_obey_a_stop_it_knows_of_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = agent.RealtimeAgent.hear

    def hear(self: agent.RealtimeAgent, message: msg.Message, *told: Any) -> msg.Messages:
        deaf = self._config.agent_id == 3 and isinstance(message, msg.DesiredAbstractState)
        return () if deaf and message.mode != msg.Mode.RUN else honest(self, message, *told)  # type: ignore[union-attr]

    with monkeypatch.context() as patch:
        patch.setattr(agent.RealtimeAgent, "hear", hear)
        run = ran("pd_het_4", story=lambda fleet: (fleet.call(agent_name(1), "stop"), fleet.run(0.3))[1])
    difference = verify(run.scenario, run.bag).difference
    assert difference is not None
    assert (difference.topic, difference.agent, difference.field) == (msg.AGENT_STATE.name, 3, "broadcast_step")
    assert 100 < (difference.step or 0) < 106
    assert "it knew of the STOP of step 1" in difference.reason


@pytest.mark.parametrize("topic", [msg.ABSTRACT_STATE, msg.AUXILIARY_STATE, msg.STANDING, msg.DESIRED_ABSTRACT_STATE])
def test_a_broadcast_that_no_robot_has_computed_is_found(topic: msg.Topic) -> None:
    bag = list(quiet().bag)
    number = next(n for n, stored in enumerate(bag) if stored.topic is topic and stored.message.step == 60)
    message: Any = bag[number].message
    name, value = next((f, v) for f, v in message._asdict().items() if isinstance(v, float) and v)
    changed = message._replace(**{name: math.nextafter(value, math.inf)})
    bag[number] = bag[number]._replace(payload=Record.of(changed).payload)
    assert place(verify(quiet().scenario, bag).difference) == (topic.name, 60, None, name)


def test_stops_that_no_robots_answer_explains_are_found() -> None:
    run = ran("pd_het_4", story=lambda fleet: (fleet.call(agent_name(1), "stop"), fleet.run(0.3))[1])
    bag = list(run.bag)
    for number, stored in enumerate(bag):
        asked = stored.message
        if isinstance(asked, msg.DesiredAbstractState) and asked.mode == msg.Mode.STOP:
            changed = asked._replace(inertia=asked.inertia * (1.0 + 1e-3 * asked.step))
            bag[number] = stored._replace(payload=Record.of(changed).payload)
    found = place(verify(run.scenario, bag).difference)
    assert (found[0], found[3]) == (msg.DESIRED_ABSTRACT_STATE.name, "inertia")


@cache
def quiet() -> Recorded:
    return ran("arise_het_4")


@settings(max_examples=12, deadline=None)
@given(st.data())
def test_a_changed_bit_of_what_a_relay_says_of_states_is_found(data: st.DataObject) -> None:
    bag = list(quiet().bag)
    relays = [n for n, s in enumerate(bag) if s.topic.message is msg.Relay and 10 < s.message.step < 95]
    number = data.draw(st.sampled_from(relays))
    stored: Stored = bag[number]
    size = 25 + 5  # the state, the answer before it: age, step of the law, division, number of states, which robots
    bit = data.draw(st.integers(8 * (len(stored.payload) - size), 8 * len(stored.payload) - 1))
    if bit // 8 == len(stored.payload) - size + 2:
        return  # of two divisions that say the same, nobody knows which one was used
    bag[number] = flipped(stored, bit)
    result = verify(quiet().scenario, bag)
    assert result.difference is not None or result.not_checkable.total() > 0
