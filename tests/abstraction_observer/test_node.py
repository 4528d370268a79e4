"""The adapters of the observer."""

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from tests.swarmabs_core.helpers import agent_state
from tests.swarmabs_ros.nodes import realtime_settings_from, settings_from

from abstraction_observer import realtime
from abstraction_observer.memory import MemoryFile
from abstraction_observer.node import PARAMETERS, make
from swarmabs_core.errors import InputError
from swarmabs_core.messages import NEVER, AgentState, EventKind, SwarmEvent
from swarmabs_core.parameters import Value
from swarmabs_core.realtime.base import OBSERVER_PHASE
from swarmabs_core.realtime.observer import RealtimeObserver, RealtimeObserverConfig
from swarmabs_ros.managed import RealtimeNode
from swarmabs_ros.status import StatusChannel

CHANNEL = StatusChannel("abstraction_observer")


def test_silent_robots_are_dropped_only_if_that_is_wanted_and_never_those_that_wait_for_orders() -> None:
    assert make(settings_from(PARAMETERS), CHANNEL).on_stall is None
    spec = make(settings_from(PARAMETERS, members=(1, 2, 3), on_stall="drop"), CHANNEL)
    assert spec.on_stall is not None
    for agent_id in (1, 2, 3):
        spec.behaviour.handle(agent_state(agent_id))
    for agent_id in (1, 2):
        spec.behaviour.handle(agent_state(agent_id, 1))
    messages = spec.on_stall()
    events = [message for message in messages if isinstance(message, SwarmEvent)]
    assert [(event.agent_id, event.kind, event.step) for event in events] == [(3, EventKind.DEAD, 1)]
    assert len(messages) == 3
    assert spec.on_stall() == (), "nobody is silent any more"
    spec = make(settings_from(PARAMETERS, members=(1, 2), on_stall="drop", steered=True), CHANNEL)
    spec.behaviour.handle(agent_state(1))
    assert spec.on_stall is not None and spec.on_stall() == ()


def real_time(**values: Value) -> RealtimeObserverConfig:
    return realtime_settings_from(realtime.PARAMETERS, **values).declared(RealtimeObserverConfig)


def test_how_many_robots_are_waited_for() -> None:
    for start, quorum, robots in (("wait", 0, 4), ("proceed", 0, 2), ("quorum", 3, 3)):
        assert real_time(start=start, quorum=quorum).needed == robots
    for quorum in (0, 1, 5):
        with pytest.raises(InputError, match=rf"parameter quorum: {quorum} of 4 robots"):
            real_time(start="quorum", quorum=quorum)


def test_in_real_time_it_remembers_silent_robots_in_a_file_and_warns_where_it_cannot(tmp_path: Path) -> None:
    warnings: list[str] = []
    node = cast("RealtimeNode", SimpleNamespace(notes=SimpleNamespace(warning=warnings.append)))
    settings = realtime_settings_from(realtime.PARAMETERS, memory=str(tmp_path / "nowhere" / "m.json"))
    spec = realtime.make(settings, node)
    assert isinstance(spec.behaviour, RealtimeObserver)
    assert spec.phase == OBSERVER_PHASE
    (tmp_path / "m.json").write_text("no states")
    with pytest.raises(InputError, match=r"parameter memory: .*contains no states of robots"):
        realtime.make(realtime_settings_from(realtime.PARAMETERS, memory=str(tmp_path / "m.json")), node)
    assert isinstance(realtime.make(realtime_settings_from(realtime.PARAMETERS), node).behaviour, RealtimeObserver)


STATE = AgentState(1, 2, NEVER, 3, 2, 1, 0.5, 0.8, -0.1, 0.25, 1.5)


def test_what_was_kept_is_there_for_the_next_node_unless_it_was_changed(tmp_path: Path) -> None:
    problems: list[str] = []
    memory = MemoryFile(tmp_path / "m.json", problems.append)
    memory[3] = STATE
    memory[4] = STATE._replace(agent_id=4)
    del memory[4]
    again = MemoryFile(tmp_path / "m.json", problems.append)
    assert dict(again) == {3: STATE}
    assert problems == []
    assert [path.name for path in tmp_path.iterdir()] == ["m.json"]
    MemoryFile(tmp_path / "m.json", print)[3] = STATE
    text = (tmp_path / "m.json").read_text().replace("-0.1", '"-0.1"')
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(InputError, match="not a robot's state"):
        MemoryFile(tmp_path / "m.json", print)


@pytest.mark.parametrize(
    "text",
    ["", "[]", '{"silent": 3}', '{"silent": [{}]}', '{"silent": [{"stamp": 1}]}', "\x00", '{"silent": ["a"]}'],
)
def test_a_file_of_something_else_is_refused_and_left(tmp_path: Path, text: str) -> None:
    path = tmp_path / "m.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"parameter memory: .*m\.json contains no states of robots"):
        MemoryFile(path, print)
    assert path.read_text() == text


@pytest.mark.parametrize("place", ["nowhere/m.json", "m.json"], ids=["no folder", "a folder of that name"])
def test_a_file_that_cannot_be_written_is_told_and_costs_only_the_memory(tmp_path: Path, place: str) -> None:
    problems: list[str] = []
    memory = MemoryFile(tmp_path / place, problems.append)
    (tmp_path / "m.json").mkdir()
    memory[3] = STATE
    assert memory[3] == STATE
    assert "are not stored" in problems[0]
    assert [path.name for path in tmp_path.iterdir()] == ["m.json"]
