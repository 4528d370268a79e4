"""What a check of the theory says: conditions with their numbers, the theorems that they belong to, verdicts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import isfinite
from typing import ClassVar, Literal, TypeAlias

Number: TypeAlias = float | tuple[float, ...]
Document: TypeAlias = "dict[str, Document] | list[Document] | str | float | bool | None"


class Verdict(Enum):
    """What a check comes to."""

    HOLDS = "holds"
    FAILS = "fails"
    NOT_APPLICABLE = "not applicable"


@dataclass(frozen=True, slots=True)
class Form:
    """One form of a condition, printed or corrected: an inequality between a value and a bound, infinite if missing."""

    text: str
    value: float
    bound: float
    relation: Literal[">", ">=", "<", "<="] = ">"

    document: ClassVar = ("text", "value", "relation", "bound", "margin", "verdict")

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


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition of a theorem, as the paper prints it, if it does, and as it has to be, which decides."""

    name: str  # short and stable, such as "k2"
    printed: Form | None
    corrected: Form
    inputs: Mapping[str, Number] = field(default_factory=dict)  # the numbers that went in, in SI units
    note: str = ""

    document: ClassVar = ("name", "printed", "corrected", "margin", "verdict", "inputs", "note")

    @property
    def margin(self) -> float:
        """By how much the corrected form holds."""
        return self.corrected.margin

    @property
    def verdict(self) -> Verdict:
        """Whether the corrected form holds."""
        return self.corrected.verdict


@dataclass(frozen=True, slots=True)
class Theorem:
    """A theorem of the paper, or a group of conditions that it lacks, evaluated for a scenario."""

    label: str  # in the paper's source, such as "LQR_SI_sys"
    title: str
    conditions: tuple[Condition, ...] = ()  # none if it does not apply
    note: str = ""  # why it does not apply, or what its proof leaves out

    document: ClassVar = ("label", "title", "applicable", "verdict", "printed_verdict", "note", "conditions")

    @property
    def applicable(self) -> bool:
        """Whether it is about this scenario."""
        return bool(self.conditions)

    @property
    def verdict(self) -> Verdict:
        """Whether all corrected conditions hold."""
        return _all_hold([condition.corrected for condition in self.conditions])

    @property
    def printed_verdict(self) -> Verdict:
        """Whether all conditions hold as the paper prints them."""
        return _all_hold([condition.printed for condition in self.conditions if condition.printed])

    @property
    def failed(self) -> tuple[Condition, ...]:
        """The conditions whose corrected form does not hold."""
        return tuple(condition for condition in self.conditions if condition.verdict is Verdict.FAILS)


@dataclass(frozen=True, slots=True)
class ParentCheck:
    """The theorem of a plane under one parent controller, evaluated for the swarm of a setting."""

    name: str  # of the controller in the labels of the theorems
    conditions: tuple[Condition, ...]
    derivative: Condition  # the derivatives of the Lyapunov functions are negative and outweigh the coupling
    torque: float  # largest that the controller may ask for, N m
    largest_angle: float  # largest |th_d|, rad
    level: float  # of S
    energy: float  # V at the start
    growths: tuple[float, float]  # g_p and g_a of V_p >= g_p |z_p|^2 in S, and of V_a >= g_a |e_a|^2
    attraction: Mapping[str, Number]  # the estimates of the region of attraction


@dataclass(frozen=True, slots=True)
class Report:
    """Everything that the theory says of a scenario."""

    scenario: str
    controller: str
    swarm: str  # its kind
    angle_max: float  # the bound theta_max of the angle that was assumed, rad
    theorems: tuple[Theorem, ...]  # the six of controllers and swarms, and the two general ones
    beyond: Theorem  # what the paper does not state but a run needs: sampled time and the singularity S3 = 0
    attraction: Mapping[str, Document]  # the estimates of the region of attraction
    abstract_states: Mapping[str, Document]  # how they lie in the constraint sets
    notes: tuple[str, ...]  # what the theory leaves out of this scenario

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
        return plain(
            {
                "scenario": self.scenario,
                "controller": self.controller,
                "swarm": self.swarm,
                "angle_max": self.angle_max,
                "covered": self.covered,
                "failed": [f"{theorem.label}.{condition.name}" for theorem, condition in self.failed],
                "theorems": self.theorems,
                "beyond_the_paper": self.beyond,
                "attraction": self.attraction,
                "abstract_states": self.abstract_states,
                "notes": self.notes,
            }
        )

    def warnings(self) -> Iterator[str]:
        """Yield a line for the theorem of the run if it does not cover it, and one for sampled time."""
        for theorem in self.theorems:
            if theorem.label.endswith("_sys") and (told := _told(theorem)):
                yield f"theorem {theorem.label} is not fulfilled: {told}; see the command check"
        if told := _told(self.beyond):
            yield f"sampled time: {told}; see the command check"


DECIDING = "ks, friction alone"
_FOLLOWING = {"ks, all terms at rest", "initial state"}
"""Conditions that cannot hold if the deciding one does not."""
_SAID_BY_THE_SCENARIO = {"inertia swing", "k1"}
"""Conditions of which `Scenario.warnings` speaks already."""


def _told(theorem: Theorem) -> str:
    """Say which conditions fail that nothing else speaks of."""
    names = {condition.name for condition in theorem.failed}
    silent = _SAID_BY_THE_SCENARIO | (_FOLLOWING if DECIDING in names else set())
    told = []
    for condition in theorem.failed:
        form = condition.corrected
        if condition.name == DECIDING:
            told.append(condition.note)
        elif condition.name not in silent:
            told.append(f"{condition.name}: {form.value:.4g} is not {form.relation} {form.bound:.4g}")
    return "; ".join(told)


def plain(value: object) -> Document:
    """Return a value as JSON can hold it, with None for what is no finite number."""
    if isinstance(value, Form | Condition | Theorem):
        return {name: plain(getattr(value, name)) for name in value.document}
    if isinstance(value, Mapping):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    if isinstance(value, Verdict):
        return value.value
    return None if isinstance(value, float) and not isfinite(value) else value  # type: ignore[return-value]


def _all_hold(forms: list[Form]) -> Verdict:
    if not forms:
        return Verdict.NOT_APPLICABLE
    return Verdict.HOLDS if all(form.verdict is Verdict.HOLDS for form in forms) else Verdict.FAILS
