"""Scenarios on parent systems of installed packages."""

from pathlib import Path

import jsonschema
import pytest

from swarmabs_config.scenario import ScenarioError, dump_scenario, json_schema, parse_scenario


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
    for given in ((5.0, 0.2), ([5.0, 6.0], [0.2])):
        jsonschema.validate(beam(*given), json_schema())
    for given, problem in (
        (("5", 0.2), "k: expected a list"),
        ((0.0, 0.2), r"k\.0: "),
        ((True, 0.2), "expected a list"),
    ):
        with pytest.raises(ScenarioError, match=problem):
            parse_scenario(str(beam(*given)))
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(beam(*given), json_schema())


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
    assert parse_scenario(str(beam(199.0, 0.2))).warnings() == ()
    (warning,) = parse_scenario(str(beam([5.0, 200.0], 0.2))).warnings()
    assert warning.endswith("k = 200.0 1/s is unstable at a step of 0.01 s; use less than 200.0")
    forces = str(beam(300.0, 0.2)).replace("single", "double")
    assert parse_scenario(forces).warnings() == ()
    assert parse_scenario(forces.replace("'gains'", "'force_law': 'velocity', 'gains'")).warnings()
