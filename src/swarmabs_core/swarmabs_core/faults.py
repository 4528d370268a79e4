"""The faults that a scenario can inject, each declared once with its settings and its effect.

The schema of scenarios, the parameters of nodes and the tables of the documentation follow from these classes. Random
draws are reproducible: every run and every process draws the same.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from fractions import Fraction
from hashlib import blake2b
from typing import TYPE_CHECKING, ClassVar, NamedTuple, TypeVar

from swarmabs_core.declaration import LONGEST_TIME, Bounds, setting, setting_of
from swarmabs_core.errors import InputError
from swarmabs_core.membership import ChangeKind
from swarmabs_core.messages import RobotState
from swarmabs_core.parameters import SettingError
from swarmabs_core.plant import STEEPEST
from swarmabs_core.steering import DISTURBANCE, REFERENCE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from swarmabs_core.messages import AnyRobotState

TimeT = TypeVar("TimeT", float, "float | None")
LARGEST_OFFSET = 1e6
"""Largest clock offset, s, that a float represents to the nanosecond."""
SMALLEST_FACTOR, LARGEST_FACTOR = 1e-3, 1e3
"""Range of the factors of a falsified state that can be safely inverted."""
_AT = "time in {unit}; the fault step is the nearest step, round(at/step)"


def fraction(text: str) -> float:
    """Return a draw from [0, 1) that depends only on a string: 53 of the first 64 bits of its BLAKE2b hash."""
    digest = blake2b(text.encode(), digest_size=8).digest()
    return float((int.from_bytes(digest, "big") >> 11) * 2.0**-53)


def _time(
    default: TimeT,
    description: str,
    *,
    name: str | None = None,
    unset: float | None = None,
    null: str = "none",
    required: bool = False,
) -> TimeT:
    bounds: Bounds = {"unit": "s", "minimum": 0.0, "maximum": LONGEST_TIME}
    return setting(default, description, name=name, unset=unset, null=null, required=required, **bounds)


def _probability(description: str) -> float:
    return setting(0.0, description, minimum=0.0, maximum=1.0, required=True)


def _robot() -> int:
    return setting(1, "id of the robot, one of swarm.agents", minimum=1, maximum=65535, required=True)


FAULTS: dict[str, type[Fault]] = {}
"""Every kind of fault."""


@dataclass(frozen=True)
class Fault:
    """A fault that a scenario injects.

    Each kind is a subclass with a `kind`, its name in scenarios, and a short `description`.
    """

    kind: ClassVar[str]
    description: ClassVar[str]
    when: ClassVar[tuple[str, str]] = "at", "until"
    """Names of its start and end times in a scenario."""

    @property
    def at(self) -> float | None:
        """Start time, s; None: not planned."""
        raise NotImplementedError

    @property
    def until(self) -> float | None:
        """End time, s; None: never."""
        return None

    def __post_init__(self) -> None:
        """Reject an end before the start."""
        if self.until is not None and self.at is not None and self.until <= self.at:
            problem = f"the fault ends at {self.until!r} s, before it begins"
            raise SettingError("", problem, f"use '{self.when[1]}' with a time after {self.at!r} s")

    def __init_subclass__(cls, **words: str) -> None:
        """Register a kind of fault."""
        for name, text in words.items():
            setattr(cls, name, text)
        if "kind" in words:
            FAULTS[cls.kind] = cls


@dataclass(frozen=True)
class MembershipFault(Fault):
    """Ends the participation of a robot, or lets it join, at one step."""

    at: float | None = _time(0.0, _AT, required=True)
    agent: int = _robot()


@dataclass(frozen=True)
class KillFault(MembershipFault, kind=ChangeKind.KILL.value, description="the process dies, the robot stands still"):
    """The robot's process dies; the robot stands still where it is, its weight stays on the plane."""


@dataclass(frozen=True)
class LeaveFault(MembershipFault, kind=ChangeKind.LEAVE.value, description="the robot leaves the plane"):
    """The robot announces that it leaves; from the next step its weight is gone."""


@dataclass(frozen=True)
class RemoveFault(MembershipFault, kind=ChangeKind.REMOVE.value, description="the robot is removed from the plane"):
    """The robot is removed from the plane without notice; from the next step its weight is gone."""


@dataclass(frozen=True)
class JoinFault(
    MembershipFault, kind=ChangeKind.JOIN.value, description="the robot appears on the plane at its initial position"
):
    """The robot, listed under ``swarm.agents``, is absent before the fault step."""

    at: float | None = _time(None, _AT, unset=-1.0, null="only when steering adds it", required=True)


@dataclass(frozen=True)
class FreezeFault(
    MembershipFault, kind=ChangeKind.FREEZE.value, description="the process is stopped, the robot stands still"
):
    """The robot's process is stopped (SIGSTOP); the robot stands still where it is."""


@dataclass(frozen=True)
class SettingFault(Fault):
    """Sets a number, the field named by `sets`, for the whole run from a step until it is set again."""

    sets: ClassVar[str]

    at: float = _time(0.0, "start time in {unit}, rounded to the nearest step", required=True)
    until: float | None = _time(
        None, "time in {unit} at which the value returns to 0", unset=-1.0, null="when it is set again, or never"
    )

    @property
    def value(self) -> float:
        """The number that is set."""
        return float(getattr(self, self.sets))


@dataclass(frozen=True)
class ReferenceFault(SettingFault, kind=REFERENCE, description="the reference is offset", sets="offset"):
    """Adds an offset to the parent controller's reference."""

    offset: float = setting(
        0.0,
        "offset added to the parent controller's reference",
        unit="rad",
        above=-STEEPEST,
        below=STEEPEST,
        required=True,
    )


@dataclass(frozen=True)
class SystemReferenceFault(ReferenceFault):
    """Adds an offset to the reference on a parent system other than the plane, where it need not be an angle."""

    offset: float = setting(0.0, "offset added to each quantity of the reference, in its unit", required=True)


@dataclass(frozen=True)
class DisturbanceFault(
    SettingFault, kind=DISTURBANCE, description="a constant torque disturbs the plane", sets="torque"
):
    """A constant torque disturbs the plane, in addition to ``plane.disturbance`` and with its sign."""

    torque: float = setting(
        0.0, "torque, {unit}; a positive one turns the plane to smaller angles", unit="N m", required=True
    )


@dataclass(frozen=True)
class RobotFault(Fault):
    """Acts on robots and their messages for some time.

    Each kind overrides the methods for its effect; `draw` is a string that differs for each robot and step.
    """

    announcement: ClassVar[str]

    when: ClassVar[tuple[str, str]] = "from", "to"

    at: float = _time(0.0, "start time in {unit}, rounded to the nearest step", name="from")
    until: float | None = _time(
        None, "end time in {unit}, rounded to the nearest step", name="to", unset=-1.0, null="end of the run"
    )

    def hits(self, agent_id: int) -> bool:
        """Return whether it affects a robot."""
        raise NotImplementedError

    def announced(self) -> tuple[tuple[float, str], ...]:
        """Return value and text of the events that announce it: its first setting, unless 0, and the text."""
        value = float(next(iter(self.effect().values()), 1.0))
        return ((value, self.announcement.format(self)),) if value else ()

    def loses(self, draw: str) -> bool:  # noqa: ARG002
        """Return whether nothing reaches the robot in a step."""
        return False

    def late(self, draw: str) -> int:  # noqa: ARG002
        """Return the delay, in steps, with which the broadcasts of a step reach the robot."""
        return 0

    def sticks(self) -> bool:
        """Return whether the robot reports its last state."""
        return False

    def doubles(self, draw: str) -> bool:  # noqa: ARG002
        """Return whether messages to or from the robot are duplicated in a step."""
        return False

    def clock_offset(self) -> int:
        """Return how far the robot's clock is ahead, ns."""
        return 0

    def falsified(self, state: AnyRobotState) -> AnyRobotState:
        """Return the state that the robot publishes."""
        return state

    def effect(self) -> dict[str, float]:
        """Return the settings specific to its kind, which define its effect regardless of times and robots."""
        return {name: getattr(self, name) for name in _own_settings(type(self))}


def _own_settings(kind: type[RobotFault]) -> list[str]:
    return [field.name for field in fields(kind) if field.name not in {"at", "until", "agent", "agents"}]


@dataclass(frozen=True)
class MessageFault(RobotFault):
    """Acts on the messages to and from robots."""

    agents: tuple[int, ...] | None = setting(
        None, "ids of the robots that it affects", unset=(), null="all", item=1, minimum=1, maximum=65535
    )

    def __post_init__(self) -> None:
        """Reject an end before the start, an empty list of robots, and duplicates in it."""
        Fault.__post_init__(self)
        if self.agents is not None and not self.agents:
            raise SettingError("agents", "no robots are listed", "list at least one, or omit 'agents' for all")
        if self.agents is not None and len(set(self.agents)) < len(self.agents):
            twice = next(agent for agent in self.agents if self.agents.count(agent) > 1)
            raise SettingError("agents", f"robot {twice} is listed twice", "list each robot once")

    def hits(self, agent_id: int) -> bool:
        """Return whether it affects a robot."""
        return self.agents is None or agent_id in self.agents


@dataclass(frozen=True)
class LossFault(
    MessageFault,
    kind="loss",
    description="robots miss broadcasts at random",
    announcement="loss of the broadcasts",
):
    """Robots miss broadcasts at random and keep their previous command."""

    probability: float = _probability("probability of a loss, for each robot and step")

    def loses(self, draw: str) -> bool:
        """Draw whether the broadcasts are lost."""
        return fraction(draw) < self.probability


@dataclass(frozen=True)
class DelayFault(
    MessageFault,
    kind="delay",
    description="robots use earlier broadcasts",
    announcement="delay of the broadcasts, steps",
):
    """Robots act on broadcasts that are some steps old; until the first ones arrive, their command is 0."""

    steps: int = setting(0, "age of the broadcasts", unit="steps", minimum=0, below=2**31, required=True)

    def late(self, draw: str) -> int:  # noqa: ARG002
        """Return the age of the broadcasts."""
        return self.steps


@dataclass(frozen=True)
class DuplicationFault(
    MessageFault,
    kind="duplication",
    description="messages are duplicated at random",
    announcement="duplication of messages",
):
    """Robots receive broadcasts twice and publish their state twice, at random."""

    probability: float = _probability(
        "probability that a robot receives the broadcasts of a step twice, and that it publishes its state twice"
    )

    def doubles(self, draw: str) -> bool:
        """Draw whether messages are duplicated."""
        return fraction(draw) < self.probability


@dataclass(frozen=True)
class ReorderingFault(
    MessageFault,
    kind="reordering",
    description="broadcasts arrive out of order at random",
    announcement="reordering of the broadcasts within {0.steps:g} steps",
):
    """Broadcasts arrive out of order, at random; a robot acts on the newest that it has received."""

    probability: float = _probability("probability that broadcasts are late, for each robot and step")
    steps: int = setting(1, "largest delay", unit="steps", minimum=1, below=2**31)

    def late(self, draw: str) -> int:
        """Draw whether the broadcasts are late, and by how many steps."""
        if fraction(f"{draw}:reordering") >= self.probability:
            return 0
        return 1 + int(fraction(f"{draw}:late") * self.steps)


@dataclass(frozen=True)
class SingleRobotFault(RobotFault):
    """Acts on one robot."""

    agent: int = _robot()

    def hits(self, agent_id: int) -> bool:
        """Return whether it affects a robot."""
        return self.agent == agent_id


@dataclass(frozen=True)
class ClockOffsetFault(
    SingleRobotFault,
    kind="clock_offset",
    description="the robot's time stamps are wrong",
    announcement="offset of the clock, s",
):
    """The clock of a robot is wrong, and with it the time stamps of its states and events."""

    offset: float = setting(
        0.0,
        "how far its clock is ahead",
        unit="s",
        minimum=-LARGEST_OFFSET,
        maximum=LARGEST_OFFSET,
        whole_nanoseconds=True,
        required=True,
    )

    def clock_offset(self) -> int:
        """Return the offset, ns."""
        return round(Fraction(repr(self.offset)) * 10**9)


@dataclass(frozen=True)
class FalsifiedStateFault(SingleRobotFault, kind="lie", description="the robot reports a false position or mass"):
    """A robot reports a false position or mass; the plane moves under the true ones."""

    position_offset: float = setting(0.0, "offset added to its position", unit="m")
    position_factor: float = setting(
        1.0,
        "factor of its position, applied before the offset; not 0",
        minimum=-LARGEST_FACTOR,
        maximum=LARGEST_FACTOR,
    )
    mass_factor: float = setting(1.0, "factor of its mass", above=0.0, maximum=LARGEST_FACTOR)

    def __post_init__(self) -> None:
        """Reject an end before the start, a state that is not falsified, and a factor that cannot be inverted."""
        Fault.__post_init__(self)
        if abs(self.position_factor) < SMALLEST_FACTOR:
            raise SettingError(
                "position_factor",
                f"{self.position_factor!r} cannot be inverted",
                f"give a number of at least {SMALLEST_FACTOR!r} in magnitude",
            )
        if (self.position_offset, self.position_factor, self.mass_factor) == (0.0, 1.0, 1.0):
            raise SettingError(
                "", "the fault falsifies nothing", "set 'position_offset', 'position_factor' or 'mass_factor'"
            )

    def announced(self) -> tuple[tuple[float, str], ...]:
        """Announce each falsified value."""
        told = (
            (self.position_offset, 0.0, "false position, m too much"),
            (self.position_factor, 1.0, "false position, factor"),
            (self.mass_factor, 1.0, "false mass, factor"),
        )
        return tuple((value, text) for value, true, text in told if value != true)

    def falsified(self, state: AnyRobotState) -> AnyRobotState:
        """Falsify position and mass; on another parent system than the plane, the coordinates."""
        if isinstance(state, RobotState):
            false = tuple(x * self.position_factor + self.position_offset for x in state.coordinates)
            return state._replace(coordinates=false)
        position = state.position * self.position_factor + self.position_offset
        return state._replace(position=position, mass=state.mass * self.mass_factor)

    def true_state(self, state: AnyRobotState) -> AnyRobotState:
        """Return the true state for a falsified one.

        The position is recomputed from the published one, so its last bits may differ from the robot's own.
        """
        if isinstance(state, RobotState):
            true = tuple((x - self.position_offset) / self.position_factor for x in state.coordinates)
            return state._replace(coordinates=true)
        position = (state.position - self.position_offset) / self.position_factor
        return state._replace(position=position, mass=state.mass / self.mass_factor)


@dataclass(frozen=True)
class DriveFailureFault(
    SingleRobotFault,
    kind="drive_failure",
    description="the robot's drive fails, and nobody knows",
    announcement="failure of the drive",
):
    """The drive of a robot gets no command any more, such as a failed rotor; the robot reports its last state.

    A single integrator stands still, a double integrator coasts, and a lag decays, also after others have noticed it.
    """

    def sticks(self) -> bool:
        """Return that its state does not change."""
        return True


_ROBOT_FAULTS = {name: fault for name, fault in FAULTS.items() if issubclass(fault, RobotFault)}


@dataclass(frozen=True, slots=True)
class InjectedFault:
    """A fault that acts on a robot in steps ``first`` to ``end - 1``, or to the end of the run.

    Parameters
    ----------
    fault : RobotFault
        Its effect; times and robots have their defaults.
    """

    fault: RobotFault
    first: int = 0
    end: int | None = None

    @classmethod
    def of(cls, fault: RobotFault, first: int, end: int | None) -> InjectedFault:
        """Return a fault of a scenario as it acts on each affected robot."""
        return cls(type(fault)(**fault.effect()), first, end)

    def acts(self, step: int) -> bool:
        """Return whether it acts in a step."""
        return self.first <= step and (self.end is None or step < self.end)

    def __str__(self) -> str:
        values = (repr(float(value)) for value in self.fault.effect().values())
        return " ".join((self.fault.kind, str(self.first), str(self.end or -1), *values))

    @classmethod
    def parse(cls, text: str) -> InjectedFault:
        """Read ``KIND FIRST END VALUE...``, such as ``loss 100 500 0.2``; an END of -1 means no end.

        Raises
        ------
        InputError
            If the text is not of this form.
        """
        try:
            name, first, end, *numbers = text.split()
            kind = _ROBOT_FAULTS[name]
            effect = {}
            for setting_name, number in zip(_own_settings(kind), numbers, strict=True):
                parameter = setting_of(kind, setting_name).parameter
                effect[setting_name] = parameter.check(type(parameter.default)(float(number)))  # type: ignore[arg-type]
            fault: Callable[..., RobotFault] = kind
            injected = cls(fault(**effect), int(first), None if int(end) < 0 else int(end))
            if injected.first >= 0:
                return injected
        except (KeyError, ValueError, OverflowError, InputError):
            pass
        raise InputError(
            f"fault {text!r} is not of the form 'KIND FIRST END VALUE...', such as 'loss 100 500 0.2', with KIND "
            f"one of {', '.join(_ROBOT_FAULTS)}"
        )


PARENT_FAULTS = (FalsifiedStateFault, DriveFailureFault)
"""Faults of a robot that the simulated parent must know."""


class Falsification(NamedTuple):
    """A fault by which the states of one robot differ from its effect on the parent."""

    agent_id: int
    injected: InjectedFault

    def __str__(self) -> str:
        return f"{self.agent_id} {self.injected}"

    @classmethod
    def parse(cls, text: str) -> Falsification:
        """Read ``AGENT lie FIRST END OFFSET FACTOR FACTOR`` or ``AGENT drive_failure FIRST END``.

        Raises
        ------
        InputError
            If the text is not of this form.
        """
        agent_id, _, rest = text.partition(" ")
        injected = InjectedFault.parse(rest)
        if not agent_id.isdecimal() or not isinstance(injected.fault, PARENT_FAULTS):
            raise InputError(f"falsification {text!r} is not of the form 'AGENT lie FIRST END OFFSET FACTOR FACTOR'")
        return cls(int(agent_id), injected)


def failed_drives(falsifications: Iterable[Falsification], step: int) -> set[int]:
    """Return the robots whose drives get no command in the period that begins at a step."""
    return {
        agent_id
        for agent_id, injected in falsifications
        if isinstance(injected.fault, DriveFailureFault) and injected.acts(step)
    }


def true_state(state: AnyRobotState, falsifications: Iterable[Falsification]) -> AnyRobotState:
    """Return a robot's true state, with injected falsifications undone."""
    for agent_id, injected in falsifications:
        if agent_id == state.agent_id and injected.acts(state.step) and isinstance(injected.fault, FalsifiedStateFault):
            state = injected.fault.true_state(state)
    return state


class RobotFaults:
    """All faults of one robot.

    Parameters
    ----------
    faults : iterable of InjectedFault
        At most one of a kind acts in a step.
    seed : int
        Seed of the draws.
    agent_id : int
        Id of the robot.
    """

    def __init__(self, faults: Iterable[InjectedFault], seed: int, agent_id: int) -> None:
        self._faults = tuple(faults)
        self._seed = seed
        self._agent_id = agent_id

    def acting(self, step: int) -> list[RobotFault]:
        """Return the faults that act in a step."""
        return [injected.fault for injected in self._faults if injected.acts(step)]

    def draw(self, step: int) -> str:
        """Return the string from which everything random in a step is drawn."""
        return f"{self._seed}:{step}:{self._agent_id}"

    def double(self, step: int, what: str) -> bool:
        """Return whether `what`, the robot's ``state`` or the broadcasts ``heard``, is duplicated in a step."""
        return any(fault.doubles(f"{self.draw(step)}:{what}") for fault in self.acting(step))

    def announced(self, step: int, *, first: bool) -> Iterator[tuple[float, str]]:
        """Yield value and text of the events of faults that start or, with value 0, end in a step.

        In the robot's `first` step, every fault that acts is announced.
        """
        for injected in self._faults:
            if injected.acts(step) and (first or injected.first == step):
                yield from injected.fault.announced()
            elif injected.end == step and not first:
                yield from ((0.0, f"over: {text}") for _, text in injected.fault.announced())
