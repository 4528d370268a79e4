"""The player of a replay, message by message."""

from collections.abc import Sequence
from typing import Any

import pytest
from tests.swarmabs_core.helpers import builtin, singly

from swarmabs_analysis.replay.player import Player
from swarmabs_bag.run.step import Step
from swarmabs_core import messages as msg
from swarmabs_core.behaviours.base import StepAheadError, UnexpectedMessageError
from swarmabs_core.errors import RunError
from swarmabs_core.publishers import CONTROLLER, OBSERVER, PARENT, NodeKind, NodeName, publisher_of
from swarmabs_run.simulation import Simulation

ROBOT = NodeName(NodeKind.AGENT, 3)
STEPS = singly(Simulation(builtin("pd_het_4", "duration=0.1", "faults=[{at: 0.05, kind: kill, agent: 3}]")).steps())
LAST = len(STEPS) - 1


def player(*live: NodeName, window: int = 0, last: int = LAST, steps: Sequence[Step] = STEPS) -> Player:
    return Player(iter(steps), live, last_step=last, window=window)


def started(*live: NodeName, **options: Any) -> Player:
    """Return a player that has said what it says at first."""
    made = player(*live, **options)
    made.start()
    return made


def recorded(step: int, topic: msg.Topic, agent_id: int = 0) -> msg.Message:
    return next(r.message for r in STEPS[step].records if r.topic is topic and r.agent_id == agent_id)


def said(step: int) -> list[msg.Message]:
    return [record.message for record in STEPS[step].records if record.topic is not msg.EVENTS]


def topics(messages: msg.Messages) -> list[tuple[int, msg.Topic]]:
    return [(message.step, msg.TOPIC_OF[type(message)]) for message in messages]


def test_the_controller_gets_a_step_when_it_has_answered_the_one_before() -> None:
    tried = player(CONTROLLER)
    of_step = [msg.AGENT_STATE] * 4 + [msg.PLANE_STATE, msg.ABSTRACT_STATE, msg.AUXILIARY_STATE]
    assert topics(tried.start()) == [(0, topic) for topic in of_step]
    assert tried.awaits() == (msg.DESIRED_ABSTRACT_STATE,)
    assert tried.missing() == (0, ("swarm/desired_abstract_state",))
    answer = tried.handle(recorded(0, msg.DESIRED_ABSTRACT_STATE))
    assert {step for step, _ in topics(answer)} == {1}


def test_a_robot_hears_the_broadcasts_of_a_step_only_when_it_is_in_it() -> None:
    """Broadcasts of another step are lost on a robot: it says by its state that it is there."""
    tried = player(ROBOT)
    assert topics(tried.start()) == [(0, msg.AGENT_STATE)] * 3
    assert tried.awaits() == (msg.AGENT_STATE,)
    assert tried.missing() == (0, ("agent 3",))
    for step in range(5):
        answer = tried.handle(recorded(step, msg.AGENT_STATE, 3))
        assert [topic for k, topic in topics(answer) if k == step] == [msg.PLANE_STATE, *msg.BROADCASTS]
        assert [topic for k, topic in topics(answer) if k == step + 1] == [msg.AGENT_STATE] * 3
    rest = tried.handle(recorded(5, msg.AGENT_STATE, 3))  # its last state
    assert {step for step, _ in topics(rest)} == set(range(5, LAST + 1))
    assert tried.awaits() == ()
    assert tried.missing()[1] == ()


def test_repetitions_and_its_own_messages_change_nothing_and_an_answer_may_come_before_its_turn() -> None:
    tried = started(ROBOT)
    assert tried.handle(recorded(0, msg.AGENT_STATE, 1)) == ()  # heard on the topic that it shares with the robot
    assert tried.handle(recorded(0, msg.AGENT_STATE, 3))
    assert tried.handle(recorded(0, msg.AGENT_STATE, 3)) == ()
    assert tried.missing() == (1, ("agent 3",))
    # A robot that has all broadcasts may answer before another node under test has.
    tried = started(ROBOT, CONTROLLER)
    tried.handle(recorded(0, msg.AGENT_STATE, 3))
    assert tried.awaits() == (msg.DESIRED_ABSTRACT_STATE,)
    assert tried.handle(recorded(1, msg.AGENT_STATE, 3)) == ()
    answer = tried.handle(recorded(0, msg.DESIRED_ABSTRACT_STATE))
    assert topics(answer) == [(1, msg.AGENT_STATE)] * 3 + [
        (1, msg.PLANE_STATE),
        (1, msg.ABSTRACT_STATE),
        (1, msg.AUXILIARY_STATE),
    ]


ALL = (PARENT, OBSERVER, CONTROLLER, *(NodeName(NodeKind.AGENT, number) for number in (1, 2, 3, 4)))


def test_nodes_that_do_not_wait_for_the_player_may_be_any_number_of_steps_ahead() -> None:
    """With all nodes under test the loop is closed without it, and of what it is late for much is lost on it."""
    tried = player(*ALL)
    assert tried.start() == ()
    for step in (7, 2, LAST):
        assert not any(map(tried.handle, said(step)))
    assert tried.awaits() == ()
    assert tried.missing() == (LAST + 1, ())
    # A robot that has ended is not waited for where others have had its states.
    tried = started(*ALL)
    assert recorded(5, msg.AGENT_STATE, 3) not in said(LAST)  # its last state, which it cannot repeat: it was killed
    assert set(tried.awaits()) == {msg.AGENT_STATE, msg.PLANE_STATE, msg.ABSTRACT_STATE, msg.AUXILIARY_STATE}
    for message in said(LAST):
        tried.handle(message)
    assert tried.awaits() == ()


def test_the_nodes_left_go_on_without_the_player_once_its_robots_are_gone() -> None:
    live = tuple(name for name in ALL if name.agent_id != 3)
    tried = started(*live)
    for step in range(5):
        for message in said(step):
            tried.handle(message)
    assert tried.missing()[0] == 5  # up to here robot 3 had a part in every step
    for message in said(LAST):
        tried.handle(message)
    assert tried.awaits() == ()


@pytest.mark.parametrize("node", [PARENT, OBSERVER, CONTROLLER, ROBOT])
def test_an_answer_to_what_is_not_yet_published_is_refused(node: NodeName) -> None:
    """Whether the next step has anything of the player in it is known when it comes to it."""
    tried = started(*(name for name in ALL if name.agent_id != 4))
    ahead = next(r.message for r in STEPS[3].records if publisher_of(r.message) == node)
    others = (message for step in range(3) for message in said(step))
    with pytest.raises(StepAheadError, match=f"{node}: step [012] expected, 3 received"):
        list(map(tried.handle, (ahead, *others)))


def test_the_recorder_is_not_left_behind() -> None:
    tried = started(ROBOT, window=3)
    for step in range(3):
        tried.handle(recorded(step, msg.AGENT_STATE, 3))
    assert tried.awaits() == (msg.RECORDING_PROGRESS,)
    assert tried.missing() == (3, ("recorder",))
    assert tried.handle(msg.RecordingProgress(0, 0, msg.NEVER)) == ()
    assert topics(tried.handle(msg.RecordingProgress(0, 0, 0))) == [(3, msg.AGENT_STATE)] * 3
    assert tried.awaits() == (msg.AGENT_STATE,)


def test_what_no_correct_node_sends_is_refused() -> None:
    tried = started(CONTROLLER)
    with pytest.raises(StepAheadError, match="controller: step 0 expected, 2 received"):
        tried.handle(recorded(2, msg.DESIRED_ABSTRACT_STATE))
    with pytest.raises(UnexpectedMessageError, match="PlaneState"):
        tried.handle(recorded(0, msg.PLANE_STATE))
    tried = started(CONTROLLER, last=4)
    with pytest.raises(StepAheadError, match="controller: step 4 expected, 5 received"):
        tried.handle(recorded(5, msg.DESIRED_ABSTRACT_STATE))


def test_a_recording_that_is_too_short_is_an_error_and_a_late_event_is_played_late() -> None:
    tried = started(CONTROLLER, last=3, steps=STEPS[:1])
    with pytest.raises(RunError, match="the recording ends with step 0, before step 3"):
        tried.handle(recorded(0, msg.DESIRED_ABSTRACT_STATE))
    late = next(r for r in STEPS[6].records if r.topic is msg.EVENTS)
    tried = started(CONTROLLER, steps=[*STEPS[:2], Step.of(0, (late,)), *STEPS[2:]])
    tried.handle(recorded(0, msg.DESIRED_ABSTRACT_STATE))
    answer = tried.handle(recorded(1, msg.DESIRED_ABSTRACT_STATE))
    assert answer[0] == late.message
    assert tried.missing() == (2, ("swarm/desired_abstract_state",))
