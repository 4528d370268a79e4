"""What a scenario configures, and the graph against the contract, node by node, written down a second time."""

import importlib

import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_config import configure, ports, realtime, theory
from swarmabs_config.graph import (
    CONTROLLER,
    GRAPH,
    LOCKSTEP,
    NODES,
    OBSERVER,
    PEER,
    PLANE,
    PLANE_DRIVER,
    REALTIME,
    RECORDER,
    ROBOT,
    SERVICES,
    STANDBY_SUFFIX,
    Driver,
    Option,
    endpoints,
    options_of,
    requested,
    standby_name,
    writers,
)
from swarmabs_core.controllers import Arise, StateFeedback, lqr_gains
from swarmabs_core.errors import InputError
from swarmabs_core.faults import DelayFault, FalsifiedStateFault, InjectedFault, LossFault
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import (
    AGENT_STATE,
    BROADCASTS,
    EVENTS,
    MAIN_TOPICS,
    PLANE_STATE,
    ROBOT_STATE,
    SWARM_STATES,
    TOPICS,
    Kind,
    Mode,
)
from swarmabs_core.realtime.validation import Bounds
from swarmabs_core.robot_controller import Limits
from swarmabs_core.settings import LifeSpan
from swarmabs_core.steering import DISTURBANCE, REFERENCE, STEERER, StepChange
from swarmabs_core.swarm_law import SwarmGains

FAULTS = (
    "faults=[{at: 0.5, kind: kill, agent: 3}, {at: 0.2, kind: join, agent: 2}, {at: 0.4, kind: leave, agent: 2}, "
    "{kind: loss, probability: 0.25}, {kind: delay, steps: 2, agents: [1, 4]}, "
    "{kind: lie, agent: 2, position_offset: 0.01, from: 0.104, to: 0.301}]"
)
SETTINGS = (
    "faults=[{at: 0.3, kind: disturbance, torque: 0.2, until: 0.5}, {at: 0.1, kind: disturbance, torque: 0.1, "
    "until: 0.3}, {at: 0.2, kind: reference, offset: 0.05}]"
)


def test_schedules_hold_the_changes_of_membership_and_settings_by_step() -> None:
    assert configure.schedule(builtin("pd_het_4", FAULTS)) == (
        Change(20, 2, ChangeKind.JOIN),
        Change(40, 2, ChangeKind.LEAVE),
        Change(50, 3, ChangeKind.KILL),
    )
    changes = [configure.step_changes(builtin("pd_het_4", SETTINGS), kind) for kind in (DISTURBANCE, REFERENCE)]
    assert changes == [(StepChange(10, 0.1), StepChange(30, 0.2), StepChange(50, 0.0)), (StepChange(20, 0.05),)]


def test_observer_plane_and_controller() -> None:
    scenario = builtin("arise_het_4", "step=0.005", "duration=1", "plane.gravity=9.8", "swarm.gains.ksd=1.5", FAULTS)
    observer, plane = configure.observer_config(scenario), configure.parent_config(scenario)
    controller = configure.controller_config(scenario, recording_window=100)
    assert observer.members == plane.members == (1, 2, 3, 4)
    assert observer.schedule == plane.schedule == configure.schedule(scenario)
    assert observer.gravity == plane.plane.gravity == 9.8
    assert observer.ksd == 1.5
    assert {c.period_ns for c in (observer, plane, controller)} == {5_000_000}
    assert {c.last_step for c in (observer, plane, controller)} == {200}
    assert plane.plane == scenario.plane
    assert (plane.plane.angle, plane.plane.disturbance.amplitude, plane.plane.friction.g3) == (0.075, 0.1, 700.0)
    assert (controller.manifold.curvature, controller.recording_window) == (0.0125, 100)


def test_robots() -> None:
    gains = "swarm.gains={k: [1, 2], kp: [3, 4], kd: [5, 6], ksd: 7}"
    robots = configure.agent_configs(builtin("pd_het_4", gains, "limits.force=2.5", "seed=9", FAULTS))
    assert [robot.agent_id for robot in robots] == [1, 2, 3, 4]
    assert [robot.kind for robot in robots] == [Kind.SINGLE_INTEGRATOR] * 2 + [Kind.DOUBLE_INTEGRATOR] * 2
    assert [robot.damping for robot in robots] == [0.0, 0.0, 0.6524, 1.3258]
    lives = LifeSpan(20, ChangeKind.LEAVE, 40), LifeSpan(0, ChangeKind.KILL, 50)
    assert [robot.life for robot in robots] == [LifeSpan(), *lives, LifeSpan()]
    for robot in robots:
        assert robot.gains == SwarmGains((1.0, 2.0), (3.0, 4.0), (5.0, 6.0), 7.0)
        assert robot.limits == Limits(force=2.5)
        assert robot.seed == 9
    loss, delay = InjectedFault(LossFault(probability=0.25)), InjectedFault(DelayFault(steps=2))
    lie = InjectedFault(FalsifiedStateFault(position_offset=0.01), 10, 30)
    assert [robot.faults for robot in robots] == [(loss, delay), (loss, lie), (loss,), (loss, delay)]
    faults = "faults=[{at: 0, kind: freeze, agent: 2}, {at: 0, kind: join, agent: 2}]"
    assert configure.agent_configs(builtin("pd_het_4", faults))[1].life == LifeSpan(0, ChangeKind.FREEZE, 0)

    robots = configure.agent_configs(builtin("arise_het_20"))
    assert len(robots) == 20
    assert [robot.position for robot in robots[:3]] == [0.125, -0.125, 0.125]
    for gravity in (True, False):
        robots = configure.agent_configs(builtin("pd_di_4", f"plane.robot_gravity={str(gravity).lower()}"))
        assert {robot.feels_gravity for robot in robots} == {gravity}


def test_control_laws_with_nested_settings_joined_by_dots() -> None:
    assert configure.parent_controller(builtin("pd_si_4")) == StateFeedback(3.1623, 3.2859)
    law = configure.parent_controller(builtin("pd_si_4", "controller={type: lqr, q: [4, 2], r: 3}"))
    assert law == StateFeedback(*lqr_gains((4.0, 2.0), 3.0, 0.525, 1.0))
    assert isinstance(configure.parent_controller(builtin("arise_si_4")), Arise)
    scenario = builtin("arise_si_4", "controller.trajectory={type: constant, angle: 0.2}")
    settings = configure.controller_settings(scenario)
    assert (settings["trajectory.type"], settings["trajectory.angle"]) == ("constant", 0.2)
    assert configure.parent_controller(scenario).reference(3.0) == 0.2


def test_a_large_swarm_is_fewer_steps_ahead_of_its_recorder() -> None:
    for robots, window in ((4, 100), (200, 100), (1000, 20), (2000, 10), (20_000, 4)):
        halves = [f"swarm.generate.{kind}_integrator={robots // 2}" for kind in ("single", "double")]
        assert configure.recording_window(builtin("arise_het_200", *halves)) == window
    relayed = {"pd_het_4": 100, "arise_het_200": 10}  # 10 messages of a robot in a step
    for name, window in relayed.items():
        assert configure.recording_window(builtin(name, "coordination=each_robot", "links.type=random")) == window


@pytest.mark.parametrize(("step", "steps"), [(0.01, 200), (0.03, 67)])
def test_the_observer_divides_the_state_until_a_change_has_settled(step: float, steps: int) -> None:
    assert configure.division(builtin("pd_het_4", f"step={step}")) == steps


def test_the_theory_is_given_the_largest_delay_and_the_bound_of_the_angle() -> None:
    plain, late = (
        builtin("pd_het_4", f"faults=[{faults}]", "step=0.02")
        for faults in ("", "{kind: delay, steps: 2, agents: [1]}, {kind: delay, steps: 5, agents: [2]}")
    )
    settings = theory.setting(plain), theory.setting(late, 0.4)
    assert [(s.delay, s.faulty, s.period, s.duration) for s in settings] == [
        (0, False, 0.02, 30.0),
        (5, True, 0.02, 30.0),
    ]
    assert theory.check_scenario(late, 0.4).angle_max == settings[1].angle_max == 0.4


def test_what_is_there_in_lockstep_only_is_refused_in_real_time() -> None:
    realtime.check_realtime(builtin("pd_het_4"))
    for override in (
        *("plane.robot_gravity=true", "swarm.actuator_lag=0.1", "swarm.sensor={noise: [0.1, 0]}"),
        *("observer.type=parent_response", "faults=[{kind: loss, probability: 0.1}]"),
    ):
        with pytest.raises(InputError, match=f"^{override.partition('=')[0]}: .*; remove it, or run in lockstep"):
            realtime.check_realtime(builtin("pd_het_4", override))


def test_nodes_in_real_time() -> None:
    scenario = builtin("pd_het_4", "step=0.02", "plane.length=2", "plane.gravity=9.8", "realtime.state_age_limit=0.2")
    clock = realtime.schedule(scenario, 5)
    assert (clock.period_ns, clock.epoch_ns) == (20_000_000, 5)
    masses = [agent.mass for agent in scenario.agents]
    assert realtime.bounds(scenario) == Bounds(9.8, 2.0, sum(masses), 0.02)
    robots = realtime.agent_configs(scenario, clock)
    assert [(robot.agent_id, robot.mass, robot.damping) for robot in robots] == [
        (agent.id, agent.mass, agent.damping) for agent in scenario.agents
    ]
    plane, controller = realtime.plane_config(scenario, clock), realtime.controller_config(scenario, clock)
    assert (plane.plane, controller.start_mode) == (scenario.plane, Mode.RUN)
    assert realtime.controller_config(scenario, clock, Mode.STOP).start_mode is Mode.STOP
    assert realtime.observer_config(scenario, clock).schedule == clock
    assert realtime.observer_config(scenario, clock).quorum is None
    for asked, quorum in ((3, 3), (9, 4)):
        given = builtin("pd_het_4", "realtime.start=quorum", f"realtime.quorum={asked}")
        assert realtime.observer_config(given, clock).quorum == quorum
    # Ports of a domain do not meet those of the next run.
    assert ports.multicast_port(3) == 7305
    assert ports.metatraffic_port(3, 2) == 7314
    assert [ports.domains_spanned(participants) for participants in (0, 203, 244, 245)] == [5, 5, 5, 10]


PACKED, STEERED, CREDITED, WATCHING, FEELING, CHANGING, SYSTEM, PAIRED, STANDBY, SENSING, SEALED, OWN_TOPICS = Option
STATE, ABSTRACT, AUXILIARY, DESIRED = (topic.name for topic in (AGENT_STATE, *BROADCASTS))
STATES = "swarm/states"
MEMBERS = (7, 1234)
MAIN = {"plane/state", STATE, ABSTRACT, AUXILIARY, DESIRED}
STANDS = "swarm/standing"
BY_PAIRS = (ABSTRACT, AUXILIARY, STANDS, DESIRED, "recording/basis")
SUMS = {ABSTRACT, AUXILIARY, STANDS, "swarm/events", "recording/basis", "swarm/removals"}
OWN_STATES, OWN_EVENTS = ({f"agent_{i:03d}/{name}" for i in MEMBERS} for name in ("state", "events"))
ALONE = {STATE, ABSTRACT, AUXILIARY, DESIRED, "swarm/events", *(f"agent_{i:03d}/relay" for i in MEMBERS)}
NEAR = {"agent_008/relay", "agent_1234/relay"}


def both(*names: str) -> set[str]:
    """Return topics of coordinators together with those of their standbys."""
    return {*names, *(f"standby/{name}" for name in names)}


CASES: list[tuple[str, Driver, set[Option], set[str], set[str]]] = [
    (PLANE, LOCKSTEP, set(), {"plane/state", "swarm/events"}, {STATE, "swarm/events"}),
    (PLANE, LOCKSTEP, {STEERED}, {"plane/state", "swarm/events"}, {STATE, "swarm/events", "swarm/steering"}),
    (PLANE, LOCKSTEP, {PACKED}, {"plane/state", "swarm/events"}, {STATES, "swarm/events"}),
    (OBSERVER, LOCKSTEP, set(), {ABSTRACT, AUXILIARY, "swarm/events"}, {STATE}),
    (OBSERVER, LOCKSTEP, {WATCHING}, {ABSTRACT, AUXILIARY, "swarm/events"}, {STATE, "plane/state"}),
    (OBSERVER, LOCKSTEP, {PACKED}, {ABSTRACT, AUXILIARY, STATES, "swarm/events"}, {STATE}),
    (CONTROLLER, LOCKSTEP, set(), {DESIRED, "swarm/events"}, {"plane/state"}),
    (CONTROLLER, LOCKSTEP, {CREDITED}, {DESIRED, "swarm/events"}, {"plane/state", "recording/progress"}),
    (
        CONTROLLER,
        LOCKSTEP,
        {PACKED, STEERED},
        {DESIRED, "swarm/events", "swarm/broadcast"},
        {"plane/state", ABSTRACT, AUXILIARY, "swarm/steering"},
    ),
    (RECORDER, LOCKSTEP, set(), {"recording/progress"}, {*MAIN, *NEAR, "swarm/events"}),
    (RECORDER, LOCKSTEP, {STEERED}, {"recording/progress"}, {*MAIN, *NEAR, "swarm/events", "swarm/steering"}),
    (
        *(RECORDER, LOCKSTEP, {PACKED}, {"recording/progress"}),
        {*MAIN, *NEAR, STATES, "swarm/broadcast", "swarm/events"} - {STATE},
    ),
    (OBSERVER, LOCKSTEP, {CHANGING}, {ABSTRACT, AUXILIARY, STANDS, "swarm/events"}, {STATE}),
    (CONTROLLER, LOCKSTEP, {CHANGING}, {DESIRED, "swarm/events"}, {"plane/state", STANDS}),
    (RECORDER, LOCKSTEP, {CHANGING}, {"recording/progress"}, {*MAIN, *NEAR, STANDS, "swarm/events"}),
    (STEERER, LOCKSTEP, set(), {"swarm/steering"}, {"plane/state", "swarm/events"}),
    (ROBOT, LOCKSTEP, set(), {STATE, "swarm/events"}, {ABSTRACT, AUXILIARY, DESIRED}),
    (ROBOT, LOCKSTEP, {FEELING}, {STATE, "swarm/events"}, {ABSTRACT, AUXILIARY, DESIRED, "plane/state"}),
    (ROBOT, LOCKSTEP, {PACKED, STEERED}, {STATE, "swarm/events"}, {"swarm/broadcast", "swarm/steering"}),
    (PEER, LOCKSTEP, set(), ALONE, {"recording/progress", *NEAR}),
    (
        *(PEER, LOCKSTEP, {SENSING, STEERED, CHANGING}, ALONE | {STANDS}),
        {"plane/state", "swarm/steering", "recording/progress", *NEAR},
    ),
    (PLANE, REALTIME, set(), {"plane/state", "swarm/events", "recording/basis"}, {STATE}),
    (PLANE_DRIVER, REALTIME, set(), {"plane/state", "swarm/events"}, set()),
    (OBSERVER, REALTIME, set(), SUMS, {STATE, "swarm/events", "swarm/removals"}),
    (CONTROLLER, REALTIME, set(), {DESIRED, "swarm/events", "recording/basis"}, {"plane/state", ABSTRACT, STANDS}),
    (RECORDER, REALTIME, set(), set(), {*MAIN, *NEAR, STANDS, "swarm/events", "recording/basis", "swarm/removals"}),
    (ROBOT, REALTIME, set(), {STATE, "swarm/events"}, {ABSTRACT, AUXILIARY, DESIRED}),
    (ROBOT, REALTIME, {PAIRED}, {STATE, "swarm/events"}, both(ABSTRACT, AUXILIARY, DESIRED)),
    (
        *(RECORDER, REALTIME, {PAIRED}, set()),
        {STATE, *NEAR, "plane/state", "swarm/events", "swarm/removals", *both(*BY_PAIRS)},
    ),
    (PLANE, REALTIME, {PAIRED}, {"plane/state", "swarm/events", "recording/basis"}, {STATE}),
    (
        *(OBSERVER, REALTIME, {PAIRED}, SUMS),
        {STATE, "swarm/events", "swarm/removals", "standby/swarm/abstract_state"},
    ),
    (
        *(OBSERVER, REALTIME, {PAIRED, STANDBY}),
        {f"standby/{name}" for name in (ABSTRACT, AUXILIARY, STANDS, "recording/basis")}
        | {"swarm/events", "swarm/removals"},
        {STATE, "swarm/events", "swarm/removals", ABSTRACT},
    ),
    (
        *(CONTROLLER, REALTIME, {PAIRED}, {DESIRED, "swarm/events", "recording/basis"}),
        {"plane/state", *both(ABSTRACT, STANDS), f"standby/{DESIRED}", "standby/recording/basis"},
    ),
    (
        *(CONTROLLER, REALTIME, {PAIRED, STANDBY}),
        {f"standby/{DESIRED}", "swarm/events", "standby/recording/basis"},
        {"plane/state", *both(ABSTRACT, STANDS), DESIRED, "recording/basis"},
    ),
    (ROBOT, REALTIME, {OWN_TOPICS}, OWN_STATES | OWN_EVENTS, {ABSTRACT, AUXILIARY, DESIRED}),
    (ROBOT, REALTIME, {OWN_TOPICS, PAIRED}, OWN_STATES | OWN_EVENTS, both(ABSTRACT, AUXILIARY, DESIRED)),
    (ROBOT, LOCKSTEP, {OWN_TOPICS}, {STATE, "swarm/events"}, {ABSTRACT, AUXILIARY, DESIRED}),
    (PLANE, REALTIME, {OWN_TOPICS}, {"plane/state", "swarm/events", "recording/basis"}, OWN_STATES),
    (OBSERVER, REALTIME, {OWN_TOPICS}, SUMS, {"swarm/removals", *OWN_STATES, *OWN_EVENTS}),
    (
        *(CONTROLLER, REALTIME, {OWN_TOPICS}),
        {DESIRED, "swarm/events", "recording/basis"},
        {"plane/state", ABSTRACT, STANDS},
    ),
    (
        *(RECORDER, REALTIME, {OWN_TOPICS}, set()),
        ({*MAIN, *NEAR, STANDS, "swarm/events", "recording/basis", "swarm/removals"} | OWN_STATES | OWN_EVENTS)
        - {STATE},
    ),
]


def test_endpoints_are_those_of_the_contract() -> None:
    for node, driver, options, *expected in CASES:
        ends = endpoints(node, driver, frozenset(options), robots=len(MEMBERS), members=MEMBERS, neighbours=(8, 1234))
        found = [{topic.name for topic in topics} for topics in (ends.publications, ends.subscriptions)]
        assert found == expected, (node, driver, options)


def test_a_standby_must_take_over_before_robots_stop() -> None:
    assert standby_name(OBSERVER) == f"{OBSERVER}{STANDBY_SUFFIX}"
    realtime.check_pairs(builtin("pd_het_4"))
    realtime.check_pairs(builtin("pd_het_4", "realtime.takeover_after=0.079"))
    with pytest.raises(InputError, match=r"realtime\.takeover_after: 0\.08 s .* set it below 0\.08 s, or raise"):
        realtime.check_pairs(builtin("pd_het_4", "realtime.takeover_after=0.08"))


def test_every_topic_is_there_once_in_the_order_of_the_messages_and_every_node_that_it_names_can_be_started() -> None:
    assert {topic for link in GRAPH for topic in link.topics} == {*TOPICS}
    assert {end.node for link in GRAPH for end in (*link.writers, *link.readers)} == {*NODES} > {*SERVICES}
    assert [writers(topic) for topic in (AGENT_STATE, PLANE_STATE)] == [(ROBOT, PEER), (PLANE, PLANE_DRIVER)]
    for node in NODES.values():
        for module in node.modules.values():
            assert callable(importlib.import_module(module).main)


def test_all_options_can_be_asked_for_by_parameters() -> None:
    given = {"packed": True, "steered": True, "recording_window": 100}
    given |= {"type": "parent_response", "feels_gravity": True, "kind": "double_integrator"}
    given |= {"paired": True, "pair": "standby", "own_topics": True}
    assert options_of({**given, "system.type": "ship"}) == {*Option} - {SENSING, SEALED}
    assert options_of({**given, "kind": "single_integrator"}) == {*Option} - {FEELING, SYSTEM, SENSING, SEALED}
    assert options_of({"packed": False, "recording_window": 0, "type": "sum"}) == frozenset()
    # Robots never hear each other, whatever is asked for.
    for driver in Driver:
        for options in (frozenset(Option), frozenset(Option) - {SYSTEM}):
            heard = endpoints(ROBOT, driver, options, members=MEMBERS).subscriptions
            assert not [topic for topic in heard if topic.message in (AGENT_STATE.message, ROBOT_STATE.message)]


@pytest.mark.parametrize(("robots", "recorded"), [(4, 1000), (100, 10_100), (200, 20_200), (2000, 22_000)])
def test_there_is_room_for_what_comes_from_all_robots(robots: int, recorded: int) -> None:
    for node in (PLANE, OBSERVER):
        assert endpoints(node, LOCKSTEP, robots=robots).subscriptions[AGENT_STATE].depth == max(100, 4 * robots)
    waiting = endpoints(RECORDER, LOCKSTEP, robots=robots).subscriptions
    assert waiting[AGENT_STATE].depth == recorded <= 100_000, "the steps under way and one; what a profile allows"
    assert endpoints(RECORDER, LOCKSTEP, frozenset({PACKED}), robots=robots).subscriptions[SWARM_STATES].depth >= 101
    assert all(waiting[topic].depth >= 101 for topic in (*BROADCASTS, PLANE_STATE)), "more than is under way"


def test_a_lost_event_would_stall_who_waits_for_it_and_nobody_asks_for_more_than_is_offered() -> None:
    hearing = {
        (node, driver.value): endpoints(node, driver).subscriptions[EVENTS].reliability
        for driver in Driver
        for node in NODES
        if EVENTS in endpoints(node, driver).subscriptions
    }
    assert set(hearing.values()) == {"reliable"}
    assert ("plane_sim", "lockstep") in hearing
    assert ("abstraction_observer", "realtime") in hearing
    assert requested(AGENT_STATE, depth=5, reliable=True).reliability == "best_effort"
    assert [requested(topic, depth=5).reliability for topic in MAIN_TOPICS] == ["best_effort"] * 5
