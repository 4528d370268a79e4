"""What pages get of a swarm that goes on: state machines on a clock that the test turns, and one real listener."""

from __future__ import annotations

import json
import math
import os
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
import rclpy
from tests.processes import until
from tests.swarmabs_bag.sample_run import make_run, make_step

from swarmabs_bag.swarm_state import RobotIdentity, SwarmState
from swarmabs_core.cdr import encode
from swarmabs_core.messages import TOPIC_OF, EventKind, Kind, PlaneState, SwarmEvent
from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass
from swarmabs_ros.endpoints import advertise
from swarmabs_ros.start import SwarmNode, initialise
from swarmabs_view.facts import Shading, regions
from swarmabs_view.listener import Listener
from swarmabs_view.live import RATE_WINDOW, SILENCE, LiveSession, LiveView, StepRate
from swarmabs_view.protocol import (
    Curves,
    Events,
    Frame,
    Hello,
    Manifold,
    Message,
    Plane,
    Play,
    Robot,
    Session,
    Sets,
    State,
)
from swarmabs_view.sources import ProcessWatch

HELLO = Hello(
    source="swarm",
    title="sample",
    place="here",
    period=None,
    last_step=None,
    robots=[],
    plane=None,
    manifold=None,
    regions=None,
    playback=False,
)


def view_of(steps: int = 0) -> LiveView:
    made = LiveView(HELLO, SwarmState())
    for message in make_run(steps) if steps else ():
        made.add(message)
    return made


def types(said: list[Message]) -> list[str]:
    return [type(message).__name__ for message in said]


def test_a_page_gets_the_past_first_and_then_what_is_new() -> None:
    live = view_of(20)
    session = LiveSession(live)
    (hello, events) = session.hello()
    assert isinstance(hello, Hello)
    assert [robot.id for robot in hello.robots] == [1, 2, 7]
    assert isinstance(events, Events)
    said = session.poll(0.0)
    assert types(said) == ["Curves", "Events", "Frame", "State"]
    curves, happened, frame, _ = said
    assert isinstance(curves, Curves)
    assert (curves.replace, len(curves.time)) == (True, 21)
    assert isinstance(happened, Events)
    assert len(happened.events) == 1
    assert isinstance(frame, Frame)
    assert frame.step == 20
    assert session.poll(0.1) == []
    for message in make_step(21):
        live.add(message)
    more = session.poll(0.2)
    assert types(more) == ["Curves", "Frame"]
    assert isinstance(more[0], Curves)
    assert (more[0].replace, more[0].time) == (False, [0.21])


def test_pages_that_come_at_different_times_have_the_same_in_the_end() -> None:
    live = view_of()
    early, late = LiveSession(live), None
    points: dict[str, list[float]] = {"early": [], "late": []}
    early.hello()
    for step in range(50):
        for message in make_step(step):
            live.add(message)
        if step == 30:
            late = LiveSession(live)
            late.hello()
        for name, session in (("early", early), ("late", late)):
            for message in session.poll(step / 10) if session else ():
                if isinstance(message, Curves):
                    points[name] = [*([] if message.replace else points[name]), *message.time]
    assert points["early"] == points["late"] == [step / 100 for step in range(50)]


def test_a_robot_that_is_heard_later_is_introduced() -> None:
    live = view_of(3)
    session = LiveSession(live)
    session.hello()
    session.poll(0.0)
    for message in make_step(4, agents=(1, 2, 5, 7)):
        live.add(message)
    said = session.poll(0.1)
    assert types(said)[:2] == ["Hello", "Events"]
    assert isinstance(said[0], Hello)
    assert [robot.id for robot in said[0].robots] == [1, 2, 5, 7]
    frame = next(message for message in said if isinstance(message, Frame))
    assert len(frame.robots.position) == 4
    assert sum(len(message.events) for message in said if isinstance(message, Events)) == 1  # none is lost


def test_something_is_said_every_second() -> None:
    session = LiveSession(view_of())
    session.hello()
    times = [time / 10 for time in range(40) if session.poll(time / 10)]
    assert times == [0.0, 1.0, 2.0, 3.0]


def test_a_swarm_that_makes_no_step_is_silent_until_it_does() -> None:
    live = view_of(3)
    live.look(0.0)
    assert live.phase == "running"
    live.look(SILENCE + 0.1)
    assert (live.phase, live.text) == ("silent", "no step since 3")
    for message in make_step(4):
        live.add(message)
    live.look(SILENCE + 0.2)
    assert live.phase == "running"


def test_what_goes_on_cannot_be_played_and_what_follows_can() -> None:
    class After(Session):
        wishes = 0

        def hello(self) -> list[Message]:
            return [HELLO]

        def poll(self, now: float) -> list[Message]:
            return [State(phase="recorded", text=f"{now}")]

        def control(self, request: object) -> None:
            assert request == Play(v=1, type="play")
            self.wishes += 1

    after: list[After] = []
    session = LiveSession(view_of(3), lambda: after[0] if after else None)
    session.hello()
    session.control(Play(v=1, type="play"))
    session.poll(0.0)
    after.append(After())
    assert session.poll(0.1) == [HELLO]
    assert types(session.poll(0.2)) == ["State"]
    session.control(Play(v=1, type="play"))
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


def test_while_no_page_is_open_only_the_window_of_the_step_rate_is_kept() -> None:
    live = view_of()
    for look in range(3000):
        live.add(PlaneState(look * 10**7, look, 0.0, 0.0))
        live.look(look / 100)
    assert len(live.rate) <= RATE_WINDOW * 100 + 2
    assert live.rate.at(29.99) == pytest.approx(100.0)


def test_boundaries_of_the_sets_are_those_of_the_classes() -> None:
    masses, length, gravity = [0.3552, 0.3532, 0.6762, 0.4596], 1.0, 9.81
    found = regions(masses, length, gravity, 5.0)
    assert found is not None
    assert found.torque == sorted(found.torque)
    rows = zip(found.torque, found.smallest, found.admissible, found.reachable, strict=True)
    for torque, smallest, admissible, reachable in list(rows)[::20]:
        assert smallest is not None
        assert admissible is not None
        assert reachable is not None
        for inertia, expected in (
            (smallest * 0.99 - 1e-6, StateClass.EMPTY),
            ((smallest + admissible) / 2, StateClass.ADMISSIBLE),
            ((admissible + reachable) / 2, StateClass.PARTIAL),
            (reachable * 1.01, StateClass.UNREACHABLE),
        ):
            assert ConstraintSets(masses, length, gravity).classify(torque, inertia) is expected


def test_weights_that_stand_still_shift_the_sets() -> None:
    """Any positions on the plane of those who move give, with the weights that stand still, a state within."""
    masses, standing, length, gravity = [0.35, 0.4, 0.6], [(0.5, 0.3), (0.2, -0.45)], 1.0, 9.81
    found = regions(masses, length, gravity, 8.0, standing)
    assert found is not None
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
    robots = [Robot(id=n, kind="single_integrator", mass=0.4, damping=0.0, joins=n == 9) for n in (1, 2, 7, 9)]
    identities = [RobotIdentity(n, Kind.SINGLE_INTEGRATOR, 0.4, 0.0, joins=n == 9) for n in (1, 2, 7, 9)]
    plane = Plane(length=1.0, inertia=0.1, gravity=9.81)
    known = {"robots": robots, "plane": plane, "manifold": Manifold(curvature=0.1, offset=0.02, torque_max=5.0)}
    first = regions([0.4] * 3, 1.0, 9.81, 5.0)
    hello = HELLO.model_copy(update={**known, "regions": first})
    live = LiveView(hello, SwarmState(identities))
    waiting: list[Callable[[], None]] = []
    live.shading = Shading(hello, waiting.append)
    pages = [LiveSession(live), LiveSession(live)]
    for page in pages:
        page.hello()

    def told(step: int, *events: SwarmEvent) -> list[list[Sets]]:
        for message in [*events, *make_step(step)]:
            live.add(message)
        said = [page.poll(step / 10) for page in pages]
        assert all("Frame" in types(messages) for messages in said)  # which come also while the sets are computed
        while waiting:
            waiting.pop()()
        said = [[*messages, *page.poll(step / 10)] for messages, page in zip(said, pages, strict=True)]
        return [[message for message in messages if isinstance(message, Sets)] for messages in said]

    def event(step: int, robot: int, kind: EventKind) -> SwarmEvent:
        return SwarmEvent(step, step, robot, kind, 0.25, "")

    assert told(0) == [[], []]
    joined = Sets(moving=[1, 2, 7, 9], standing=[], regions=regions([0.4] * 4, 1.0, 9.81, 5.0))
    assert told(1, event(1, 9, EventKind.JOINED)) == [[joined], [joined]]
    died = Sets(moving=[1, 7, 9], standing=[2], regions=regions([0.4] * 3, 1.0, 9.81, 5.0, [(0.4, 0.25)]))
    assert told(2, event(2, 2, EventKind.DEAD)) == [[died], [died]]
    assert told(3) == [[], []]
    ((alone,), _) = told(4, event(4, 1, EventKind.LEFT), event(4, 9, EventKind.LEFT))
    assert (alone.moving, alone.regions) == ([7], None)
    late = LiveSession(live)
    late.hello()
    assert [message for message in late.poll(1.0) if isinstance(message, Sets)] == [alone]


def test_a_torque_that_no_robots_on_the_plane_give_is_not_shown() -> None:
    found = regions([0.1, 0.1], 1.0, 10.0, 5.0)
    assert found is not None
    assert max(found.torque) == pytest.approx(1.0)
    assert found.reachable[-1] == pytest.approx(0.05)


def test_processes_are_watched_until_they_are_gone_and_not_mistaken() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        watch = ProcessWatch({"child": child.pid, "nobody": 2**22 + 1})
        until(lambda: watch.look().processes[0].state == "sleeping", "the child waits")
        alive, nobody = watch.look().processes
        assert (alive.name, alive.pid) == ("child", child.pid)
        assert alive.memory is not None
        assert alive.memory == pytest.approx(psutil.Process(child.pid).memory_info().rss, rel=0.2)
        assert (nobody.state, nobody.memory) == ("gone", None)
        child.kill()
        child.wait()
        assert watch.look().processes[0].state == "gone"


@pytest.mark.timeout(60)
@pytest.mark.usefixtures("ros")
def test_a_listener_hears_a_namespace_and_takes_nothing_for_a_message_that_is_none() -> None:
    run = make_run(5)
    initialise("view", ["--ros-args", "-r", "__ns:=/some/swarm"])
    try:
        listener, node = Listener(SwarmNode("hearer"), 3), SwarmNode("speaker")
        publishers = {topic: advertise(node, topic) for topic in dict.fromkeys(TOPIC_OF[type(m)] for m in run)}
        state = SwarmState()
        heard = {topic.name for topic in publishers} - {"swarm/auxiliary_state"}
        names = [p.topic_name for p in publishers.values()]
        assert all(name.startswith("/some/swarm/") for name in names)
        met = [publisher for topic, publisher in publishers.items() if topic.name in heard]
        until(lambda: all(p.get_subscription_count() for p in met), "speaker and listener have met", 30.0)
        for message in run:
            publishers[TOPIC_OF[type(message)]].publish(encode(message))
        good = encode(next(m for m in run if TOPIC_OF[type(m)].name == "plane/state"))
        publishers[TOPIC_OF[type(run[3])]].publish(good[:30])

        def complete() -> bool:
            for heard in listener.poll():
                state.add(heard.message)
            instant = state.instant()
            return instant is not None and instant.step == 5 and state.event_count == 1 and listener.malformed == 1

        until(complete, "all has been heard", 30.0)
        node.destroy_node()  # type: ignore[no-untyped-call]
    finally:
        rclpy.try_shutdown()


def test_processes_file_is_whole_or_not_there(tmp_path: Path) -> None:
    from swarmabs_run.orchestration.run_files import read_processes, write_processes  # noqa: PLC0415

    (tmp_path / "logs").mkdir()
    assert read_processes(tmp_path) is None
    write_processes(tmp_path / "logs", {"plane_sim": 7})
    assert read_processes(tmp_path) == {"orchestrator": os.getpid(), "plane_sim": 7}
    assert [path.name for path in (tmp_path / "logs").iterdir()] == ["processes.json"]
    assert json.loads((tmp_path / "logs" / "processes.json").read_text())["plane_sim"] == 7
