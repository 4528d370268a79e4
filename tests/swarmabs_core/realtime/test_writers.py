"""Two senders with the id of one robot: the first one that is heard speaks for it, until it is silent."""

from random import Random

import pytest
from tests.swarmabs_core.realtime import nodes

from swarmabs_config import realtime as configure
from swarmabs_core import messages as msg
from swarmabs_core.realtime.base import Level, Sender
from swarmabs_core.realtime.observer import RealtimeObserver, Role
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_core.realtime.validation import SECOND_SENDER, HeardStates, Origin, Writers

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
        assert not heard.problem(state, 50, None, writer)
        assert "two different states" in str(heard.problem(state._replace(position=FORGED), 50, None, writer))
        assert "two different states" in str(heard.problem(state._replace(step=51), 51, None, writer))


@pytest.mark.parametrize("seed", range(60))
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
            problem = heard.problem(changed, clock, None, writer)
            assert (SECOND_SENDER in str(problem)) == (writer == INTRUDER)
        if leap < 0:
            heard.forget()


def broadcasts(step: int, torque: float, *, forged: bool) -> list[msg.Message]:
    """Return broadcasts of a step, as a forger says them or as they are."""
    abstract, sums, desired = nodes.broadcasts(step, torque=torque)
    return [abstract._replace(agent_count=4), sums._replace(d0=0.4), desired] if forged else [abstract, sums, desired]


@pytest.mark.parametrize("lead", [0, 1, 2])
@pytest.mark.parametrize("part", [0, 1, 2], ids=["abstract", "sums", "desired"])
def test_a_robot_never_acts_on_broadcasts_of_a_second_sender_and_names_it(lead: int, part: int) -> None:
    body, node = nodes.robot()
    alone_body, alone = nodes.robot()
    answers: list[msg.Message] = []
    for step in range(100, 180):
        forging = 110 <= step < 140
        genuine = broadcasts(step, 0.3, forged=False)
        for message in genuine:
            alone.hear(message, nodes.at(step + 0.6), Sender(writer=HONEST))
        spoken = [(message, HONEST) for message in genuine]
        if forging:
            spoken.insert(0, (broadcasts(step + lead, -3.0, forged=True)[part], INTRUDER))
        if step == 112 + lead:  # of what is missing of a step nothing forged takes the place
            spoken = [(message, writer) for message, writer in spoken if message is not genuine[part]]
        for message, writer in spoken:
            answers += node.hear(message, nodes.at(step + 0.6), Sender(writer=writer))
        answers += node.tick(nodes.at(step + 1))
        alone.tick(nodes.at(step + 1))
        if step == 125:
            health = node.health(nodes.at(step + 1))
            assert "safe stop: the broadcasts contradict each other" in health.text
            assert f"a second sender speaks for {msg.BROADCASTS[part].name}" in health.text
    assert set(body.commands) <= {0.0, *alone_body.commands}
    assert body.commands[-1] == alone_body.commands[-1] != 0.0, "it follows again"
    assert min(details(answers)) == f"{msg.BROADCASTS[part].name}: {SECOND_SENDER}"
    assert len(details(answers)) == 2


@pytest.mark.parametrize("lead", [0, 1, 2])
def test_the_controller_never_answers_a_second_plane_and_names_it(lead: int) -> None:
    node = nodes.controller()
    answers: list[msg.Message] = []
    asked: list[int] = []
    for step in range(100, 160):
        forging = 110 <= step < 130
        spoken = [(msg.PlaneState(0, step, 0.05, 0.0), HONEST)]
        if forging:
            spoken.insert(0, (msg.PlaneState(0, step + lead, 1.0, 0.0), INTRUDER))
        for plane, writer in spoken:
            answer = node.hear(plane, nodes.at(step + 0.55), Sender(writer=writer))
            asked += [m.step for m in answer if isinstance(m, msg.DesiredAbstractState)]
            answers += answer
            assert writer == HONEST or not any(isinstance(m, msg.DesiredAbstractState) for m in answer)
        answers += node.tick(nodes.at(step + 0.75))
        if step == 125:
            health = node.health(nodes.at(step + 0.8))
            assert health.level is Level.ERROR
            assert "a second sender speaks for plane/state" in health.text
    assert asked == [*range(100, 110 + lead), *range(140 + lead, 160)]
    assert details(answers)[0] == f"plane/state: {SECOND_SENDER}"


def test_coordinators_that_restart_take_the_place_of_their_old_writers() -> None:
    controller, (body, robot) = nodes.controller(), nodes.robot()
    asked = []
    for step in range(100, 160):
        sender = Sender(writer=HONEST if step < 110 else RESTARTED)
        if not 110 <= step < 125:
            answer = controller.hear(msg.PlaneState(0, step, 0.05, 0.0), nodes.at(step + 0.55), sender)
            asked += [m.step for m in answer if isinstance(m, msg.DesiredAbstractState)]
            for message in nodes.broadcasts(step, torque=0.3):
                robot.hear(message, nodes.at(step + 0.6), sender)
        controller.tick(nodes.at(step + 0.75))
        robot.tick(nodes.at(step + 1))
    assert asked == [*range(100, 110), *range(125, 160)]
    assert controller.health(nodes.at(160)).text == "running"
    assert (body.commands[-36] == 0.0, body.commands[-35] != 0.0) == (True, True)


def test_memory_is_bounded_however_many_writers_there_are() -> None:
    writers, origin = Writers(AGE), Origin("plane/state")
    assert not writers.hear(origin, HONEST)
    for number in range(10_000):
        assert writers.refuses(origin, number.to_bytes(16, "big"))
    sizes = [len(value) for value in vars(writers).values() if isinstance(value, dict)]
    assert sizes == [0, 1, 1]
