"""Properties of all scenarios: texts load back, and no input does anything but load or be refused."""

from itertools import accumulate
from pathlib import Path

import yaml
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from pydantic import ValidationError

from swarmabs_config.model.agents import DoubleIntegratorAgent, Generate, SingleIntegratorAgent
from swarmabs_config.model.controllers import AriseConfig, ControllerConfig, CsvTrajectory, LqrConfig, PdConfig
from swarmabs_config.model.scenario import Swarm, is_name
from swarmabs_config.scenario import (
    Agent,
    Scenario,
    ScenarioError,
    dump_scenario,
    load_scenario,
    parse_scenario,
    yaml_tree,
)
from swarmabs_core.behaviours.base import Lockstep
from swarmabs_core.faults import (
    ClockOffsetFault,
    DelayFault,
    DuplicationFault,
    Fault,
    FreezeFault,
    JoinFault,
    KillFault,
    LeaveFault,
    LieFault,
    LossFault,
    ReorderingFault,
)
from swarmabs_core.manifold import Manifold
from swarmabs_core.plant import Disturbance, Plane
from swarmabs_core.robot_controller import Limits
from swarmabs_core.swarm_law import SwarmGains
from swarmabs_core.trajectory import Constant, QuinticStep, Sine

numbers = st.floats(-1e12, 1e12)
small = st.floats(-1.0, 1.0)
not_negative = st.floats(0.0, 1e12)
positive = st.floats(1e-12, 1e12)
angles = st.floats(-1.49, 1.49)
seeds = st.integers(0, 2**63 - 1)
names = st.text(st.characters(codec="utf-8"), min_size=1, max_size=60).filter(is_name)


def times(low: int, high: int) -> st.SearchStrategy[float]:
    return st.integers(low, high).map(lambda ns: ns / 10**9)


def pairs(values: st.SearchStrategy[float]) -> st.SearchStrategy[tuple[float, float]]:
    return st.tuples(values, values)


controllers: st.SearchStrategy[ControllerConfig] = st.one_of(
    st.builds(PdConfig, gains=pairs(numbers)),
    st.builds(LqrConfig, q=st.tuples(positive, not_negative), r=positive),
    st.builds(
        AriseConfig,
        ks=not_negative,
        alpha1=positive,
        alpha2=positive,
        beta=not_negative,
        gamma=st.tuples(*[not_negative] * 4),
        smoothing=positive,
        adaptive_initial=st.tuples(*[numbers] * 4),
        trajectory=st.one_of(
            st.builds(Constant, angle=angles),
            st.builds(Sine, amplitude=angles, angular_frequency=numbers),
            st.builds(
                QuinticStep,
                start_angle=angles,
                end_angle=angles,
                start_time=not_negative,
                duration=positive,
            ),
            st.lists(st.tuples(st.floats(0.001, 10.0), st.floats(-0.01, 0.01)), min_size=2, max_size=6).map(
                lambda rows: CsvTrajectory(
                    times=tuple(accumulate(2.0 + gap for gap, _ in rows)), angles=tuple(angle for _, angle in rows)
                )
            ),
        ),
    ),
)
bodies = st.tuples(st.floats(0.5, 10.0), st.floats(-0.5, 0.5), st.none() | not_negative, small)


def robot(number: int, mass: float, position: float, damping: float | None, velocity: float) -> Agent:
    if damping is None:
        return SingleIntegratorAgent(id=number, mass=mass, position=position)
    return DoubleIntegratorAgent(id=number, mass=mass, position=position, damping=damping, velocity=velocity)


listed = st.lists(st.tuples(st.integers(1, 65535), bodies), min_size=2, max_size=8, unique_by=lambda pair: pair[0]).map(
    lambda pairs: {"agents": tuple(robot(number, *body) for number, body in pairs)}
)
generated = st.fixed_dictionaries(
    {
        "generate": st.builds(
            Generate,
            single_integrator=st.integers(1, 6),
            double_integrator=st.integers(1, 6),
            mass=st.just((0.5, 0.75)),
            position=st.one_of(st.just("auto"), st.floats(0.001, 0.5)),
            seed=seeds,
        )
    }
)


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    step_ns = draw(st.integers(1, 10**10))
    steps = draw(st.integers(1, min(10**7, (2**31 - 1) * 10**9 // step_ns)))
    swarm = Swarm(
        gains=draw(st.builds(SwarmGains, k=pairs(positive), kp=pairs(positive), kd=pairs(positive), ksd=not_negative)),
        **draw(listed | generated),
    )
    going = st.sampled_from([KillFault, LeaveFault, FreezeFault, JoinFault])
    moments = st.integers(0, steps).map(lambda step: step * step_ns / 10**9)
    hit = draw(st.lists(st.sampled_from(swarm.members), max_size=3, unique_by=lambda agent: agent.id))
    faults: list[Fault] = [draw(going)(at=draw(moments), agent=agent.id) for agent in hit]
    faults += draw(st.lists(st.builds(LossFault, probability=st.floats(0, 1)), max_size=1))
    faults += draw(st.lists(st.builds(DelayFault, steps=st.integers(0, 2**31 - 1)), max_size=1))
    ids = st.sampled_from([agent.id for agent in swarm.members])
    named = st.none() | st.lists(ids, min_size=1, unique=True).map(tuple)
    late = st.builds(ReorderingFault, probability=st.floats(0, 1), steps=st.integers(1, 99), agents=named)
    faults += draw(st.lists(late, max_size=1))
    faults += draw(st.lists(st.builds(DuplicationFault, probability=st.floats(0, 1), agents=named), max_size=1))
    faults += draw(st.lists(st.builds(LieFault, agent=ids, mass_factor=st.floats(1.5, 9)), max_size=1))
    faults += draw(st.lists(st.builds(ClockOffsetFault, agent=ids, offset=st.sampled_from([-1.5, 1e-9])), max_size=1))
    try:
        return Scenario(
            schema=1,
            name=draw(names),
            duration=steps * step_ns / 10**9,
            step=step_ns / 10**9,
            seed=draw(seeds),
            plane=draw(
                st.builds(
                    Plane,
                    inertia=positive,
                    friction=st.tuples(*[not_negative] * 6),
                    substep=times(1, 10**12),
                    angle=angles,
                    angular_velocity=numbers,
                    disturbance=st.builds(Disturbance, amplitude=numbers, angular_frequency=numbers),
                    robot_gravity=st.booleans(),
                )
            ),
            manifold=draw(st.builds(Manifold, curvature=st.floats(0.0125, 1e12), offset=positive, torque_max=positive)),
            controller=draw(controllers),
            swarm=swarm,
            limits=draw(st.builds(Limits, velocity=st.none() | positive, force=st.none() | positive)),
            lockstep=draw(st.builds(Lockstep, on_stall=st.sampled_from(["fail", "drop"]), stall_timeout=positive)),
            faults=tuple(faults),
        )
    except ValidationError as exc:
        # Robots too close together, too few at the start, or decimals with more digits than a float has.
        assume(not any(text in str(exc) for text in ("at one point", "at step 0", "of the step", "nanoseconds")))
        raise


@given(scenarios())
@settings(suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow], deadline=None)
def test_every_scenario_loads_back(scenario: Scenario) -> None:
    text = dump_scenario(scenario)
    again = parse_scenario(text)
    assert again == scenario.resolved()
    assert dump_scenario(again) == text
    assert all(warning.isprintable() for warning in scenario.warnings())


@given(st.integers(1, 2**31 * 10**9 - 10**9))
def test_every_time_that_a_float_can_tell_is_exact(nanoseconds: int) -> None:
    seconds = nanoseconds / 10**9
    assume(len(str(nanoseconds).rstrip("0")) <= 15)
    text = f"schema: 1\nduration: {seconds!r}\nstep: {seconds!r}\nswarm: {{generate: {{single_integrator: 4}}}}"
    assert parse_scenario(text).duration_ns == nanoseconds


VALID = """\
schema: 1
name: pd_het_4          # comment
duration: 30.0
plane: {friction: [0.01, 1000, 700, 0.02, 1000, 1.0], angle: 0.1, disturbance: {amplitude: 0.0}}
controller:
  type: arise
  trajectory: {type: sine, amplitude: 0.7}
swarm:
  gains: &g {k: [10, 10], ksd: 1.0}
  agents:
    - {id: 1, kind: single_integrator, mass: 0.6, position: 0.125}
    - {id: 3, kind: double_integrator, mass: 0.6762, damping: 0.6524, position: -0.125, velocity: 0.0}
limits: {velocity: null}
faults: [{kind: loss, probability: .2}, {at: 5.0, kind: kill, agent: 3}]
"""
FRAGMENTS = [
    "", " ", "\n", "\t", "-", "- ", ":", ": ", "{", "}", "[", "]", ",", "#", "&g ", "*g", "!", "!!",
    "!!float ", "!!str ", "!!python/name:os.system ", "|\n", ">\n", "'", '"', "%", "@", "`", "---\n",
    "...\n", "? ", "<<: ", "null", "~", "true", "yes", "0", "1", "-1", "-0", "007", "0x1F", "1e999", "1e-999",
    "9" * 500, ".nan", "-.inf", "1:30", "\0", "\x1b", "\x7f", "\ufeff", "\u2028", "\x85", "\ud800",
    "\U0010ffff", "é", "\r", "agents", "generate: {single_integrator: 9}",
]  # fmt: skip
edits = st.lists(
    st.tuples(
        st.integers(0, len(VALID)),
        st.integers(0, 12),
        st.one_of(st.sampled_from(FRAGMENTS), st.text(max_size=6)),
    ),
    min_size=1,
    max_size=4,
)


def edited(changes: list[tuple[int, int, str]]) -> str:
    text = VALID
    for start, length, new in changes:
        text = text[:start] + new + text[start + length :]
    return text


def refused(error: ScenarioError) -> ScenarioError:
    assert str(error).isprintable()
    assert error.problem
    assert error.remedy
    assert error.line is not None or error.source.startswith("--set ")
    return error


def outcome(text: str) -> Scenario | ScenarioError:
    try:
        return parse_scenario(text, source="f")
    except ScenarioError as exc:
        return refused(exc)


@given(edits)
@settings(max_examples=500, deadline=None)
def test_edited_files_load_or_are_refused(changes: list[tuple[int, int, str]]) -> None:
    found = outcome(edited(changes))
    if isinstance(found, Scenario):
        assert parse_scenario(dump_scenario(found)) == found.resolved()


@given(st.text() | st.binary().map(lambda data: data.decode("latin-1")))
@settings(deadline=None)
def test_any_text_is_refused(text: str) -> None:
    assert isinstance(outcome(text), ScenarioError)


@given(st.binary(max_size=60), st.integers(0, len(VALID)))
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_load_or_are_refused(tmp_path: Path, data: bytes, start: int) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(VALID.encode()[:start] + data + VALID.encode()[start:])
    try:
        load_scenario(path)
    except ScenarioError as exc:
        refused(exc)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
paths = st.sampled_from([
    "schema", "name", "duration", "step", "seed", "plane", "plane.friction", "plane.friction.1",
    "plane.substep", "plane.disturbance", "manifold", "manifold.offset", "controller", "controller.type",
    "controller.gamma", "controller.gamma.0", "controller.trajectory", "controller.trajectory.type",
    "swarm", "swarm.gains.k.1",
    "swarm.agents", "swarm.agents.0", "swarm.agents.1.kind", "swarm.agents.2", "swarm.generate",
    "swarm.generate.position", "limits.force", "lockstep.on_stall", "faults", "faults.0", "faults.0.kind",
    "faults.1.at", "faults.2",
])  # fmt: skip


@given(st.lists(st.tuples(paths, values | st.text(max_size=8)), min_size=1, max_size=3))
@settings(max_examples=300, deadline=None)
def test_any_override_is_taken_or_refused(changes: list[tuple[str, object]]) -> None:
    overrides = [f"{path}={value}" for path, value in changes]
    try:
        scenario = parse_scenario(VALID, overrides=overrides)
    except ScenarioError as exc:
        refused(exc)
    else:
        assert parse_scenario(dump_scenario(scenario)) == scenario.resolved()


@given(edits)
@settings(max_examples=200, deadline=None)
def test_both_yaml_parsers_agree_on_what_both_read(changes: list[tuple[int, int, str]]) -> None:
    text = edited(changes)
    fast = outcome(text)
    loader = yaml_tree._LOADER
    yaml_tree._LOADER = yaml.SafeLoader
    try:
        slow = outcome(text)
    finally:
        yaml_tree._LOADER = loader
    if isinstance(fast, Scenario) and isinstance(slow, Scenario):
        assert fast == slow
