"""A robot on any parent system at the limits of its command."""

import pytest
from tests.swarmabs_core.systems.helpers import PERIOD, heard, rotors

from swarmabs_core.behaviours.systems import HELD, SystemAgentConfig, SystemRobot
from swarmabs_core.messages import NEVER, RobotKind, RobotStatus, Status, SwarmBroadcast
from swarmabs_core.systems.check import initial_states
from swarmabs_core.systems.interface import NamedSystem

pytestmark = pytest.mark.usefixtures("systems")


def rotor(thrust: float) -> tuple[SystemRobot, SwarmBroadcast, SwarmBroadcast]:
    """Return a rotor of a lift with a thrust, and broadcasts with a usable and with a singular Gram matrix."""
    system = NamedSystem("lift", {})
    states = initial_states(system, rotors(-0.5, 0.1, 0.5))
    usable = heard(system, states)
    usable = usable._replace(desired=usable.desired._replace(mean_rate=(1e3, 0.0)))
    singular = usable._replace(auxiliary=usable.auxiliary._replace(gram=(0.0, 0.0, 0.0)))
    config = SystemAgentConfig(
        "lift",
        kind=RobotKind.FIRST_ORDER_LAG,
        coordinates=(thrust,),
        constants=states[0].constants,
        period_ns=round(PERIOD * 1e9),
    )
    return SystemRobot(config), usable, singular


def test_a_limited_robot_returns_if_the_others_cannot_control_all_rows() -> None:
    robot, usable, singular = rotor(14.0)
    assert robot.decide(usable, "", 0).beyond is not None
    limited = robot.state(1, 0, Status.ACTIVE)
    assert (limited.status, limited.command) == (RobotStatus.LIMITED, (15.0,))
    assert robot.decide(singular, "", 1).problem == ""
    again = robot.state(2, 1, Status.ACTIVE)
    assert (again.status, again.command) == (RobotStatus.ACTIVE, (15.0,))
    assert robot.decide(singular, "", 2).problem == HELD  # it was not limited, so its return cannot help
    assert robot.state(3, NEVER, Status.SAFE_STOP).command == (14.0,)
