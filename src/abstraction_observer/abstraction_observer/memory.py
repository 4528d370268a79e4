"""The memory of an observer across restarts: the positions of silent robots."""

from __future__ import annotations

import json
from collections import UserDict
from typing import TYPE_CHECKING

from swarmabs_config.files import write_whole
from swarmabs_core.errors import InputError
from swarmabs_core.messages import AgentState

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


class MemoryFile(UserDict[int, AgentState]):
    """Last states of silent robots by id, stored in a file that each change replaces atomically.

    Parameters
    ----------
    path : Path
        The file; it need not exist, but its folder must.
    on_problem : callable
        Receives the reason if the file cannot be written; the observer then continues without the memory.

    Raises
    ------
    InputError
        If the file cannot be read, or is not a memory file.
    """

    def __init__(self, path: Path, on_problem: Callable[[str], None]) -> None:
        super().__init__()
        self._path = path
        self._on_problem = on_problem
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                f"parameter memory: {path} cannot be read ({error}); remove it, or give another file"
            ) from error
        try:
            for item in json.loads(text)["silent"]:
                state = _state(item)
                self.data[state.agent_id] = state
        except (ValueError, TypeError, KeyError) as error:
            raise InputError(
                f"parameter memory: {path} contains no states of robots ({error}); remove it, or give another file"
            ) from error

    def __setitem__(self, agent_id: int, state: AgentState) -> None:
        super().__setitem__(agent_id, state)
        self._write()

    def __delitem__(self, agent_id: int) -> None:
        super().__delitem__(agent_id)
        self._write()

    def _write(self) -> None:
        """Replace the file."""
        silent = [state._asdict() for _, state in sorted(self.data.items())]
        try:
            write_whole(self._path, f"{json.dumps({'silent': silent})}\n".encode())
        except OSError as error:
            self._on_problem(f"{self._path}: {error.strerror}: the positions of silent robots are not stored")


def _state(item: dict[str, float]) -> AgentState:
    state = AgentState(**item)  # type: ignore[arg-type]  # checked below
    if not all(type(value) in (int, float) for value in state):
        raise ValueError(f"{item} is not a robot's state")
    return state
