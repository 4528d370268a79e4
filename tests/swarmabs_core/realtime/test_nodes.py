"""Single nodes in real time: what they do with their clock, their drive and messages that should not be."""

from math import inf, nan

import pytest
from tests.swarmabs_core.realtime import nodes

from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_core.abstraction import Weight, abstraction, second_moments
from swarmabs_core.events import EventCode
from swarmabs_core.messages import NEVER, Basis, EventKind, Message, Mode, PlaneState, Removal, Status
from swarmabs_core.realtime.base import Level, StepCounter
from swarmabs_core.realtime.observer import RealtimeObserver, Role
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_core.realtime.validation import QUIET_NS, Problem, Refusals
from swarmabs_core.swarm_law import LAWS


def test_a_state_tells_the_command_that_led_to_it_and_a_deactivated_body_is_safe() -> None:
    body, node = nodes.robot()
    assert nodes.state_of(node.tick(nodes.at(10))).broadcast_step == NEVER
    nodes.follow(node, 10)
    assert body.commands[-1] != 0.0
    later = nodes.state_of(node.tick(nodes.at(12)))
    assert (later.command, later.broadcast_step, later.status) == (body.commands[-2], 10, Status.ACTIVE)
    node.halt()
    node.halt()
    assert (body.stops, node.health(nodes.at(0)).text) == (2, "safe stop: deactivated")


def test_the_newest_complete_broadcasts_count_in_whatever_order_they_came() -> None:
    def commands(*heard: Message) -> list[float]:
        body, node = nodes.robot()
        nodes.tell(node, heard, 11.6)
        node.tick(nodes.at(12))
        return body.commands

    one, two, three = (nodes.broadcasts(10 + step, torque=0.1 + 0.6 * step) for step in range(3))
    assert commands(*one, *two) == commands(*reversed(two), *reversed(one), *three[:2]) != [0.0]
    for missing in range(3):
        assert commands(*two[:missing], *two[missing + 1 :]) == [0.0]


def test_broadcasts_are_followed_up_to_their_age_limit_and_not_longer() -> None:
    body, node = nodes.robot()
    nodes.tell(node, nodes.broadcasts(10), 10.6)
    for step in range(11, 21):
        node.tick(nodes.at(step))
        assert body.commands[-1] != 0.0, step
    answer = node.tick(nodes.at(21))
    assert body.commands[-1] == 0.0
    assert EventKind.SAFE_STOP in nodes.kinds(answer)
    assert nodes.state_of(node.tick(nodes.at(22))).status == Status.SAFE_STOP
    assert node.health(nodes.at(22)).level is Level.ERROR
    nodes.tell(node, nodes.broadcasts(22), 22.6)
    assert EventKind.RECOVERED in nodes.kinds(node.tick(nodes.at(23)))


@pytest.mark.parametrize(
    "trouble", [{"blind": True}, {"stamp": nodes.at(11)}, {"stamp": nodes.at(40)}, {"position": nan}]
)
def test_a_robot_that_does_not_know_where_it_is_stops(trouble: dict[str, object]) -> None:
    body, node = nodes.robot()
    nodes.follow(node, 10)
    vars(body).update(trouble)
    for step in range(11, 23):
        answer = nodes.follow(node, step)
    assert body.commands[-1] == 0.0
    assert (nodes.state_of(answer).status, nodes.state_of(answer).position) == (Status.SAFE_STOP, 0.1)
    assert "measurement" in node.health(nodes.at(23)).text


def test_a_robot_that_leaves_says_so_for_ten_periods_and_is_back_when_asked() -> None:
    body, node = nodes.robot()
    nodes.follow(node, 10)
    assert nodes.kinds(node.leave(nodes.at(11.2))) and not node.leave(nodes.at(11.3))
    answers = [nodes.follow(node, step) for step in range(11, 25)]
    assert [nodes.state_of(answer).status for answer in answers if answer] == [Status.LEFT] * 10
    assert (len(body.commands), body.stops) == (1, 1)
    assert nodes.kinds(node.join(nodes.at(26.2))) and not node.join(nodes.at(26.3))
    nodes.follow(node, 26)
    assert (nodes.state_of(nodes.follow(node, 27)).status, body.commands[-1] != 0.0) == (Status.ACTIVE, True)


def test_a_law_without_a_finite_command_stops_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LAWS, "make", lambda *_: lambda *_: inf)
    body, node = nodes.robot()
    nodes.follow(node, 10)
    assert body.commands == [0.0]
    assert "finite" in node.health(nodes.at(11)).text


def test_a_limited_command_is_told_when_it_begins_to_be() -> None:
    body, node = nodes.robot("limits={force: 0.3}")
    told = [
        nodes.kinds(nodes.follow(node, step, torque=torque))
        for step, torque in enumerate((9.0, -9.0, 0.5, 9.0), start=10)
    ]
    assert told == [[EventKind.RECOVERED, EventKind.LIMIT_HIT], [], [], [EventKind.LIMIT_HIT]]
    assert body.commands == [0.3, -0.3, pytest.approx(0.16, abs=0.01), 0.3]
    assert node.health(nodes.at(14)).text.endswith(EventCode.COMMAND_LIMITED.text)
    body.position, body.velocity = 0.4795, 0.02
    nodes.follow(node, 14, torque=9.0)
    assert node.health(nodes.at(15)).text.endswith(EventCode.LANE_LIMITED.text)


def test_gains_that_are_installed_are_those_of_a_node_made_with_them() -> None:
    gains = "swarm.gains={kp: [20, 20], ksd: 3}"
    other = nodes.scenario(gains, "controller={gains: [9.0, 4.0]}")
    (old, robot), (new, tuned), (wanted, untuned) = nodes.robot(), nodes.robot(), nodes.robot(gains)
    install = tuned.tuned(next(c for c in configure.agent_configs(other, nodes.CLOCK) if c.agent_id == 3))
    for step in (10, 11):
        for node in (robot, tuned, untuned):
            nodes.follow(node, step)
        install()
    assert old.commands[0] == new.commands[0] != wanted.commands[0]
    assert old.commands[1] != new.commands[1] == wanted.commands[1]

    observers = nodes.observer(), nodes.observer(), nodes.observer(gains)
    observers[1].tuned(configure.observer_config(other, nodes.CLOCK))()
    usual, changed, expected = (nodes.sums(nodes.hear(node, nodes.states(5), 5)) for node in observers)
    assert usual != changed == expected

    controllers = [nodes.controller(overrides=changes) for changes in ((), (), ("controller={gains: [9.0, 4.0]}",))]
    controllers[1].tuned(lambda: lockstep.parent_controller(other))()
    plane = PlaneState(nodes.at(1), 1, 0.1, 0.02)
    asked, tuned_asked, wanted_asked = (nodes.desired(node.hear(plane, nodes.at(1.6))) for node in controllers)
    assert asked != tuned_asked == wanted_asked


def test_roles_decide_what_a_robot_counts_in() -> None:
    node = nodes.observer()
    first, second, third, fourth = nodes.states(5)
    second = second._replace(status=Status.SAFE_STOP)
    nodes.hear(node, (first, second, third, fourth), 5)
    for step in range(6, 16):
        gone = third._replace(status=Status.LEFT if step > 10 else Status.ACTIVE)
        nodes.hear(node, [state._replace(step=step) for state in (first, second, gone)], step)
    answer = node.tick(nodes.at(16.5))
    assert node.roles == {1: Role.ACTIVE, 2: Role.STOPPED, 3: Role.LEFT, 4: Role.SILENT}
    health = node.health(nodes.at(16.5))
    assert (health.level, health.text) == (Level.WARN, "1 of 4 robots follow")
    abstract, auxiliary = nodes.sums(answer)
    on_plane = [Weight(s.mass, s.position, 0.0 if s.agent_id == 4 else s.velocity) for s in (first, second, fourth)]
    *expected, q = abstraction(on_plane, 9.81)
    assert abstract[2:] == (3, *expected)
    assert auxiliary[2:] == (*second_moments([(first.mass, first.position)]), 0.0, 0.0, 0.0, q)


def test_neither_outdated_states_nor_one_robot_that_followed_before_start_the_swarm() -> None:
    node = nodes.observer()
    outdated = [m for state in nodes.states(5) for m in node.hear(state, nodes.at(100_000.2))]
    assert not nodes.sums_in([*outdated, *node.tick(nodes.at(100_000.5))])
    assert "0 heard, 4 needed" in node.health(nodes.at(100_000.5)).text
    assert nodes.sums_in(nodes.hear(node, nodes.states(100_001), 100_001))
    assert node.health(nodes.at(100_001)).level is Level.OK
    # States count for ten steps; after so many it knows of all robots that can be heard.
    for count, first in ((1, None), (2, 16)):
        node = nodes.observer()
        summed = [
            s for s in range(5, 30) if nodes.sums_in(nodes.hear(node, nodes.states(s, broadcast_step=s - 1)[:count], s))
        ]
        assert summed == ([] if first is None else list(range(first, 30)))


def test_a_robot_that_was_silent_before_the_observer_restarted_counts_where_it_was() -> None:
    *others, silent = nodes.states(100)
    memory = {4: silent._replace(step=7)}
    node = RealtimeObserver(configure.observer_config(nodes.scenario(), nodes.CLOCK), memory)
    abstract, _ = nodes.sums(nodes.hear(node, others, 100))
    on_plane = [*(Weight(s.mass, s.position, s.velocity) for s in others), Weight(silent.mass, silent.position, 0.0)]
    assert abstract[2:] == (4, *abstraction(on_plane, 9.81)[:4])
    assert memory == {4: silent._replace(step=7)}
    assert node.hear(Removal(0, 6, 4, EventKind.LEFT, 0.0, ""), nodes.at(100.6)) == (), "it was heard after that"
    nodes.hear(node, nodes.states(101), 101)
    assert (memory, node.roles[4]) == ({}, Role.ACTIVE), "it is heard again"


def test_an_observer_forgets_what_was_heard_when_its_clock_is_set_back_and_only_then() -> None:
    node = nodes.observer()
    for step in (1000, 5):
        node.tick(nodes.at(step - 0.5))
        abstract, _ = nodes.sums(nodes.hear(node, nodes.states(step, velocity=step / 1000), step))
        assert abstract.torque_rate == pytest.approx(9.81 * 1.8 * step / 1000)
        assert node.tick(nodes.at(step + 0.5)) == (), "repeated"
        node.tick(nodes.at(step + 1.5))
        assert set(node.roles.values()) == {Role.ACTIVE}


def test_a_robot_that_left_counts_again_after_all_clocks_were_set_back() -> None:
    node = nodes.observer()
    *others, last = nodes.states(1000)
    nodes.hear(node, [*others, last._replace(status=Status.LEFT)], 1000)
    assert node.roles[4] is Role.LEFT
    node.tick(nodes.at(4.5))
    nodes.hear(node, nodes.states(5), 5)
    assert node.roles[4] is Role.ACTIVE


def test_missed_states_of_the_plane_are_caught_up() -> None:
    """The plane stands still here, so that it makes no difference whether its states were heard."""
    whole, gaps = nodes.controller(), nodes.controller()
    for step in range(30):
        wanted = nodes.desired(whole.hear(PlaneState(0, step, 0.05, 0.0), nodes.at(step + 0.5)))
        if step in (0, 3, 4, 9, 29):
            got = nodes.desired(gaps.hear(PlaneState(0, step, 0.05, 0.0), nodes.at(step + 0.5)))
            assert got == wanted


@pytest.mark.parametrize(
    ("step", "angle", "rate"),
    [
        *((25, nan, 0.0), (25, 0.1, inf), (25, 9.0, 0.0), (25, 0.1, 1e300), (25, 0.1, -101.0)),
        *((2**63, 0.1, 0.0), (33, 0.1, 0.0), (19, 0.1, 0.0)),
    ],
)
def test_a_state_of_the_plane_that_cannot_be_true_is_not_answered(step: int, angle: float, rate: float) -> None:
    node = nodes.controller()
    assert nodes.kinds(node.hear(PlaneState(0, step, angle, rate), nodes.at(30.5))) == [EventKind.REFUSED]
    for credible in (20, 32):  # as old and as far in the future as it may be
        assert nodes.desired(node.hear(PlaneState(0, credible, 0.1, 0.0), nodes.at(30.5))).step == credible


def test_a_swarm_that_waits_for_a_reset_is_told_so_without_a_plane_once_per_step() -> None:
    node = nodes.controller(Mode.STOP)
    assert node.health(nodes.at(3)).text == "STOP: waiting for a reset"
    assert nodes.desired(node.tick(nodes.at(3.75)))[:3] == (nodes.at(3.75), 3, Mode.STOP)
    node.reset(nodes.at(4))
    assert node.tick(nodes.at(4.75)) == ()
    modes = {nodes.desired(node.tick(nodes.at(step + 0.75))).mode for step in range(5, 104)}
    assert modes == {Mode.RESET}
    node.tick(nodes.at(104.75))
    assert ("mode", "RUN") in node.health(nodes.at(104.75)).values
    answer = node.hear(PlaneState(0, 105, 0.1, 0.0), nodes.at(105.5))
    assert nodes.desired(answer).mode == Mode.RUN
    assert [basis.begun for basis in answer if isinstance(basis, Basis)] == [105]
    node = nodes.controller(Mode.STOP)
    assert len([*node.hear(PlaneState(0, 5, 0.1, 0.0), nodes.at(5.5)), *node.tick(nodes.at(5.75))]) == 1
    node = nodes.controller()
    answer = node.hear(PlaneState(0, 5, 1.55, 0.0), nodes.at(5.5))
    assert nodes.desired(answer).mode == Mode.STOP
    assert EventKind.MODE_CHANGED in nodes.kinds(answer)
    assert nodes.desired(node.hear(PlaneState(0, 6, 0.0, 0.0), nodes.at(6.5))).mode == Mode.STOP


def test_the_plane_is_held_until_a_robot_follows_and_then_makes_up_for_being_late() -> None:
    node = RealtimePlane(configure.plane_config(nodes.scenario(), nodes.CLOCK))
    for step in range(10):
        _, held = nodes.hear(node, nodes.states(step), step)
        assert held[2:] == (0.1, 0.0)
    nodes.hear(node, nodes.states(10, broadcast_step=9)[:1], 10)
    _, moved = node.tick(nodes.at(11.5))
    assert moved[2:] != (0.1, 0.0)
    node.halt()
    assert ("angular velocity, rad/s", "0.0000") in node.health(nodes.at(12)).values
    _, held = node.tick(nodes.at(12.5))
    assert held[2:] == (moved[2], 0.0)
    pushed = nodes.scenario("plane.disturbance={amplitude: 0.5, angular_frequency: 9.0}")
    late, punctual = (RealtimePlane(configure.plane_config(pushed, nodes.CLOCK)) for _ in range(2))
    for node in (late, punctual):
        nodes.hear(node, nodes.states(0, broadcast_step=0, velocity=0.0), 0)
    for step in range(1, 21):
        _, expected = punctual.tick(nodes.at(step + 0.5))
    assert late.tick(nodes.at(20.5))[1] == expected


def test_the_plane_takes_states_of_earlier_steps_after_its_clock_was_set_back() -> None:
    node = RealtimePlane(configure.plane_config(nodes.scenario(), nodes.CLOCK))
    for step in (1000, 5):
        node.tick(nodes.at(step - 0.5))
        for answer in (nodes.hear(node, nodes.states(step), step), nodes.hear(node, nodes.states(step - 1), step + 1)):
            provenance, _ = answer
            assert isinstance(provenance, Basis)
            assert provenance.state_steps == (step,) * 4


def test_the_plane_makes_up_for_at_most_a_thousand_periods() -> None:
    """After a longer pause it is where it was after a thousand periods, and not one period further."""
    slow = nodes.scenario("plane.friction=[0, 0, 0, 0, 0, 50]")
    angles = {}
    for pause in (999, 1000, 1001, 4000):
        node = RealtimePlane(configure.plane_config(slow, nodes.CLOCK))
        nodes.hear(node, nodes.states(0, broadcast_step=0, velocity=0.0), 0)
        _, state = node.tick(nodes.at(pause + 0.5))
        angles[pause] = state[2]
    assert angles[999] != angles[1000] == angles[1001] == angles[4000]


def test_the_plane_tells_of_robots_beyond_its_end_and_of_their_return() -> None:
    node = RealtimePlane(configure.plane_config(nodes.scenario(), nodes.CLOCK))
    told = []
    for step, position in enumerate((0.4, 0.51, 0.52, 0.6, 0.3)):  # too far to be credible in step 3
        first, *others = nodes.states(step)
        answer = nodes.hear(node, (first._replace(position=position), *others), step)
        told += [(e.step, e.agent_id, e.value, e.detail) for e in answer if "range" in getattr(e, "detail", "")]
    robot = first.agent_id
    assert [event[1:] for event in told] == [
        (robot, 0.51, "out of range: position above 0.5 m"),
        (robot, 0.3, "back in range: position"),
    ]


def test_refusals_are_counted_and_reported_now_and_then() -> None:
    book, nonsense = Refusals(7), Problem("nonsense", "0", "plane/state")
    said = "plane/state: nonsense (0)"
    assert [first[2:] for first in book.add(nonsense, 3, 0)] == [(7, EventKind.REFUSED, 1.0, said)]
    others = [nonsense._replace(shown=f"{k}") for k in range(1, 100)]
    assert all(book.add(problem, 3, k) == () for k, problem in enumerate(others)), "it is the same reason"
    assert [again[2:] for again in book.add(nonsense, 3, QUIET_NS)] == [(7, EventKind.REFUSED, 100.0, said)]
    assert book.values() == (("refused", "101"), ("last refusal", said))


def test_no_number_of_refusals_silences_a_reason_that_is_new() -> None:
    node = nodes.controller()
    told = [event.detail for k in range(1, 1001) for event in node.hear(PlaneState(0, 5, 4.0 + k, 0.0), nodes.at(5.5))]
    told += [event.detail for event in node.hear(PlaneState(0, 5, 0.0, 200.0), nodes.at(5.5))]
    assert told == [
        "plane/state: an angle beyond 3.2 rad (5 rad)",
        "plane/state: an angular velocity beyond 100 rad/s (200 rad/s)",
    ]


def test_steps_are_made_once() -> None:
    counter = StepCounter(nodes.CLOCK)
    steps = [counter.next(nodes.at(k)) for k in (-1, 0, 0.5, 1, 3, 2, 4)]
    assert steps == [None, 0, None, 1, 3, None, 4]
    assert counter.next(nodes.at(0)) is None
    assert counter.last is None
    assert counter.next(nodes.at(0.1)) == 0
