from dataclasses import replace
from typing import Any

import pytest
from tests.swarmabs_core.helpers import PERIOD_NS, agent_state

from swarmabs_core import messages as msg, plant
from swarmabs_core.behaviours import Parent
from swarmabs_core.behaviours.base import ConflictError, StepAheadError, UnexpectedMessageError, UnknownAgentError
from swarmabs_core.behaviours.packed import PackedParent
from swarmabs_core.cdr import encode
from swarmabs_core.errors import MalformedMessageError, RunError
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.models import PlaneConfig
from swarmabs_core.plant import Disturbance, Friction, RobotPath
from swarmabs_core.sensing import Sensor

H = PERIOD_NS / 1e9
MASS = 0.5
FRICTION, DISTURBANCE = Friction(0.01, 30.0, 20.0, 0.02, 30.0, 1.0), Disturbance(0.3, 4.0)
PLANE = plant.Plane(inertia=0.5, friction=FRICTION, angle=0.1, angular_velocity=-0.2, disturbance=DISTURBANCE)


def plane(*schedule: Change, **options: Any) -> Parent:
    body = replace(PLANE, **{name: options.pop(name) for name in ("end_stop", "sensor") if name in options})
    given = {"members": (1, 2, 3), "period_ns": PERIOD_NS, "plane": body, "schedule": schedule}
    return Parent(PlaneConfig(**{**given, **options}))


def robots(step: int = 0, without: tuple[int, ...] = ()) -> list[msg.AgentState]:
    """Two single integrators and a double integrator, moving fast."""
    moves = [
        agent_state(1, step, position=0.1 + 0.03 * step, velocity=3.0),
        agent_state(2, step, position=-0.2 + 0.02 * step, velocity=2.0),
        agent_state(
            3, step, kind=msg.Kind.DOUBLE_INTEGRATOR, damping=1.0, position=0.3 - 0.01 * step, velocity=1.0 - step
        ),
    ]
    return [state for state in moves if state.agent_id not in without]


def feed(node: Parent, messages: list[msg.AgentState]) -> list[msg.Message]:
    return [answer for message in messages for answer in node.handle(message)]


def angle(node: Parent, messages: list[msg.AgentState]) -> tuple[float, float]:
    """Feed the last messages of a step and return the plane's state."""
    *_, state = feed(node, messages)
    assert isinstance(state, msg.PlaneState)
    return state.angle, state.angular_velocity


def paths(step: int) -> list[RobotPath]:
    """Return how robots move in a period: single integrators on straight lines, double integrators on cubics."""
    before, after = robots(step), robots(step + 1)
    lines = [plant.straight(MASS, a.position, b.position) for a, b in zip(before[:2], after[:2], strict=True)]
    ends = [(state.position, state.velocity) for state in (before[2], after[2])]
    return [*lines, plant.hermite(MASS, *ends, H)]


def moved(start: tuple[float, float], step: int, robots: list[RobotPath]) -> tuple[float, float]:
    """Return the plane's state after a period under robots on given paths (`test_plant` shows that it is so)."""
    return plant.PlaneDynamics(PLANE, H).advance(*start, step * H, plant.swarm_load(robots, 9.81))


def test_robots_move_on_paths_through_their_states_and_weigh_from_their_first_on() -> None:
    node, state = plane(), (0.1, -0.2)
    feed(node, robots(0))
    for step in (0, 1):
        state, expected = angle(node, robots(step + 1)), moved(state, step, paths(step))
        assert state == expected
    node = plane(Change(1, 3, ChangeKind.JOIN))
    feed(node, robots(0, without=(3,)))
    state = angle(node, robots(1))
    assert state == moved((0.1, -0.2), 0, paths(0)[:2])
    assert angle(node, robots(2)) == moved(state, 1, paths(1))


def test_the_initial_state_comes_with_the_last_robot_and_the_run_ends_with_its_last_step() -> None:
    node = plane(last_step=0)
    assert node.start() == ()
    assert feed(node, robots()[1:]) == []
    assert node.missing() == (0, ("agent 1",))
    assert node.awaits() == (msg.AGENT_STATE, msg.EVENTS)
    assert feed(node, robots()[:1]) == [msg.PlaneState(0, 0, 0.1, -0.2)]
    assert node.awaits() == ()
    assert feed(node, robots(1)) == []


def test_what_no_correct_peer_sends() -> None:
    node = plane()
    feed(node, robots()[:2])
    refused: dict[msg.Message, type[Exception]] = {
        agent_state(9): UnknownAgentError,
        agent_state(3, 1): StepAheadError,
        agent_state(1, position=0.3): ConflictError,
        msg.AbstractState(0, 0, 3, 0.0, 0.0, 0.0, 0.0): UnexpectedMessageError,
    }
    for message, error in refused.items():
        with pytest.raises(error):
            node.handle(message)
    assert feed(node, robots()[2:]) == [msg.PlaneState(0, 0, 0.1, -0.2)]


@pytest.mark.parametrize(
    ("schedule", "says", "weighs"),
    [
        ((Change(1, 3, ChangeKind.KILL),), msg.Status.ACTIVE, (True, True)),
        ((Change(1, 3, ChangeKind.FREEZE),), msg.Status.ACTIVE, (True, True)),
        ((), msg.Status.LEFT, (True, False)),
    ],
)
def test_robot_that_ends_stands_and_one_that_leaves_weighs_until_the_next_step(
    schedule: tuple[Change, ...], says: msg.Status, weighs: tuple[bool, bool]
) -> None:
    node = plane(*schedule)
    feed(node, robots(0))
    state = angle(node, [*robots(1)[:2], robots(1)[2]._replace(status=says)])
    stands = plant.standing(MASS, robots(1)[2].position)
    for step, there in zip((1, 2), weighs, strict=True):
        expected = moved(state, step, [*paths(step)[:2], *[stands] * there])
        state = angle(node, robots(step + 1, without=(3,)))
        assert state == expected


def test_an_end_that_the_observer_tells_holds_unless_the_plane_has_moved_on() -> None:
    dead = msg.SwarmEvent(PERIOD_NS, 1, 3, msg.EventKind.DEAD, 0.3, "silent")
    node = plane()
    feed(node, robots(0) + robots(1))
    with pytest.raises(RunError, match=r"robot 3 is reported to be out from step 1 on \(silent\), but the parent has"):
        node.handle(dead)
    node = plane()
    feed(node, robots(0))
    with pytest.raises(StepAheadError, match=r"end of robot 3: step 1 expected, 2 received"):
        node.handle(dead._replace(step=2))
    node = plane()
    feed(node, robots(0) + robots(1, without=(1,)))
    assert node.handle(dead) == ()  # heard, but not used
    assert len(feed(node, [agent_state(1, 1), *robots(2, without=(3,))])) == 2
    assert node.handle(dead) == ()  # repeated
    assert node.handle(msg.SwarmEvent(PERIOD_NS, 1, 2, msg.EventKind.LIMIT_HIT, 0.3, "")) == ()
    node, twin = plane(), plane(Change(0, 3, ChangeKind.KILL))
    assert feed(node, robots(0)) == feed(twin, robots(0))
    assert feed(node, robots(1, without=(3,))) == []
    found = node.handle(msg.SwarmEvent(PERIOD_NS, 1, 3, msg.EventKind.DEAD, 0.3, "no answer"))
    assert list(found) == feed(twin, robots(1, without=(3,)))


def test_end_of_the_plane_is_told_once_per_crossing() -> None:
    node = plane()
    found = []
    for step, position in enumerate((0.4, 0.5, 0.51, 0.52, 0.4, -0.6)):
        answers = feed(node, [agent_state(1, step, position=position), *robots(step)[1:]])
        found += [event for event in answers if isinstance(event, msg.SwarmEvent)]
    assert [(e.step, e.agent_id, e.kind, e.value) for e in found] == [
        (2, 1, msg.EventKind.LIMIT_HIT, 0.51),
        (4, 1, msg.EventKind.LIMIT_HIT, 0.4),
        (5, 1, msg.EventKind.LIMIT_HIT, -0.6),
    ]


@pytest.mark.parametrize(("lag", "curved"), [(0.0, False), (0.24 * H, False), (0.25 * H, True), (1.0, True)])
def test_a_lag_as_long_as_a_part_of_the_period_makes_the_path_a_cubic(lag: float, *, curved: bool) -> None:
    states = [agent_state(1, step, position=0.1 + 0.01 * step, velocity=1.0 - 2.0 * step) for step in (0, 1)]
    node = plane(members=(1,), actuator_lag=lag)
    feed(node, states[:1])
    ends = [(state.position, state.velocity) for state in states]
    path = plant.hermite(MASS, *ends, H) if curved else plant.straight(MASS, ends[0][0], ends[1][0])
    assert angle(node, states[1:]) == moved((0.1, -0.2), 0, [path])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_end_stop_is_announced_once_per_hit_with_its_side(side: float) -> None:
    node = plane(members=(1,), end_stop=0.11)
    hits: list[msg.SwarmEvent] = []
    for step in range(120):
        position = side * (0.3 if 40 <= step < 60 else -0.3)
        *said, state = feed(node, [agent_state(1, step, position=position)])
        hits += [event for event in said if isinstance(event, msg.SwarmEvent)]
        assert isinstance(state, msg.PlaneState)
        assert abs(state.angle) <= 0.11
    assert [(event.agent_id, event.kind, event.value) for event in hits] == [
        (0, msg.EventKind.LIMIT_HIT, side * 0.11)
    ] * 2
    assert hits[0].step < 40 and hits[1].step > 60
    assert hits[0].detail.startswith("end stop hit at 0.")


def test_what_is_published_is_measured_and_what_is_integrated_is_true() -> None:
    sensor = Sensor((0.01, 0.1), (0.001, 0.0))
    measuring, true = plane(sensor=sensor, seed=4), plane()
    for step in range(5):
        expected = sensor.measure(*angle(true, robots(step)), f"4:{step}:plane")
        assert angle(measuring, robots(step)) == expected


def test_packed_states_count_like_single_ones_and_only_where_they_are_expected() -> None:
    alone, packed = plane(), PackedParent(PlaneConfig(PERIOD_NS, members=(1, 2, 3), plane=PLANE))
    assert packed.awaits() == (msg.SWARM_STATES, msg.EVENTS)
    assert packed.missing() == (0, ("abstraction_observer",))
    for step in range(3):
        message = msg.SwarmStates(step * PERIOD_NS, step, b"".join(map(encode, robots(step))))
        assert list(packed.handle(message)) == feed(alone, robots(step))
        assert packed.handle(message) == (), "repeated"
    with pytest.raises(ConflictError, match="agent 2"):
        packed.handle(msg.SwarmStates(0, 3, b"".join(encode(agent_state(2, 3, position=p)) for p in (0.1, 0.2))))
    with pytest.raises(MalformedMessageError, match="malformed AgentState: 91 bytes, expected 92"):
        packed.handle(msg.SwarmStates(0, 3, encode(agent_state(1, 3))[:-1]))
    with pytest.raises(UnexpectedMessageError):
        alone.handle(msg.SwarmStates(0, 3, b""))
