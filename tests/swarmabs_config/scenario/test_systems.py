"""Scenarios on parent systems of installed packages."""

import math
import random
from pathlib import Path

import jsonschema
import pytest

from swarmabs_config.scenario import ScenarioError, dump_scenario, json_schema, parse_scenario, warnings_of


def beam(k: object, coordinates: object) -> dict[str, object]:
    robot = {"kind": "single_integrator", "constants": {"mass": 0.5}}
    agents = [{"id": 1, "coordinates": coordinates, **robot}, {"id": 2, "coordinates": [-0.2], **robot}]
    return {"schema": 1, "system": {"type": "beam"}, "swarm": {"gains": {"k": k}, "agents": agents}}


def test_one_number_is_a_list_with_one_number(systems: Path) -> None:
    del systems
    numbers, lists = (parse_scenario(str(beam(*given))) for given in ((5.0, 0.2), ([5.0], [0.2])))
    assert numbers == lists
    assert numbers.swarm.gains.k == (5.0,)
    assert dump_scenario(numbers) == dump_scenario(lists)
    schema = json_schema()
    for given in ((5.0, 0.2), ([5.0, 6.0], [0.2])):
        jsonschema.validate(beam(*given), schema)
    for given, problem in (
        (("5", 0.2), "k: expected a list"),
        ((0.0, 0.2), r"k\.0: "),
        ((True, 0.2), "expected a list"),
    ):
        with pytest.raises(ScenarioError, match=problem):
            parse_scenario(str(beam(*given)))
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(beam(*given), schema)


GENERATED = {
    "single_integrator": 2,
    "first_order_lag": 1,
    "constants": {"time_constant": [0.05, 0.05], "mass": [0.3, 0.6]},
}


def generated(system: str, **changes: object) -> dict[str, object]:
    return {"schema": 1, "system": {"type": system}, "swarm": {"generate": {**GENERATED, "seed": 7, **changes}}}


@pytest.mark.usefixtures("systems")
def test_a_swarm_is_generated_from_ranges_by_its_seed() -> None:
    given = generated("beam", coordinates=[[-0.3, 0.2]])
    jsonschema.validate(given, json_schema())
    scenario = parse_scenario(str(given))
    draw = random.Random(7)
    for number, agent in enumerate(scenario.agents, start=1):
        mass, lag, place = (draw.uniform(*ends) for ends in ((0.3, 0.6), (0.05, 0.05), (-0.3, 0.2)))
        assert agent.id == number
        assert agent.kind == ("single_integrator" if number < 3 else "first_order_lag")
        assert agent.constants == {"mass": mass, "time_constant": lag}
        assert agent.coordinates == (place,)
    assert parse_scenario(dump_scenario(scenario)) == scenario.resolved()
    assert parse_scenario(str(generated("beam", coordinates=[[-0.3, 0.2]], seed=8))).agents != scenario.agents


@pytest.mark.usefixtures("systems")
def test_a_swarm_is_generated_where_the_system_places_it() -> None:
    counts = {"single_integrator": 3, "double_integrator": 1, "first_order_lag": 0}
    agents = parse_scenario(str(generated("sheet", **counts, constants={"mass": [0.5, 1.5]}))).agents
    kinds = [agent.kind for agent in agents]
    assert kinds == ["single_integrator"] * 3 + ["double_integrator"]
    for agent in agents:
        angle = 2.0 * math.pi * agent.id / 4
        assert agent.coordinates == (0.2 * math.cos(angle) / agent.constants["mass"], 0.2 * math.sin(angle))


@pytest.mark.usefixtures("systems")
@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({}, r"swarm\.generate: beam has no method generated; give ranges of coordinates$"),
        ({"coordinates": [[0.2, 0.1]]}, r"generate\.coordinates\.0: the smallest 0\.2 exceeds the largest 0\.1; write"),
        (
            {"coordinates": [[0.1, 0.2]] * 2},
            r"swarm\.generate: 2 numbers for 1 coordinates; give position \(\+2 more\)$",
        ),
        ({"coordinates": [[0.1, 0.1]]}, r"swarm\.generate: the robots cannot control row 'inertia'"),
        (
            {"constants": {"mass": 1.0}},
            r"swarm\.generate\.constants\.mass: expected a list of 2 numbers, found the number 1\.0",
        ),
        ({"first_order_lag": 65535}, r"swarm\.generate: 65537 robots are more than the 65535 ids; generate at most"),
    ],
)
def test_a_swarm_that_cannot_be_generated_is_refused(changes: dict[str, object], problem: str) -> None:
    with pytest.raises(ScenarioError, match=problem):
        parse_scenario(str(generated("beam", **changes)))


@pytest.mark.usefixtures("systems")
@pytest.mark.parametrize(
    ("part", "problem"),
    [
        ({"sensor": {"noise": [0.1]}}, r"sensor\.noise: 1 numbers for 2; give angle, rate$"),
        ({"sensor": {"resolution": [0.1]}}, r"sensor\.resolution: 1 numbers for 2; give angle, rate$"),
        ({"sensor": {"resolution": [0.1, -0.1]}}, r"sensor\.resolution\.1: -0\.1 is out of range"),
        ({"requests": {"bandwidth": 0.0}}, r"requests\.bandwidth: 0\.0 is out of range; give a number > 0$"),
        ({"requests": {"low": [1.0, 2.0]}}, r"requests\.low: 2 numbers for 1; give torque$"),
        (
            {"requests": {"high": [5.5]}},
            r"requests: torque is limited to -5\.0 to 5\.5; give low <= high, within -5\.0",
        ),
        ({"requests": {"high": [-1.0], "low": [1.0]}}, r"requests: torque is limited to 1\.0 to -1\.0; "),
    ],
)
def test_sensor_and_requests_fit_the_system(part: dict[str, object], problem: str) -> None:
    with pytest.raises(ScenarioError, match=problem):
        parse_scenario(str({**beam(5.0, 0.2), **part}))


def test_the_offset_of_a_reference_need_not_be_an_angle(systems: Path) -> None:
    del systems
    fault = {"kind": "reference", "at": 1.0, "offset": 25.0}
    scenario = parse_scenario(str({**beam(5.0, 0.2), "faults": [fault]}))
    assert scenario.faults[0].offset == 25.0  # type: ignore[attr-defined]
    jsonschema.validate({**beam(5.0, 0.2), "faults": [fault]}, json_schema())
    with pytest.raises(ScenarioError, match=r"faults\.0\.offset: 25\.0 is out of range"):
        parse_scenario(str({"schema": 1, "swarm": {"generate": {"single_integrator": 2}}, "faults": [fault]}))


def test_a_gain_that_is_unstable_in_sampled_time_is_warned_of(systems: Path) -> None:
    del systems
    assert warnings_of(parse_scenario(str(beam(199.0, 0.2)))) == ()
    (warning,) = warnings_of(parse_scenario(str(beam([5.0, 200.0], 0.2))))
    assert warning.endswith("k = 200.0 1/s is unstable at a step of 0.01 s; use less than 200.0")
    forces = str(beam(300.0, 0.2)).replace("single", "double")
    assert warnings_of(parse_scenario(forces)) == ()
    assert warnings_of(parse_scenario(forces.replace("'gains'", "'force_law': 'velocity', 'gains'")))
