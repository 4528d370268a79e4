"""What a check of the theory says: conditions with their numbers, the theorems that they belong to, verdicts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import isfinite
from typing import Literal, TypeAlias

Number: TypeAlias = float | tuple[float, ...]
Document: TypeAlias = "dict[str, Document] | list[Document] | str | float | bool | None"


class Verdict(Enum):
    """What a check comes to."""

    HOLDS = "holds"
    FAILS = "fails"
    NOT_APPLICABLE = "not applicable"


@dataclass(frozen=True, slots=True)
class Form:
    """One form of a condition, printed or corrected: an inequality with its numbers.

    Parameters
    ----------
    text : str
        The inequality.
    value, bound : float
        Its left and its right side; infinite where there is none.
    relation : str
        How they must compare.
    """

    text: str
    value: float
    bound: float
    relation: Literal[">", ">=", "<", "<="] = ">"

    @property
    def margin(self) -> float:
        """By how much the inequality holds; negative if it does not, minus infinity if a side does not exist."""
        if not isfinite(self.value) or not isfinite(self.bound):
            return float("-inf")
        return self.value - self.bound if self.relation.startswith(">") else self.bound - self.value

    @property
    def verdict(self) -> Verdict:
        """Whether the inequality holds."""
        holds = self.margin >= 0 if self.relation.endswith("=") else self.margin > 0
        return Verdict.HOLDS if holds else Verdict.FAILS

    def document(self) -> Document:
        """Return the form for JSON."""
        return {
            "text": self.text,
            "value": finite(self.value),
            "relation": self.relation,
            "bound": finite(self.bound),
            "margin": finite(self.margin),
            "verdict": self.verdict.value,
        }


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition of a theorem, as the paper prints it and as it has to be.

    Parameters
    ----------
    name : str
        Short and stable, such as ``k2``.
    printed : Form or None
        The paper's form; None if the paper does not state the condition.
    corrected : Form
        The right form. Its verdict is that of the condition.
    inputs : mapping
        The numbers that went in, by name, in SI units.
    note : str
        What else a reader has to know.
    """

    name: str
    printed: Form | None
    corrected: Form
    inputs: Mapping[str, Number] = field(default_factory=dict)
    note: str = ""

    @property
    def verdict(self) -> Verdict:
        """Whether the corrected form holds."""
        return self.corrected.verdict

    def document(self) -> Document:
        """Return the condition for JSON."""
        return {
            "name": self.name,
            "printed": self.printed.document() if self.printed else None,
            "corrected": self.corrected.document(),
            "margin": finite(self.corrected.margin),
            "verdict": self.verdict.value,
            "inputs": {name: _number(value) for name, value in self.inputs.items()},
            "note": self.note,
        }


@dataclass(frozen=True, slots=True)
class Theorem:
    """A theorem of the paper, or a group of conditions that it lacks, evaluated for a scenario.

    Parameters
    ----------
    label : str
        Its label in the paper's source, such as ``LQR_SI_sys``.
    title : str
        What it is about.
    conditions : tuple of Condition
        Its conditions; none if it does not apply.
    note : str
        Why it does not apply, or what its proof leaves out.
    """

    label: str
    title: str
    conditions: tuple[Condition, ...] = ()
    note: str = ""

    @property
    def applicable(self) -> bool:
        """Whether it is about this scenario."""
        return bool(self.conditions)

    @property
    def verdict(self) -> Verdict:
        """Whether all corrected conditions hold."""
        if not self.applicable:
            return Verdict.NOT_APPLICABLE
        return Verdict.FAILS if self.failed else Verdict.HOLDS

    @property
    def printed_verdict(self) -> Verdict:
        """Whether all conditions hold as the paper prints them."""
        forms = [condition.printed for condition in self.conditions if condition.printed]
        if not forms:
            return Verdict.NOT_APPLICABLE
        return Verdict.HOLDS if all(form.verdict is Verdict.HOLDS for form in forms) else Verdict.FAILS

    @property
    def failed(self) -> tuple[Condition, ...]:
        """The conditions whose corrected form does not hold."""
        return tuple(condition for condition in self.conditions if condition.verdict is Verdict.FAILS)

    def document(self) -> Document:
        """Return the theorem for JSON."""
        return {
            "label": self.label,
            "title": self.title,
            "applicable": self.applicable,
            "verdict": self.verdict.value,
            "printed_verdict": self.printed_verdict.value,
            "note": self.note,
            "conditions": [condition.document() for condition in self.conditions],
        }


@dataclass(frozen=True, slots=True)
class ParentCheck:
    """The theorem of a plane under one parent controller, for one setting.

    Parameters
    ----------
    name : str
        The controller's in the labels of the theorems, and in their titles.
    conditions : tuple of Condition
        Of the theorem that fits the swarm.
    derivative : Condition
        That the derivatives of the Lyapunov functions are negative and outweigh the coupling.
    torque : float
        Largest torque that the controller may ask for, N m.
    largest_angle : float
        Largest abs(th_d), rad.
    level, energy : float
        Of S, and V at the start.
    growths : tuple of float
        g_p and g_a of ``V_p >= g_p abs(z_p)^2`` in S, and of ``V_a >= g_a abs(e_a)^2``.
    attraction : mapping
        The estimates of the region of attraction.
    """

    name: str
    conditions: tuple[Condition, ...]
    derivative: Condition
    torque: float
    largest_angle: float
    level: float
    energy: float
    growths: tuple[float, float]
    attraction: Mapping[str, Document]


@dataclass(frozen=True, slots=True)
class Report:
    """Everything that the theory says of a scenario.

    Parameters
    ----------
    scenario, controller, swarm : str
        Its name, its parent controller and the kind of its swarm.
    angle_max : float
        The bound theta_max of the angle that was assumed, rad.
    theorems : tuple of Theorem
        The six of controllers and swarms, and the two general ones.
    beyond : Theorem
        What the paper does not state but a run needs: sampled time and the singularity S3 = 0.
    attraction : mapping
        The estimates of the region of attraction.
    abstract_states : mapping
        How the abstract states lie in the constraint sets.
    notes : tuple of str
        What the theory leaves out of this scenario.
    """

    scenario: str
    controller: str
    swarm: str
    angle_max: float
    theorems: tuple[Theorem, ...]
    beyond: Theorem
    attraction: Mapping[str, Document]
    abstract_states: Mapping[str, Document]
    notes: tuple[str, ...] = ()

    @property
    def failed(self) -> tuple[tuple[Theorem, Condition], ...]:
        """The applicable conditions whose corrected form does not hold."""
        return tuple((theorem, bad) for theorem in (*self.theorems, self.beyond) for bad in theorem.failed)

    @property
    def covered(self) -> bool:
        """Whether a theorem of controller and swarm applies and all applicable conditions hold."""
        return not self.failed and any(theorem.applicable for theorem in self.theorems)

    def document(self) -> Document:
        """Return the report as a JSON document without NaN or infinity."""
        return {
            "scenario": self.scenario,
            "controller": self.controller,
            "swarm": self.swarm,
            "angle_max": self.angle_max,
            "covered": self.covered,
            "failed": [f"{theorem.label}.{condition.name}" for theorem, condition in self.failed],
            "theorems": [theorem.document() for theorem in self.theorems],
            "beyond_the_paper": self.beyond.document(),
            "attraction": dict(self.attraction),
            "abstract_states": dict(self.abstract_states),
            "notes": list(self.notes),
        }


def finite(value: float) -> float | None:
    """Return a number, or None for what JSON cannot hold."""
    return value if isfinite(value) else None


def _number(value: Number) -> Document:
    if isinstance(value, tuple):
        return [finite(one) for one in value]
    return finite(value)
