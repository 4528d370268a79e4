"""A node that does not belong to the swarm publishes on its topics: what it says has no effect, or ends the run."""

from collections.abc import Callable
from typing import Any

import pytest
from tests.swarmabs_core.helpers import builtin, singly
from tests.transport.network import Act, script
from tests.transport.swarm import AGENTS, Cast, Node, Swarm

from swarmabs_bag.run.step import Step
from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BROADCAST,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    STEERING,
    SWARM_STATES,
    Action,
    EventKind,
    SwarmEvent,
    SwarmStates,
    Topic,
)
from swarmabs_run.orchestration.supervision import Supervision
from swarmabs_run.run import RunOptions
from swarmabs_run.simulation import Simulation

STEPS = 6
SCENARIO = builtin("pd_het_4", f"duration={STEPS * 0.01}", f"swarm.agents=[{', '.join(AGENTS)}]")
OPTIONS = {
    "single": RunOptions(),
    "packed": RunOptions(packed=True),
    "steered": RunOptions(packed=True, steered=True),
}
FORGED: dict[Topic, Callable[[Any], Any]] = {
    PLANE_STATE: lambda m: m._replace(angle=m.angle + 0.01),
    AGENT_STATE: lambda m: m._replace(position=m.position + 0.01),
    ABSTRACT_STATE: lambda m: m._replace(torque=m.torque + 0.2),
    AUXILIARY_STATE: lambda m: m._replace(s0=2.0 * m.s0),
    DESIRED_ABSTRACT_STATE: lambda m: m._replace(torque=m.torque + 0.2),
    BROADCAST: lambda m: m._replace(abstract=m.abstract._replace(torque=m.abstract.torque + 0.2)),
    SWARM_STATES: lambda m: SwarmStates(m.stamp, m.step, m.states[:-8] + bytes(8)),
    STEERING: lambda m: m._replace(request=1, action=Action.DISTURBANCE, value=0.1),
}
"""What a stranger makes of a message of each topic."""


class Beset(Swarm):
    """A swarm in whose network somebody publishes a forged message just before the genuine one of a step, or after."""

    def __init__(self, cast: Cast, seed: int, topic: Topic, step: int, *, first: bool) -> None:
        self._forged, self._step, self._first, self.forged = topic, step, first, 0
        super().__init__(cast, script(seed, 25))

    def _publish(self, sender: Node, topic: Topic, data: bytes) -> None:
        message = decode(topic.message, data) if topic is self._forged else None
        due = message is not None and message.step == self._step and not self.forged
        if due and self._first:
            self._forge(topic, message)
        super()._publish(sender, topic, data)
        if due and not self._first:
            self._forge(topic, message)

    def _meet(self, act: Act, index: int) -> None:
        """Lose no genuine message of the forged step: who has never heard it cannot compare."""
        parcel = self._under_way[index]
        if parcel.topic is self._forged and decode(parcel.topic.message, parcel.data).step == self._step:
            self._under_way[index] = parcel._replace(reliable=True)
        super()._meet(act, index)

    def _forge(self, topic: Topic, message: Any) -> None:
        self.forged += 1
        self.intrude(topic, encode(FORGED[topic](message)))


def payloads(steps: list[Step]) -> list[list[bytes]]:
    return [[record.payload for record in step.records] for step in steps]


SIMULATED = payloads(singly(Simulation(SCENARIO).steps()))


@pytest.mark.parametrize("topic", FORGED, ids=lambda topic: topic.name)
@pytest.mark.parametrize("options", OPTIONS)
def test_what_a_stranger_publishes_has_no_effect_or_ends_the_run(options: str, topic: Topic) -> None:
    cast, forged, ended = Cast(SCENARIO, OPTIONS[options]), 0, 0
    for seed in range(2):
        for step in (0, 2, STEPS - 1, STEPS):
            for first in (True, False):
                swarm = Beset(cast, seed, topic, step, first=first)
                finished = swarm.run()
                forged += swarm.forged
                if swarm.problems:
                    ended += 1
                    texts = [str(problem) for problem in swarm.problems.values()]
                    assert all("is a second swarm in this namespace?" in text for text in texts), texts
                else:
                    assert finished, (seed, step, first)
                    assert payloads(swarm.recorded) == SIMULATED, (
                        seed,
                        step,
                        first,
                        "the forged message had an effect",
                    )
    published = any(topic in role.endpoints.publications for role in cast.roles)
    assert bool(forged) == published
    assert ended >= forged / 3, "most of them are noticed"


@pytest.mark.parametrize("kind", [EventKind.DEAD, EventKind.LEFT, EventKind.JOINED])
def test_an_event_that_ends_a_robot_which_nothing_ends_ends_the_run(kind: EventKind) -> None:
    swarm = Swarm(Cast(SCENARIO))
    while not swarm.published:
        swarm.step()
    swarm.intrude(EVENTS, encode(SwarmEvent(30_000_000, 3, 2, kind, 0.0, "")))
    assert not swarm.run(until=4.0)
    assert any("is a second swarm in this namespace?" in str(problem) for problem in swarm.problems.values())


@pytest.mark.parametrize("forged", [False, True])
def test_an_event_is_recorded_unnoticed_only_if_a_node_has_published_it(forged: bool) -> None:  # noqa: FBT001
    scenario = builtin("pd_het_4", "duration=0.06", "faults=[{at: 0.03, kind: kill, agent: 2}]")
    swarm = Swarm(Cast(scenario), script(7, 25))
    while not swarm.published:
        swarm.step()
    if forged:
        swarm.intrude(EVENTS, encode(SwarmEvent(30_000_000, 3, 2, EventKind.SAFE_STOP, 0.0, "")))
    assert swarm.run()
    state = Supervision(tuple(swarm.nodes))
    for report in ("publishes", "recorded"):
        for node in swarm.nodes.values():
            for details in node.reports.of(report):
                state.take({"node": node.name, "event": report, **details})
    assert len([event for step in swarm.recorded for event in step.events]) == 1 + forged
    assert str(state.failure).count("an event 'safe stop' of robot 2 of step 3 that no node") == forged
