"""The example systems on arrays, with the bits of the state machines."""

from collections.abc import Sequence

import pytest
from tests.examples.test_parent_systems import PATHS, _installed, forces  # noqa: F401 - a fixture
from tests.swarmabs_run.test_simulation import digest_and_bag

from swarmabs_config.scenario import load_scenario
from swarmabs_run.simulation import Simulation, simulated_steps
from swarmabs_run.swarm_columns import NotVectorisableError
from swarmabs_run.vector_simulation import VectorSimulation, vectorised


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        *((name, forced) for name in ("ship", "plate") for forced in ((), range(1, 41), range(3, 41, 4))),
        ("payload", ()),  # rotors are not driven by forces
    ],
    ids=str,
)
def test_arrays_give_the_bits_of_the_state_machines(name: str, changed: Sequence[int]) -> None:
    scenario = load_scenario(PATHS[f"{name}_40"], ["duration=0.4", "faults=[]", *forces(changed)])
    swarm = vectorised(scenario)
    assert swarm is not None
    machines = digest_and_bag(Simulation(scenario).steps())
    assert digest_and_bag(VectorSimulation(scenario, swarm).steps()) == machines


@pytest.mark.system
def test_a_robot_that_reaches_a_limit_is_left_to_the_state_machines() -> None:
    given = ["duration=0.8", "faults=[]", "swarm.agents.7.constants.highest=2.95"]
    scenario = load_scenario(PATHS["payload_40"], given)
    swarm = vectorised(scenario)
    assert swarm is not None
    with pytest.raises(NotVectorisableError):
        for _ in VectorSimulation(scenario, swarm).steps():
            pass
    machines = digest_and_bag(Simulation(scenario).steps())
    assert any(topic.name == "swarm/events" for topic, _, _ in machines[1])
    assert digest_and_bag(simulated_steps(scenario)) == machines
