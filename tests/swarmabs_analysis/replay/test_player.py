"""The player of a replay, message by message."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_analysis.replay.player import Player
from swarmabs_bag.recording import RecordedStep
from swarmabs_core.behaviours.base import StepAheadError, UnexpectedMessageError
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BROADCASTS,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    NEVER,
    PLANE_STATE,
    RECORDING_PROGRESS,
    TOPIC_OF,
    AbstractState,
    AuxiliaryState,
    DesiredAbstractState,
    EventKind,
    Message,
    Messages,
    PlaneState,
    RecordingProgress,
    SwarmEvent,
    Topic,
)
from swarmabs_core.publishers import CONTROLLER, OBSERVER, PLANE, NodeKind, NodeName, publisher_of
from swarmabs_run.simulation import Simulation

ROBOT = NodeName(NodeKind.AGENT, 3)
STEPS = list(Simulation(builtin("pd_het_4", "duration=0.1", "faults=[{at: 0.05, kind: kill, agent: 3}]")).steps())
LAST = len(STEPS) - 1


def player(*live: NodeName, window: int = 0, last: int = LAST) -> Player:
    return Player(iter(STEPS), live, last_step=last, window=window)


def recorded(step: int, topic: Topic, agent_id: int = 0) -> Message:
    return next(r.message for r in STEPS[step].records if r.topic is topic and r.agent_id == agent_id)


def topics(messages: Messages) -> list[tuple[int, Topic]]:
    return [(message.step, TOPIC_OF[type(message)]) for message in messages]


def credit(step: int) -> RecordingProgress:
    return RecordingProgress(0, 0, step)


def test_the_controller_gets_a_step_when_it_has_answered_the_one_before() -> None:
    tried = player(CONTROLLER)
    assert topics(tried.start()) == [(0, AGENT_STATE)] * 4 + [
        (0, PLANE_STATE),
        (0, ABSTRACT_STATE),
        (0, AUXILIARY_STATE),
    ]
    assert tried.awaits() == (DESIRED_ABSTRACT_STATE,)
    assert tried.missing() == (0, ("swarm/desired_abstract_state",))
    answer = tried.handle(recorded(0, DESIRED_ABSTRACT_STATE))
    assert {step for step, _ in topics(answer)} == {1}


def test_a_robot_hears_the_broadcasts_of_a_step_only_when_it_is_in_it() -> None:
    """Broadcasts of another step are lost on a robot: it says by its state that it is there."""
    tried = player(ROBOT)
    assert topics(tried.start()) == [(0, AGENT_STATE)] * 3
    assert tried.awaits() == (AGENT_STATE,)
    assert tried.missing() == (0, ("agent 3",))
    for step in range(5):
        answer = tried.handle(recorded(step, AGENT_STATE, 3))
        assert [topic for k, topic in topics(answer) if k == step] == [PLANE_STATE, *BROADCASTS]
        assert [topic for k, topic in topics(answer) if k == step + 1] == [AGENT_STATE] * 3
    rest = tried.handle(recorded(5, AGENT_STATE, 3))  # its last state
    assert {step for step, _ in topics(rest)} == set(range(5, LAST + 1))
    assert tried.awaits() == ()
    assert tried.missing()[1] == ()


def test_everything_is_played_once_and_in_order_of_steps() -> None:
    tried = player(OBSERVER)
    played = list(tried.start())
    for step in range(LAST + 1):
        played += tried.handle(recorded(step, AUXILIARY_STATE))
        played += tried.handle(recorded(step, ABSTRACT_STATE))
    wanted = [r.message for s in STEPS for r in s.records if publisher_of(r.message) != OBSERVER]
    assert sorted(played) == sorted(wanted)
    assert [m.step for m in played] == sorted(m.step for m in played)
    assert tried.awaits() == ()


def test_both_broadcasts_of_the_observer_are_awaited() -> None:
    tried = player(OBSERVER)
    tried.start()
    assert tried.awaits() == (ABSTRACT_STATE, AUXILIARY_STATE)
    assert tried.handle(recorded(0, ABSTRACT_STATE)) == ()
    assert tried.awaits() == (AUXILIARY_STATE,)
    assert tried.handle(recorded(0, AUXILIARY_STATE))


def test_repetitions_and_its_own_messages_change_nothing() -> None:
    tried = player(ROBOT)
    tried.start()
    assert tried.handle(recorded(0, AGENT_STATE, 1)) == ()  # heard on the topic that it shares with the robot
    assert tried.handle(recorded(0, AGENT_STATE, 3))
    assert tried.handle(recorded(0, AGENT_STATE, 3)) == ()
    assert tried.missing() == (1, ("agent 3",))


def test_an_answer_may_come_before_its_turn() -> None:
    """A robot that has all broadcasts may answer before another node under test has."""
    tried = player(ROBOT, CONTROLLER)
    tried.start()
    tried.handle(recorded(0, AGENT_STATE, 3))
    assert tried.awaits() == (DESIRED_ABSTRACT_STATE,)
    assert tried.handle(recorded(1, AGENT_STATE, 3)) == ()
    answer = tried.handle(recorded(0, DESIRED_ABSTRACT_STATE))
    assert topics(answer) == [(1, AGENT_STATE)] * 3 + [(1, PLANE_STATE), (1, ABSTRACT_STATE), (1, AUXILIARY_STATE)]


ALL = (PLANE, OBSERVER, CONTROLLER, *(NodeName(NodeKind.AGENT, number) for number in (1, 2, 3, 4)))


def test_nodes_that_do_not_wait_for_the_player_may_be_any_number_of_steps_ahead() -> None:
    """With all nodes under test the loop is closed without it, and of what it is late for much is lost on it."""
    tried = player(*ALL)
    assert tried.start() == ()
    for step in (7, 2, LAST):
        for record in STEPS[step].records:
            if record.topic is not EVENTS:
                assert tried.handle(record.message) == ()
    assert tried.awaits() == ()
    assert tried.missing() == (LAST + 1, ())


def test_a_robot_that_has_ended_is_not_waited_for_where_others_have_had_its_states() -> None:
    tried = player(*ALL)
    tried.start()
    gone = recorded(5, AGENT_STATE, 3)  # its last state, which it cannot repeat: it was killed
    later = [r.message for r in STEPS[LAST].records if r.topic is not EVENTS]
    assert gone not in later
    assert set(tried.awaits()) == {AGENT_STATE, PLANE_STATE, ABSTRACT_STATE, AUXILIARY_STATE}
    for message in later:
        tried.handle(message)
    assert tried.awaits() == ()


def test_the_nodes_left_go_on_without_the_player_once_its_robots_are_gone() -> None:
    live = tuple(name for name in ALL if name.agent_id != 3)
    tried = player(*live)
    tried.start()
    for step in range(5):
        for record in STEPS[step].records:
            if record.topic is not EVENTS and publisher_of(record.message) in live:
                tried.handle(record.message)
    assert tried.missing()[0] == 5  # up to here robot 3 had a part in every step
    for record in STEPS[LAST].records:
        tried.handle(record.message)
    assert tried.awaits() == ()


@pytest.mark.parametrize("node", [PLANE, OBSERVER, CONTROLLER, ROBOT])
def test_an_answer_to_what_is_not_yet_published_is_refused(node: NodeName) -> None:
    """Whether the next step has anything of the player in it is known when it comes to it."""
    tried = player(*(name for name in ALL if name.agent_id != 4))
    tried.start()
    ahead = next(r.message for r in STEPS[3].records if publisher_of(r.message) == node)
    others = (r.message for step in STEPS[:3] for r in step.records if r.topic is not EVENTS)
    with pytest.raises(StepAheadError, match=f"{node}: step [012] expected, 3 received"):
        list(map(tried.handle, (ahead, *others)))


def test_the_recorder_is_not_left_behind() -> None:
    tried = player(ROBOT, window=3)
    tried.start()
    for step in range(3):
        tried.handle(recorded(step, AGENT_STATE, 3))
    assert tried.awaits() == (RECORDING_PROGRESS,)
    assert tried.missing() == (3, ("recorder",))
    assert tried.handle(credit(NEVER)) == ()
    assert topics(tried.handle(credit(0))) == [(3, AGENT_STATE)] * 3
    assert tried.awaits() == (AGENT_STATE,)


def test_what_no_correct_node_sends_is_refused() -> None:
    tried = player(CONTROLLER)
    tried.start()
    with pytest.raises(StepAheadError, match="controller: step 0 expected, 2 received"):
        tried.handle(recorded(2, DESIRED_ABSTRACT_STATE))
    with pytest.raises(UnexpectedMessageError, match="PlaneState"):
        tried.handle(recorded(0, PLANE_STATE))
    tried = player(CONTROLLER, last=4)
    tried.start()
    with pytest.raises(StepAheadError, match="controller: step 4 expected, 5 received"):
        tried.handle(recorded(5, DESIRED_ABSTRACT_STATE))


def test_it_ends_with_the_last_step() -> None:
    tried = player(CONTROLLER, last=1)
    tried.start()
    tried.handle(recorded(0, DESIRED_ABSTRACT_STATE))
    assert tried.awaits() == (DESIRED_ABSTRACT_STATE,)
    assert tried.handle(recorded(1, DESIRED_ABSTRACT_STATE)) == ()
    assert tried.awaits() == ()


def test_a_recording_that_is_too_short_is_an_error() -> None:
    tried = Player(iter(STEPS[:1]), (CONTROLLER,), last_step=3)
    tried.start()
    with pytest.raises(RunError, match="the recording ends with step 0, before step 3"):
        tried.handle(recorded(0, DESIRED_ABSTRACT_STATE))


def test_a_late_event_is_played_late() -> None:
    late = next(r for r in STEPS[6].records if r.topic is EVENTS)

    def steps() -> Iterator[RecordedStep]:
        yield from (STEPS[0], STEPS[1], RecordedStep(0, (late,)), *STEPS[2:])

    tried = Player(steps(), (CONTROLLER,), last_step=LAST)
    tried.start()
    tried.handle(recorded(0, DESIRED_ABSTRACT_STATE))
    answer = tried.handle(recorded(1, DESIRED_ABSTRACT_STATE))
    assert answer[0] == late.message
    assert tried.missing() == (2, ("swarm/desired_abstract_state",))


def event(kind: EventKind, agent_id: int, detail: str) -> SwarmEvent:
    return SwarmEvent(0, 0, agent_id, kind, 0.0, detail)


@pytest.mark.parametrize(
    ("message", "publisher"),
    [
        (PlaneState(0, 0, 0.0, 0.0), PLANE),
        (AbstractState(0, 0, 1, 0.0, 0.0, 0.0, 0.0), OBSERVER),
        (AuxiliaryState(0, 0, *[0.0] * 8), OBSERVER),
        (DesiredAbstractState(0, 0, 1, *[0.0] * 8), CONTROLLER),
        (event(EventKind.JOINED, 3, ""), OBSERVER),
        (event(EventKind.LEFT, 3, "leave"), OBSERVER),
        (event(EventKind.DEAD, 3, "silent"), OBSERVER),
        (event(EventKind.SAFE_STOP, 3, "stop commanded"), ROBOT),
        (event(EventKind.RECOVERED, 3, ""), ROBOT),
        (event(EventKind.FAULT_INJECTED, 3, "loss of the broadcasts"), ROBOT),
    ],
)
def test_who_has_published_what(message: Message, publisher: NodeName) -> None:
    assert publisher_of(message) == publisher


@pytest.mark.parametrize("text", ["plane", "observer", "controller", "agent:3", "agent:65535"])
def test_names_are_read_as_they_are_written(text: str) -> None:
    assert str(NodeName.parse(text)) == text


@pytest.mark.parametrize(
    "text", ["", "robot", "agent", "agent:", "agent:x", "agent:03", "plane:1", "Plane", "agent:-0"]
)
def test_other_names_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="name controller, observer, plane, or a robot as agent:N"):
        NodeName.parse(text)
