"""When the bag of a run goes on in a new file."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Split:
    """When a bag goes on in a new file, always between two steps; 0: never.

    Attributes
    ----------
    bytes : int
        Size of a file after which the next one begins; it may end one chunk beyond it.
    nanoseconds : int
        Log time that a file spans.
    """

    bytes: int = 0
    nanoseconds: int = 0


ONE_FILE = Split()
"""The bag stays one file."""
