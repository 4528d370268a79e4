"""Injected faults of robots and their messages, drawn so that every run and every process draws the same."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from hashlib import blake2b
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from swarmabs_core.messages import AgentState

_STATE, _HEARD = "state", "heard"


def fraction(text: str) -> float:
    """Return a draw from [0, 1) that depends on a text alone: 53 of the first 64 bits of its BLAKE2b hash."""
    digest = blake2b(text.encode(), digest_size=8).digest()
    return float((int.from_bytes(digest, "big") >> 11) * 2.0**-53)


def lost(probability: float, seed: int, step: int, agent_id: int) -> bool:
    """Tell whether a robot misses the broadcasts of a step; the draw is that of the text ``seed:step:agent``."""
    return probability > 0.0 and fraction(f"{seed}:{step}:{agent_id}") < probability


def held_back(probability: float, steps: int, seed: int, step: int, agent_id: int) -> int:
    """Return by how many steps, at most `steps`, the broadcasts of a step come late to a robot; mostly 0.

    Whether they do is the draw of ``seed:step:agent:reordering``, by how many that of ``seed:step:agent:late``.
    """
    draw = f"{seed}:{step}:{agent_id}"
    if fraction(f"{draw}:reordering") >= probability:
        return 0
    return 1 + int(fraction(f"{draw}:late") * steps)


def duplicated(probability: float, seed: int, step: int, agent_id: int, what: str) -> bool:
    """Tell whether a robot says its state twice, or hears the broadcasts twice: ``seed:step:agent:what``."""
    return fraction(f"{seed}:{step}:{agent_id}:{what}") < probability


class FaultKind(str, Enum):
    """What is injected into a robot, and what its values are."""

    LOSS = "loss"
    """Probability."""
    DELAY = "delay"
    """Steps."""
    DUPLICATION = "duplication"
    """Probability."""
    REORDERING = "reordering"
    """Probability, most steps."""
    CLOCK_OFFSET = "clock_offset"
    """Offset in s."""
    LIE = "lie"
    """Offset of the position in m, factor of the position, factor of the mass."""


_VALUES = {FaultKind.REORDERING: 2, FaultKind.LIE: 3}


@dataclass(frozen=True, slots=True)
class RobotFault:
    """A fault that acts on a robot in steps ``first`` to ``end - 1``, or to the end of the run."""

    kind: FaultKind
    values: tuple[float, ...]
    first: int = 0
    end: int | None = None

    def acts(self, step: int) -> bool:
        """Tell whether it acts in a step."""
        return self.first <= step and (self.end is None or step < self.end)

    def __str__(self) -> str:
        return " ".join((self.kind.value, str(self.first), str(self.end or -1), *map(repr, self.values)))

    @classmethod
    def parse(cls, text: str) -> RobotFault:
        """Read ``KIND FIRST END VALUE...``, such as ``loss 100 500 0.2``; -1 stands for no end.

        Raises
        ------
        InputError
            If the text is not of this form.
        """
        fault: RobotFault | None
        try:
            name, first, end, *numbers = text.split()
            kind, values = FaultKind(name), tuple(map(float, numbers))
            fault = cls(kind, values, int(first), None if int(end) < 0 else int(end))
        except ValueError:
            fault = None
        if fault is None or len(values) != _VALUES.get(kind, 1) or not all(map(isfinite, values)) or fault.first < 0:
            raise InputError(
                f"fault {text!r} is not of the form 'KIND FIRST END VALUE...', such as 'loss 100 500 0.2', with KIND "
                f"one of {', '.join(kind.value for kind in FaultKind)}"
            )
        return fault

    def told(self) -> Iterator[tuple[float, str]]:
        """Yield value and text of the events that announce it."""
        texts: tuple[tuple[str, float], ...]
        match self.kind:
            case FaultKind.LOSS:
                texts = (("loss of the broadcasts", 0.0),)
            case FaultKind.DELAY:
                texts = (("delay of the broadcasts, steps", 0.0),)
            case FaultKind.DUPLICATION:
                texts = (("duplication of messages", 0.0),)
            case FaultKind.REORDERING:
                texts = ((f"reordering of the broadcasts within {self.values[1]:g} steps", 0.0),)
            case FaultKind.CLOCK_OFFSET:
                texts = (("offset of the clock, s", 0.0),)
            case FaultKind.LIE:
                position = ("false position, m too much", 0.0), ("false position, factor", 1.0)
                texts = (*position, ("false mass, factor", 1.0))
        for value, (text, neutral) in zip(self.values, texts, strict=False):
            if value != neutral:
                yield value, text


class Falsification(NamedTuple):
    """A fault of one robot that falsifies its states."""

    agent_id: int
    fault: RobotFault

    def __str__(self) -> str:
        return f"{self.agent_id} {self.fault}"

    @classmethod
    def parse(cls, text: str) -> Falsification:
        """Read ``AGENT lie FIRST END OFFSET FACTOR FACTOR``.

        Raises
        ------
        InputError
            If the text is not of this form.
        """
        agent_id, _, rest = text.partition(" ")
        fault = RobotFault.parse(rest)
        if not agent_id.isdecimal() or fault.kind is not FaultKind.LIE or 0.0 in fault.values[1:]:
            raise InputError(f"lie {text!r} is not of the form 'AGENT lie FIRST END OFFSET FACTOR FACTOR'")
        return cls(int(agent_id), fault)


def true_state(state: AgentState, lies: Iterable[Falsification]) -> AgentState:
    """Return a robot's state as it is, without what injected faults have made of it.

    The position is divided as it was multiplied, so its last bits are those of the published one and not of the robot's
    own.
    """
    for agent_id, fault in lies:
        if agent_id == state.agent_id and fault.acts(state.step):
            offset, factor, heavier = fault.values
            state = state._replace(position=(state.position - offset) / factor, mass=state.mass / heavier)
    return state


class RobotFaults:
    """All faults of one robot.

    Parameters
    ----------
    faults : iterable of RobotFault
        At most one of a kind acts in a step.
    seed : int
        Seed of what is drawn.
    agent_id : int
        Id of the robot.
    """

    def __init__(self, faults: Iterable[RobotFault], seed: int, agent_id: int) -> None:
        self._faults = tuple(faults)
        self._kinds = frozenset(fault.kind for fault in self._faults)
        self._seed = seed
        self._agent_id = agent_id

    def __bool__(self) -> bool:
        return bool(self._faults)

    def _values(self, kind: FaultKind, step: int) -> tuple[float, ...] | None:
        if kind not in self._kinds:
            return None
        return next((fault.values for fault in self._faults if fault.kind is kind and fault.acts(step)), None)

    def loses(self, step: int) -> bool:
        """Tell whether nothing reaches the robot in a step."""
        values = self._values(FaultKind.LOSS, step)
        return values is not None and lost(values[0], self._seed, step, self._agent_id)

    def late(self, step: int) -> int:
        """Return how many steps later than usual the broadcasts of a step reach the robot."""
        late = 0
        if (values := self._values(FaultKind.DELAY, step)) is not None:
            late += int(values[0])
        if (values := self._values(FaultKind.REORDERING, step)) is not None:
            late += held_back(values[0], int(values[1]), self._seed, step, self._agent_id)
        return late

    def hears_twice(self, step: int) -> bool:
        """Tell whether the broadcasts of a step reach the robot twice."""
        return self._duplicates(step, _HEARD)

    def says_twice(self, step: int) -> bool:
        """Tell whether the robot publishes its state of a step twice."""
        return self._duplicates(step, _STATE)

    def _duplicates(self, step: int, what: str) -> bool:
        values = self._values(FaultKind.DUPLICATION, step)
        return values is not None and duplicated(values[0], self._seed, step, self._agent_id, what)

    def clock_offset(self, step: int) -> int:
        """Return by how much the robot's clock is ahead in a step, ns."""
        values = self._values(FaultKind.CLOCK_OFFSET, step)
        return 0 if values is None else round(Fraction(repr(values[0])) * 10**9)

    def said(self, state: AgentState) -> AgentState:
        """Return what the robot says its state is."""
        values = self._values(FaultKind.LIE, state.step)
        if values is None:
            return state
        offset, factor, heavier = values
        return state._replace(position=state.position * factor + offset, mass=state.mass * heavier)

    def acting(self, step: int) -> Iterator[tuple[float, str]]:
        """Yield value and text of the announcements of all faults that act in a step."""
        for fault in self._faults:
            if fault.acts(step):
                yield from fault.told()

    def changing(self, step: int) -> Iterator[tuple[float, str]]:
        """Yield value and text of the announcements of the faults that begin or, with value 0, end with a step."""
        for fault in self._faults:
            if fault.first == step and fault.acts(step):
                yield from fault.told()
            elif fault.end == step:
                yield from ((0.0, f"over: {text}") for _, text in fault.told())
