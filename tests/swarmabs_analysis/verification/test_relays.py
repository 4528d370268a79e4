"""What robots passed on is verified from what each had heard: right runs, changed bags, and robots that cheat."""

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import pytest
from tests.swarmabs_core.helpers import builtin, digest
from tests.swarmabs_core.realtime.bags import Stored

from swarmabs_analysis.verification.base import VerificationResult
from swarmabs_analysis.verification.lockstep import LockstepVerification
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.recorder.recording import Recording
from swarmabs_config import configure
from swarmabs_config.scenario import Scenario
from swarmabs_core.behaviours import Peer
from swarmabs_core.cdr import encode
from swarmabs_core.links import Links
from swarmabs_core.messages import AGENT_STATE, Relay, relay_topic
from swarmabs_core.relays import Content, reduced
from swarmabs_run.simulation import NodeInProcess, Simulation, peers_in_process

CHAIN = "links={type: listed, pairs: [1 2, 2 3, 3 4]}"
LOSSY = "links={type: ring, loss: 0.5, sensing: [2]}"
MESHED = "links={loss: 0.5, sensing: [2, 3]}"
ENDS = (
    "faults=[{kind: join, agent: 4, at: 0.05}, {kind: kill, agent: 2, at: 0.1}, {kind: leave, agent: 1, at: 0.15},"
    " {kind: lie, agent: 3, from: 0.02, to: 0.1, position_offset: 0.01}, {kind: duplication, probability: 0.5},"
    " {kind: loss, agents: [3], probability: 0.3}]"
)


@cache
def world(*changes: str) -> Scenario:
    return builtin("pd_het_4", "duration=0.2", "coordination=each_robot", *changes).resolved()


def stored(simulation: Simulation) -> list[Stored]:
    return [Stored(*message) for step in simulation.steps() for message in step.stored()]


@cache
def recorded(*changes: str) -> tuple[Stored, ...]:
    return tuple(stored(Simulation(world(*changes))))


def verify(scenario: Scenario, bag: Iterable[Stored], **options: Any) -> VerificationResult:
    verification = LockstepVerification(scenario, relayed=True, **options)
    for message in bag:
        verification.add(*message)
    verification.finish()
    return verification.result


def found(scenario: Scenario, bag: Iterable[Stored], **options: Any) -> tuple[str, int | None, int | None, str, str]:
    """Return topic, step, robot, field and reason of the first difference."""
    difference = verify(scenario, bag, **options).difference
    assert difference is not None
    return difference.topic, difference.step, difference.agent, difference.field, difference.reason


def changed(
    bag: Iterable[Stored], step: int, robot: int, round_: int, change: Callable[[Relay], Relay | None]
) -> list[Stored]:
    """Return a bag with another relay, or none, in one place."""
    result = []
    for message in bag:
        relay = message.message
        if isinstance(relay, Relay) and (relay.step, relay.agent_id, relay.round) == (step, robot, round_):
            other = change(relay)
            if other is not None:
                result.append(message._replace(payload=encode(other)))
        else:
            result.append(message)
    return result


def flipped(place: int, bit: int) -> Callable[[Relay], Relay]:
    """Return a change of one bit of the content; negative places count from its end."""

    def change(relay: Relay) -> Relay:
        content = bytearray(relay.content)
        content[place] ^= 1 << bit
        return relay._replace(content=bytes(content))

    return change


@pytest.mark.parametrize("changes", [(), (CHAIN,), (LOSSY,), (MESHED, ENDS)])
def test_a_right_run_is_right_to_the_last_relay(tmp_path: Path, changes: tuple[str, ...]) -> None:
    scenario = world(*changes)
    recording = Recording(scenario, tmp_path / "bag", driver="simulate")
    for step in Simulation(scenario).steps():
        recording.add(step)
    recording.close()
    result = BagToVerify(tmp_path).verify()
    assert (result.difference, result.complete, result.notes) == (None, True, ())
    assert result.messages == len(recorded(*changes))
    central = builtin("pd_het_4", "duration=0.2", *(change for change in changes if change is ENDS))
    assert result.digest == digest(Simulation(central).steps())


def test_the_order_within_a_few_steps_does_not_matter() -> None:
    """Other recorders receive topics independently of each other."""
    draw = Random(1)
    bag = sorted(recorded(LOSSY), key=lambda message: message.message.step + 3.0 * draw.random())
    assert verify(world(LOSSY), bag).ok


@pytest.mark.parametrize(("place", "what"), [(-9, "robot_2.position"), (-1, "robot_2.velocity")])
def test_a_changed_bit_of_a_motion_is_found(place: int, what: str) -> None:
    bag = changed(recorded(CHAIN), 7, 2, 0, flipped(place, 2))
    assert found(world(CHAIN), bag) == ("agent_002/relay", 7, 2, what, "round 0")


def test_a_state_that_nobody_has_passed_on_is_not_held() -> None:
    """In a chain robot 1 hears of robot 2 in round 0, of robot 3 in round 1, and of robot 4 in round 2."""
    bag = changed(recorded(CHAIN), 5, 1, 2, flipped(1, 3))
    reason = "round 2: it cannot have heard the state of robot 4: no neighbour has passed it on"
    assert found(world(CHAIN), bag) == ("agent_001/relay", 5, 1, "held", reason)


def test_a_state_that_a_robot_has_not_heard_is_not_passed_on() -> None:
    """Robot 2 passes on the right state of robot 4 too early."""
    scenario, bag = world(CHAIN), recorded(CHAIN)
    content = Content(range(1, 5), scenario.family)
    states = {
        (message.message.step, message.message.agent_id): reduced(message.message)
        for message in bag
        if message.topic is AGENT_STATE
    }
    before = {robot: states[4, robot] for robot in range(1, 5)}

    def early(relay: Relay) -> Relay:
        told = content.read(relay, before)
        passed = sorted((*told.states, states[5, 4]), key=lambda state: state.agent_id)
        return relay._replace(content=content.written(told.before, told.held, passed, told.parent, before, told.votes))

    topic, step, robot, field, reason = found(scenario, changed(bag, 5, 2, 1, early))
    assert (topic, step, robot, field) == ("agent_002/relay", 5, 2, "passed_on")
    assert reason == "round 1: it cannot have heard the state of robot 4: no neighbour has passed it on"


@pytest.mark.parametrize("round_", [0, 1, 3])
def test_a_missing_relay_is_found(round_: int) -> None:
    bag = changed(recorded(CHAIN), 7, 3, round_, lambda _: None)
    assert found(world(CHAIN), bag) == ("agent_003/relay", 7, 3, "message", f"round {round_}")


def test_a_relay_too_many_is_found() -> None:
    bag = list(recorded(CHAIN))
    last = max((m.message for m in bag if isinstance(m.message, Relay)), key=lambda relay: (relay.step, relay.round))
    more = last._replace(round=last.round + 1, step=7, stamp=70_000_000)
    bag.append(Stored(relay_topic(more.agent_id), 70_000_000, encode(more)))
    reason = f"round {more.round}: nothing that the robot had heard leads to it"
    bag.sort(key=lambda message: message.time)
    topic = f"agent_{more.agent_id:03d}/relay"
    assert found(world(CHAIN), bag) == (topic, 7, more.agent_id, "message", reason)
    twice = next(m for m in bag if isinstance(m.message, Relay) and m.message.step == 4)
    assert found(world(CHAIN), [*recorded(CHAIN)[:-1], twice])[-1] == "it is a duplicate, or out of place"


class Listening(Links):
    """Links of a robot that hears some messages which are lost."""

    def __init__(self, scenario: Scenario, step: int, sender: int, receiver: int) -> None:
        super().__init__(scenario.links, configure.members(scenario))
        self._heard = step, sender, receiver

    def loses(self, step: int, turn: int, sender: int, receiver: int) -> bool:
        return (step, sender, receiver) != self._heard and super().loses(step, turn, sender, receiver)


def cheated(scenario: Scenario, links: Mapping[int, Links]) -> list[Stored]:
    """Run a scenario in which some robots have other links."""
    nodes = peers_in_process(scenario)
    parts = (configure.observer_config(scenario), configure.controller_config(scenario, recording_window=0))
    for name, node in nodes.items():
        if name.agent_id in links:
            config = configure.agent_configs(scenario)[name.agent_id - 1]
            peer = Peer(*parts, config, links[name.agent_id])
            assert isinstance(node.behaviour, Peer)
            nodes[name] = NodeInProcess(peer, peer.needs)
    return stored(Simulation(scenario, nodes.values()))


@pytest.mark.parametrize("which", range(3))
def test_a_robot_that_uses_a_lost_message_is_named(which: int) -> None:
    """Robot 3 hears all of robot 2 in a step; everybody goes on with what it then passes on, and the run is right."""
    scenario = world(LOSSY)
    honest = Links(scenario.links, range(1, 5))
    lossy = [step for step in range(20) if honest.loses(step, 0, 2, 3)][which]
    bag = cheated(scenario, {3: Listening(scenario, lossy, 2, 3)})
    topic, step, robot, field, reason = found(scenario, bag)
    assert (topic, step, robot, field) == ("agent_003/relay", lossy, 3, "held")
    lost = "it cannot have heard the state of robot 2: the link lost the relay of robot 2 in round 0"
    assert reason == f"round 1: {lost}"


def test_numbers_of_another_arithmetic_are_within_a_tolerance() -> None:
    def slightly(relay: Relay) -> Relay:
        return flipped(-16, 0)(relay)

    bag = changed(recorded(CHAIN), 7, 2, 0, slightly)
    assert found(world(CHAIN), bag)[3] == "robot_2.position"
    assert verify(world(CHAIN), bag, tolerance=1e-12).ok
    far = changed(recorded(CHAIN), 7, 2, 0, flipped(-10, 6))
    assert found(world(CHAIN), far, tolerance=1e-12)[3] == "robot_2.position"
