"""Robots that coordinate the swarm by themselves publish, bit for bit, what observer and parent controller would."""

from collections.abc import Iterator
from itertools import takewhile
from random import Random

import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_config import configure
from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_core.behaviours import Controller, Peer
from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    PARENT_STATES,
    RELAY,
    Message,
    PlaneState,
    RecordingProgress,
    Relay,
    topic_of,
)
from swarmabs_core.nodes import NodeKind, NodeName
from swarmabs_run.simulation import Network, nodes_in_process, peers_in_process

DECENTRALISED = "coordination=each_robot"
LOSSES = """
schema: 1
name: losses
duration: 1
swarm:
  generate: {single_integrator: 6, double_integrator: 6, seed: 3}
faults:
  - {kind: join, agent: 7, at: 0.15}
  - {kind: kill, agent: 3, at: 0.25}
  - {kind: leave, agent: 1, at: 0.35}
  - {kind: remove, agent: 5, at: 0.45}
  - {kind: freeze, agent: 2, at: 0.55}
  - {kind: loss, agents: [4], from: 0.05, to: 0.7, probability: 0.3}
  - {kind: lie, agent: 8, from: 0.6, to: 0.8, position_offset: 0.01}
  - {kind: duplication, agents: [9], probability: 0.5}
  - {kind: reference, offset: 0.02, at: 0.5}
"""


def published(scenario: Scenario) -> dict[str, list[bytes]]:
    """Run all nodes; return what they publish for a bag, by topic."""
    named = peers_in_process(scenario) if scenario.decentralised else nodes_in_process(scenario)
    network = Network(named.values())
    network.start()
    found: dict[str, list[bytes]] = {}
    for message in network.deliver():
        if not isinstance(message, Relay):
            found.setdefault(topic_of(message).name, []).append(encode(message))
    return {name: sorted(payloads) for name, payloads in found.items()}


@pytest.mark.parametrize(
    "links",
    [
        "{}",
        "{loss: 0.5}",
        "{type: ring}",
        "{type: ring, loss: 0.5, sensing: [2]}",
        "{type: listed, pairs: [1 2, 2 3, 2 4], loss: 0.2}",
    ],
)
@pytest.mark.parametrize("name", ["pd_het_4", "arise_het_4"])
def test_four_robots_are_what_observer_and_controller_are(name: str, links: str) -> None:
    central = builtin(name, "duration=0.5")
    alone = builtin(name, "duration=0.5", DECENTRALISED, f"links={links}")
    assert published(alone) == published(central)


def test_robots_that_die_leave_join_and_lie_change_nothing() -> None:
    links = "links={type: random, degree: 6, loss: 0.5, sensing: [4, 10]}"
    assert published(parse_scenario(LOSSES, overrides=[DECENTRALISED, links])) == published(parse_scenario(LOSSES))


def test_an_estimated_torque_needs_the_parent_at_every_robot() -> None:
    estimated = "observer={type: parent_response, bandwidth: 60}"
    alone = builtin("pd_het_4", "duration=0.5", estimated, DECENTRALISED, "links={type: ring, sensing: [3]}")
    assert published(alone) == published(builtin("pd_het_4", "duration=0.5", estimated))


def rounds(scenario: Scenario) -> Iterator[Relay]:
    network = Network(peers_in_process(scenario).values())
    network.start()
    return (message for message in network.deliver() if isinstance(message, Relay))


@pytest.mark.system
def test_few_rounds_and_one_datagram_are_enough() -> None:
    """Of 200 robots with 6 neighbours: 10 rounds if half of all is lost; of 80, each message fits 1,472 bytes."""
    large = builtin("arise_het_200", "duration=0.01", DECENTRALISED, "links={type: random, loss: 0.5}")
    first = takewhile(lambda relay: relay.step == 0, rounds(large))
    incomplete = [relay.round for relay in first if not relay.complete]
    assert 5 <= max(incomplete) + 1 <= 10
    swarm = "swarm={generate: {single_integrator: 40, double_integrator: 40, seed: 1}}"
    eighty = builtin("arise_het_20", "duration=0.01", DECENTRALISED, "links={type: random, loss: 0.2}", swarm)
    assert max(len(encode(relay)) for relay in rounds(eighty) if relay.step) <= 1472


def test_any_order_and_repetition_of_what_arrives_gives_the_same() -> None:
    """Messages of all robots are delivered in random order, half of them again later."""
    scenario = builtin("pd_het_4", "duration=0.1", DECENTRALISED, "links={type: ring, loss: 0.3}")
    expected = published(builtin("pd_het_4", "duration=0.1"))
    for seed in range(5):
        draw = Random(seed)
        nodes = peers_in_process(scenario).values()
        waiting = [message for node in nodes for message in node.behaviour.start()]
        found: dict[str, set[bytes]] = {}
        while waiting:
            message = waiting.pop(draw.randrange(len(waiting)))
            topic = topic_of(message)
            if not isinstance(message, Relay):
                found.setdefault(topic.name, set()).add(encode(message))
            hearing = [node for node in nodes if topic in node.hears]
            waiting += [answer for node in hearing for answer in node.behaviour.handle(message)]
            if draw.random() < 0.5:
                waiting += [answer for node in hearing for answer in node.behaviour.handle(message)]
        assert {name: sorted(payloads) for name, payloads in found.items()} == expected


def test_a_robot_uses_only_what_it_hears() -> None:
    """Robot 1 of a ring knows a state that only robots 2 and 3 could have passed on, after the rounds that it takes."""
    scenario = builtin("pd_het_4", "duration=0.1", DECENTRALISED, "links={type: listed, pairs: [1 2, 2 3, 3 4]}")
    chain = {peer.agent_id: peer for peer in configure.peers(scenario, range(1, 5), recorded=False)}
    assert [peer.neighbours for peer in chain.values()] == [(2,), (1, 3), (2, 4), (3,)]
    complete = {}
    for relay in rounds(scenario):
        if relay.step == 3 and relay.complete:
            complete.setdefault(relay.agent_id, relay.round)
    assert complete == {1: 3, 2: 2, 3: 2, 4: 3}  # the ends are three links apart
    one = chain[1]
    assert [type(message) for message in one.start()] == [Relay], "its state is given once it knows those of all"
    assert one.handle(PlaneState(0, 0, 0.1, 0.0)) == ()
    assert one.missing() == (0, ("agent 2",))


def test_robots_cut_off_by_the_end_of_others_say_so() -> None:
    ends = "faults=[{kind: kill, agent: 2, at: 0.03}, {kind: leave, agent: 4, at: 0.05}]"
    scenario = builtin("pd_het_4", "duration=0.1", DECENTRALISED, "links={type: ring}", ends)
    with pytest.raises(RunError, match="step 6: robot 3 is cut off from robot 1"):
        published(scenario)
    blind = builtin("pd_het_4", "duration=0.1", DECENTRALISED, "links={sensing: [2]}", ends)
    with pytest.raises(RunError, match="step 4: no robot is left that hears the parent"):
        published(blind)


def test_the_run_waits_for_its_recorder() -> None:
    scenario = builtin("pd_het_4", "duration=2", DECENTRALISED)
    nodes = {**peers_in_process(scenario)}
    peers = configure.peers(scenario, range(1, 5))
    plane = nodes[NodeName(NodeKind.PARENT)]
    waiting: list[Message] = [*plane.behaviour.start(), *(message for peer in peers for message in peer.start())]
    steps = 0

    def settle() -> int:
        newest = 0
        while waiting:
            message = waiting.pop(0)
            if isinstance(message, PARENT_STATES):
                newest = message.step
            waiting.extend(plane.behaviour.handle(message) if topic_of(message) in plane.hears else ())
            for peer in peers:
                if topic_of(message) in peer.needs:
                    waiting.extend(peer.handle(message))
        return newest

    window = configure.recording_window(scenario)
    steps = settle()
    assert steps == window
    assert {peer.missing() for peer in peers} == {(window + 1, ("recorder",))}
    waiting.append(RecordingProgress(0, 0, 40))
    assert settle() == window + 41
    assert Controller(configure.controller_config(scenario, recording_window=window)).awaits()
    assert all(isinstance(peer, Peer) and RELAY not in peer.needs for peer in peers)
