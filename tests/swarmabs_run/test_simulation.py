"""The whole system in one process, by state machines or on arrays, and the runs that record it."""

import os
import random
import signal
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.swarmabs_core.helpers import Run, builtin, digest

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.reader import open_bag
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.run.digest import Digest
from swarmabs_bag.run.step import Step
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenario import Scenario, dump_scenario, parse_scenario
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import MAIN_TOPICS, AbstractState, DesiredAbstractState, PlaneState, Topic
from swarmabs_core.nodes import NodeKind, NodeName
from swarmabs_run.run import Outcome, Progress, RunOptions
from swarmabs_run.simulated_run import simulate_run
from swarmabs_run.simulation import Simulation, nodes_in_process, simulate, simulated_steps
from swarmabs_run.swarm_columns import NotVectorisableError
from swarmabs_run.vector_simulation import VectorSimulation, vectorised

SHORT = "duration=0.5"


def listed(order: tuple[int, ...]) -> Scenario:
    robots = {
        1: "{id: 1, kind: single_integrator, mass: 0.3552, position: 0.125}",
        2: "{id: 2, kind: single_integrator, mass: 0.3532, position: -0.125}",
        3: "{id: 3, kind: double_integrator, mass: 0.6762, damping: 0.6524, position: 0.125}",
        4: "{id: 4, kind: double_integrator, mass: 0.4596, damping: 1.3258, position: -0.125}",
    }
    agents = ", ".join(robots[i] for i in order)
    return parse_scenario(
        f"schema: 1\nname: pd_het_4\nduration: 0.5\nswarm: {{agents: [{agents}]}}\n"
        "faults: [{kind: loss, probability: 0.1}, {at: 0.2, kind: kill, agent: 2}]"
    )


def test_order_in_the_file_changes_no_bit_and_messages_come_as_arrays(tmp_path: Path) -> None:
    run = Run(listed((1, 2, 3, 4)))
    for order in ((4, 3, 2, 1), (3, 1, 4, 2)):
        assert digest(Simulation(listed(order)).steps()) == run.digest()
    file = tmp_path / "scenario.yaml"
    file.write_text(dump_scenario(listed((1, 2, 3, 4))), encoding="utf-8")
    angles = simulate(file).angle.tolist()
    assert angles == [message.angle for message in run.of(PlaneState)]
    assert len(angles) == 51


def test_a_scenario_by_name_with_values_gives_what_its_bag_gives(tmp_path: Path) -> None:
    faults = [{"kind": "reference", "at": 0.2, "offset": 0.05}]
    run = simulate("pd_het_4", {"plane.angle": 0.2, "duration": 0.5, "faults": faults})
    assert run.angle[0] == 0.2
    assert run.reference.tolist() == [0.05 if step >= 20 else 0.0 for step in range(51)]
    assert [(e.step, e.time, e.kind, e.agent, e.value) for e in run.events] == [(20, 0.2, "steering", None, 0.05)]
    scenario = builtin("pd_het_4", "plane.angle=0.2", "duration=0.5", f"faults={faults}")
    folder = new_run_folder(tmp_path / "run")
    simulate_run(scenario, folder)
    again, changed = load_arrays(folder.path), simulate(scenario, {"plane.angle": 0.1})
    assert (again.events, again.reference.tolist()) == (run.events, run.reference.tolist())
    assert again.summary() == run.summary() == simulate(folder.path).summary()
    assert (changed.angle[0], changed.summary()["digest"] == run.summary()["digest"]) == (0.1, False)
    with pytest.raises(InputError, match="'pd_het_5'; did you mean pd_het_4"):
        simulate("pd_het_5", {})


def test_every_message_of_the_main_topics_is_there_once_and_the_first_say_what_the_scenario_says() -> None:
    run = Run(builtin("pd_het_4", SHORT))
    assert [step.step for step in run.steps] == list(range(51))
    for step in run.steps:
        assert [(r.topic, r.agent_id) for r in step.records] == [
            *((MAIN_TOPICS[0], i) for i in (1, 2, 3, 4)),
            *((topic, 0) for topic in MAIN_TOPICS[1:]),
        ]
        assert {r.message.step for r in step.records} == {step.step}
        assert {r.message[0] for r in step.records} == {step.step * 10_000_000}
    assert run.one(PlaneState, 0)[2:] == (0.1, 0.0)
    assert [state.position for state in run.states(0)] == [0.125, -0.125, 0.125, -0.125]
    assert run.one(AbstractState, 0).agent_count == 4
    desired = run.one(DesiredAbstractState, 0)
    assert desired.torque == pytest.approx(0.31623, rel=1e-12)
    assert desired.inertia == pytest.approx(0.0125 * 0.31623**2 + 0.025, rel=1e-12)
    assert (desired.torque_rate, desired.inertia_rate) == (0.0, 0.0)


ALL_KILLED = ", ".join(f"{{at: 0.1, kind: kill, agent: {i}}}" for i in (1, 2, 3, 4))


@pytest.mark.parametrize(
    ("overrides", "problem"),
    [
        (("plane.angle=1.0", "controller.gains=[-3.0, 0.0]"), r"step \d+: the plane's angle is -?1\.5\d* rad"),
        (("swarm.gains.k=[300, 300]",), "not finite"),
        ((f"faults=[{ALL_KILLED}]",), "step 11: no robot is left"),
    ],
)
def test_what_fails_a_run(overrides: tuple[str, ...], problem: str) -> None:
    with pytest.raises(RunError, match=problem):
        Run(builtin("pd_si_4", *overrides))


def test_a_run_that_stalls_fails() -> None:
    scenario = builtin("pd_si_4", SHORT)
    nodes = nodes_in_process(scenario)
    del nodes[NodeName(NodeKind.CONTROLLER)]
    with pytest.raises(RunError, match="the run stalls at step 0; missing: swarm/desired_abstract_state"):
        list(Simulation(scenario, nodes.values()).steps())


def swarm(count: int, seed: int, *, controller: str = "pd") -> Scenario:
    """Return a mixed swarm with robots all over the plane, some of them without damping."""
    draw = random.Random(seed)
    agents = []
    for number in range(1, count + 1):
        body = f"id: {number}, mass: {draw.uniform(0.05, 2.0)!r}, position: {draw.uniform(-0.5, 0.5)!r}, kind: "
        if draw.random() < 0.5:
            agents.append(f"{{{body} single_integrator}}")
        else:
            damping, velocity = draw.choice([0.0, draw.uniform(0.1, 3.0)]), draw.uniform(-0.1, 0.1)
            agents.append(f"{{{body} double_integrator, damping: {damping!r}, velocity: {velocity!r}}}")
    return parse_scenario(
        f"schema: 1\nduration: 0.5\nmanifold: {{offset: 0.3}}\ncontroller: {{type: {controller}}}\n"
        "plane: {disturbance: {amplitude: 0.1}}\n"
        f"swarm: {{gains: {{kd: [8, 8]}}, agents: [{', '.join(agents)}]}}\n"
    )


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


def of_one_kind(kind: str) -> Scenario:
    return builtin("pd_het_4", SHORT, f"swarm={{generate: {{{kind}: 8}}}}").resolved()


def strained() -> Scenario:
    """Return a swarm of whose limits there are events."""
    calm = swarm(20, seed=5)
    manifold, plane = replace(calm.manifold, torque_max=0.01), replace(calm.plane, length=0.2)
    return calm.model_copy(update={"manifold": manifold, "plane": plane})


@pytest.mark.parametrize(
    ("scenario", "events"),
    [
        *((swarm(n, n, controller=name), False) for n in (2, 3, 17, 60) for name in ("pd", "lqr", "pid", "arise")),
        (of_one_kind("single_integrator"), False),
        (of_one_kind("double_integrator"), False),
        (strained(), True),
        (builtin("pd_het_4", "duration=0.6", "swarm.gains={k: [199, 199], kp: [20000, 20000]}"), True),  # fly off
        (builtin("pd_si_4", "plane.disturbance={amplitude: 500, angular_frequency: 1}"), False),  # turns over
        (builtin("pd_het_4", SHORT, *(f"swarm.agents.{n}.center_height={0.02 * n}" for n in range(4))), False),
        (builtin("arise_di_4", SHORT, "plane={mass: 2.0, center_height: -0.1}"), False),
        (builtin("pd_het_4", SHORT, "swarm={generate: {single_integrator: 8, center_height: 0.03}}"), False),
    ],
)
def test_arrays_give_the_bits_and_the_order_of_the_state_machines(scenario: Scenario, events: bool) -> None:  # noqa: FBT001
    machines = digest_and_bag(Simulation(scenario).steps())
    robots = vectorised(scenario)
    assert robots is not None
    assert digest_and_bag(VectorSimulation(scenario, robots).steps()) == machines
    assert any(topic.name == "swarm/events" for topic, _, _ in machines[1]) or not events


@pytest.mark.parametrize(
    "option",
    [
        "faults=[{at: 0.1, kind: kill, agent: 2}]",
        "faults=[{kind: delay, steps: 1}]",
        "limits={velocity: 0.01}",
        "limits={force: 0.1}",
        "plane.end_stop=0.101",
        "plane.robot_gravity=true",
        *(f"{of}.sensor.{what}" for of in ("plane", "swarm") for what in ("noise=[1e-4, 0]", "resolution=[0, 1e-4]")),
        "swarm.actuator_lag=0.02",
        "observer={type: parent_response}",
    ],
)
def test_imperfect_worlds_are_left_to_the_state_machines(option: str) -> None:
    plain = ("duration=0.3", "plane.angle=0.1", "plane.angular_velocity=0.2")
    scenario = builtin("arise_het_20", *plain, option)
    assert vectorised(scenario) is None
    imperfect = digest_and_bag(simulated_steps(scenario))
    assert imperfect == digest_and_bag(Simulation(scenario).steps())
    assert imperfect != digest_and_bag(simulated_steps(builtin("arise_het_20", *plain)))


def test_a_swarm_that_loses_its_spread_goes_on_with_the_state_machines(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = swarm(6, seed=2)
    whole = VectorSimulation.steps

    def breaks_off(self: VectorSimulation) -> Iterator[Step]:
        first = next(whole(self))
        assert len(first) > 7
        yield first[:7]
        raise NotVectorisableError

    monkeypatch.setattr(VectorSimulation, "steps", breaks_off)
    assert digest_and_bag(simulated_steps(scenario)) == digest_and_bag(Simulation(scenario).steps())


def recorded(folder: Path, name: str, *overrides: str, **options: Any) -> Outcome:
    return simulate_run(builtin(name, *overrides).resolved(), new_run_folder(folder), RunOptions(**options))


def test_a_run_tells_how_it_goes_and_what_it_came_to_and_has_the_same_digest_without_a_bag(tmp_path: Path) -> None:
    told: list[Progress] = []
    outcome = recorded(tmp_path / "run", "pd_het_4", "duration=1", on_progress=told.append)
    assert (outcome.status, outcome.reason) == ("ok", None)
    assert outcome.stepping_seconds
    assert (told[-1].phase, told[-1].step, told[-1].steps) == ("closing", 100, 100)
    assert open_bag(tmp_path / "run").message_count == outcome.figures["messages"] == 101 * 8
    other = recorded(tmp_path / "other", "pd_het_4", "duration=1", record=False)
    assert other.figures["digest"] == outcome.figures["digest"]
    assert [(tmp_path / run / "bag").exists() for run in ("run", "other")] == [True, False]


def test_a_plane_that_turns_over_fails_the_run_and_leaves_a_readable_bag(tmp_path: Path) -> None:
    outcome = recorded(tmp_path / "run", "pd_si_4", "plane.disturbance={amplitude: 500, angular_frequency: 1}")
    assert outcome.status == "failed"
    assert outcome.reason is not None and "the plane's angle is" in outcome.reason
    assert open_bag(tmp_path / "run").message_count == outcome.figures["messages"] > 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupt_ends_it_in_order(tmp_path: Path, number: signal.Signals, monkeypatch: pytest.MonkeyPatch) -> None:
    real = Recording.add

    def add(self: Recording, step: object) -> None:
        real(self, step)  # type: ignore[arg-type]
        if self.run.latest is not None and self.run.latest.step >= 30:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(Recording, "add", add)
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    outcome = recorded(tmp_path / "run", "pd_het_4")
    assert (outcome.status, outcome.reason) == ("interrupted", "interrupted")
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before
    assert 31 * 8 <= open_bag(tmp_path / "run").message_count == outcome.figures["messages"] < 3001 * 8
