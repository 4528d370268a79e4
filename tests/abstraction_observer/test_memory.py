"""The file in which an observer keeps where silent robots stand."""

from __future__ import annotations

from pathlib import Path

import pytest

from abstraction_observer.memory import MemoryFile
from swarmabs_core.errors import InputError
from swarmabs_core.messages import NEVER, AgentState

STATE = AgentState(1, 2, NEVER, 3, 2, 1, 0.5, 0.8, -0.1, 0.25, 1.5)


def test_what_was_kept_is_there_for_the_next_node(tmp_path: Path) -> None:
    problems: list[str] = []
    memory = MemoryFile(tmp_path / "m.json", problems.append)
    memory[3] = STATE
    memory[4] = STATE._replace(agent_id=4)
    del memory[4]
    again = MemoryFile(tmp_path / "m.json", problems.append)
    assert dict(again) == {3: STATE}
    assert problems == []
    assert [path.name for path in tmp_path.iterdir()] == ["m.json"]


@pytest.mark.parametrize(
    "text",
    ["", "[]", '{"silent": 3}', '{"silent": [{}]}', '{"silent": [{"stamp": 1}]}', "\x00", '{"silent": ["a"]}'],
)
def test_a_file_of_something_else_is_refused_and_left(tmp_path: Path, text: str) -> None:
    path = tmp_path / "m.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"parameter memory: .*m\.json holds no states of robots"):
        MemoryFile(path, print)
    assert path.read_text() == text


def test_a_state_with_texts_for_numbers_is_refused(tmp_path: Path) -> None:
    MemoryFile(tmp_path / "m.json", print)[3] = STATE
    text = (tmp_path / "m.json").read_text().replace("-0.1", '"-0.1"')
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(InputError, match="no robot's state"):
        MemoryFile(tmp_path / "m.json", print)


def test_a_file_that_cannot_be_written_is_told_and_costs_only_the_memory(tmp_path: Path) -> None:
    problems: list[str] = []
    memory = MemoryFile(tmp_path / "nowhere" / "m.json", problems.append)
    memory[3] = STATE
    assert memory[3] == STATE
    assert "is not remembered" in problems[0]
