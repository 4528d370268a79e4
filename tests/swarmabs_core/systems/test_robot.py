"""A robot on any parent system at the limits of its command."""

import pytest
from tests.swarmabs_core.systems.helpers import PERIOD, heard, rotors

from swarmabs_core.messages import NEVER, Kind, Status, SwarmBroadcast
from swarmabs_core.models import SystemAgentConfig
from swarmabs_core.models.systems import HELD, SystemRobot
from swarmabs_core.systems.check import initial_states
from swarmabs_core.systems.interface import NamedSystem

pytestmark = pytest.mark.usefixtures("systems")


def rotor(thrust: float) -> tuple[SystemRobot, SwarmBroadcast, SwarmBroadcast]:
    """Return a rotor of a lift with a thrust, and broadcasts with a usable and with an empty Gram matrix."""
    system = NamedSystem("lift", {})
    states = initial_states(system, rotors(-0.5, 0.1, 0.5))
    usable = heard(system, states)
    usable = usable._replace(desired=usable.desired._replace(mean_rate=(1e3, 0.0)))
    singular = usable._replace(auxiliary=usable.auxiliary._replace(gram=(0.0, 0.0, 0.0)))
    config = SystemAgentConfig(
        system="lift",
        kind=Kind.FIRST_ORDER_LAG,
        coordinates=(thrust,),
        constants=states[0].constants,
        period_ns=round(PERIOD * 1e9),
    )
    return SystemRobot(config), usable, singular


def test_a_limited_robot_stays_with_the_others_if_these_need_it() -> None:
    """Alone they cannot control all rows, so it takes part with what it can do, without a break."""
    robot, usable, alone = rotor(14.0)
    assert robot.decide(usable, "", 0).beyond is not None
    assert robot.state(1, 0, Status.ACTIVE).status == Status.LIMITED, "three control two rows without one"
    outcome = robot.decide(alone, "", 1)
    assert (outcome.problem, outcome.beyond is not None) == ("", True)
    state = robot.state(2, 0, Status.ACTIVE)
    assert (state.status, state.command) == (Status.ACTIVE, (15.0,))
    less = usable._replace(desired=usable.desired._replace(mean_rate=(0.0, 0.0), value=usable.abstract.value))
    assert robot.decide(less, "", 2).beyond is None


def test_a_robot_is_held_while_no_robot_follows_and_follows_with_the_next_sums() -> None:
    robot, usable, nobody = rotor(14.0)
    outcome = robot.decide(nobody, "", 0)
    assert (outcome.problem, outcome.held) == (HELD, True)
    assert robot.state(1, NEVER, Status.ACTIVE).command == (14.0,)
    assert not robot.decide(usable, "", 1).problem
