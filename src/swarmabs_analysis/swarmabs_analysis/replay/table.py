"""How a replay differs from its recording, for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.text import Text

from swarmabs_analysis.comparison.table import deviations_table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import RenderableType


def result_parts(result: Mapping[str, Any]) -> tuple[RenderableType, ...]:
    """Return the result of a replay: that it is the same, or what differs first and how far each field deviates."""
    compared = f"{', '.join(result['nodes'])}: {result['compared']} messages compared with the recording"
    if result["same"]:
        return (Text(f"{compared}; same digest"),)
    first = result["first_difference"]
    if first is None:
        return (Text(f"{compared}; none differs"),)
    robot = f" of robot {first['agent']}" if first["agent"] else ""
    text = (
        f"{compared}; the first that differs: step {first['step']}, {first['topic']}{robot}, {_what(first)}\n"
        "open loop: this is what the nodes would have said to what was recorded; nothing else has reacted"
    )
    columns = {"differing": "differ", "largest": "largest", "step": "at step", "agent": "robot"}
    return Text(text), deviations_table(result["deviations"], columns)


def _what(first: Mapping[str, Any]) -> str:
    """Say how a message differs."""
    if first["replayed"] is None:
        return "the message is missing in the replay"
    if first["recorded"] is None:
        return "the message is missing in the recording"
    return f"{first['field']} is {first['replayed']!r}, was {first['recorded']!r}"
