"""Simulating on arrays gives the bits of the state machines."""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator
from dataclasses import replace

import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_bag.recording import Digest, Step
from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_core.errors import RunError
from swarmabs_core.messages import Topic
from swarmabs_run.simulation import Simulation, simulated_steps
from swarmabs_run.vector_simulation import NotVectorisableError, VectorSimulation, vectorisable


def swarm(count: int, seed: int, *, controller: str = "pd", extra: str = "") -> Scenario:
    """Return a mixed swarm with robots all over the plane, some of them without damping."""
    draw = random.Random(seed)
    agents = []
    for number in range(1, count + 1):
        body = f"id: {number}, mass: {draw.uniform(0.05, 2.0)!r}, position: {draw.uniform(-0.5, 0.5)!r}"
        if draw.random() < 0.5:
            agents.append(f"    - {{{body}, kind: single_integrator}}")
        else:
            damping = draw.choice([0.0, draw.uniform(0.1, 3.0)])
            velocity = draw.uniform(-0.1, 0.1)
            agents.append(f"    - {{{body}, kind: double_integrator, damping: {damping!r}, velocity: {velocity!r}}}")
    text = (
        f"schema: 1\nduration: 0.5\nmanifold: {{offset: 0.3}}\ncontroller: {{type: {controller}}}\n"
        "plane: {disturbance: {amplitude: 0.1}}\n"
        "swarm:\n  gains: {kd: [8, 8]}\n  agents:\n" + "\n".join(agents) + f"\n{extra}"
    )
    return parse_scenario(text)


def digest_and_bag(steps: Iterable[Step]) -> tuple[str, list[tuple[Topic, int, bytes]], str]:
    """Return digest, messages and, of a run that fails, the reason."""
    digest = Digest()
    stored: list[tuple[Topic, int, bytes]] = []
    problem = ""
    try:
        for step in steps:
            digest.update(step)
            stored.extend(step.stored())
    except RunError as error:
        problem = str(error)
    return digest.hexdigest(), stored, problem


@pytest.mark.parametrize("count", [2, 3, 17, 60])
@pytest.mark.parametrize("controller", ["pd", "lqr", "arise"])
def test_same_bits_and_order_as_the_state_machines(count: int, controller: str) -> None:
    scenario = swarm(count, seed=count, controller=controller)
    machines = digest_and_bag(Simulation(scenario).steps())
    arrays = digest_and_bag(VectorSimulation(scenario).steps())
    assert arrays == machines


@pytest.mark.parametrize("kind", ["single_integrator", "double_integrator"])
def test_swarms_of_one_kind(kind: str) -> None:
    damping = ", damping: 0.7" if kind == "double_integrator" else ""
    agents = "\n".join(
        f"    - {{id: {n}, kind: {kind}, mass: 0.{n}, position: {(-1) ** n * 0.1}{damping}}}" for n in range(1, 9)
    )
    scenario = parse_scenario(f"schema: 1\nduration: 0.5\nswarm:\n  agents:\n{agents}\n")
    assert digest_and_bag(VectorSimulation(scenario).steps()) == digest_and_bag(Simulation(scenario).steps())


def test_events_stand_where_the_state_machines_put_them() -> None:
    scenario = swarm(20, seed=5)
    strained = scenario.model_copy(
        update={
            "manifold": replace(scenario.manifold, torque_max=0.01),
            "plane": replace(scenario.plane, length=0.2),
        }
    )
    machines = digest_and_bag(Simulation(strained).steps())
    assert any(topic.name == "swarm/events" for topic, _, _ in machines[1])
    assert digest_and_bag(VectorSimulation(strained).steps()) == machines


@pytest.mark.parametrize(
    "extra",
    [
        "faults: [{at: 0.1, kind: kill, agent: 2}]\n",
        "faults: [{kind: delay, steps: 1}]\n",
        "limits: {velocity: 0.01}\n",
        "limits: {force: 0.1}\n",
    ],
)
def test_what_concerns_single_robots_is_left_to_the_state_machines(extra: str) -> None:
    scenario = swarm(6, seed=1, extra=extra)
    assert not vectorisable(scenario)
    assert digest_and_bag(simulated_steps(scenario)) == digest_and_bag(Simulation(scenario).steps())


@pytest.mark.parametrize(
    "option",
    [
        "plane.end_stop=0.101",
        "plane.sensor.noise=[1e-4, 0]",
        "plane.sensor.resolution=[0, 1e-4]",
        "swarm.sensor.noise=[1e-4, 0]",
        "swarm.sensor.resolution=[0, 1e-4]",
        "swarm.actuator_lag=0.02",
        "observer={type: parent_response}",
    ],
)
def test_imperfect_worlds_are_left_to_the_state_machines(option: str) -> None:
    plain = ("duration=0.3", "plane.angle=0.1", "plane.angular_velocity=0.2")
    scenario = builtin("arise_het_20", *plain, option)
    assert not vectorisable(scenario)
    found = digest_and_bag(simulated_steps(scenario))
    assert found == digest_and_bag(Simulation(scenario).steps())
    assert found != digest_and_bag(simulated_steps(builtin("arise_het_20", *plain)))


def test_a_swarm_that_loses_its_spread_goes_on_with_the_state_machines(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = swarm(6, seed=2)
    machines = digest_and_bag(Simulation(scenario).steps())
    whole = VectorSimulation.steps

    def breaks_off(self: VectorSimulation) -> Iterator[Step]:
        for step in whole(self):
            if step.step == 7:
                raise NotVectorisableError
            yield step

    monkeypatch.setattr(VectorSimulation, "steps", breaks_off)
    assert digest_and_bag(simulated_steps(scenario)) == machines
