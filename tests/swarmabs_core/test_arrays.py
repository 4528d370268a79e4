import pickle
from dataclasses import fields
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.swarmabs_core.helpers import Run, builtin

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.run.writer import BagWriter
from swarmabs_config.scenario import Scenario, dump_scenario, parse_scenario
from swarmabs_core import messages as msg
from swarmabs_core.arrays import LAYOUT, MessageArrays, RunArrays
from swarmabs_core.cdr import encode
from swarmabs_core.systems import SYSTEMS
from swarmabs_run.simulation import simulate


@cache
def scenario() -> Scenario:
    return builtin(
        "pd_het_4",
        "duration=0.2",
        "faults=[{at: 0.1, kind: kill, agent: 3}, {kind: clock_offset, agent: 1, offset: -0.5}]",
    )


@cache
def arrays() -> RunArrays:
    return simulate(scenario())


@cache
def run() -> Run:
    return Run(scenario())


def test_columns_are_the_fields_of_the_messages() -> None:
    """One column per robot; where it has no message there is NaN, and 0 in the integers."""
    np.testing.assert_array_equal(arrays().step, np.arange(21))
    np.testing.assert_array_equal(arrays().time, np.arange(21) * 10_000_000 / 1e9)
    np.testing.assert_array_equal(arrays().agents.ids, [1, 2, 3, 4])
    parts = {"abstract": msg.AbstractState, "auxiliary": msg.AuxiliaryState, "desired": msg.DesiredAbstractState}
    for found, kind in [(arrays(), msg.PlaneState), *((getattr(arrays(), part), kind) for part, kind in parts.items())]:
        for name in kind._fields[2:]:
            np.testing.assert_array_equal(getattr(found, name), run().column(kind, name))
    assert [name for name, _ in arrays().desired.items()] == list(msg.DesiredAbstractState._fields[2:])
    for name in ("kind", "status", "mass", "damping", "position", "velocity", "command"):
        found = getattr(arrays().agents, name)
        expected = np.full((21, 4), 0 if found.dtype == np.int64 else np.nan, dtype=found.dtype)
        for state in run().of(msg.AgentState):
            expected[state.step, state.agent_id - 1] = getattr(state, name)
        np.testing.assert_array_equal(found, expected)


def test_a_run_on_the_plane_is_read_by_tables_as_on_any_parent_system() -> None:
    found = arrays()
    for name, column in (
        ("angle", found.angle),
        ("angular_velocity", found.angular_velocity),
        ("torque", found.abstract.torque),
        ("inertia", found.abstract.inertia),
        ("position", found.agents.position),
        ("mass", found.agents.mass),
        ("damping", found.agents.damping),
    ):
        np.testing.assert_array_equal(found[name], column)
    np.testing.assert_array_equal(found.parent[:, 1], found.angular_velocity)
    np.testing.assert_array_equal(found.references[:, 0], found.reference)
    np.testing.assert_array_equal(found.desired.vector("value")[:, 1], found.desired.inertia)
    np.testing.assert_array_equal(found.agents.vector("command")[..., 0], found.agents.command)
    with pytest.raises(KeyError, match="no quantity 'roll'"):
        found["roll"]


SYSTEMS_RUN = """
schema: 1
duration: 0.2
system: {type: %s}
swarm:
  agents:
    - {id: 9, kind: single_integrator, coordinates: %s, constants: {mass: 1.2}}
    - {id: 2, kind: double_integrator, coordinates: %s, constants: {mass: 1.9, damping: 0.7}}
    - {id: 5, kind: single_integrator, coordinates: %s, constants: {mass: 1.7}}
faults: [{at: 0.1, kind: remove, agent: 5}]
"""


@pytest.mark.parametrize(
    ("system", "places"),
    [("beam", ("[0.1]", "[-0.1]", "[0.15]")), ("sheet", ("[0.2, 0.05]", "[-0.15, 0.1]", "[0.0, -0.2]"))],
)
def test_a_run_of_any_system_as_arrays_is_the_same_simulated_and_from_its_bag(
    system: str, places: tuple[str, ...], systems: Path, tmp_path: Path
) -> None:
    given = parse_scenario(SYSTEMS_RUN % (system, *places))
    run, found = Run(given), simulate(given)
    np.testing.assert_array_equal(found.parent, run.column(msg.ParentState, "state"))
    for part, kind in (
        ("abstract", msg.SwarmAbstract),
        ("auxiliary", msg.SwarmAuxiliary),
        ("desired", msg.SwarmDesired),
    ):
        for name in kind._fields[3:]:
            np.testing.assert_array_equal(getattr(getattr(found, part), name), run.column(kind, name))
    assert found.agents.ids.tolist() == [2, 5, 9]
    for state in run.of(msg.RobotState):
        column = (2, 5, 9).index(state.agent_id)
        for name in ("coordinates", "velocities", "command", "constants", "status"):
            np.testing.assert_array_equal(getattr(found.agents, name)[state.step, column], getattr(state, name))
    assert np.isnan(found.agents.coordinates[-1, 1]).all()
    assert not np.isnan(found.agents.coordinates[:10]).any()
    wanted = [SYSTEMS.make(system, {}, None).reference(time) for time in found.time]
    np.testing.assert_array_equal(found.reference, wanted)
    assert found.summary()["digest"] == run.digest()

    family = msg.SYSTEM_FAMILY
    text = dump_scenario(given).encode()
    with BagWriter(
        tmp_path / "bag",
        topics=(*family.once, *family.main, msg.STANDING, msg.EVENTS),
        attachments={"scenario.yaml": text},
    ) as writer:
        for step in run.steps:
            for topic, time, payload in step.stored():
                writer.write(topic, time, payload)
    loaded = load_arrays(tmp_path / "bag")
    for field in fields(RunArrays):
        one, other = getattr(found, field.name), getattr(loaded, field.name)
        if isinstance(one, MessageArrays):
            assert [name for name, _ in one.items()] == [name for name, _ in other.items()]
            for name, values in one.items():
                np.testing.assert_array_equal(getattr(other, name), values)
        elif isinstance(one, np.ndarray):
            np.testing.assert_array_equal(other, one)
        elif field.name != "figures":
            assert other == one
    assert loaded.summary() == found.summary()
    assert pickle.loads(pickle.dumps(loaded))[loaded.description.robot[0].name].shape == (21, 3)


def test_layout_is_that_of_the_bytes() -> None:
    for topic in msg.MAIN_TOPICS:
        (message, *_) = run().of(topic.message)
        (row,) = np.frombuffer(encode(message), dtype=LAYOUT[topic])
        assert tuple(row[name] for name in topic.message._fields[1:]) == message[1:]


def test_arrays_can_be_copied_between_processes_and_name_their_fields_to_who_misspells_one() -> None:
    again = pickle.loads(pickle.dumps(arrays()))
    np.testing.assert_array_equal(again.agents.position, arrays().agents.position)
    with pytest.raises(AttributeError, match=r"no field 'torqe'; .* agent_count, torque, inertia, "):
        _ = again.abstract.torqe
