from dataclasses import dataclass, field
from math import nan

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.signal import cont2discrete
from tests.swarmabs_core.helpers import PERIOD_NS, agent_state, taylor

from swarmabs_core import messages as msg
from swarmabs_core.behaviours import Controller
from swarmabs_core.behaviours.base import ConflictError, StepAheadError, UnexpectedMessageError
from swarmabs_core.controllers import StateFeedback
from swarmabs_core.desired_state import DesiredStateGenerator, SwarmOnPlane
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.manifold import Manifold
from swarmabs_core.models import ControllerConfig
from swarmabs_core.swarm_law import SwarmGains

H = PERIOD_NS / 1e9
MANIFOLD = Manifold(0.0125, 0.025, 5.0)
ON_PLANE = SwarmOnPlane(9.81, SwarmGains())


@dataclass
class Given:
    """A law that wants given torques, one after the other, and notes when it was asked."""

    torques: list[float]
    asked: list[float] = field(default_factory=list)

    def torque(self, time: float, plane: msg.PlaneState) -> float:
        self.asked.append(time)
        return self.torques[len(self.asked) - 1]

    def reference(self, time: float) -> float:
        return 0.0


def controller(torques: list[float], *, window: int = 0, last_step: int | None = None) -> tuple[Controller, Given]:
    law = Given(torques)
    config = ControllerConfig(PERIOD_NS, last_step, manifold=MANIFOLD, recording_window=window)
    return Controller(config, config.desired_states(law)), law


def plane(step: int, angle: float = 0.1) -> msg.PlaneState:
    return msg.PlaneState(step * PERIOD_NS, step, angle, 0.0)


def answered(node: Controller, steps: int) -> list[msg.Message]:
    return [answer for step in range(steps) for answer in node.handle(plane(step))]


def test_desired_state_is_the_filtered_torque_lifted_onto_the_manifold() -> None:
    """The filter is SciPy's; the rest is written out from the filter's states."""
    torques = [0.3, 0.1, -0.4, 7.0, 7.0, -9.0, 0.0, 0.0]
    node, law = controller(torques)
    found = [answer[3:] for answer in answered(node, len(torques)) if isinstance(answer, msg.DesiredAbstractState)]

    w = 50.0
    system = np.array([[0.0, 1.0], [-w * w, -2.0 * w]]), np.array([[0.0], [w * w]])
    a, b, *_ = cont2discrete((*system, np.eye(2), np.zeros((2, 1))), H, "zoh")
    x = [np.array([0.3, 0.0])]
    for torque in np.clip(torques, -5.0, 5.0):
        x.append(a @ x[-1] + b[:, 0] * torque)
    t, dt = np.array(x).T
    acceleration = np.diff(dt) / H
    t, dt, after = t[:-1], dt[:-1], t[1:]
    expected = [
        t,
        0.0125 * t**2 + 0.025,
        dt,
        0.025 * t * dt,
        (after - t) / H,
        0.0125 * (after**2 - t**2) / H,
        acceleration,
        0.025 * (dt**2 + t * acceleration),
    ]
    np.testing.assert_allclose(found, np.transpose(expected), rtol=1e-9, atol=1e-11)
    assert law.asked == [step * H for step in range(len(torques))]


def test_every_step_is_answered_once_and_what_no_correct_peer_sends_is_refused() -> None:
    node, law = controller([9.0, *[0.1] * 3], last_step=2)
    assert node.start() == ()
    for step in range(3):
        assert node.awaits() == (msg.PLANE_STATE,)
        assert node.missing() == (step, ("plane_sim",))
        *_, answer = node.handle(plane(step))
        assert (answer[0], answer.step) == (step * PERIOD_NS, step)
        if step == 0:
            still = (0.0,) * 6
            assert answer == msg.DesiredAbstractState(0, 0, msg.Mode.RUN, 5.0, pytest.approx(0.3375), *still), (
                "begins at rest"
            )
        assert node.handle(plane(step)) == ()
    assert node.awaits() == ()
    assert len(law.asked) == 3
    node, _ = controller([0.1] * 3, window=1)
    with pytest.raises(StepAheadError, match="plane/state: step 0 expected, 1 received"):
        node.handle(plane(1))
    with pytest.raises(UnexpectedMessageError, match="parent controller: received AgentState"):
        node.handle(agent_state(1))
    node.handle(plane(0))
    assert node.handle(plane(1)) == ()
    assert node.handle(plane(1)) == ()
    with pytest.raises(ConflictError, match="plane/state: two different messages of step 1"):
        node.handle(plane(1, 0.2))


def test_limited_torque_is_told_on_the_rising_edge_only() -> None:
    torques = [5.0, 5.1, 9.0, 5.0, -5.1, -6.0, 6.0, 0.0, 8.0]
    node, _ = controller(torques)
    events = [m for m in answered(node, len(torques)) if isinstance(m, msg.SwarmEvent)]
    assert [(e.step, e.agent_id, e.kind, e.value) for e in events] == [
        (1, 0, msg.EventKind.LIMIT_HIT, 5.1),
        (4, 0, msg.EventKind.LIMIT_HIT, -5.1),
        (8, 0, msg.EventKind.LIMIT_HIT, 8.0),
    ]


@pytest.mark.parametrize("angle", [1.5, -1.5, float("inf"), float("nan")])
def test_steep_plane_fails_the_run(angle: float) -> None:
    node, law = controller([0.0, 0.0])
    node.handle(plane(0, 1.4999))
    with pytest.raises(RunError, match=r"step 1: the plane's angle is .* rad and a run ends at 1\.5 rad"):
        node.handle(plane(1, angle))
    assert len(law.asked) == 1


def test_run_stays_within_the_recorders_credit() -> None:
    """With a window of 3 steps, step k waits until step k - 3 is written."""
    node, law = controller([0.1] * 10, window=3)
    for step in range(3):
        assert len(node.handle(plane(step))) == 1
    assert node.handle(plane(3)) == ()
    assert node.awaits() == (msg.RECORDING_PROGRESS,)
    assert node.missing() == (3, ("recorder",))
    assert node.handle(msg.RecordingProgress(0, 0, msg.NEVER)) == ()
    (desired,) = node.handle(msg.RecordingProgress(0, 0, 0))
    assert desired.step == 3
    assert node.handle(msg.RecordingProgress(0, 0, 2)) == ()  # credit for two more
    assert node.handle(msg.RecordingProgress(0, 0, 1)) == ()  # late news take none back
    assert [len(node.handle(plane(step))) for step in (4, 5, 6)] == [1, 1, 0]
    assert len(law.asked) == 6


def test_a_generator_resumes_from_a_state_of_its_filter_and_offsets_the_reference_of_a_law_that_knows_how() -> None:
    law = StateFeedback(3.0, 2.0)
    first, second, third = (DesiredStateGenerator(PERIOD_NS, MANIFOLD, law, ON_PLANE) for _ in range(3))
    first.advance(0, plane(0, 0.3))
    _, wanted = first.advance(PERIOD_NS, plane(1, 0.2))
    second.resume(wanted)
    assert second.advance(PERIOD_NS, plane(1, 0.2)) == ((), wanted)
    _, wanted = third.advance(0, msg.PlaneState(0, 0, 0.3, 0.1), offset=0.1)
    assert wanted.torque == pytest.approx(3.0 * (0.3 - 0.1) + 2.0 * 0.1, rel=1e-15)
    other = DesiredStateGenerator(PERIOD_NS, MANIFOLD, Given([nan]), ON_PLANE)
    with pytest.raises(InputError, match="has no method offset_torque"):
        other.advance(0, plane(7), offset=0.1)
    with pytest.raises(RunError, match=r"step 7: .* a torque of nan N m at an angle of 0\.1 rad"):
        other.advance(0, plane(7))


def test_manifold_of_the_paper() -> None:
    assert [MANIFOLD.inertia(torque) for torque in (0.0, -5.0)] == pytest.approx([0.025, 0.3375], rel=1e-15)
    clipped = [MANIFOLD.clip(torque) for torque in (-7.0, -5.0, -0.0, 4.9, 1e300, nan)]
    assert clipped == pytest.approx([-5.0, -5.0, 0.0, 4.9, 5.0, nan], rel=0.0, nan_ok=True)


@given(st.floats(-3.0, 3.0), st.floats(-2.0, 2.0), st.floats(0.1, 2.0))
def test_rates_on_the_manifold_are_the_derivatives_along_a_path(t: float, a: float, b: float) -> None:
    """tau(t) = a + b t + t^2, exactly differentiated and lifted numerically."""
    tau, rate, acceleration = a + b * t + t * t, b + 2.0 * t, 2.0
    _, first, second = taylor(lambda z: 0.0125 * (a + b * z + z * z) ** 2 + 0.025, t, 2)
    assert MANIFOLD.curve.rate(tau, rate) == pytest.approx(first, abs=1e-10)
    assert MANIFOLD.curve.acceleration(tau, rate, acceleration) == pytest.approx(second, abs=1e-9)
