"""Robots that coordinate the swarm by themselves, on the example systems: the digest of the usual coordination."""

from functools import cache
from typing import Any

import pytest
import yaml
from tests.examples.test_parent_systems import PATHS, _installed  # noqa: F401 - a fixture
from tests.swarmabs_core.helpers import digest

from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_run.simulation import Simulation

FAULTS = (
    "faults=[{kind: join, agent: 3, at: 0.03}, {kind: kill, agent: 2, at: 0.05}, {kind: leave, agent: 4, at: 0.07},"
    " {kind: loss, agents: [1], probability: 0.3}]"
)


@cache
def cut(name: str, robots: int) -> str:
    """Return a scenario of an example with so many of its robots, every second of which is driven by a force."""
    document: dict[str, Any] = yaml.safe_load(PATHS[f"{name}_40"].read_text(encoding="utf-8"))
    swarm = document["swarm"]
    swarm["agents"] = swarm["agents"][:robots]
    if name != "payload":  # whose rotors are not driven by forces
        for agent in swarm["agents"][::2]:
            agent["kind"] = "double_integrator"
    return yaml.safe_dump(document | {"duration": 0.1, "faults": []}, sort_keys=False)


def scenario(name: str, robots: int, *overrides: str) -> Scenario:
    return parse_scenario(cut(name, robots), overrides=[FAULTS, *overrides])


@cache
def central(name: str, robots: int) -> str:
    return digest(Simulation(scenario(name, robots)).steps())


RANDOM = "type: random, degree: 6"


STRONGEST = f"{RANDOM}, loss: 0.5, sensing: [1, 3]"
SMALL, LARGE = (("ship", 4), ("plate", 10), ("payload", 8)), (("ship", 20), ("plate", 20), ("payload", 20))


@pytest.mark.parametrize(
    ("name", "robots", "links"),
    [
        *((*of, links) for of in SMALL for links in ("", "loss: 0.5", STRONGEST)),
        *(pytest.param(*of, STRONGEST, marks=pytest.mark.system) for of in LARGE),
    ],
)
def test_the_digest_is_that_of_the_usual_coordination(name: str, robots: int, links: str) -> None:
    alone = scenario(name, robots, "coordination=each_robot", f"links={{{links}}}")
    assert digest(Simulation(alone).steps()) == central(name, robots)
