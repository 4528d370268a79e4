"""What is refused before a run: faulty parent systems, unsuitable robots, starts without control."""

from collections.abc import Sequence
from dataclasses import replace

import pytest
from tests.swarmabs_core.systems.helpers import PERIOD, Robot, robots, rotors
from tests.systems import BEAM_SCENARIO

from swarmabs_config.scenario import ScenarioError, parse_scenario
from swarmabs_core.messages import Kind
from swarmabs_core.parameters import SettingError
from swarmabs_core.registry import PluginError
from swarmabs_core.systems.check import Problem, problems_of
from swarmabs_core.systems.interface import NamedSystem
from swarmabs_core.systems.kinds import KINDS, RobotKind
from swarmabs_core.systems.law import RobotLaw, SystemGains

pytestmark = pytest.mark.usefixtures("systems")
LINE = robots((0.125,), (-0.125,), (0.2,), (-0.12,))
RING = robots((0.2, 0.1), (-0.2, 0.1), (0.1, -0.2), (-0.1, -0.2))

SAID = {
    "jacobian": r"jacobian\(\) of robot 1 has 0\.0375 in row 'inertia', column 'position', but differences .* 0\.075$",
    "jacobian_shape": r"jacobian\(\) of robot 1, row 'torque' is 2\.943; it must be a tuple",
    "contribution_nan": r"contribution\(\) of robot 1 is \(nan, 0\.0\); it must be a tuple of 2 finite",
    "contribution_size": r"contribution\(\) of robot 1 is \(0\.0,\); it must be",
    "contribution_raises": r"contribution\(\) of robot 1 raises KeyError: 'no\\nkey'",
    "weight": r"weight\(\) of robot 1 is 0\.0; it must be a positive number",
    "own_motion": r"own_motion\(\) of robot 1 is \(0\.0, 0\.0\); it must be a tuple with one .* such as \(0\.0,\)",
    "derivative_size": r"derivative\(\) is \(0\.0,\); it must be a tuple of 2 finite numbers",
    "derivative_nan": r"derivative\(\) is \(nan, 0\.0\); ",
    "derivative_raises": r"derivative\(\) raises ZeroDivisionError: division by zero",
    "derivative_text": r"derivative\(\) is \('0', 0\.0\); ",
    "ask_missing": r"ask\(\) of the controller raises AttributeError: 'object' object has no attribute 'ask'",
    "ask_size": r"ask\(\) of the controller is \(0\.0, 0\.0\); it must be a tuple with one .* such as \(0\.0,\)",
    "ask_number": r"ask\(\) of the controller is 0\.0; ",
    "contribution_moved": r"the way to complete\(\(0\.\d+,\)\) raises ZeroDivisionError: .* \(systems_of_tests\.py:\d",
    "impure_derivative": r"derivative\(\) is \(0\.0, 0\.0\) and, for equal arguments, \(1e-15, 0\.0\)$",
    "impure_weight": r"weight\(\) of robot 1 is 1\.0 and, for equal arguments, 1\.0+1\d*$",
    "impure_reference": r"reference\(\) is \(0\.0,\) and, for equal arguments, \(1e-15,\)$",
    "impure_reach": r"reach\(\) is True and, for equal arguments, False$",
    "impure_outline": r"outline\(\) is \[\(0\.0, 1\.0\)\] and, for equal arguments, \[\(0\.0, 2\.0\)\]$",
    "shared_controller": r"ask\(\) of the controller is \(0\.00\d+,\) and, for equal arguments, \(0\.00\d+,\)$",
    "offset_ask": r"offset_ask\(\) of the controller is 0\.0; it must be a tuple with one",
    "refuses": r"^parent system 'faulty': no wheel is left$",
    "refuses_plainly": r"^parent system 'faulty': no wheel is left$",
    "limits_of_kinds": r"limits\(\) of robot 1 raises KeyError: 'single_integrator' \(systems_of_tests\.py:\d+\)$",
    "columns_power": r"contribution\(\) does not accept columns: TypeError: square is applied to columns",
    "columns_function": r"own_motion\(\) does not accept columns: TypeError: a column is used as a number",
    "columns_branch": r"own_motion\(\) does not accept columns: TypeError: greater is applied to columns",
    "columns_in_place": r"weight\(\) does not accept columns: TypeError: multiply is applied to columns",
    "columns_joined": r"weight\(\) does not accept columns: TypeError: a column is used as a number",
    "outline": r"outline\(\) raises TypeError: cannot unpack",
    "robot_place": r"robot_place\(\) is \(0\.0, 0\.0, 0\.0, 0\.0\); it must be a tuple of 1 to 3 finite numbers",
    "robot_body": r"robot_body\(\) raises TypeError: cannot unpack",
    "impure_robot_body": r"robot_body\(\) is \[\(0\.0, 1\.0\)\] and, for equal arguments, \[\(0\.0, 2\.0\)\]$",
    "controller_raises": r"controller\(\) raises KeyError: 'x'",
    "complete_size": r"complete\(\(-5\.0,\)\) is \(-5\.0,\); it must be a tuple of 2 finite numbers",
    "complete_at_end": r"complete\(\(5\.0,\)\) is \(5\.0, inf\); ",
    "complete_at_zero": r"complete\(\(0\.0,\)\) raises ZeroDivisionError: .*division by zero",
    "reference": r"reference\(\) is \(0\.0, 0\.0\); it must be a tuple with one .* such as \(0\.0,\)",
    "limits": r"limits\(\) of robot 1 is \(\(1\.0,\), \(-1\.0,\)\); it must be two tuples of 1, low <= high",
    "limits_shape": r"limits\(\) of robot 1 raises TypeError: ",
    "initial_size": r"initial is \(0\.0,\); it must be a tuple of 2 finite numbers",
    "initial_nan": r"initial is \(nan, 0\.0\); ",
    "fails_at_once": r"it fails at the start: 'it leans'",
    "substep": r"substep is 0\.0; it must be a positive number",
    "parent_empty": r"parent has 0 rows; it must have 1 to 32",
    "parent_many": r"parent has 33 rows; it must have 1 to 32",
    "parent_text": r"parent is \('angle', 'rate'\); it must be a tuple of Quantity",
    "robot_none": r"robot is None; it must be a tuple of Quantity",
    "name": r"robot has a row 'the position'; each needs its own name",
    "ends": r"robot 'position' has the ends \(0\.5, -0\.5\); only rows of robot have ends, low < high",
    "ends_text": r"robot 'position' has the ends \(-inf, '0\.5'\); only rows of robot",
    "ends_of_parent": r"parent 'angle' has the ends \(-1\.0, inf\); only rows of robot have ends",
    "twice": r"parent has a row 'angle'; each needs its own name",
    "scale": r"abstract 'torque' has \('N m', 0\.0\), which is out of range",
    "scale_text": r"parent 'angle' has \('rad', '0\.1'\), which is out of range",
    "unit": r"robot 'position' has \(1\.0, 1\.0\), which is out of range",
    "no_method": r"^parent system 'faulty' makes an object of type Faulty, which has no method weight$",
    "need": r"needs 'torque' has \('N m', 5\.0, -5\.0\), which is out of range",
    "need_infinite": r"needs 'torque' has \('N m', -inf, 5\.0\), which is out of range",
    "needs_empty": r"needs has 0 rows; it must have 1 to 16",
    "tracked": r"tracked 'angel' must be in parent, with the unit of the others",
    "tolerance": r"tracked 'angle' has \(0\.0,\), which is out of range",
    "constant": r"constants 'mass' has \('kg', nan\), which is out of range",
}


REMEDIES = {
    "columns": "use only + - * / there",
    "impure": "make it a pure function, ",
    "shared": "make it a pure function, ",
    "refuses": "add a wheel",
}


def found(name: str, given: Sequence[Robot], gains: SystemGains | None = None, **settings: str) -> list[Problem]:
    return problems_of(NamedSystem(name, settings), given, gains or SystemGains(), PERIOD)


@pytest.mark.parametrize("fault", SAID)
def test_a_faulty_system_is_refused_in_one_line(fault: str) -> None:
    (problem,) = found("faulty", LINE, fault=fault)
    assert problem[0] == ("system",)
    assert problem[1].startswith("parent system 'faulty'")
    assert "\n" not in problem[1]
    remedy = next((text for start, text in REMEDIES.items() if fault.partition("_")[0] == start), "correct the parent ")
    if fault in {"no_method", "refuses_plainly"}:
        remedy = {"no_method": "repair the package"}.get(fault, "correct the parent system")
    assert problem[2].startswith(remedy)
    with pytest.raises(AssertionError, match=SAID[fault]):
        raise AssertionError(problem[1])


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("beam", LINE),
        ("beam", robots((0.1,), (-0.3,), kind="double_integrator")),
        ("beam", robots((0.1,), (-0.3,), kind="first_order_lag")),
        ("sheet", RING),
        ("lift", rotors(0.5, -0.4, 0.3)),
        ("tilting_plane", LINE),
        ("faulty", LINE),
    ],
)
def test_sound_systems_are_accepted(name: str, given: list[Robot]) -> None:
    assert found(name, given) == []
    assert found(name, given, SystemGains((1.0,), (2.0,), (3.0,))) == []


def test_functions_that_apply_arithmetic_only_accept_columns() -> None:
    assert found("faulty", LINE, fault="columns") == []


def test_robots_start_within_the_ends_of_their_coordinates() -> None:
    assert found("faulty", robots((0.2,), (-0.2,)), fault="lane") == []
    (problem,) = found("faulty", robots((0.1,), (-0.21,)), fault="lane")
    assert problem == (
        ("swarm", "agents", 1, "coordinates"),
        "-0.21 m is out of the range of position",
        "give a number from -0.2 to 0.2",
    )


def test_a_start_without_control_is_refused_with_the_row_that_is_lost() -> None:
    (problem,) = found("sheet", robots(*((x, 2.0 * x + 0.1) for x in (0.1, 0.2, 0.3, -0.4))))
    assert problem[1] == "the robots cannot control row 'inertia_xy': their Gram matrix is singular at the start"
    assert found("beam", robots((0.1,), (0.1,), (0.1,)))[0][1].startswith("the robots cannot control row 'inertia'")
    (problem,) = problems_of(NamedSystem("beam"), LINE, SystemGains(), PERIOD, later=(2, 4, 3))
    assert "row 'inertia'" in problem[1], "the others join later"
    assert found("lift", rotors(0.5, 0.5, 0.5))[0][1].startswith("the robots cannot control row 'torque'")


def test_a_row_that_no_robot_can_change_is_refused_with_its_name() -> None:
    """Rotors in the middle of the lift have no torque, wherever they start; robots at rest on the beam can move."""
    (problem,) = found("lift", rotors(0.0, 0.0, 0.0))
    assert problem[1].startswith("no robot can change row 'torque' of the abstract state: ")
    assert problem[2] == "add a robot that can, or remove the row from the system's table abstract"
    given = rotors(0.0, 0.0, 0.5)
    (problem,) = problems_of(NamedSystem("lift"), given, SystemGains(), PERIOD, later=(3,))
    assert problem[1].startswith("no robot can change row 'torque'"), "the one that can joins later"
    (problem,) = found("beam", robots((0.0,), (0.0,)))
    assert problem[1].startswith("the robots cannot control row 'inertia'")
    assert "spread" in problem[2]


def test_limits_depend_on_the_kind_of_robot() -> None:
    assert found("faulty", robots((0.1,), (-0.3,), kind="double_integrator"), fault="limits_of_kinds") == []
    system = NamedSystem("faulty", {"fault": "limits_of_kinds"})
    law = RobotLaw(system, Kind.DOUBLE_INTEGRATOR, (0.5, 0.0, 0.05), SystemGains(), PERIOD)
    assert law.limited((3.0,)) == (1.0,)


def test_an_error_without_a_remedy_has_no_empty_part() -> None:
    assert str(ScenarioError("ship.yaml", "it sinks", "", line=3)) == "ship.yaml:3: it sinks"
    assert str(PluginError("it sinks", "")) == "it sinks"
    assert str(SettingError("mass", "it sinks", "")) == "mass: it sinks"


def test_a_completion_that_no_robots_can_have_is_refused() -> None:
    (problem,) = found("faulty", LINE, fault="never_reachable")
    assert problem[1] == ("the robots cannot reach the abstract state of complete((0.0,)), the first that is requested")
    assert found("faulty", LINE, fault="unreachable") == [], "it is reachable at the start"
    assert found("faulty", LINE, fault="roaming") == [], "motions of their own do not prevent it"


@pytest.mark.parametrize(
    ("changes", "location", "text", "remedy"),
    [
        ({"constants": {"mas": 1.0, "mass": 1.0}}, ("constants", "mas"), "no constant 'mas'", "did you mean 'mass'?"),
        (
            {"constants": {"height": 1.0, "mass": 1.0}},
            ("constants", "height"),
            "'height'",
            "known: mass, damp",
        ),
        ({"constants": {}}, ("constants",), "robot 1 lacks mass", "give mass in kg"),
        (
            {"kind": "double_integrator", "constants": {"mass": -1.0}},
            ("constants", "mass"),
            "-1.0 is out of range",
            "give a number > 0",
        ),
        (
            {"kind": "first_order_lag", "constants": {"mass": 1.0, "time_constant": 0.0}},
            ("constants", "time_constant"),
            "0.0 is out of range",
            "give a number > 0",
        ),
        ({"coordinates": (0.1, 0.2)}, ("coordinates",), "2 numbers for 1 coordinates", "give position"),
        ({"coordinates": ()}, ("coordinates",), "0 numbers", "give position"),
        ({"kind": "double_integrator", "velocities": (0.1, 0.2)}, ("velocities",), "2 numbers", "give position"),
        ({"velocities": (0.1,)}, ("velocities",), "not applicable to robots of kind single_integrator", "omit them"),
    ],
)
def test_unsuitable_robots_are_refused(
    changes: dict[str, object], location: tuple[str, ...], text: str, remedy: str
) -> None:
    (problem,) = found("beam", [replace(LINE[0], **changes), *LINE[1:]])  # type: ignore[arg-type]
    assert problem[0] == ("swarm", "agents", 0, *location)
    assert text in problem[1]
    assert problem[2].startswith(remedy)


def test_a_kind_of_robot_needs_its_constant_and_the_gains_fit_the_rows() -> None:
    (problem,) = found("lift", [*rotors(0.5, -0.4), replace(rotors(0.3)[0], kind="double_integrator", id=3)])
    assert problem[0] == ("swarm", "agents", 2, "kind")
    assert "has no constant 'mass'" in problem[1]
    (problem,) = found("beam", LINE, SystemGains(kd=(1.0, 2.0, 3.0)))
    assert problem == (("swarm", "gains", "kd"), "3 gains for 2 rows", "give one or 2")


def test_a_kind_of_robot_is_refused_where_coordinates_are_others_than_it_moves_along(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Unicycle(RobotKind):
        coordinates = ("m", "m", "rad")

    class Planar(RobotKind):
        coordinates = ("m", "m")

    monkeypatch.setitem(KINDS, Kind.SINGLE_INTEGRATOR, Planar())
    assert found("sheet", RING) == []
    monkeypatch.setitem(KINDS, Kind.SINGLE_INTEGRATOR, Unicycle())
    problem, *others = found("sheet", RING)
    assert problem == (
        ("swarm", "agents", 0, "kind"),
        "robots of kind single_integrator need coordinates in m, m, rad; those of sheet are in m, m",
        "choose another kind, or a system whose robots have these coordinates",
    )
    assert [where for where, *_ in others] == [("swarm", "agents", n, "kind") for n in (1, 2, 3)]
    with pytest.raises(ScenarioError, match=r"swarm\.agents\.0\.kind: .* those of beam are in m; choose another kind"):
        parse_scenario(BEAM_SCENARIO)


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        (["system.type=faulty", "system.fault=jacobian"], "system: parent system 'faulty': jacobian() of robot 1 has"),
        (["swarm.agents.2.constants.mas=3"], "swarm.agents.2.constants.mas: beam has no constant 'mas'; did you mean"),
        (["swarm.gains.kp=[1, 2, 3]"], "swarm.gains.kp: 3 gains for 2 rows; give one or 2"),
        (["swarm.agents=[]"], "swarm.agents: the robots cannot control row 'torque': their Gram matrix is singular"),
        (
            [f"faults=[{', '.join(f'{{kind: join, agent: {n}, at: 1.0}}' for n in (2, 3, 4))}]"],
            "swarm.agents: the robots cannot control row 'inertia': their Gram matrix is singular at the start; spread",
        ),
        (["system.type=faulty", "system.fault=never_reachable"], "the robots cannot reach the abstract state of"),
    ],
)
def test_scenarios_are_refused_at_the_place_of_the_mistake(overrides: list[str], text: str) -> None:
    with pytest.raises(ScenarioError) as refusal:
        parse_scenario(BEAM_SCENARIO, source="beam.yaml", overrides=overrides)
    (line,) = str(refusal.value).splitlines()
    assert text in line


def test_the_order_of_robots_in_the_file_does_not_matter_for_the_place() -> None:
    with pytest.raises(ScenarioError, match=r"swarm\.agents\.0\.coordinates: 2 numbers for 1 coordinates"):
        parse_scenario(BEAM_SCENARIO, overrides=["swarm.agents.0.id=9", "swarm.agents.0.coordinates=[0.1, 0.2]"])
