"""Swarm laws that packages bring, in simulations."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest
from tests.plugin_packages import BANG_BANG, SCALED, install

from swarmabs_bag.recording import Digest
from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_core import law_registry, swarm_law
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.errors import RunError
from swarmabs_core.messages import EventKind, Kind, Status, SwarmEvent
from swarmabs_core.realtime import drive_registry, drives
from swarmabs_run.simulation import Simulation, simulate, simulated_steps
from swarmabs_run.vector_simulation import vectorisable

KINDS = {
    "SI": "{single_integrator: 4}",
    "DI": "{double_integrator: 4}",
    "mixed": "{single_integrator: 2, double_integrator: 2}",
    "many": "{single_integrator: 4, double_integrator: 4}",
}
HALVED = {"k": "[5, 4]", "kp": "[8, 6]", "kd": "[3, 2]"}
"""Gains whose doubles are exact."""
DOUBLED = {"k": "[10, 8]", "kp": "[16, 12]", "kd": "[6, 4]"}


def scenario(kind: str, law: str, gains: dict[str, str], *overrides: str) -> Scenario:
    given = ", ".join(f"{name}: {value}" for name, value in gains.items())
    swarm = f"{{law: {law}, gains: {{{given}}}, generate: {KINDS[kind]}}}"
    return parse_scenario(f"{{schema: 1, duration: 1.0, swarm: {swarm}}}", overrides=overrides)


def digest(found: Scenario) -> str:
    result = Digest()
    for step in simulated_steps(found):
        result.update(step)
    return result.hexdigest()


@pytest.mark.parametrize("kind", KINDS)
def test_a_law_that_doubles_the_gains_does_what_doubled_gains_do(packages: Path, kind: str) -> None:
    install(packages, "law", "scaled", SCALED)
    plain = digest(scenario(kind, "{type: paper}", DOUBLED))
    assert digest(scenario(kind, "{type: scaled, factor: 2}", HALVED)) == plain
    assert digest(scenario(kind, "{type: scaled}", HALVED)) != plain


def test_a_law_that_is_not_known_on_arrays_is_left_to_the_state_machines(packages: Path) -> None:
    install(packages, "law", "scaled", SCALED)
    assert vectorisable(scenario("many", "{type: paper}", {}))
    assert not vectorisable(scenario("many", "{type: scaled}", {}))


def test_a_robot_whose_law_gives_no_number_stops_safely(packages: Path) -> None:
    install(packages, "law", "scaled", SCALED)
    found = scenario("mixed", "{type: scaled}", {}, "swarm.generate.mass=[0.5, 0.5]", "swarm.law.bad_mass=0.5")
    steps = list(Simulation(found).steps())
    events = [record.message for step in steps for record in step.records if isinstance(record.message, SwarmEvent)]
    stopped = [event for event in events if event.kind == EventKind.SAFE_STOP]
    assert {event.agent_id for event in stopped} == {1, 2, 3, 4}
    assert {event.step for event in stopped} == {6}
    assert {event.detail for event in stopped} == {"the law gives no finite command"}
    arrays = simulate(found)
    assert (arrays.agents.status[:6] == Status.ACTIVE).all()
    assert (arrays.agents.status[6:] == Status.SAFE_STOP).all()
    single = arrays.agents.kind[6] == Kind.SINGLE_INTEGRATOR
    assert (arrays.agents.command[6:, single] == 0.0).all()


def test_a_controller_that_asks_for_no_number_ends_the_run(packages: Path) -> None:
    install(packages, "controller", "bang_bang", BANG_BANG.replace("copysign(self.torque_of", "copysign(float('nan')"))
    found = scenario("SI", "{type: paper}", {}, "controller={type: bang_bang}")
    with pytest.raises(
        RunError, match=r"step 0: the parent controller asks for a torque of nan N m at an angle of 0\.1"
    ):
        simulate(found)


@pytest.mark.parametrize("kind", ["SI", "DI", "mixed"])
@pytest.mark.parametrize("law", CONTROLLERS.built_in)
def test_every_parent_controller_leads_every_kind_of_swarm(law: str, kind: str) -> None:
    overrides = [f"controller.type={law}", "duration=12", "plane.angle=0.1"]
    if law == "arise":
        overrides.append("controller.trajectory={type: constant, angle: 0.0}")
    run = simulate(scenario(kind, "{type: paper}", {}, *overrides))
    late = abs(run.angle[-200:]).max()
    assert late < 0.05 * abs(run.angle[0])
    assert abs(run.desired.torque - run.abstract.torque)[-200:].max() < 0.02
    assert abs(run.desired.inertia - run.abstract.inertia)[-200:].max() < 1e-3


@pytest.mark.parametrize(("former", "module"), [(law_registry, swarm_law), (drive_registry, drives)])
def test_packages_find_the_parts_where_they_have_imported_them_from(former: ModuleType, module: ModuleType) -> None:
    assert {name: getattr(former, name) for name in former.__all__} == {
        name: getattr(module, name) for name in former.__all__
    }
