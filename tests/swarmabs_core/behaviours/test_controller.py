from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.signal import cont2discrete
from tests.swarmabs_core.helpers import PERIOD_NS, agent_state

from swarmabs_core.behaviours import Controller, ControllerConfig
from swarmabs_core.behaviours.base import ConflictError, StepAheadError, UnexpectedMessageError
from swarmabs_core.errors import RunError
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import (
    NEVER,
    PLANE_STATE,
    RECORDING_PROGRESS,
    DesiredAbstractState,
    EventKind,
    Message,
    Mode,
    PlaneState,
    RecordingProgress,
    SwarmEvent,
)

H = PERIOD_NS / 1e9


@dataclass
class Given:
    """A law that wants given torques, one after the other, and notes when it was asked."""

    torques: list[float]
    asked: list[float] = field(default_factory=list)

    def torque(self, time: float, plane: PlaneState) -> float:
        self.asked.append(time)
        return self.torques[len(self.asked) - 1]

    def reference(self, time: float) -> float:
        return 0.0


def controller(torques: list[float], *, window: int = 0, last_step: int | None = None) -> tuple[Controller, Given]:
    law = Given(torques)
    return Controller(ControllerConfig(PERIOD_NS, Manifold(0.0125, 0.025, 5.0), window, last_step), law), law


def plane(step: int, angle: float = 0.1) -> PlaneState:
    return PlaneState(step * PERIOD_NS, step, angle, 0.0)


def progress(written: int) -> RecordingProgress:
    return RecordingProgress(0, 0, written)


def wishes(answers: list[Message]) -> np.ndarray:
    return np.array([answer[3:] for answer in answers if isinstance(answer, DesiredAbstractState)])


def test_desired_state_is_the_filtered_torque_lifted_onto_the_manifold() -> None:
    """The filter is SciPy's; the rest is written out from the filter's states."""
    torques = [0.3, 0.1, -0.4, 7.0, 7.0, -9.0, 0.0, 0.0]
    node, law = controller(torques)
    found = wishes([m for step in range(len(torques)) for m in node.handle(plane(step))])

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


def test_all_rates_start_at_zero() -> None:
    node, _ = controller([9.0])
    *_, desired = node.handle(plane(0))
    zeros = (0.0,) * 6
    assert desired == DesiredAbstractState(0, 0, Mode.RUN, 5.0, pytest.approx(0.3375), *zeros)


def test_every_step_is_answered_once() -> None:
    node, law = controller([0.1] * 4, last_step=2)
    assert node.start() == ()
    for step in range(3):
        assert node.awaits() == (PLANE_STATE,)
        assert node.missing() == (step, ("plane_sim",))
        (answer,) = node.handle(plane(step))
        assert (answer[0], answer.step) == (step * PERIOD_NS, step)
        assert node.handle(plane(step)) == ()
    assert node.awaits() == ()
    assert len(law.asked) == 3


def test_limited_torque_is_told_on_the_rising_edge_only() -> None:
    torques = [5.0, 5.1, 9.0, 5.0, -5.1, -6.0, 6.0, 0.0, 8.0]
    node, _ = controller(torques)
    answers = [m for step in range(len(torques)) for m in node.handle(plane(step))]
    events = [m for m in answers if isinstance(m, SwarmEvent)]
    assert [(e.step, e.agent_id, e.kind, e.value) for e in events] == [
        (1, 0, EventKind.LIMIT_HIT, 5.1),
        (4, 0, EventKind.LIMIT_HIT, -5.1),
        (8, 0, EventKind.LIMIT_HIT, 8.0),
    ]


@pytest.mark.parametrize("angle", [1.5, -1.5, 2.0, float("inf"), float("nan")])
def test_steep_plane_fails_the_run(angle: float) -> None:
    node, law = controller([0.0, 0.0])
    node.handle(plane(0, 1.4999))
    with pytest.raises(RunError, match=r"step 1: the plane's angle is .* rad and a run ends at 1\.5 rad"):
        node.handle(plane(1, angle))
    assert len(law.asked) == 1


def test_what_no_correct_peer_sends() -> None:
    node, _ = controller([0.1] * 3, window=1)
    with pytest.raises(StepAheadError, match="plane/state: step 0 expected, 1 received"):
        node.handle(plane(1))
    with pytest.raises(UnexpectedMessageError, match="parent controller: a AgentState was delivered"):
        node.handle(agent_state(1))
    node.handle(plane(0))
    assert node.handle(plane(1)) == ()
    assert node.handle(plane(1)) == ()
    with pytest.raises(ConflictError, match="plane/state: two different messages of step 1"):
        node.handle(plane(1, 0.2))


def test_run_stays_within_the_recorders_credit() -> None:
    """With a window of 3 steps, step k waits until step k - 3 is written."""
    node, law = controller([0.1] * 10, window=3)
    for step in range(3):
        assert len(node.handle(plane(step))) == 1
    assert node.handle(plane(3)) == ()
    assert node.awaits() == (RECORDING_PROGRESS,)
    assert node.missing() == (3, ("recorder",))
    assert node.handle(progress(NEVER)) == ()
    (desired,) = node.handle(progress(0))
    assert desired.step == 3
    assert node.handle(progress(2)) == ()  # credit for two more
    assert node.handle(progress(1)) == ()  # late news take none back
    assert [len(node.handle(plane(step))) for step in (4, 5, 6)] == [1, 1, 0]
    assert len(law.asked) == 6


def test_without_a_recorder_nothing_is_waited_for() -> None:
    node, _ = controller([0.1] * 500)
    assert all(len(node.handle(plane(step))) == 1 for step in range(500))
