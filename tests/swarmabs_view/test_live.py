"""What pages get of a swarm that goes on: state machines on a clock that the test turns."""

import math
import random
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.swarmabs_bag.sample_run import make_run, make_step
from tests.swarmabs_core.helpers import builtin
from tests.swarmabs_view.conftest import HELLO, PRESENTER, told

from swarmabs_bag.shown.percentiles import QUANTILES
from swarmabs_bag.shown.swarm_state import Instant, RobotIdentity, SwarmState
from swarmabs_config.graph import SILENCE
from swarmabs_core.messages import EventKind, Kind, PlaneState, SwarmEvent
from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass
from swarmabs_view import protocol
from swarmabs_view.facts import Shading, hello_of, regions
from swarmabs_view.live import RATE_WINDOW, LiveSession, LiveView, StepRate
from swarmabs_view.presenter import Placed, sides
from swarmabs_view.session import NOTHING, CurveBuffer, Session


def view_of(steps: int = 0) -> LiveView:
    made = LiveView(HELLO, SwarmState())
    for message in make_run(steps) if steps else ():
        made.add(message)
    return made


def types(said: list[protocol.Message]) -> list[str]:
    return [type(message).__name__ for message in said]


def test_a_page_gets_the_past_first_and_then_what_is_new_also_a_robot_that_is_heard_later() -> None:
    live = view_of(20)
    session = LiveSession(live)
    said = session.poll(0.0)
    assert types(said) == ["Hello", "Curves", "Positions", "Events", "Frame", "State"]
    assert [robot.id for robot in told(said, protocol.Hello)[0].robots] == [1, 2, 7]
    assert [(curves.replace, len(curves.time)) for curves in told(said, protocol.Curves)] == [(True, 21)]
    assert len(told(said, protocol.Events)[0].events) == 1
    assert told(said, protocol.Frame)[0].step == 20
    assert session.poll(0.1) == []
    for message in make_step(21):
        live.add(message)
    said = session.poll(0.2)
    assert types(said) == ["Curves", "Frame"]
    assert [(curves.replace, curves.time) for curves in told(said, protocol.Curves)] == [(False, [0.21])]
    for message in make_step(22, agents=(1, 2, 5, 7)):
        live.add(message)
    said = session.poll(0.3)
    assert types(said)[0] == "Hello"
    assert [robot.id for robot in told(said, protocol.Hello)[0].robots] == [1, 2, 5, 7]
    assert len(told(said, protocol.Frame)[0].robots.position) == 4
    assert sum(len(message.events) for message in told(said, protocol.Events)) == 1  # none is lost


def test_a_page_gets_the_heights_of_robots_that_are_not_flat() -> None:
    scenario = builtin("pd_si_4", "swarm.agents.2.center_height=0.03")
    for shown, heights in ((scenario, {3: 0.03}), (builtin("pd_si_4"), {})):
        plane = hello_of("run", "title", "place", shown).plane
        assert plane is not None
        assert plane.heights == heights


def test_of_the_events_only_the_new_ones_are_sent_and_those_in_their_order() -> None:
    live = view_of(20)
    session = LiveSession(live)
    assert len(told(session.poll(0.0), protocol.Events)[0].events) == 1
    for step in (21, 22):
        live.add(SwarmEvent(0, step, 1, EventKind.SAFE_STOP, 0.0, ""))
    (events,) = told(session.poll(0.1), protocol.Events)
    assert (events.replace, [event.step for event in events.events]) == (False, [21, 22])


def test_something_is_said_every_second() -> None:
    session = LiveSession(view_of())
    times = [time / 10 for time in range(40) if session.poll(time / 10)]
    assert times == [0.0, 1.0, 2.0, 3.0]


def test_a_swarm_that_makes_no_step_is_silent_until_it_does() -> None:
    live = view_of(3)
    live.refresh(0.0)
    assert live.phase == "running"
    live.refresh(SILENCE)
    assert (live.phase, live.text) == ("silent", "no step since 3")
    for message in make_step(4):
        live.add(message)
    live.refresh(SILENCE + 0.2)
    assert live.phase == "running"


def test_a_paused_run_is_not_silent_and_has_time_to_go_on() -> None:
    live = view_of(3)
    live.refresh(0.0)
    live.paused = True
    for now in (0.1, 10.0 * SILENCE):
        live.refresh(now)
        assert (live.phase, live.text) == ("paused", "at step 3")
    live.paused = False
    live.refresh(10.5 * SILENCE)
    assert live.phase == "running"
    live.refresh(11.0 * SILENCE)
    assert (live.phase, live.text) == ("silent", "no step since 3")
    fresh = view_of()
    fresh.paused = True
    fresh.refresh(0.0)
    assert (fresh.phase, fresh.text) == ("paused", "")


def test_what_goes_on_cannot_be_played_and_what_follows_can() -> None:
    class After(Session):
        wishes = 0

        def poll(self, now: float) -> list[protocol.Message]:
            return [protocol.State(phase="recorded", text=f"{now}")]

        def control(self, request: object) -> None:
            assert request == protocol.Play(v=2, type="play")
            self.wishes += 1

    after: list[After] = []
    session = LiveSession(view_of(3), lambda: after[0] if after else None)
    session.control(protocol.Play(v=2, type="play"))
    session.poll(0.0)
    after.append(After(view_of()))
    assert types(session.poll(0.2)) == ["State"]
    session.control(protocol.Play(v=2, type="play"))
    assert after[0].wishes == 1


def test_step_rate_is_that_of_the_last_seconds() -> None:
    rate = StepRate()
    assert rate.at(0.0) is None
    for tenth in range(100):  # 10 s at 50 steps/s, then 10 s at 500
        rate.take(tenth / 10, tenth * 5)
    assert rate.at(9.9) == pytest.approx(50.0, rel=0.06)
    for tenth in range(100):
        rate.take(10 + tenth / 10, 500 + tenth * 50)
    assert rate.at(19.9) == pytest.approx(500.0, rel=0.06)
    live = view_of()  # while no page is open, only the window is kept
    for look in range(3000):
        live.add(PlaneState(look * 10**7, look, 0.0, 0.0))
        live.refresh(look / 100)
    assert len(live.rate) <= RATE_WINDOW * 100 + 2
    assert live.rate.at(29.99) == pytest.approx(100.0)
    assert live.rate.at(31.99) == pytest.approx(0.0, abs=1.0), "time without a step counts"


def sets(*known: Any) -> protocol.Regions:
    found = regions(*known)
    assert found is not None
    return found


def test_boundaries_of_the_sets_are_those_of_the_classes() -> None:
    masses, length, gravity = [0.3552, 0.3532, 0.6762, 0.4596], 1.0, 9.81
    found = sets(masses, length, gravity, 5.0)
    assert found.torque == sorted(found.torque)
    rows = zip(found.torque, found.smallest, found.admissible, found.reachable, strict=True)
    for torque, smallest, admissible, reachable in list(rows)[::20]:
        assert smallest is not None and admissible is not None and reachable is not None
        for inertia, expected in (
            (smallest * 0.99 - 1e-6, StateClass.EMPTY),
            ((smallest + admissible) / 2, StateClass.ADMISSIBLE),
            ((admissible + reachable) / 2, StateClass.PARTIAL),
            (reachable * 1.01, StateClass.UNREACHABLE),
        ):
            assert ConstraintSets(masses, length, gravity).classify(torque, inertia) is expected
    # A torque that no robots on the plane give is not shown.
    found = sets([0.1, 0.1], 1.0, 10.0, 5.0)
    assert max(found.torque) == pytest.approx(1.0)
    assert found.reachable[-1] == pytest.approx(0.05)


def test_weights_that_stand_still_shift_the_sets() -> None:
    """Any positions on the plane of those who move give, with the weights that stand still, a state within."""
    masses, standing, length, gravity = [0.35, 0.4, 0.6], [(0.5, 0.3), (0.2, -0.45)], 1.0, 9.81
    found = sets(masses, length, gravity, 8.0, standing)
    draw = random.Random(5)
    for _ in range(300):
        places = [draw.uniform(-0.5, 0.5) for _ in masses]
        weights = [*zip(masses, places, strict=True), *standing]
        torque = gravity * sum(mass * place for mass, place in weights)
        inertia = sum(mass * place**2 for mass, place in weights)
        smallest, reachable = (
            float(np.interp(torque, found.torque, np.array(one, dtype=float)))
            for one in (found.smallest, found.reachable)
        )
        assert smallest - 1e-3 < inertia < reachable + 1e-3
    # All who move at one end: the largest torque, at which there is one inertia.
    ends = [*((mass, 0.5) for mass in masses), *standing]
    assert found.torque[-1] == pytest.approx(gravity * sum(mass * place for mass, place in ends))
    assert found.smallest[-1] == found.admissible[-1] == pytest.approx(sum(mass * place**2 for mass, place in ends))
    assert regions(masses[:1], length, gravity, 5.0, standing) is None
    assert regions(masses, length, gravity, 5.0, [(0.5, math.nan)]) is None


def test_the_sets_follow_who_takes_part_and_nobody_waits_for_them() -> None:
    robots = [
        protocol.RobotInfo(id=n, kind="single_integrator", constants=[0.4, 0.0], joins=n == 9) for n in (1, 2, 7, 9)
    ]
    identities = [RobotIdentity(n, Kind.SINGLE_INTEGRATOR, (0.4, 0.0), joins=n == 9) for n in (1, 2, 7, 9)]
    plane = protocol.Plane(length=1.0, inertia=0.1, gravity=9.81)
    known = {
        "robots": robots,
        "plane": plane,
        "manifold": protocol.Manifold(curvature=0.1, offset=0.02, torque_max=5.0),
    }
    first = regions([0.4] * 3, 1.0, 9.81, 5.0)
    hello = HELLO.model_copy(update={**known, "regions": first})
    live = LiveView(hello, SwarmState(identities))
    waiting: list[Callable[[], None]] = []

    def begin(work: Callable[[], None]) -> Any:
        assert not waiting, "one is computed at a time"
        waiting.append(work)
        return SimpleNamespace(is_alive=lambda: bool(waiting))

    live.shading = Shading(hello, begin)
    pages = [LiveSession(live), LiveSession(live)]
    for page in pages:
        page.poll(0.0)

    def after(step: int, *events: SwarmEvent) -> list[list[protocol.Sets]]:
        for message in [*events, *make_step(step)]:
            live.add(message)
        said = [page.poll(step / 10) for page in pages]
        assert all("Frame" in types(messages) for messages in said)  # which come also while the sets are computed
        while waiting:
            waiting.pop()()
        return [
            told([*messages, *page.poll(step / 10)], protocol.Sets) for messages, page in zip(said, pages, strict=True)
        ]

    def event(step: int, robot: int, kind: EventKind) -> SwarmEvent:
        return SwarmEvent(step, step, robot, kind, 0.25, "")

    assert after(0) == [[], []]
    joined = protocol.Sets(moving=[1, 2, 7, 9], standing=[], regions=regions([0.4] * 4, 1.0, 9.81, 5.0))
    assert after(1, event(1, 9, EventKind.JOINED)) == [[joined], [joined]]
    died = protocol.Sets(moving=[1, 7, 9], standing=[2], regions=regions([0.4] * 3, 1.0, 9.81, 5.0, [(0.4, 0.25)]))
    assert after(2, event(2, 2, EventKind.DEAD)) == [[died], [died]]
    assert after(3) == [[], []]
    ((alone,), _) = after(4, event(4, 1, EventKind.LEFT), event(4, 9, EventKind.LEFT))
    assert (alone.moving, alone.regions) == ([7], None)
    late = LiveSession(live)
    assert told(late.poll(1.0), protocol.Sets) == [alone]


def point(step: int) -> Instant:
    return Instant(step, 0, step / 100, (step * 0.5, 0.0), (), (1.0, 3.0), (2.0, 4.0))


def since(buffer: CurveBuffer[Instant], epoch: int = -1, count: int = 0) -> protocol.Curves:
    """Return the points after those that are known, of which there are some."""
    found = buffer.since((epoch, count))
    assert found is not None
    return PRESENTER.curves(*found)


def test_the_beginning_comes_later_and_whole() -> None:
    buffer: CurveBuffer[Instant] = CurveBuffer(most=10)
    for step in (6, 7, 8):
        buffer.add(point(step))
    known = buffer.mark
    buffer.begin((point(step) for step in range(8)), 6)  # of which some have been heard
    found = since(buffer, *known)
    assert (found.replace, found.time) == (True, [step / 100 for step in range(9)])
    buffer.add(point(9))
    buffer.add(point(10))
    assert since(buffer).time == [step / 100 for step in range(0, 11, 2)]


def test_curves_have_no_gap_where_robots_are_discovered_one_after_the_other() -> None:
    identities = [RobotIdentity(n, Kind.SINGLE_INTEGRATOR, (0.4, 0.0)) for n in (1, 2, 7)]
    recorded, live = (LiveView(HELLO, SwarmState(identities)) for _ in range(2))
    assert live.heard_since is None
    for step in range(12):
        for message in make_step(step):
            recorded.add(message)
        for message in make_step(step, agents=(1, 2) if step < 8 else (1, 2, 7)) if step >= 5 else ():
            live.add(message)
    whole, found = LiveSession(recorded), LiveSession(live)
    for view in (recorded, live):
        view.refresh(0.0)
    assert live.heard_since == 8
    (bag,) = told(whole.poll(0.0), protocol.Positions)
    curves, places = recorded.curves, recorded.positions
    live.begin(curves, places, 8)
    (shown,) = told(found.poll(0.0), protocol.Positions)
    assert (shown.time, shown.lines) == (bag.time, bag.lines)
    assert all(place is not None for line in shown.lines for place in line)


def test_positions_are_lines_of_few_robots_and_bands_of_many() -> None:
    live = view_of(20)
    live.refresh(0.0)
    session = LiveSession(live)
    (positions,) = told(session.poll(0.0), protocol.Positions)
    assert (positions.labels, len(positions.time)) == (["robot 1", "robot 2", "robot 7"], 21)
    shown = live.state.shown_robots(20)
    assert [line[-1] for line in positions.lines] == [robot.coordinates[0] for robot in shown]


def test_many_robots_have_bands_on_each_side_of_the_axis_on_which_they_start() -> None:
    """While robots cross the axis, or leave, no line jumps from one side to the other."""
    places = {robot: ((0.1 if robot <= 100 else -0.1) + robot / 1e4,) for robot in range(1, 202)}
    crossed: dict[int, tuple[float, ...]] = {robot: (-place,) for robot, (place,) in places.items()}
    crossed |= {200: (), 201: (), 3: ()}
    points = [Placed(0, 0.0, places), Placed(1, 0.1, crossed)]
    positions = PRESENTER.positions(list(places), points, True, sides(points))
    lines = dict(zip(positions.labels, positions.lines, strict=True))
    for label, part in QUANTILES.items():
        for side, chosen in (("> 0", range(1, 101)), ("≤ 0", range(101, 202))):
            for place, point in enumerate(points):
                known = [x for robot in chosen for x in point.places[robot]]
                assert lines[f"start {side}: {label}"][place] == np.quantile(np.array(known), part)


def test_there_are_never_more_points_than_allowed_and_they_are_evenly_spread() -> None:
    buffer: CurveBuffer[Instant] = CurveBuffer(most=100)
    shown: list[float] = []
    mark = NOTHING
    for step in range(10_000):
        buffer.add(point(step))
        assert len(buffer) <= 100
        if step % 37 == 0 or step == 9_999:  # a page that follows
            found, mark = buffer.since(mark), buffer.mark
            if found is not None:
                times = [kept.time for kept in found[0]]
                shown = times if found[1] else shown + times
    assert shown == since(buffer).time
    steps = [round(time * 100) for time in shown]
    assert steps[0] == 0
    assert {later - earlier for earlier, later in pairwise(steps)} == {128}
    assert steps[-1] > 9_800
