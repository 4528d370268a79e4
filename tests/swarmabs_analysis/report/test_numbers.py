"""The numbers of a report are those of its bag, computed here from what another reader finds in it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from tests.swarmabs_analysis.figures.conftest import ReadBag
from tests.swarmabs_analysis.report.conftest import Page
from tests.swarmabs_bag.test_digest import digest

from swarmabs_analysis.report import Report
from swarmabs_analysis.report.record import read_recorded

LENGTH, GRAVITY = 1.0, 9.81


def value(page: Page, row: str) -> float:
    found = page.rows[row][1]
    assert isinstance(found, float)
    return found


def test_metrics(page: Page, run: Path, report: Report) -> None:
    bag = ReadBag(run)
    times, error = bag.times(), -bag.column("/plane/state", "angle")
    assert len(times) == 31
    assert value(page, "Final error") == error[-1]
    assert value(page, "RMS error") == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-13)
    outside = np.flatnonzero(np.abs(error) >= 0.01)
    assert len(outside) > 5
    assert value(page, "Settled at") == pytest.approx(times[outside[-1] + 1], rel=1e-15)
    positions = np.abs(bag.column("/swarm/agent_state", "position"))
    assert value(page, "Largest |position|") == positions.max()
    assert value(page, "Messages") == sum(map(len, bag._messages.values()))
    assert ("code", digest(run / "bag" / "bag_0.mcap")) in page.texts
    assert report.numbers["digest"] == digest(run / "bag" / "bag_0.mcap")


def test_margins(page: Page, run: Path) -> None:
    bag = ReadBag(run)
    # Robot 4 joins at step 2, robot 1 dies after step 5 and stays, robot 2 leaves after step 10.
    on_plane = [[1, 2, 3]] * 2 + [[1, 2, 3, 4]] * 9 + [[1, 3, 4]] * 20
    states = {agent: bag.column("/swarm/agent_state", "position", agent) for agent in bag.agents()}
    mass = {agent: bag.column("/swarm/agent_state", "mass", agent)[0] for agent in bag.agents()}
    first = {1: 0, 2: 0, 3: 0, 4: 2}
    reach, clearance = [], []
    torque, inertia = bag.column("/swarm/abstract_state", "torque"), bag.column("/swarm/abstract_state", "inertia")
    for step, agents in enumerate(on_plane):
        at = {agent: states[agent][min(step - first[agent], len(states[agent]) - 1)] for agent in agents}
        reach.append(max(map(abs, at.values())))
        assert GRAVITY * sum(mass[agent] * at[agent] for agent in agents) == pytest.approx(torque[step], abs=1e-12)
        # The nearest of very many points of the curve on which the outermost robot can be at the plane's end.
        total, least = sum(mass[agent] for agent in agents), min(mass[agent] for agent in agents)
        moment = np.linspace(-total * LENGTH / 2, total * LENGTH / 2, 400_001)
        curve = moment**2 / total + (LENGTH / 2 - np.abs(moment) / total) ** 2 / (1 / least - 1 / total)
        clearance.append(np.hypot(GRAVITY * moment - torque[step], curve - inertia[step]).min())
    assert value(page, "Margin to the plane's end") == LENGTH / 2 - max(reach)
    assert value(page, "Margin to A_A's boundary") == pytest.approx(min(clearance), abs=1e-6)
    s0, s3 = (bag.column("/swarm/auxiliary_state", field) for field in ("s0", "s3"))
    assert value(page, "Smallest S₃/S₀²") == pytest.approx((s3 / s0**2).min(), rel=1e-14)


def test_weights_give_the_recorded_abstract_state(run: Path) -> None:
    recorded, bag = read_recorded(run), ReadBag(run)
    np.testing.assert_allclose(recorded.torque, bag.column("/swarm/abstract_state", "torque"), rtol=0, atol=1e-14)
    on_plane = recorded.swarm.on_plane.sum(axis=1)
    np.testing.assert_array_equal(on_plane, bag.column("/swarm/abstract_state", "agent_count"))


def test_pictures_are_told_in_numbers(page: Page, run: Path) -> None:
    bag, labels = ReadBag(run), page.labels()
    rate = bag.column("/plane/state", "angular_velocity")
    lies = f"between {rate.min():.4g} and {rate.max():.4g} rad/s"
    assert lies in labels["Angle, reference and rate of the plane"]
    wanted = bag.column("/swarm/desired_abstract_state", "torque")
    torque = labels["Torque τ of the swarm, desired and actual"]
    assert f"desired torque: from {wanted[0]:.4g} to {wanted[-1]:.4g} N m" in torque
    q = bag.column("/swarm/auxiliary_state", "q")
    assert f"Q: from {q[0]:.4g} to {q[-1]:.4g} kg m²/s²" in labels["Auxiliary sums"]
    assert "4 at first" not in labels["Which robots take part"]
    assert "robots on the plane: 3 at first, 3 at last" in labels["Which robots take part"]


def test_events_stand_in_a_table(page: Page) -> None:
    cells = [text for tag, text in page.texts if tag in {"td", "th"}]
    at = cells.index("dead")
    assert cells[at - 3 : at] == ["0.06 s", "6", "1"]
    assert {"left", "joined", "kill", "leave"} <= set(cells)


def test_a_picture_shows_the_bag(report: Report, run: Path) -> None:
    """The angle's line in the page, taken back to rad by the labels of the axis, is the recorded angle."""
    svg = report.html[report.html.index('id="panel-plane"') :]
    svg = svg[: svg.index("</svg>")]
    line = next(d for d in re.findall(r'<path d="([^"]*)"[^>]*var\(--blue\)', svg) if d.count("L") > 8)
    points = np.array(re.findall(r"[ML] (-?[\d.]+) (-?[\d.]+)", line), dtype=float)
    angle = ReadBag(run).column("/plane/state", "angle")
    # Path simplification leaves out points, so only the ends and the extremes are compared, in units of the range.
    height = (points[:, 1].max() - points[:, 1]) / np.ptp(points[:, 1])
    scaled = (angle - angle.min()) / np.ptp(angle)
    assert height[0] == pytest.approx(scaled[0], abs=0.005)
    assert height[-1] == pytest.approx(scaled[-1], abs=0.005)
