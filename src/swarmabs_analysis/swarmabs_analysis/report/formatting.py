"""Formatting of numbers and of text from bags."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LONGEST = 400


def quantity(value: float, unit: str) -> str:
    """Return a number with four digits and its unit."""
    return f"{value:.4g} {unit}".strip()


def tolerated(value: float, unit: str) -> str:
    """Return a tolerance with its unit; angles are in mrad."""
    return f"{1e3 * value:g} mrad" if unit == "rad" else quantity(value, unit)


def span(name: str, values: NDArray[np.float64], unit: str, *, over_time: bool = True) -> str:
    """Return the range of values in words, and for values over time also the first and the last."""
    there = np.asarray(values)[np.isfinite(values)]
    if not len(there):
        return f"{name}: nothing recorded"
    ends = f"from {there[0]:.4g} to {quantity(float(there[-1]), unit)}, " if over_time else ""
    return f"{name}: {ends}between {np.min(there):.4g} and {quantity(float(np.max(there)), unit)}"


def joined(*parts: str, by: str = "; ") -> str:
    """Join the parts that are not empty."""
    return by.join(part for part in parts if part)


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, singular or plural."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def shown(value: object) -> str:
    """Return a value from a bag as one printable line of limited length."""
    text = "".join(map(_printable, str(value)))
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def printable_lines(text: str) -> str:
    """Return text with its lines unchanged and each unprintable character replaced."""
    return "\n".join("".join(map(_printable, line)) for line in text.splitlines())


def sentence(text: str) -> str:
    """Return text with an initial capital and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def _printable(letter: str) -> str:
    return letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}"
