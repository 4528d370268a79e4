"""The couplings of examples/cascade take messages late, early, repeated and contradicting, as all nodes do."""

from itertools import permutations

import pytest
from coupling import Coupled, TiltDrive
from layers import Coupling, absolute, carried_robot, led_controller, load_cascade

from swarmabs_core import messages as msg
from swarmabs_core.behaviours.base import ConflictError, StepAheadError

PERIOD = 10_000_000
BROADCASTS: tuple[msg.Message, ...] = (
    msg.AbstractState(0, 0, 3, 0.3, 0.03, 0.0, 0.0),
    msg.AuxiliaryState(0, 0, 1.1, 0.04, 0.02, 0.0204, 0.0, 0.0, 0.0, 0.0),
    msg.DesiredAbstractState(0, 0, msg.Mode.RUN, 0.2, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)


def plane(step: int, angle: float = 0.02) -> msg.PlaneState:
    return msg.PlaneState(step * PERIOD, step, angle, 0.1)


def robot(step: int, command: float = 0.01, agent_id: int = 1) -> msg.AgentState:
    return msg.AgentState(step * PERIOD, step, 0, agent_id, 1, 1, 0.6, 0.0, 0.14, 0.0, command)


def carried() -> Coupled:
    cascade = load_cascade()
    return carried_robot(cascade.upper, 1, cascade.lower[1], Coupling())


def led(duration: str = "20.0") -> Coupled:
    cascade = load_cascade(overrides=[f"duration={duration}"])
    return led_controller(cascade.lower[1], 1, Coupling(), recording_window=0)


def test_a_carried_robot_moves_by_the_tilt_whatever_comes_first() -> None:
    answers = set()
    for order in permutations((*BROADCASTS, plane(1))):
        behaviour = carried()
        assert behaviour.start()
        *early, last = order
        assert not [answer for message in early for answer in behaviour.handle(message)]
        answers.add(behaviour.handle(last))
        assert not behaviour.handle(last)
    ((state,),) = answers
    assert isinstance(state, msg.AgentState)
    # By hand: from 0.03 rad at rest to 0.02 rad at 0.1 rad/s in 10 ms, at 1 m/s per rad.
    assert state.position == pytest.approx(0.14 + 0.005 * (0.03 + 0.02) - 1e-4 / 12.0 * 0.1, rel=1e-14)
    assert (state.step, state.velocity) == (1, 0.02)
    # Its row of the pseudo-inverse, m (S2 - p S1)/(g S3) = 0.00864/0.200124, times K e = 1.5 (0.2 - 0.3).
    assert state.command == pytest.approx(-0.15 * 0.00864 / 0.200124, rel=1e-9)


def test_a_led_controller_waits_for_its_own_robot_of_the_same_step() -> None:
    behaviour = led()
    assert behaviour.awaits() == (absolute(msg.AGENT_STATE, "/upper"),)
    assert not behaviour.handle(plane(0, 0.03))
    assert not behaviour.handle(robot(0, agent_id=2))
    assert "/upper/swarm/agent_state" in behaviour.missing()[1]
    (first,) = behaviour.handle(robot(0))
    assert isinstance(first, msg.DesiredAbstractState)
    assert not behaviour.handle(robot(0))
    assert not behaviour.handle(plane(0, 0.03))
    assert not behaviour.handle(robot(1))
    assert behaviour.awaits() == (msg.PLANE_STATE,)
    assert behaviour.handle(plane(1))[-1].step == 1
    behaviour = led("0.01")
    for step in (0, 1):
        behaviour.handle(robot(step))
        assert behaviour.handle(plane(step))
    assert behaviour.awaits() == ()


def test_contradictions_and_steps_ahead_are_refused() -> None:
    behaviour = led()
    behaviour.handle(robot(0))
    with pytest.raises(ConflictError, match="/upper/swarm/agent_state: two different messages of step 0"):
        behaviour.handle(robot(0, command=0.02))
    with pytest.raises(StepAheadError, match="step 0 expected, 2 received"):
        behaviour.handle(robot(2))
    behaviour = carried()
    behaviour.start()
    behaviour.handle(BROADCASTS[2])
    with pytest.raises(ConflictError, match="desired_abstract_state: two different messages of step 0"):
        behaviour.handle(BROADCASTS[2]._replace(torque=0.5))


def test_a_tilt_drive_integrates_a_cubic_exactly() -> None:
    def cubic(t: float) -> tuple[float, float, float]:
        """Angle, rate and integral."""
        return 0.1 - t + 3.0 * t**2 + 2.0 * t**3, -1.0 + 6.0 * t + 6.0 * t**2, 0.1 * t - t**2 / 2.0 + t**3 + t**4 / 2.0

    drive = TiltDrive(0.5, 0.2, *cubic(0.0)[:2])
    position, velocity = 1.0, 0.0
    for step in (1, 2):
        angle, rate, _ = cubic(0.2 * step)
        drive.hear(msg.PlaneState(0, step, angle, rate))
        position, velocity = drive.advance(position, velocity, 7.0)
    assert position == pytest.approx(1.0 + 0.5 * cubic(0.4)[2], rel=1e-14)
    assert velocity == 0.5 * cubic(0.4)[0]
