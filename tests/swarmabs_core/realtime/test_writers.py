"""Two senders with the id of one robot: the first one that is heard speaks for it, until it is silent."""

from random import Random

import pytest
from tests.swarmabs_core.realtime import nodes

from swarmabs_config import realtime as configure
from swarmabs_core import messages as msg
from swarmabs_core.realtime.base import Level, Sender
from swarmabs_core.realtime.observer import RealtimeObserver, Role
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_core.realtime.validation import SECOND_SENDER, HeardStates, Writers

AGE = 10
HONEST, INTRUDER, RESTARTED = b"h" * 16, b"i" * 16, b"r" * 16
FORGED = -0.4


def hear(node: RealtimeObserver | RealtimePlane, step: int, *sent: tuple[msg.AgentState, bytes]) -> msg.Messages:
    """Let a node hear states with their writers, and tick."""
    answers: list[msg.Message] = []
    for state, writer in sent:
        answers += node.hear(state, nodes.at(step + 0.1), Sender(writer=writer))
    return (*answers, *node.tick(nodes.at(step + 0.5)))


def swarm(step: int, third: bytes = HONEST) -> list[tuple[msg.AgentState, bytes]]:
    """Return the states of four robots; `third` speaks for robot 3, nobody if it is empty."""
    writers = (b"1" * 16, b"2" * 16, third, b"4" * 16)
    return [(state, writer) for state, writer in zip(nodes.states(step), writers, strict=True) if writer]


def details(answers: list[msg.Message]) -> list[str]:
    return [m.detail for m in answers if isinstance(m, msg.SwarmEvent) and m.kind == msg.EventKind.REFUSED]


@pytest.mark.parametrize("lead", [-1, 0, 1, 2])
def test_a_second_sender_changes_no_sum_of_the_honest_swarm_and_is_named(lead: int) -> None:
    node, alone = nodes.observer(), nodes.observer()
    answers: list[msg.Message] = []
    for step in range(100, 150):
        honest = swarm(step)
        forged = honest[2][0]._replace(step=step + lead, position=FORGED)
        both = [*honest, (forged, INTRUDER)]
        if step > 100 and step % 2:
            both.insert(0, both.pop())
        answer, expected = hear(node, step, *both), hear(alone, step, *honest)
        assert nodes.sums(answer) == nodes.sums(expected)
        answers += answer
    assert set(node.roles.values()) == {Role.ACTIVE}
    assert details(answers) == [f"robot 3: {SECOND_SENDER}"]
    health = node.health(nodes.at(150))
    assert (health.level, health.text) == (Level.WARN, "4 of 4 robots follow; a second sender speaks for robots 3")
    assert dict(health.values)["second sender of robot 3"].startswith(INTRUDER.hex("."))


def test_the_simulated_plane_follows_the_first_sender() -> None:
    clock = configure.plane_config(nodes.scenario(), nodes.CLOCK)
    node, alone = RealtimePlane(clock), RealtimePlane(clock)
    for step in range(100, 150):
        honest = [(s._replace(broadcast_step=step - 1), w) for s, w in swarm(step)]
        forged = honest[2][0]._replace(position=FORGED)
        planes = [
            [m for m in answer if isinstance(m, msg.PlaneState)]
            for answer in (hear(node, step, *honest, (forged, INTRUDER)), hear(alone, step, *honest))
        ]
        assert planes[0] == planes[1] != []
    assert node.health(nodes.at(150)).text.endswith("a second sender speaks for robots 3")


def test_a_restarted_robot_speaks_again_once_its_old_writer_is_silent() -> None:
    node = nodes.observer()
    roles = {}
    for step in range(100, 160):
        third = HONEST if step < 120 else b"" if step < 125 else RESTARTED
        hear(node, step, *swarm(step, third))
        roles[step] = node.roles[3]
    assert roles[129] is Role.ACTIVE  # by its age
    assert {roles[step] for step in range(120 + AGE, 160)} == {
        Role.ACTIVE,
    }
    assert node.health(nodes.at(161)).level is Level.WARN  # its first states were those of a second sender


def test_who_was_there_first_speaks_and_the_robot_that_comes_later_is_named() -> None:
    node = nodes.observer()
    answers: list[msg.Message] = []
    for step in range(100, 140):
        honest, other = swarm(step), nodes.states(step)[2]._replace(position=FORGED)
        late = honest if step >= 110 else [pair for pair in honest if pair[1] != HONEST]
        early = [] if step >= 125 else [(other, INTRUDER)]
        answers += hear(node, step, *early, *late)
    assert details(answers) == [f"robot 3: {SECOND_SENDER}"]
    assert node.roles[3] is Role.ACTIVE  # the intruder fell silent
    assert nodes.sums(hear(node, 140, *swarm(140))) == nodes.sums(hear(fresh(), 140, *swarm(140)))


def fresh() -> RealtimeObserver:
    """Return an observer that has just heard all."""
    node = nodes.observer()
    hear(node, 139, *swarm(139))
    return node


def test_different_states_of_one_writer_and_of_unknown_writers_still_contradict() -> None:
    for writer in (HONEST, b""):
        heard = HeardStates(AGE, 2)
        state = nodes.states(50)[2]
        assert not heard.problem(state, 50, "", writer)
        assert "two different states" in heard.problem(state._replace(position=FORGED), 50, "", writer)
        assert "two different states" in heard.problem(state._replace(step=51), 51, "", writer)


@pytest.mark.parametrize("seed", range(200))
def test_in_no_schedule_does_an_intruder_speak_for_a_robot_that_lives(seed: int) -> None:
    """An independent count of the receiver's steps decides who may speak; pauses and changes of the clock are drawn."""
    draw = Random(seed)
    heard = HeardStates(AGE, 2)
    clock, silent, begun = 1000, 0, False
    for _ in range(300):
        leap = draw.choice([1] * 12 + [2, 40, 1000, -7])
        clock += leap
        lost = begun and silent < (AGE if leap == 1 else 0) // 2 and draw.random() < 0.5
        arriving = [INTRUDER] * draw.randrange(3) + ([] if lost else [HONEST])
        if begun:
            draw.shuffle(arriving)
        else:
            arriving, begun = [HONEST], True
        silent = silent + 1 if lost else 0
        for writer in arriving:
            state = nodes.states(clock + draw.randrange(-1, 3))[2]
            changed = state._replace(position=FORGED if writer == INTRUDER else 0.1 + 1e-6 * state.step)
            problem = heard.problem(changed, clock, "", writer)
            assert (SECOND_SENDER in problem) == (writer == INTRUDER)
        if leap < 0:
            heard.forget()


def test_memory_is_bounded_however_many_writers_there_are() -> None:
    writers = Writers(AGE)
    assert not writers.hear(1, HONEST)
    for number in range(10_000):
        assert writers.refuses(1, number.to_bytes(16, "big"))
    assert writers.contested(1)
    sizes = [len(value) for value in vars(writers).values() if isinstance(value, dict)]
    assert sizes == [1, 1]
