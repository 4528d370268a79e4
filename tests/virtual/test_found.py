"""What the search has found in the nodes: each case once broke a property."""

import pytest
from tests.transport.network import Act
from tests.virtual.bags import BagCase, Harm
from tests.virtual.lockstep import Doing as Turn, LockstepCase
from tests.virtual.rounds import Doing, RoundsCase
from tests.virtual.schedule import Case, Fault
from tests.virtual.search import AnyCase, run

from swarmabs_config.graph import PLANE

_WITHOUT = "a fleet without coordinators"
_STOPPED = "a fleet without coordinators that is stopped while a robot is dead"

FOUND = {
    "an observer that is heard and hears nothing leads on": Case(
        5061, robots=3, hertz=50, paired=True, faults=(Fault(3.195, "cut", "*>abstraction_observer", 3.0),)
    ),
    "who speaks for both of a pair leads a robot": Case(
        121, hertz=10, paired=True, faults=(Fault(13.068, "impostor", "agent_001", 0.785, 1),), quiet=14.0
    ),
    "a robot that is activated at the start counts nobody, and stops for ever": Case(
        31,
        robots=8,
        hertz=10,
        each_robot=True,
        start="proceed",
        faults=(Fault(0.0, "crash", "plane_sim", 0.986), Fault(0.953, "idle", "agent_003", 0.086)),
        quiet=3.5,
    ),
    "a robot that has left hears of no join while it is dead": Case(
        187,
        robots=3,
        faults=(
            Fault(4.966, "leave", "agent_001"),
            Fault(5.1, "pause", "agent_001", 0.4),
            Fault(5.2, "join", "agent_001"),
        ),
    ),
    "what happens just after a coordinator is lost is never reported": Case(
        421,
        robots=4,
        paired=True,
        start="proceed",
        faults=(Fault(0.0, "crash", "agent_001", 2.97), Fault(3.01, "crash", "abstraction_observer", 1.0)),
        quiet=4.1,
    ),
    "a controller whose clock was set back in STOP does not repeat it until the clock is as late again": Case(
        1400374,
        robots=2,
        hertz=10,
        paired=True,
        faults=(
            Fault(3.374, "clock", "parent_controller", 1.394, 12),
            Fault(3.634, "clock", "parent_controller_standby", 1.875, -12),
            Fault(4.062, "stop", "parent_controller_standby"),
        ),
        quiet=5.7,
    ),
    "an order before the first step ends a robot": Case(
        22061,
        hertz=10,
        each_robot=True,
        stopped=True,
        faults=(Fault(0.339, "clock", "agent_003", 1.092, -0.5), Fault(0.36, "stop", "agent_003")),
        quiet=1.5,
    ),
    "a STOP that repeats an answer which was never published is taken for wrong": Case(
        30863,
        hertz=10,
        paired=True,
        recorded=True,
        faults=(
            Fault(3.422, "leave", "agent_002"),
            Fault(3.513, "join", "agent_002"),
            Fault(7.957, "stop", "parent_controller_standby"),
        ),
        quiet=7.957,
    ),
    "an event that a recorder has told is told again, and twice in the merged bag": Case(
        1300865,
        robots=3,
        hertz=10,
        paired=True,
        recorded=True,
        faults=(
            Fault(3.3, "clock", "plane_sim", 5.282, 1.1),
            Fault(4.026, "clock", "abstraction_observer", 3.806, 1),
            Fault(4.348, "clock", "agent_003", 1.159, -0.4),
            Fault(4.976, "stop", "parent_controller_standby"),
            Fault(5.636, "stop", "parent_controller"),
            Fault(5.681, "stop", "parent_controller"),
        ),
        quiet=8.582,
    ),
    "a robot acts on its last measurement as if it had not moved since, and leaves its lane": Case(
        7001625,
        robots=3,
        paired=True,
        own_topics=True,
        stopped=True,
        faults=(Fault(0.0, "skew", "abstraction_observer", 8.979, -0.075), Fault(7.331, "blind", "agent_003", 1.648)),
        quiet=8.979,
    ),
    "a RESET ends by the clock while the node stands still, so that the STOP before it holds for ever": Case(
        7009205,
        hertz=10,
        each_robot=True,
        stopped=True,
        links="{type: ring, loss: 0.3, seed: 75, sensing: []}",
        faults=(
            Fault(8.713, "crash", "agent_003", 1.091),
            Fault(10.381, "crash", "plane_sim", 0.585),
            Fault(10.465, "pause", "agent_003", 0.601),
        ),
        quiet=11.104,
    ),
    "robots that nobody connects with the plane any more wait for its state for ever": RoundsCase(
        80040,
        robots=9,
        links="{type: ring, sensing: [1, 2]}",
        loss=0.0,
        planned="[]",
        faults=(
            Doing("stands", 4, 0.257, 0.436),
            Doing("ends", 3, 91),
            Doing("ends", 7, 43),
            Doing("ends", 1, 68),
        ),
    ),
    "who decides with a vote that nobody knows, and ends, is left out of a step that has its state": RoundsCase(
        601144,
        robots=8,
        links="{type: ring, loss: 0.3}",
        loss=0.0,
        planned="[]",
        faults=(Doing("ends", 8, 22), Doing("ends", 1, 75)),
    ),
    "neighbours are taken for done that have not heard of the last vote, and all wait for ever": RoundsCase(
        601678,
        robots=8,
        links="{type: ring, loss: 0.3}",
        loss=0.0,
        planned="[]",
        faults=(Doing("ends", 6, 11), Doing("stands", 4, 0.645, 0.311), Doing("deaf", 5, 0.585, other=4)),
    ),
    "who leaves while neighbours wait for what it has voted is waited for, for ever": RoundsCase(
        4300712,
        robots=7,
        links="{loss: 0.3}",
        loss=0.05,
        planned="[{kind: leave, agent: 3, at: 0.05}, {kind: kill, agent: 6, at: 0.08}]",
        faults=(),
    ),
    "who waits in vain for the plane has waited since before the others gave their states": RoundsCase(
        4504600,
        robots=8,
        links="{type: random, degree: 4, loss: 0.3, sensing: [1, 2]}",
        loss=0.05,
        planned="[]",
        faults=(Doing("ends", 1, 82), Doing("stands", 3, 0.391, 0.503), Doing("deaf", 1, 0.518, other=6)),
    ),
    "the last word of a neighbour comes after its round was given up, and is waited for, for ever": RoundsCase(
        4618312,
        robots=10,
        links="{type: ring, loss: 0.3}",
        loss=0.05,
        planned="[]",
        faults=(Doing("ends", 10, 32), Doing("stands", 8, 0.368, 0.297), Doing("stands", 3, 0.532, 0.374)),
    ),
    "one is told to have joined in the step in which it is dropped": RoundsCase(
        4505080,
        robots=5,
        links="{loss: 0.3}",
        loss=0.0,
        planned="[{kind: join, agent: 5, at: 0.07}, {kind: join, agent: 4, at: 0.05}]",
        faults=(Doing("ends", 2, 70), Doing("ends", 5, 32), Doing("ends", 3, 32)),
    ),
    "robots that wait for the plane vote although nobody is silent, so that other relays are recorded": LockstepCase(
        1312, "drop, each robot", (), PLANE, 3, stands=True
    ),
    "robots vote although nobody is silent while a neighbour, which is behind them, waits for the plane": LockstepCase(
        1600875,
        "drop, each robot",
        (
            Turn(3, Act.PASS, 7),
            Turn(3, Act.RUN, 246),
            Turn(19, Act.OTHER, 244),
            Turn(7, Act.PASS, 57),
            Turn(13, Act.RUN, 13),
            Turn(14, Act.OTHER, 128),
            Turn(5, Act.OTHER, 207),
            Turn(13, Act.LOSE, 105),
        ),
        PLANE,
        67,
        stands=True,
    ),
    "a robot votes although what it waits for is only under way, so that other relays are recorded": LockstepCase(
        4301571,
        "drop, each robot",
        (
            Turn(8, Act.TWICE, 87),
            Turn(15, Act.RUN, 168),
            Turn(10, Act.OTHER, 17),
            Turn(2, Act.RUN, 130),
            Turn(8, Act.OTHER, 54),
            Turn(18, Act.OTHER, 52),
            Turn(20, Act.RUN, 136),
            Turn(14, Act.PASS, 6),
            Turn(8, Act.OTHER, 207),
            Turn(19, Act.OTHER, 200),
            Turn(8, Act.OTHER, 216),
            Turn(10, Act.RUN, 88),
            Turn(3, Act.OTHER, 184),
            Turn(5, Act.RUN, 78),
            Turn(4, Act.OTHER, 208),
            Turn(14, Act.LOSE, 19),
            Turn(15, Act.OTHER, 119),
            Turn(19, Act.TWICE, 221),
            Turn(20, Act.OTHER, 228),
            Turn(10, Act.OTHER, 152),
            Turn(2, Act.OTHER, 58),
        ),
        PLANE,
        112,
        stands=True,
        calm=True,
    ),
    "a standby whose clock is ahead, within what is tolerated, leads on beside its primary": Case(
        2000193,
        robots=2,
        hertz=10,
        paired=True,
        quiet=12.0,
        faults=(
            Fault(0.0, "skew", "parent_controller_standby", 11.862, 0.15),
            Fault(6.54, "cut", "parent_controller>parent_controller_standby", 0.967),
        ),
    ),
    "a STOP at the silent controller that its leader does not hear is given up for the RESET before it": Case(
        2101489,
        hertz=20,
        paired=True,
        stopped=True,
        faults=(
            Fault(2.259, "cut", "parent_controller_standby>parent_controller", 1.247),
            Fault(2.359, "stop", "parent_controller_standby"),
        ),
    ),
    "an observer that restarts begins without one that is carried away meanwhile": Case(
        1601935,
        hertz=10,
        paired=True,
        stopped=True,
        faults=(
            Fault(0.0, "crash", "agent_004", 3.953),
            Fault(0.739, "crash", "agent_002", 7.264),
            Fault(4.168, "crash", "abstraction_observer", 0.282),
            Fault(5.298, "removal", "agent_002"),
        ),
    ),
    "what robots compute themselves is taken for wrong where a bag begins, and hears them late": BagCase(
        0, _WITHOUT, (Harm(1.418, "late", 1, 1.758, 0.3), Harm(2.261, "begins", 1)), recorders=1
    ),
    "what robots compute themselves is taken for wrong where the relay of an order is lost": BagCase(
        2, _STOPPED, (Harm(2.35, "loss", 1, 0.1, 0.3),), recorders=1
    ),
    "a STOP of robots without coordinators repeats an answer before the bag, and is taken for wrong": BagCase(
        0, _STOPPED, (Harm(2.0, "begins", 1),), recorders=1
    ),
    "a bag that ends before a robot is dropped lacks relays of that robot, and is taken for wrong": BagCase(
        1450,
        "a run without coordinators in which a robot is dropped",
        (Harm(0.059, "late", 1, 0.669, 0.02), Harm(0.188, "late", 1, 0.25, 0.3), Harm(0.64, "killed", 1)),
        recorders=1,
        chunk_bytes=2500,
        short=0.3,
    ),
    "a merge does not name what is missing of a last step of which there is one relay": BagCase(
        401218,
        "a run without coordinators",
        (
            Harm(0.404, "full disk", 1, 0.086, 70090.0),
            Harm(1.149, "late", 2, 1.536, 0.3),
            Harm(3.369, "full disk", 2, 1.187, 101260.0),
        ),
        short=0.3,
        pace=0.06,
        gathers=0.2,
    ),
}


@pytest.mark.parametrize("case", FOUND.values(), ids=FOUND)
def test_what_once_broke_holds(case: AnyCase) -> None:
    assert str(run(case).broken) == "None"
