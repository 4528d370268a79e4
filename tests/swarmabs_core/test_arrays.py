from __future__ import annotations

import pickle
from functools import cache

import numpy as np
import pytest
from tests.swarmabs_core.helpers import SCENARIOS, Run, builtin

from swarmabs_config.scenario import Scenario, ScenarioError
from swarmabs_core.arrays import LAYOUT, RunArrays
from swarmabs_core.cdr import encode
from swarmabs_core.messages import (
    MAIN_TOPICS,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    Message,
    PlaneState,
    Topic,
)
from swarmabs_run.simulation import simulate


@cache
def scenario() -> Scenario:
    return builtin("pd_het_4", "duration=0.2", "faults=[{at: 0.1, kind: kill, agent: 3}]")


@cache
def arrays() -> RunArrays:
    return simulate(scenario())


@cache
def run() -> Run:
    return Run(scenario())


def test_steps_and_times() -> None:
    np.testing.assert_array_equal(arrays().step, np.arange(21))
    np.testing.assert_array_equal(arrays().time, np.arange(21) * 10_000_000 / 1e9)


def test_plane() -> None:
    for name in ("angle", "angular_velocity"):
        np.testing.assert_array_equal(getattr(arrays(), name), run().column(PlaneState, name))


@pytest.mark.parametrize(
    ("part", "kind"),
    [("abstract", AbstractState), ("auxiliary", AuxiliaryState), ("desired", DesiredAbstractState)],
)
def test_broadcasts(part: str, kind: type[Message]) -> None:
    found = getattr(arrays(), part)
    assert [name for name, _ in found.items()] == list(kind._fields[2:])
    for name in kind._fields[2:]:
        np.testing.assert_array_equal(getattr(found, name), run().column(kind, name))


@pytest.mark.parametrize("name", ["kind", "status", "mass", "damping", "position", "velocity", "command"])
def test_robots(name: str) -> None:
    """One column per robot; where it has no message there is NaN, and 0 in the integers."""
    found = getattr(arrays().agents, name)
    assert found.shape == (21, 4)
    gap = 0 if found.dtype == np.int64 else np.nan
    expected = np.full((21, 4), gap, dtype=found.dtype)
    for state in run().of(AgentState):
        expected[state.step, state.agent_id - 1] = getattr(state, name)
    np.testing.assert_array_equal(found, expected)
    assert np.array_equal(found[11:, 2], np.full(10, gap), equal_nan=True)


def test_ids_are_the_columns() -> None:
    np.testing.assert_array_equal(arrays().agents.ids, [1, 2, 3, 4])


@pytest.mark.parametrize("topic", MAIN_TOPICS, ids=lambda topic: topic.name)
def test_layout_is_that_of_the_bytes(topic: Topic) -> None:
    (message, *_) = run().of(topic.message)
    (row,) = np.frombuffer(encode(message), dtype=LAYOUT[topic])
    names = topic.message._fields[1:]
    assert tuple(row[name] for name in names) == message[1:]


def test_scenario_may_be_given_as_a_file() -> None:
    from_file = simulate(str(SCENARIOS / "pd_si_4.yaml"))
    assert len(from_file.angle) == 3001
    assert abs(from_file.angle[-1]) < 5e-4
    with pytest.raises(ScenarioError, match="no such file"):
        simulate("missing.yaml")


def test_a_misspelt_field_is_named_with_those_there_are() -> None:
    with pytest.raises(AttributeError, match="no field 'torqe'; there are agent_count, torque, inertia, "):
        _ = arrays().abstract.torqe


def test_arrays_can_be_copied_between_processes() -> None:
    again = pickle.loads(pickle.dumps(arrays()))
    np.testing.assert_array_equal(again.agents.position, arrays().agents.position)
