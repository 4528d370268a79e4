"""Result of a check of the theory: conditions with their numbers, their theorems, and verdicts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import isfinite
from typing import ClassVar, Literal, TypeAlias

Number: TypeAlias = float | tuple[float, ...]
Document: TypeAlias = "dict[str, Document] | list[Document] | str | float | bool | None"


class Verdict(Enum):
    """The result of a check."""

    HOLDS = "holds"
    FAILS = "fails"
    UNKNOWN = "could not be evaluated"
    NOT_APPLICABLE = "not applicable"


class Coverage(Enum):
    """The verdict on a scenario."""

    COVERED = "covered"
    NOT_COVERED = "not covered"
    UNKNOWN = "could not be evaluated"


@dataclass(frozen=True, slots=True)
class Form:
    """A form of a condition, printed or corrected: an inequality between a value and a bound, infinite if missing."""

    text: str
    value: float
    bound: float
    relation: Literal[">", ">=", "<", "<="] = ">"
    unknown: bool = False  # whether it could not be evaluated; then it has no value

    document: ClassVar = ("text", "value", "relation", "bound", "margin", "verdict")

    @property
    def margin(self) -> float:
        """Margin of the inequality; negative if it does not hold, minus infinity if a side does not exist."""
        if not isfinite(self.value) or not isfinite(self.bound):
            return float("-inf")
        return self.value - self.bound if self.relation.startswith(">") else self.bound - self.value

    @property
    def verdict(self) -> Verdict:
        """Whether the inequality holds."""
        if self.unknown:
            return Verdict.UNKNOWN
        holds = self.margin >= 0 if self.relation.endswith("=") else self.margin > 0
        return Verdict.HOLDS if holds else Verdict.FAILS


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition of a theorem: as printed in the paper, if it is, and as corrected, which decides."""

    name: str  # short and stable, such as "k2"
    printed: Form | None
    corrected: Form
    inputs: Mapping[str, Number] = field(default_factory=dict)  # the numbers used, in SI units
    note: str = ""

    document: ClassVar = ("name", "printed", "corrected", "margin", "verdict", "inputs", "note")

    @property
    def margin(self) -> float:
        """Margin of the corrected form."""
        return self.corrected.margin

    @property
    def verdict(self) -> Verdict:
        """Whether the corrected form holds."""
        return self.corrected.verdict


@dataclass(frozen=True, slots=True)
class Theorem:
    """A theorem of the paper, or a group of conditions missing from it, evaluated for a scenario."""

    label: str  # in the paper's source, such as "LQR_SI_sys"
    title: str
    conditions: tuple[Condition, ...] = ()  # none if it does not apply
    note: str = ""  # why it does not apply, or what its proof omits

    document: ClassVar = ("label", "title", "applicable", "verdict", "printed_verdict", "note", "conditions")

    @property
    def applicable(self) -> bool:
        """Whether it applies to this scenario."""
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
        return self.of(Verdict.FAILS)

    def of(self, verdict: Verdict) -> tuple[Condition, ...]:
        """Return the conditions whose corrected form has a verdict."""
        return tuple(condition for condition in self.conditions if condition.verdict is verdict)


@dataclass(frozen=True, slots=True)
class ParentCheck:
    """The theorem for a plane under one parent controller, evaluated for the swarm of a setting."""

    name: str  # of the controller in the labels of the theorems
    conditions: tuple[Condition, ...]
    derivative: Condition  # the derivatives of the Lyapunov functions are negative and outweigh the coupling
    torque: float  # largest torque that the controller may request, N m
    largest_angle: float  # largest |th_d|, rad
    level: float  # of S
    energy: float  # V at the start
    growths: tuple[float, float]  # g_p and g_a of V_p >= g_p |z_p|^2 in S, and of V_a >= g_a |e_a|^2
    attraction: Mapping[str, Number]  # the estimates of the region of attraction


@dataclass(frozen=True, slots=True)
class Loss:
    """The simulated loss of robots: when, and the largest and smallest numbers from then on."""

    robots: tuple[int, ...]
    change: str  # how they are lost, such as "kill"
    time: float  # s
    simulated: float  # time for which the swarm is simulated afterwards, s
    failed: tuple[str, ...]  # names of the conditions that fail
    speed: float  # of a robot, in m/s on the plane, else in scales of its coordinate per s; not of lags
    reach: float  # coordinate of a robot, without its sign
    deviation: float  # of the parent from its reference
    pivot: float  # the smallest scaled pivot of the Gram matrix, on the plane S3/(S0^2 L^2)
    limited: float  # share of the robots' commands that are at a limit
    failure: str = ""  # why the simulation has ended early

    document: ClassVar = (
        *("robots", "change", "time", "simulated", "failed", "speed", "reach", "deviation", "pivot", "limited"),
        "failure",
    )


@dataclass(frozen=True, slots=True)
class Report:
    """The evaluation of the whole theory for a scenario."""

    scenario: str
    controller: str
    swarm: str  # its kind
    angle_max: float | None  # the assumed bound theta_max of the plane's angle, rad
    theorems: tuple[Theorem, ...]  # the six for controllers and swarms, and the two general ones
    beyond: Theorem  # conditions that a run needs beyond the paper: sampled time and the singularity S3 = 0
    attraction: Mapping[str, Document]  # the estimates of the region of attraction
    abstract_states: Mapping[str, Document]  # their location in the constraint sets
    notes: tuple[str, ...]  # properties of this scenario that the theory does not consider
    simulated: tuple[Theorem, ...] = ()  # conditions on simulations, such as of losses of robots
    losses: tuple[Loss, ...] = ()  # the simulated losses, the worst first

    @property
    def groups(self) -> tuple[Theorem, ...]:
        """All theorems and groups of conditions."""
        return (*self.theorems, self.beyond, *self.simulated)

    @property
    def failed(self) -> tuple[tuple[Theorem, Condition], ...]:
        """The applicable conditions whose corrected form does not hold."""
        return self._of(Verdict.FAILS)

    @property
    def unknown(self) -> tuple[tuple[Theorem, Condition], ...]:
        """The conditions that could not be evaluated; their notes tell why."""
        return self._of(Verdict.UNKNOWN)

    def _of(self, verdict: Verdict) -> tuple[tuple[Theorem, Condition], ...]:
        return tuple((theorem, one) for theorem in self.groups for one in theorem.of(verdict))

    @property
    def verdict(self) -> Coverage:
        """Whether a theorem for controller and swarm applies and all applicable conditions hold, if that is known."""
        if self.failed:
            return Coverage.NOT_COVERED
        if self.unknown:
            return Coverage.UNKNOWN
        return Coverage.COVERED if any(theorem.applicable for theorem in self.theorems) else Coverage.NOT_COVERED

    @property
    def covered(self) -> bool:
        """Whether the verdict is that the theory covers the scenario."""
        return self.verdict is Coverage.COVERED

    def document(self) -> Document:
        """Return the report as a JSON document without NaN or infinity."""
        return plain(
            {
                "scenario": self.scenario,
                "controller": self.controller,
                "swarm": self.swarm,
                "angle_max": self.angle_max,
                "verdict": self.verdict.value,
                "covered": self.covered,
                "failed": [f"{theorem.label}.{condition.name}" for theorem, condition in self.failed],
                "not_evaluated": [f"{theorem.label}.{condition.name}" for theorem, condition in self.unknown],
                "theorems": self.theorems,
                "beyond_the_paper": self.beyond,
                "attraction": self.attraction,
                "abstract_states": self.abstract_states,
                "notes": self.notes,
                "simulated": self.simulated,
                "losses": self.losses,
            }
        )


def plain(value: object) -> Document:
    """Return a value in a form that JSON can represent, with None for numbers that are not finite."""
    if isinstance(value, Form | Condition | Theorem | Loss):
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
    verdicts = {form.verdict for form in forms}
    return next(verdict for verdict in (Verdict.FAILS, Verdict.UNKNOWN, Verdict.HOLDS) if verdict in verdicts)
