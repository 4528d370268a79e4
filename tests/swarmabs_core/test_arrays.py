import pickle
from functools import cache

import numpy as np
import pytest
from tests.swarmabs_core.helpers import Run, builtin

from swarmabs_config.scenario import Scenario
from swarmabs_core import messages as msg
from swarmabs_core.arrays import LAYOUT, RunArrays
from swarmabs_core.cdr import encode
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
