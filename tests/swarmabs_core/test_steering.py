"""Offsets of the reference and torques that disturb the plane, set at steps (docs/how-to/steering.md)."""

from math import inf, nan
from typing import Any

import pytest
from tests.swarmabs_core.helpers import Run, agent_state, builtin

from swarmabs_config import configure
from swarmabs_config.scenario import parse_scenario
from swarmabs_core import messages as msg
from swarmabs_core.behaviours import Parent, Request, Steered, SteeringConfig, SteeringController
from swarmabs_core.behaviours.base import ConflictError, StepAheadError, UnexpectedMessageError
from swarmabs_core.behaviours.steering import MOST_WAITING, OVER
from swarmabs_core.errors import InputError
from swarmabs_core.membership import UNPLANNED, Change, ChangeKind
from swarmabs_core.steering import DISTURBANCE, REFERENCE, OffsetReference, StepChange, StepSchedule, change_of

SHORT = "duration=0.7"


def faults(*texts: str) -> str:
    return f"faults=[{', '.join('{kind: ' + text + '}' for text in texts)}]"


def told(run: Run) -> list[tuple[int, int, int, float, str]]:
    return [(e.step, e.agent_id, e.kind, e.value, e.detail) for e in run.events() if e.kind != msg.EventKind.LIMIT_HIT]


def first_difference(one: Run, other: Run, kind: type[msg.PlaneState | msg.DesiredAbstractState]) -> int:
    pairs = zip(one.of(kind), other.of(kind), strict=True)
    return next(a.step for a, b in pairs if a != b)


def test_a_step_schedule_holds_each_value_until_the_next() -> None:
    schedule = StepSchedule([StepChange(5, 0.5), StepChange(2, -1.0)])
    assert [schedule.at(step) for step in range(7)] == [0.0, 0.0, -1.0, -1.0, -1.0, 0.5, 0.5]
    assert [schedule.changing(step) for step in range(7)] == [None, None, -1.0, None, None, 0.5, None]
    schedule.set(3, 0.0)
    assert [schedule.at(step) for step in (2, 3, 4, 5)] == [-1.0, 0.0, 0.0, 0.5]
    assert not StepSchedule()
    assert StepSchedule().at(3) == 0.0
    assert StepChange.parse(str(StepChange(12, 0.1))) == StepChange(12, 0.1)
    for text in ("", "1", "1 2 3", "-1 0.5", "x 1", "1 nan", "1 inf", "1.5 2"):
        with pytest.raises(InputError, match="STEP VALUE"):
            StepChange.parse(text)


def test_the_reference_of_a_step_has_the_offset_of_the_step() -> None:
    """Also where the time of a step is no round number: 0.07 s is 7.000000000000001 periods."""
    reference = OffsetReference(lambda time: time, StepSchedule([StepChange(7, 0.5)]), 10_000_000)
    assert [reference(step * 10_000_000 / 1e9) for step in (6, 7, 8)] == [0.06, 0.07 + 0.5, 0.08 + 0.5]
    assert reference(inf) == inf
    reference.hear(msg.SwarmEvent(0, 8, 0, msg.EventKind.STEERING, 0.25, "disturbance"))
    reference.hear(msg.SwarmEvent(0, 8, 0, msg.EventKind.LIMIT_HIT, 0.25, "reference"))
    assert reference(0.08) == 0.08 + 0.5
    reference.hear(msg.SwarmEvent(0, 8, 0, msg.EventKind.STEERING, 0.25, "reference"))
    assert reference(0.08) == 0.08 + 0.25


def test_an_ordered_change_begins_with_the_step_of_the_order() -> None:
    ends = {
        msg.Action.KILL: ChangeKind.KILL,
        msg.Action.FREEZE: ChangeKind.FREEZE,
        msg.Action.REMOVE: ChangeKind.REMOVE,
    }
    changes: dict[msg.Action, Change | None] = {action: Change(6, 3, kind) for action, kind in ends.items()}
    changes |= {msg.Action.ADD: Change(7, 3, ChangeKind.JOIN), msg.Action.REFERENCE: None, msg.Action.NONE: None}
    assert {action: change_of(msg.Steering(70_000_000, 7, 1, action, 3, 0.0)) for action in changes} == changes


@pytest.mark.parametrize(
    ("name", "law"), [("pd_het_4", "pd"), ("pd_het_4", "lqr"), ("pd_het_4", "pid"), ("arise_het_4", "arise")]
)
def test_the_step_from_which_an_offset_holds(name: str, law: str) -> None:
    """The desired state of the step is the first to differ; the robots' commands of the step follow it at once."""
    common = (name, "duration=0.4", f"controller.type={law}")
    plain, run = Run(builtin(*common)), Run(builtin(*common, faults("reference, at: 0.3, offset: 0.05")))
    assert first_difference(plain, run, msg.DesiredAbstractState) == 30
    assert first_difference(plain, run, msg.PlaneState) == 31
    assert told(run) == [(30, 0, msg.EventKind.STEERING, 0.05, "reference")]


def test_an_offset_makes_one_constant_reference_another() -> None:
    """0.125 + 0.25 rad is 0.375 rad without rounding: ARISE cannot tell the two apart, in any bit."""
    common = ("arise_het_4", "duration=0.5", "controller.adaptive_initial=[0.4, 0.009, 0.01, 0.8]")
    near, far = (f"controller.trajectory={{type: constant, angle: {angle}}}" for angle in (0.125, 0.375))
    offset = Run(builtin(*common, near, faults("reference, at: 0, offset: 0.25")))
    assert offset.digest() == Run(builtin(*common, far)).digest()


def test_a_torque_holds_from_its_step_on_until_another_is_set() -> None:
    """The plane feels it in the period that begins with the step."""
    settings = ("disturbance, at: 0.3, torque: 0.25, until: 0.5", "reference, at: 0.7, offset: -0.1")
    other = "disturbance, at: 0.5, torque: 0.2"
    plain, scenario = Run(builtin("pd_het_4", SHORT)), builtin("pd_het_4", SHORT, faults(*settings, other))
    assert configure.step_changes(scenario, DISTURBANCE) == (StepChange(30, 0.25), StepChange(50, 0.2))
    assert configure.step_changes(scenario, REFERENCE) == (StepChange(70, -0.1),)
    run = Run(builtin("pd_het_4", SHORT, faults(settings[0])))
    assert first_difference(plain, run, msg.PlaneState) == 31
    before, after = (run.one(msg.PlaneState, step).angular_velocity for step in (30, 31))
    undisturbed = plain.one(msg.PlaneState, 31).angular_velocity
    inertia = 0.5 + run.one(msg.AbstractState, 30).inertia
    assert before == plain.one(msg.PlaneState, 30).angular_velocity
    assert after - undisturbed == pytest.approx(-0.25 * 0.01 / inertia, rel=0.05)
    assert told(run) == [
        (step, 0, msg.EventKind.STEERING, torque, "disturbance") for step, torque in ((30, 0.25), (50, 0.0))
    ]


def test_robots_that_are_taken_off_the_plane_or_never_put_on_it() -> None:
    """It does not know: its last state says nothing of it; from the next step its weight is gone."""
    run = Run(builtin("pd_het_4", SHORT, faults("remove, at: 0.3, agent: 3")))
    states = run.agent(3)
    assert list(states) == list(range(31))
    assert states[30].status == msg.Status.ACTIVE
    assert [run.one(msg.AbstractState, step).agent_count for step in (30, 31, 70)] == [4, 3, 3]
    assert told(run) == [(31, 3, msg.EventKind.LEFT, states[30].position, "remove")]
    for step in (30, 31, 70):
        weights = [state.mass * state.position for state in run.states(step)]
        assert run.one(msg.AbstractState, step).torque == pytest.approx(9.81 * sum(weights), rel=1e-12, abs=1e-12)
    scenario = builtin("pd_het_4", SHORT, "faults=[{kind: join, at: null, agent: 4}]")
    assert [agent.id for agent in scenario.initial_agents] == [1, 2, 3]
    assert [change.step for change in configure.schedule(scenario)] == [UNPLANNED]
    run = Run(scenario)
    assert {state.agent_id for state in run.of(msg.AgentState)} == {1, 2, 3}
    assert run.events() == []


HEAD = "schema: 1\nswarm:\n  generate: {double_integrator: 3, mass: [1, 2]}\n"


@pytest.mark.parametrize(
    ("entries", "error"),
    [
        ("{kind: reference, at: 1, offset: 1.5}", "f:4: faults.0.offset: 1.5 is out of range; give a number < 1.5"),
        (
            "{kind: disturbance, at: 2, torque: 1, until: 4}, {kind: disturbance, at: 3, torque: 1}",
            "f:4: faults.1: a second disturbance at the same time (see line 4); end one before the other begins",
        ),
        (
            "{kind: reference, at: 2, offset: 1}, {kind: reference, at: 2.001, offset: 0.5}",
            "f:4: faults.1: a second reference at the same time",
        ),
        (
            "{kind: join, at: null, agent: 3}, {kind: kill, at: 3, agent: 3}",
            "f:4: faults.1: robot 3 joins at an unplanned time, so its end cannot be planned (see line 4); remove this",
        ),
    ],
)
def test_entries_that_are_refused(entries: str, error: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_scenario(f"{HEAD}faults: [{entries}]", source="f")
    assert str(caught.value).startswith(error)


def controller(**changes: Any) -> SteeringController:
    given = {"members": (1, 2, 3, 4), "period_ns": 10_000_000, "last_step": 10, "largest_offset": 1.0}
    made = SteeringController(SteeringConfig(**{**given, "largest_torque": 2.0, **changes}))
    made.start()
    return made


REFER = Request(msg.Action.REFERENCE, 0, 0.1)
JOINS_LATER = Change(2**63 - 1, 4, ChangeKind.JOIN)


def plane(step: int) -> msg.PlaneState:
    return msg.PlaneState(step * 10_000_000, step, 0.1, 0.0)


def ordered(made: SteeringController, *steps: int) -> list[msg.Action]:
    """Return what is ordered while the plane reaches steps."""
    return [order.action for step in steps for order in made.handle(plane(step)) if isinstance(order, msg.Steering)]


def test_a_request_gets_the_next_step_and_each_step_one() -> None:
    made = controller()
    assert (made.awaits(), made.missing()) == ((msg.EVENTS, msg.PLANE_STATE), (0, ("plane_sim",)))
    assert made.handle(plane(0)) == (msg.Steering(10_000_000, 1, 0, msg.Action.NONE, 0, 0.0),)
    numbers = [made.ask(Request(msg.Action.REFERENCE, 0, 0.25)), made.ask(Request(msg.Action.KILL, 3))]
    assert made.handle(plane(0)) == (), "a repetition"
    assert made.handle(plane(1)) == (msg.Steering(20_000_000, 2, numbers[0], msg.Action.REFERENCE, 0, 0.25),)
    assert (made.step, made.setting(msg.Action.REFERENCE), made.setting(msg.Action.DISTURBANCE)) == (2, 0.25, 0.0)
    assert made.handle(plane(2)) == (msg.Steering(30_000_000, 3, numbers[1], msg.Action.KILL, 3, 0.0),)
    assert [(d.number, d.step, d.reason) for d in made.decisions()] == [(numbers[0], 2, ""), (numbers[1], 3, "")]
    assert made.decisions() == []
    assert made.members == (1, 2, 4)
    with pytest.raises(StepAheadError, match="plane/state: step 3 expected, 4 received"):
        made.handle(plane(4))
    with pytest.raises(UnexpectedMessageError, match="steering: received Steering"):
        made.handle(msg.Steering(0, 3, 0, msg.Action.NONE, 0, 0.0))


def test_what_the_scenario_sets_goes_first_and_a_robot_that_has_just_been_added_can_be_killed() -> None:
    made = controller(offsets=(StepChange(1, 0.5),))
    made.ask(REFER)
    assert ordered(made, 0, 1) == [msg.Action.NONE, msg.Action.REFERENCE]
    made = controller(schedule=(JOINS_LATER,))
    assert made.absent == (4,)
    made.ask(Request(msg.Action.ADD, 4))
    made.handle(plane(0))
    made.ask(Request(msg.Action.KILL, 4))
    assert ordered(made, 1) == [msg.Action.KILL], "its first state, of step 1, is its last one"


@pytest.mark.parametrize(
    ("action", "agent_id", "value", "reason"),
    [
        (msg.Action.REFERENCE, 0, 1.01, "1.01 rad is out of range; an offset of the reference is at most 1 rad"),
        (msg.Action.DISTURBANCE, 0, nan, "nan N m is out of range; a disturbance is at most 2 N m"),
        (msg.Action.DISTURBANCE, 0, -inf, "-inf N m is out of range"),
        (msg.Action.DISTURBANCE, 0, -2.01, "-2.01 N m is out of range"),
        (msg.Action.KILL, 7, 0.0, "there is no robot 7; the robots are 1, 2, 3, 4"),
        (msg.Action.KILL, 4, 0.0, "robot 4 does not take part in step 1; those that do are 1, 3"),
        (msg.Action.FREEZE, 2, 0.0, "robot 2 does not take part in step 1; those that do are 1, 3"),
        (
            msg.Action.ADD,
            1,
            0.0,
            "robot 1 takes part already; the robots that can be added are 4",
        ),
        (msg.Action.ADD, 2, 0.0, "robot 2 has taken part until step 0 (silent), and robots do not return; the robots"),
    ],
)
def test_requests_that_are_refused(action: msg.Action, agent_id: int, value: float, reason: str) -> None:
    made = controller(schedule=(JOINS_LATER,))
    made.handle(msg.SwarmEvent(0, 1, 2, msg.EventKind.DEAD, 0.0, "silent"))
    with pytest.raises(InputError) as caught:
        made.ask(Request(action, agent_id, value))
    assert str(caught.value).startswith(reason)
    assert ordered(made, 0) == [msg.Action.NONE]


def test_the_last_robot_stays_also_where_others_leave_by_plan_and_what_waits_is_judged_again() -> None:
    made = controller(members=(1, 2))
    made.ask(Request(msg.Action.KILL, 1))
    made.ask(Request(msg.Action.KILL, 2))
    ordered(made, 0, 1)
    first, second = made.decisions()
    assert (first.step, second.step) == (1, None)
    assert "robot 2 is the last one" in second.reason
    made = controller(members=(1, 2, 3), schedule=(Change(4, 1, ChangeKind.KILL), Change(6, 2, ChangeKind.LEAVE)))
    with pytest.raises(InputError, match="robot 3 is the last one at step 7"):
        made.ask(Request(msg.Action.KILL, 3))
    made.ask(Request(msg.Action.KILL, 2))


def test_after_the_end_nothing_can_be_asked_for() -> None:
    made = controller(last_step=1, offsets=(StepChange(1, 0.5),))
    made.ask(REFER)
    made.handle(plane(0))
    with pytest.raises(InputError, match="the run is over"):
        made.ask(Request(msg.Action.KILL, 1))
    assert made.handle(plane(1)) == made.handle(plane(1)) == made.awaits() == ()
    assert [(late.step, late.reason) for late in made.decisions()] == [(None, OVER)]
    with pytest.raises(InputError, match="the run is over"):
        made.ask(REFER)


def test_too_many_requests_and_offsets_of_a_law_without_any_are_refused() -> None:
    made = controller()
    for _ in range(MOST_WAITING):
        made.ask(REFER)
    with pytest.raises(InputError, match=r"100 requests are already waiting"):
        made.ask(REFER)
    with pytest.raises(InputError, match="offset_torque"):
        controller(largest_offset=0.0).ask(REFER)


def test_a_push_is_two_changes_of_the_disturbance_and_what_changes_it_meanwhile_waits() -> None:
    made = controller(torques=(StepChange(1, 0.5),))
    first = made.ask(Request(msg.Action.DISTURBANCE, 0, -1.25, steps=3))
    later = made.ask(Request(msg.Action.DISTURBANCE, 0, 0.25))
    orders = [order for step in range(8) for order in made.handle(plane(step)) if isinstance(order, msg.Steering)]
    told = [(order.step, order.request, order.value) for order in orders if order.action == msg.Action.DISTURBANCE]
    # The scenario sets the torque at step 1, so the push begins after it; the torque before it returns exactly.
    assert told == [(2, first, 0.5 - 1.25), (5, first, 0.5), (6, later, 0.25)]
    assert [(decision.number, decision.step) for decision in made.decisions()] == [(first, 2), (later, 6)]


def test_a_push_waits_for_what_the_scenario_sets_before_its_end_and_stays_in_range() -> None:
    for held, push in ((1.5, 1.0), (-1.5, -1.0)):
        made = controller(torques=(StepChange(4, held),))
        made.ask(Request(msg.Action.DISTURBANCE, 0, push, steps=3))
        assert ordered(made, *range(10)) == [msg.Action.NONE] * 10
        (decision,) = made.decisions()
        assert decision.step is None
        assert decision.reason == (
            f"{push} N m and the disturbance of {held} N m are together out of range; "
            "a disturbance is at most 2 N m in magnitude"
        )
    made = controller()
    made.ask(Request(msg.Action.DISTURBANCE, 0, 1.0, steps=30))
    assert ordered(made, *range(11)) == [msg.Action.DISTURBANCE] + [msg.Action.NONE] * 9, "the run ends during it"


def test_a_paused_run_takes_a_step_only_for_a_request() -> None:
    made = controller()
    made.pause(paused=True)
    assert made.paused
    assert made.handle(plane(0)) == made.handle(plane(0)) == made.release() == ()
    made.ask(Request(msg.Action.KILL, 2))
    (order,) = made.release()
    assert isinstance(order, msg.Steering)
    assert (order.step, order.action, order.agent_id) == (1, msg.Action.KILL, 2)
    assert made.release() == made.handle(plane(0)) == made.handle(plane(1)) == ()
    made.pause(paused=False)
    assert made.release() == (msg.Steering(20_000_000, 2, 0, msg.Action.NONE, 0, 0.0),)
    assert made.release() == ()
    assert ordered(made, *range(1, 11)) == [msg.Action.NONE] * 8
    with pytest.raises(InputError, match="the run is over"):
        made.pause(paused=True)


def test_a_node_waits_for_the_order_and_refuses_what_cannot_be_one() -> None:
    node = Steered(Parent(configure.parent_config(builtin("pd_het_4", "duration=0.3"))))
    assert (node.awaits(), node.missing(), node.open) == ((msg.STEERING,), (0, ("steering",)), False)
    node.handle(msg.Steering(0, 0, 0, msg.Action.NONE, 0, 0.0))
    assert (node.awaits(), node.open) == ((msg.AGENT_STATE, msg.EVENTS), True)
    with pytest.raises(ConflictError):
        node.handle(msg.Steering(0, 0, 1, msg.Action.KILL, 1, 0.0))
    with pytest.raises(StepAheadError, match="swarm/steering: step 1 expected, 3 received"):
        node.handle(msg.Steering(0, 3, 1, msg.Action.KILL, 1, 0.0))
    with pytest.raises(StepAheadError, match="AgentState: step 1 expected, 2 received"):
        node.handle(agent_state(1, 2))
    assert node.handle(agent_state(1, 1)) == (), "kept until the order of its step"
    assert node.missing() == (0, tuple(f"agent {i}" for i in (1, 2, 3, 4)))
    for agent_id in (1, 2, 3, 4):
        node.handle(agent_state(agent_id))
    assert node.missing() == (1, ("steering",))
    node.handle(msg.Steering(0, 1, 0, msg.Action.NONE, 0, 0.0))
    assert node.missing() == (1, ("agent 2", "agent 3", "agent 4"))
