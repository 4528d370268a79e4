"""The swarms of the demo: where they start, and that they come back to the curve of desired states."""

import pytest

from swarmabs_cli.run.demo import SHOWS, overrides
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.simulation import simulate


@pytest.mark.parametrize("robots", SHOWS)
def test_a_swarm_beside_the_curve_comes_back_to_it(robots: str) -> None:
    show = SHOWS[robots]
    changed = overrides(show, beside=True)
    curve = find_scenario(show.scenario, [f"{name}={value}" for name, value in changed.items()]).manifold
    run = simulate(show.scenario, {**changed, "duration": 4.0})
    torque, inertia = run.abstract.torque, run.abstract.inertia
    on_curve = curve.curvature * torque**2 + curve.offset
    assert inertia[0] > 4.0 * on_curve[0]
    assert abs(inertia[-1] / on_curve[-1] - 1.0) < 0.02
    assert abs(torque[-1] - run.desired.torque[-1]) < 0.02
    assert abs(run.angle[-1] - run.reference[-1]) < 0.02
    assert run.events == ()
