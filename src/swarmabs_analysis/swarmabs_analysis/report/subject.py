"""What a report calls the numbers of a parent system and its robots: names of their tables, or symbols of the paper."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.systems.components import derived

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_core.systems import Quantity, SystemTables


class Term(NamedTuple):
    """What a number is called.

    Attributes
    ----------
    title : str
        In headings.
    symbol : str
        In legends.
    words : str
        In descriptions.
    unit : str
        Its unit, for readers.
    label : str
        On axes, with the unit.
    """

    title: str
    symbol: str
    words: str
    unit: str
    label: str


_PAPER: Mapping[str, Term] = {
    "angle": Term("Angle", "θ", "angle θ", "rad", "θ, rad"),
    "angular_velocity": Term("Rate", "ω", "rate ω", "rad/s", "ω, rad/s"),
    "torque": Term("Torque τ", "τ", "torque", "N m", "τ, N m"),
    "inertia": Term("Inertia J", "J", "inertia", "kg m²", "J, kg m²"),
    "position": Term("Positions", "p", "positions", "m", "position p, m"),
    "rate of position": Term("Velocities", "v", "velocities", "m/s", "velocity v, m/s"),
}


class Subject:
    """What the panels and tables of a report name.

    Attributes
    ----------
    parent : str
        The parent system.
    falsified : str
        What a robot with a falsified state misreports.
    """

    def __init__(self, tables: SystemTables) -> None:
        self.parent = tables.name.replace("_", " ")
        of_paper = tables.name == "plane"
        self.falsified = "positions and masses" if of_paper else "coordinates and constants"
        self._terms = _PAPER if of_paper else {}

    def term(self, quantity: Quantity) -> Term:
        """Return what a number is called."""
        return self._term(quantity.name, quantity.unit)

    def rate(self, quantity: Quantity) -> Term:
        """Return what the rate of a number is called."""
        return self._term(f"rate of {quantity.name}", derived(quantity.unit))

    def _term(self, name: str, unit: str) -> Term:
        words, shown = name.replace("_", " "), unit.replace("^2", "²").replace("^3", "³")
        usual = Term(f"{words[:1].upper()}{words[1:]}", words, words, shown, ", ".join(filter(None, (words, shown))))
        return self._terms.get(name, usual)
