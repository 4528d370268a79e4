"""What can be true of robots, their swarm and its plane, and that nobody else pays for one who says what cannot."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

import pytest
from tests.swarmabs_core.realtime.nodes import CLOCK, at, controller, kinds, observer, scenario, states, sums

from swarmabs_config import realtime as configure
from swarmabs_core.messages import NEVER, AbstractState, AgentState, EventKind, PlaneState, Status, SwarmEvent
from swarmabs_core.realtime.observer import RealtimeObserver, Role
from swarmabs_core.realtime.validation import FASTEST_TURN, Bounds

if TYPE_CHECKING:
    from swarmabs_core.messages import Message

IMPLAUSIBLE = {
    "mass": {"mass": 3.0},
    "great mass": {"mass": 1e9},
    "with the others": {"mass": 1.0},
    "velocity": {"velocity": 1e300},
    "backwards": {"velocity": -200.0},
    "damping": {"damping": 1e300},
}


@pytest.mark.parametrize("name", IMPLAUSIBLE)
def test_a_robot_that_cannot_be_so_is_named_and_counts_as_silent(name: str) -> None:
    node = observer()
    answers: list[Message] = []
    for step in range(100, 130):
        for state in states(step):
            if state.agent_id == 3 and step > 110:
                state = state._replace(**IMPLAUSIBLE[name])  # noqa: PLW2901 - it begins to lie
            answers += node.hear(state, at(step + 0.2))
        answer = node.tick(at(step + 0.5))
        answers += answer
    (refused,) = [m for m in answers if isinstance(m, SwarmEvent) and m.kind == EventKind.REFUSED]
    word = {"backwards": "velocity"}.get(name, name.rsplit(" ", maxsplit=1)[-1])
    assert refused.detail.startswith("robot 3: a ")
    assert word in refused.detail
    assert node.roles[3] is Role.SILENT
    bounds = configure.bounds(scenario())
    assert [bounds.problem(m) for m in sums(answer)] == ["", ""]


def test_robots_at_their_bounds_make_broadcasts_that_are_believed() -> None:
    """What the observer takes, the others must take: else one robot stops all."""
    bounds = configure.bounds(scenario())
    config = configure.observer_config(scenario(), CLOCK)
    for position in (-bounds.reach, bounds.reach):
        for speed in (-bounds.fastest, bounds.fastest):
            node = RealtimeObserver(config)
            masses = (0.001, 0.001, bounds.swarm_mass - 0.003, 0.001)
            for state, mass in zip(states(5), masses, strict=True):
                state = state._replace(position=position, velocity=speed, mass=mass)  # noqa: PLW2901 - at a bound
                assert node.hear(state, at(5.2)) == ()
            answer = node.tick(at(5.5))
            assert [bounds.problem(m) for m in sums(answer)] == ["", ""]


def test_rates_that_no_robots_can_cause_are_refused() -> None:
    bounds = configure.bounds(scenario())
    state = AbstractState(0, 5, 4, 0.0, 0.03, 0.0, 0.0)
    for change in ({"torque_rate": 1e300}, {"inertia_rate": -1e300}):
        assert "robots too fast" in bounds.problem(state._replace(**change))
        assert Bounds(9.81, 1.0, inf).problem(state._replace(**change)) == ""


@pytest.mark.parametrize("rate", [1e6, 1e300, -101.0])
def test_a_plane_that_turns_faster_than_any_does_is_not_answered(rate: float) -> None:
    node = controller()
    assert kinds(node.hear(PlaneState(0, 30, 0.1, rate), at(30.5))) == [EventKind.REFUSED]
    assert "rad/s" in node.health(at(30.5)).values[-1][1]
    assert Bounds(9.81, 1.0).problem(PlaneState(0, 30, 0.1, FASTEST_TURN)) == ""


def test_a_robot_that_leaves_makes_room_for_its_mass() -> None:
    node = observer()
    for step, mass in ((5, 0.5), (6, 1.0)):
        for state in states(step):
            if state.agent_id == 4 and step == 6:
                state = state._replace(status=Status.LEFT)  # noqa: PLW2901 - it takes its weight along
            state = state._replace(mass=mass) if state.agent_id == 3 else state  # noqa: PLW2901
            node.hear(state, at(step + 0.2))
        node.tick(at(step + 0.5))
    late = AgentState(0, 7, NEVER, 3, 2, 1, 1.0, 0.1, 0.13, 0.0, 0.0)
    assert node.hear(late, at(7.2)) == ()
