"""Which one of a pair of coordinators speaks, by hand, and by a search of all that can happen to two pairs."""

from random import Random

import pytest
from tests.swarmabs_core.realtime import leadership_model as model
from tests.swarmabs_core.realtime.nodes import CLOCK, at, broadcasts, controller, desired, kinds, scenario, states

from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_core import messages as msg
from swarmabs_core.events import EventCode
from swarmabs_core.realtime import broadcasts as inbox
from swarmabs_core.realtime.base import Sender
from swarmabs_core.realtime.broadcasts import BroadcastInbox, Coordinators
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_core.realtime.leadership import PRIMARY, SETTLES, SINGLE, STANDBY, Leadership, Pair, Voice
from swarmabs_core.realtime.modes import ModeLatch, PublishedMode
from swarmabs_core.realtime.observer import RealtimeObserver
from swarmabs_core.realtime.validation import Bounds

TAKEOVER = 4


def leadership(rank: str, listening: int = 10) -> Leadership:
    return Leadership(rank, TAKEOVER, 2, listening)


def following(rank: str = STANDBY, step: int = 100) -> Leadership:
    """Return one that stands by and has heard of the step before."""
    started = leadership(rank)
    for k in range(step - 20, step + 1):
        started.hear(k - 1, k)
        assert not started.tick(k)
    return started


def test_one_without_a_peer_always_speaks_and_says_nothing_about_it() -> None:
    single = leadership(SINGLE)
    assert [single.tick(k) for k in (5, 4, 1000)] == [True] * 3
    assert single.values(5, 0.01) == ()


def test_one_that_starts_listens_and_leads_if_it_hears_nobody() -> None:
    primary = leadership(PRIMARY)
    assert [k for k in range(100, 130) if primary.tick(k)] == [*range(110, 130)]
    assert primary.why == "no peer speaks"
    # What has nothing to say does not lead, and a standby lets its primary begin when both could.
    first, second = leadership(PRIMARY), leadership(STANDBY)
    assert not any(one.tick(k, able=False) for one in (first, second) for k in range(100, 200))
    assert first.tick(200)
    assert [k for k in range(200, 210) if second.tick(k)] == [*range(205, 210)]


def test_the_other_takes_over_once_it_was_silent_for_longer_than_the_limit() -> None:
    standby = following(step=100)
    assert [standby.tick(k) for k in range(101, 106)] == [False, False, False, True, True]
    assert (standby.since, standby.why) == (104, "peer silent")
    said = dict(standby.values(304, 0.01))
    assert (said["pair"], said["role"], said["role for, s"]) == (STANDBY, "leads", "2")
    # Not because of a silence in which it could not have spoken either, such as one of the plane.
    standby = following(step=100)
    assert not any(standby.tick(k, able=False) for k in range(101, 150))
    assert [standby.tick(k) for k in range(150, 156)] == [False] * 4 + [True] * 2


def test_one_that_was_frozen_hears_first_who_leads() -> None:
    primary = leadership(PRIMARY, listening=0)
    assert all(primary.tick(k) for k in range(100, 110))
    assert primary.tick(113), "not frozen for longer than it takes to take over"
    assert not primary.tick(118)
    primary.hear(117, 118)
    assert not any(primary.tick(k) for k in range(118, 122))
    # Without anybody it leads again before robots stop: with its last message five steps before, after ten.
    alone = leadership(PRIMARY, listening=0)
    assert alone.tick(100)
    assert [k for k in range(105, 115) if alone.tick(k)] == [*range(110, 115)]


def test_of_two_that_speak_the_standby_yields() -> None:
    primary, standby = leadership(PRIMARY, listening=0), leadership(STANDBY, listening=0)
    spoke = []
    for k in range(100, 140):
        if k >= 110:  # the partition has healed
            primary.hear(k - 1, k)
            standby.hear(k - 1, k)
        spoke.append((primary.tick(k), standby.tick(k)))
    assert spoke[10:19] == [(True, True)] * 9
    assert spoke[19:] == [(True, False)] * 21


def test_a_message_from_the_future_is_no_sign_of_life_since_robots_reject_it() -> None:
    standby = following(step=100)
    for k in range(101, 104):
        standby.hear(k + 3, k)
        assert not standby.tick(k)
    assert standby.tick(104)


def test_a_release_without_anybody_to_take_over_ends_before_robots_stop() -> None:
    primary = leadership(PRIMARY, listening=0)
    assert all(primary.tick(k) for k in range(100, 110))
    primary.release(109)
    assert [k for k in range(110, 120) if primary.tick(k)] == [117, 118, 119]
    primary.release(119)
    primary.hear(124, 125)
    assert not any(primary.tick(k) for k in range(120, 129))


def inbox_of() -> BroadcastInbox:
    return BroadcastInbox(CLOCK, 0.1, 0.02, Bounds(9.81, 1.0))


def tell(to: BroadcastInbox, step: int, *, observer: bool, controller: bool, torque: float = 0.5) -> None:
    abstract, sums, asked = broadcasts(step, torque=torque)
    to.add(abstract, at(step + 0.6), Sender(standby=observer))
    to.add(sums, at(step + 0.6), Sender(standby=observer))
    to.add(asked, at(step + 0.6), Sender(standby=controller))


def test_a_robot_never_mixes_and_stays_with_whom_it_follows() -> None:
    box = inbox_of()
    abstract, sums, asked = broadcasts(5)
    box.add(abstract, at(5.6), Sender(standby=False))
    box.add(sums, at(5.6), Sender(standby=True))
    box.add(asked, at(5.6), Sender(standby=False))
    assert box.problem(at(6)) == "no complete broadcasts yet"
    box.add(sums, at(5.6), Sender(standby=False))
    assert box.problem(at(6)) == ""
    for step in range(6, 9):  # both speak, and the standby is up to three steps ahead
        tell(box, step, observer=True, controller=False)
        assert box.followed == Coordinators(observer=False, controller=False)
    tell(box, 9, observer=True, controller=False, torque=0.4)
    assert box.followed == Coordinators(observer=True, controller=False)
    assert box.newest is not None
    assert (box.newest.step, box.newest.desired.torque) == (9, 0.4)
    # Whoever else speaks now is not followed, unless those who are contradict themselves.
    tell(box, 10, observer=False, controller=False)
    tell(box, 10, observer=True, controller=False)
    assert box.followed == Coordinators(observer=True, controller=False)
    box.add(broadcasts(10)[0]._replace(stamp=1), at(10.7), Sender(standby=True))
    assert box.problem(at(11)) == ""
    assert box.followed == Coordinators(observer=False, controller=False)


def test_a_stop_counts_whoever_sends_it() -> None:
    box = inbox_of()
    tell(box, 5, observer=False, controller=False)
    box.add(broadcasts(5, msg.Mode.STOP)[2], at(5.7), Sender(standby=True))
    tell(box, 6, observer=False, controller=False)
    assert box.problem(at(7)) == "stop commanded"


def paired_controller(rank: str, mode: msg.Mode = msg.Mode.RUN) -> RealtimeController:
    loaded = scenario()
    config = configure.controller_config(loaded, CLOCK, mode)
    object.__setattr__(config, "pair", Pair(rank, paired=True))
    node = RealtimeController(config, lambda: lockstep.parent_controller(loaded))
    node.hear(broadcasts(0)[0], at(0.6))
    return node


def plane(step: int) -> msg.PlaneState:
    return msg.PlaneState(at(step), step, 0.1, 0.0)


def turn(node: RealtimeController, step: int, peer: msg.Message | None = None) -> msg.Messages:
    """Let a controller hear the plane and its peer, and tick."""
    said = node.hear(plane(step), at(step + 0.5))
    if peer is not None:
        said += node.hear(peer, at(step + 0.6), Sender(standby=True))
    return (*said, *node.tick(at(step + 0.75)))


def test_a_silent_controller_follows_the_mode_of_the_leader_and_continues_where_it_ended() -> None:
    single = controller()
    standby = paired_controller(STANDBY, msg.Mode.STOP)
    for step in range(10, 40):
        heard = single.hear(plane(step), at(step + 0.5))
        for message in heard:
            standby.hear(message, at(step + 0.6))
        assert turn(standby, step) == (), "it stands by, and its own start mode does not count"
    said = [message for step in range(40, 50) for message in turn(standby, step)]
    (event,) = [m for m in said if isinstance(m, msg.SwarmEvent)]
    assert (event.kind, event.detail) == (msg.EventKind.LEADING, "parent_controller_standby: peer silent")
    # The law's time is the leader's, and so is what it asks for, but for the rounding of the filter.
    basis = next(m for m in said if isinstance(m, msg.Basis))
    assert (basis.step, basis.begun) == (44, 10)
    for step in range(40, 45):
        expected = desired(single.hear(plane(step), at(step + 0.5)))
    first = next(m for m in said if isinstance(m, msg.DesiredAbstractState))
    assert first.torque == pytest.approx(expected.torque, rel=1e-9)
    assert first.inertia_acceleration == pytest.approx(expected.inertia_acceleration, rel=1e-6)


class Noted:
    """A law that notes when it was asked."""

    def __init__(self) -> None:
        self.asked: list[float] = []

    def torque(self, time: float, plane: msg.PlaneState) -> float:
        self.asked.append(time)
        return 0.2

    def reference(self, time: float) -> float:
        return 0.0


@pytest.mark.parametrize(("plane_first", "times"), [(False, [0.05, 0.06]), (True, [0.0, 0.06])])
def test_a_silent_controller_computes_a_step_of_the_leaders_law_once_or_takes_it_over(
    *, plane_first: bool, times: list[float]
) -> None:
    """The leader's law began in step 5. Who hears of it after the state of step 10 has begun one of its own before."""
    leader, standby, law = controller(), paired_controller(STANDBY), Noted()
    standby.tuned(lambda: law)()
    for step in range(5, 11):
        basis, asked = leader.hear(plane(step), at(step + 0.5))
    assert isinstance(asked, msg.DesiredAbstractState)
    for message in (plane(10), basis, asked) if plane_first else (basis, plane(10), asked):
        standby.hear(message, at(10.6))
    assert dict(standby.health(at(10.7)).values)["desired torque, N m"] == f"{asked.torque:.4f}"
    standby.hear(plane(11), at(11.5))
    assert law.asked == pytest.approx(times)


def test_a_stop_at_the_silent_controller_reaches_the_leader_and_outlives_it() -> None:
    leader, standby = paired_controller(PRIMARY), paired_controller(STANDBY)
    for step in range(10, 150):
        said = turn(leader, step)
        for message in said:
            standby.hear(message, at(step + 0.6))
        turn(standby, step)
    assert said
    told = standby.stop(at(150))
    assert desired(told).mode == msg.Mode.STOP
    assert desired(turn(standby, 151)).mode == msg.Mode.STOP, "again, as long as the leader may not have heard it"
    (answer,) = [m for m in leader.hear(desired(told), at(151.9)) if isinstance(m, msg.DesiredAbstractState)]
    assert answer.mode == msg.Mode.STOP
    standby.hear(answer, at(151.95))
    assert turn(standby, 152) == ()
    later = [m for step in range(153, 170) for m in turn(standby, step) if isinstance(m, msg.DesiredAbstractState)]
    assert {m.mode for m in later} == {msg.Mode.STOP}, "it leads now, and the swarm is still stopped"


def test_a_reset_of_the_leader_opens_the_latch_of_the_silent_controller() -> None:
    leader, standby = paired_controller(PRIMARY, msg.Mode.STOP), paired_controller(STANDBY, msg.Mode.STOP)
    modes = []
    for step in range(10, 400):
        said = turn(leader, step)
        if step == 200:
            said += leader.reset(at(step + 0.8))
        for message in said:
            if not isinstance(message, msg.SwarmEvent):
                assert standby.hear(message, at(step + 0.9)) == ()
        assert turn(standby, step) == ()
        modes.append(dict(standby.health(at(step)).values)["mode"])
    assert list(dict.fromkeys(modes)) == ["STOP", "RESET", "RUN"]


def mode_of(node: RealtimeController, step: int) -> str:
    return dict(node.health(at(step)).values)["mode"]


def test_who_has_stopped_and_reset_the_swarm_does_not_stop_it_again_when_it_follows() -> None:
    first, second = paired_controller(PRIMARY), paired_controller(STANDBY)
    for step in range(10, 400):
        awake = not 350 <= step < 380
        said = turn(first, step) if awake else ()
        if step == 150:
            said += first.stop(at(step + 0.8))
        if step == 200:
            said += first.reset(at(step + 0.8))
        answers = [answer for message in said for answer in second.hear(message, at(step + 0.85))]
        answers += turn(second, step)
        for message in answers if awake else ():
            first.hear(message, at(step + 0.9))
    assert dict(first.health(at(step)).values)["role"] == "stands by"
    assert (mode_of(first, 400), mode_of(second, 400)) == ("RUN", "RUN")


def test_a_clock_set_back_does_not_let_an_old_reset_overrule_a_new_stop() -> None:
    node = paired_controller(PRIMARY)
    for step in range(1000, 1250):
        turn(node, step)
        if step == 1020:
            node.reset(at(step + 0.8))
    for step in range(10, 60):
        turn(node, step, broadcasts(step, msg.Mode.STOP)[2] if step == 50 else None)
    assert mode_of(node, 60) == "STOP"
    # The rest of a reset is as long by the new clock.
    node.reset(at(60.9))
    turn(node, 61)
    modes = []
    for step in range(10, 160):
        turn(node, step)
        modes.append(mode_of(node, step))
    assert 95 <= modes.count("RESET") <= 105
    assert modes[-1] == "RUN"


def test_robots_obey_a_stop_of_a_controller_whose_clock_is_ahead() -> None:
    for node in (controller(), paired_controller(PRIMARY), paired_controller(STANDBY)):
        box, ahead = inbox_of(), 6
        for step in range(10, 310):
            said = (*node.hear(plane(step), at(step + ahead + 0.5)), *node.tick(at(step + ahead + 0.75)))
            if step == 270:
                said += node.stop(at(step + ahead + 0.8))
            for message in said:
                if isinstance(message, msg.DesiredAbstractState):
                    assert box.add(message, at(step + 0.8)) is None
        assert box.stopped


@pytest.mark.parametrize(("ahead", "oldest"), [(0, 2), (1, 3), (2, 4), (3, TAKEOVER)])
def test_a_message_is_without_delay_that_seems_old_because_clocks_differ(ahead: int, oldest: int) -> None:
    for late in (oldest, oldest + 1):
        standby = Leadership(STANDBY, TAKEOVER, ahead, 0)
        for k in range(100, 140):
            if k > 110:
                standby.hear(k - late, k)
            standby.tick(k)
        assert standby.leading == (late > oldest)


def voice_of(rank: str, rules: Leadership) -> Voice:
    voice = Voice(EventCode.OBSERVER_LEADS, Pair(rank), CLOCK, 0.0)
    voice.leadership = rules
    return voice


def test_events_from_the_time_in_which_neither_spoke_are_published_by_the_next_leader() -> None:
    def event(step: int) -> msg.SwarmEvent:
        return msg.SwarmEvent(0, step, 1, msg.EventKind.DEAD, 0.0, "")

    voice = voice_of(STANDBY, following(step=100))
    for k in range(101, 115):
        if k == 108:  # the peer has told what happened up to its last step
            voice.leadership.hear(107, 108)
        assert voice.say((event(k),), at(k), able=k > 110) == ()
    leads = msg.SwarmEvent(at(115), 115, 0, msg.EventKind.LEADING, 0.0, "abstraction_observer_standby: peer silent")
    assert voice.say((event(115),), at(115)) == (leads, *map(event, range(108, 116)))
    assert voice.say((event(116),), at(116)) == (event(116),)


def spoke(voice: Voice, step: int, *, able: bool) -> bool:
    """Execute a step; return whether something was published."""
    return bool(voice.say((msg.SwarmEvent(0, step, 1, msg.EventKind.DEAD, 0.0, ""),), at(step), able=able))


@pytest.mark.parametrize("rank", [PRIMARY, STANDBY])
def test_once_one_has_settled_the_other_may_stop(rank: str) -> None:
    draw = Random(f"settles {rank}")
    for _ in range(300):
        voice = voice_of(rank, leadership(rank))
        peer, source = (100 + draw.choice((draw.randrange(5), draw.randrange(80))) for _ in range(2))
        k = 100
        while not voice.settled:
            if k >= peer:
                voice.leadership.hear(k - draw.randrange(2), k)
            spoke(voice, k, able=k >= source)
            k += 1
        # It has heard robots or plane, and has not left before it knew them for a while.
        assert source + 10 < k <= max(peer, source) + 25
        # Now the peer stops.
        assert any(spoke(voice, later, able=True) for later in range(k, k + TAKEOVER + 2)), (peer, source, k)


def test_one_that_hears_nothing_is_not_awaited_for_ever() -> None:
    assert voice_of(SINGLE, leadership(SINGLE)).settled
    voice, steps = voice_of(PRIMARY, leadership(PRIMARY)), 0
    while not voice.settled:
        spoke(voice, 100 + steps + 10**6 * (steps > 30), able=False)  # the clock of the host is set meanwhile
        steps += 1
    assert steps == SETTLES * 10 + 1


def test_two_controllers_that_start_in_stop_do_not_wait_for_each_other() -> None:
    pair = [paired_controller(rank, msg.Mode.STOP) for rank in (PRIMARY, STANDBY)]
    last = SETTLES * 2 * CLOCK.steps(1.0) + 1
    for k in range(last + 1):
        assert all(one.tick(at(k)) == () for one in pair)
    assert all(one.voice.settled for one in pair)


def test_a_single_controller_obeys_no_other_one() -> None:
    single = controller()
    said = single.hear(broadcasts(20, msg.Mode.STOP)[2], at(20.5))
    assert kinds(said) == [msg.EventKind.REFUSED]
    assert mode_of(single, 21) == "RUN"


def test_an_older_mode_of_the_leader_changes_nothing() -> None:
    standby = paired_controller(STANDBY, msg.Mode.STOP)
    for step, mode in ((100, msg.Mode.RUN), (102, msg.Mode.RESET), (101, msg.Mode.RUN)):
        standby.hear(broadcasts(step, mode)[2], at(103))
    assert mode_of(standby, 103) == "RESET"


def test_a_silent_observer_publishes_what_changed_while_nobody_spoke() -> None:
    config = configure.observer_config(scenario(), CLOCK)
    object.__setattr__(config, "pair", Pair(STANDBY, paired=True))
    standby = RealtimeObserver(config)
    for step in range(10, 40):
        standby.hear(broadcasts(step - 1)[0], at(step + 0.1))
        for state in states(step):
            standby.hear(state, at(step + 0.2))
        assert standby.tick(at(step + 0.5)) == ()
    said: list[msg.Message] = []
    for step in range(40, 55):
        for state in states(step)[: None if step < 41 else 3]:
            standby.hear(state, at(step + 0.2))
        said += standby.tick(at(step + 0.5))
    assert kinds(said) == [msg.EventKind.LEADING, msg.EventKind.DEAD]
    assert [m.step for m in said if isinstance(m, msg.AbstractState)] == [*range(43, 55)]


def test_whatever_one_fault_does_robots_follow_never_mix_and_one_leader_is_left() -> None:
    assert model.search(model.FEW) > 100


def test_a_stop_during_a_fault_stays_whoever_leads() -> None:
    assert model.search(model.PAUSES[4:5], paired="c", orders=[msg.Mode.STOP]) > 1000


def test_the_search_finds_a_robot_that_leaves_its_coordinators_too_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inbox, "MOST_BEHIND", 12)
    with pytest.raises(model.BrokenError, match="does not follow, though there was but one fault"):
        model.search(model.PAUSES[:1])


@pytest.mark.parametrize(
    ("of", "name", "value", "faults", "granted", "orders", "error"),
    [
        (ModeLatch, "open", lambda _: None, model.PAUSES[4:6], 2, [], "robots do not follow"),
        (PublishedMode, "told_to_stop", False, model.CUTS[1:2], 1, [msg.Mode.STOP], "robots are not stopped"),
        (Leadership, "_count", lambda *_, **__: None, model.CUTS[:1], 1, [], "speak long after"),
    ],
)
def test_the_search_finds_wrong_rules(
    monkeypatch: pytest.MonkeyPatch,
    of: type,
    name: str,
    value: object,
    faults: tuple[model.Fault, ...],
    granted: int,
    orders: list[msg.Mode],
    error: str,
) -> None:
    monkeypatch.setattr(of, name, value)
    said = [(msg.Mode.RESET, 80)]
    with pytest.raises(model.BrokenError, match=error):
        model.search(faults, granted=granted, paired="c", orders=orders, said=said)


@pytest.mark.full
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("name", model.SEARCHES)
def test_all_that_can_happen(name: str) -> None:
    assert model.SEARCHES[name]() > 2000
