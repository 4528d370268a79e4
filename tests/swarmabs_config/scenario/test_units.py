"""Units of the numbers of a scenario, as declared."""

import pytest

from swarmabs_config.model.declared import unit_at
from swarmabs_config.scenario import json_schema, parse_scenario

SCENARIO = """
schema: 1
duration: 2.0
plane: {disturbance: {amplitude: 0.1, angular_frequency: 2.0}}
controller: {type: arise, trajectory: {type: sine, amplitude: 0.1}}
swarm:
  agents:
    - {id: 1, kind: single_integrator, mass: 0.4, position: 0.15}
    - {id: 2, kind: double_integrator, mass: 0.5, damping: 0.8, position: -0.15}
faults:
  - {kind: delay, from: 0.5, to: 1.0, steps: 2}
"""
UNITS = {
    "duration": "s",
    "step": "s",
    "plane.angle": "rad",
    "plane.inertia": "kg m^2",
    "plane.end_stop": "rad",
    "plane.disturbance.angular_frequency": "rad/s",
    "plane.friction.0": "",
    "controller.alpha1": "1/s",
    "controller.trajectory.amplitude": "rad",
    "manifold.curvature": "kg m^2/(N m)^2",
    "swarm.agents.0.mass": "kg",
    "swarm.agents.1.damping": "N s/m",
    "swarm.agents.9.mass": "",
    "swarm.agents.0.kind": "",
    "swarm.gains.kp": "1/s^2",
    "swarm.actuator_lag": "s",
    "limits.force": "N",
    "limits.velocity": "m/s",
    "lockstep.stall_timeout": "s",
    "realtime.lane_margin": "m",
    "faults.0.from": "s",
    "faults.0.to": "s",
    "faults.0.steps": "steps",
    "seed": "",
    "nothing.like.this": "",
}


@pytest.mark.parametrize(("path", "unit"), UNITS.items())
def test_each_number_has_its_declared_unit(path: str, unit: str) -> None:
    assert unit_at(parse_scenario(SCENARIO), path) == unit


def test_amplitudes_of_a_torque_and_of_an_angle_differ() -> None:
    scenario = parse_scenario(SCENARIO)
    paths = ("plane.disturbance.amplitude", "controller.trajectory.amplitude")
    assert [unit_at(scenario, path) for path in paths] == ["N m", "rad"]


def test_the_schema_tells_units_as_data_and_in_words() -> None:
    step = json_schema()["properties"]["step"]  # type: ignore[index]
    assert (step["unit"], step["description"]) == ("s", "control period, s")
