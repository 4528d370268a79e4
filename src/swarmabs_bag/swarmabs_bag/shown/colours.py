"""The colour of each quantity and status in all views of a swarm; those of robots are in `swarmabs_core.systems.kinds`.

Reports, the figures of the paper, pictures of sweeps, RViz markers and models use these values; the style sheet of the
page, the Foxglove layout and the model in `swarmabs_bringup` repeat them. Six of the colours are those of Okabe and
Ito, distinct with any colour vision.
"""

from __future__ import annotations

from swarmabs_core.systems.kinds import DOUBLE_INTEGRATOR, SINGLE_INTEGRATOR

PLANE = "#0072b2"
"""The plane: its angle and rate."""
REFERENCE = "#000000"
"""Desired values, drawn dashed: the reference of the angle, the desired abstract state."""
ERROR = "#d55e00"
TORQUE = "#009e73"
INERTIA = "#cc79a7"
FAILED = "#b00020"
"""A dead robot, a stalled node, a failed run."""
SAFE_STOP = "#f0e442"
"""A robot in a safe stop, drawn with a dark outline."""
ABSENT = "#888888"
"""A robot that is silent or has left."""

ROBOTS = (DOUBLE_INTEGRATOR.colour, SINGLE_INTEGRATOR.colour, TORQUE, INERTIA)
"""The first four robots in Foxglove's layout, which cannot tell the kinds of robots."""


def parts(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue of a colour, from 0 to 1."""
    red, green, blue = (value / 255.0 for value in bytes.fromhex(colour.removeprefix("#")))
    return red, green, blue


def tint(colour: str, share: float) -> str:
    """Return a mix of white and a colour, with a share of the colour from 0 to 1."""
    mixed = [round(255.0 * (1.0 - share * (1.0 - part))) for part in parts(colour)]
    return f"#{bytes(mixed).hex()}"
