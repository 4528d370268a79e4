"""The faults that a scenario can inject; each kind is declared once, with its settings and with what it does.

The schema of scenarios, the parameters of nodes and the tables of the documentation follow from these classes. What is
random is drawn so that every run and every process draws the same.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from fractions import Fraction
from hashlib import blake2b
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from swarmabs_core.declaration import LONGEST_TIME, setting, setting_of
from swarmabs_core.errors import InputError
from swarmabs_core.membership import ChangeKind
from swarmabs_core.parameters import SettingError
from swarmabs_core.plant import STEEPEST
from swarmabs_core.steering import DISTURBANCE, REFERENCE

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from swarmabs_core.messages import AgentState

LARGEST_OFFSET = 1e6
"""Largest offset of a clock, s: nanoseconds of it are exact in a float."""
SMALLEST_FACTOR, LARGEST_FACTOR = 1e-3, 1e3
"""Factors of a lie between which it can be undone without harm."""
_AT = "time in s; the fault step is the nearest step, round(at/step)"


def fraction(text: str) -> float:
    """Return a draw from [0, 1) that depends on a text alone: 53 of the first 64 bits of its BLAKE2b hash."""
    digest = blake2b(text.encode(), digest_size=8).digest()
    return float((int.from_bytes(digest, "big") >> 11) * 2.0**-53)


def _time(default: float | None, description: str, **more: Any) -> Any:
    return setting(default, description, minimum=0.0, maximum=LONGEST_TIME, **more)


def _probability(description: str) -> Any:
    return setting(0.0, description, minimum=0.0, maximum=1.0, required=True)


def _robot() -> Any:
    return setting(1, "id of the robot, one of swarm.agents", minimum=1, maximum=65535, required=True)


FAULTS: dict[str, type[Fault]] = {}
"""Every kind of fault."""


@dataclass(frozen=True)
class Fault:
    """What a scenario injects.

    A kind is a subclass with a `kind`, the name by which a scenario chooses it, and a `description` in a few words.
    """

    kind: ClassVar[str]
    description: ClassVar[str]
    when: ClassVar[tuple[str, str]] = "at", "until"
    """Names of its times in a scenario."""

    @property
    def at(self) -> float | None:
        """Time at which it begins, s; None: not planned."""
        raise NotImplementedError

    @property
    def until(self) -> float | None:
        """Time at which it ends, s; None: never."""
        return None

    def __post_init__(self) -> None:
        """Refuse an end before the beginning."""
        if self.until is not None and self.at is not None and self.until <= self.at:
            problem = f"the fault ends at {self.until!r} s, before it begins"
            raise SettingError("", problem, f"use '{self.when[1]}' with a time after {self.at!r} s")

    def __init_subclass__(cls, **words: str) -> None:
        """Note a kind of fault."""
        for name, text in words.items():
            setattr(cls, name, text)
        if "kind" in words:
            FAULTS[cls.kind] = cls


@dataclass(frozen=True)
class MembershipFault(Fault):
    """Ends a robot, or lets it join, at one step."""

    at: float | None = _time(0.0, _AT, required=True)
    agent: int = _robot()


@dataclass(frozen=True)
class KillFault(MembershipFault, kind=ChangeKind.KILL.value, description="the process dies, the robot stands still"):
    """The robot's process dies; the robot stands still where it is, its weight stays on the plane."""


@dataclass(frozen=True)
class LeaveFault(MembershipFault, kind=ChangeKind.LEAVE.value, description="the robot leaves the plane"):
    """The robot says that it leaves; from the next step its weight is gone."""


@dataclass(frozen=True)
class RemoveFault(MembershipFault, kind=ChangeKind.REMOVE.value, description="the robot is taken off the plane"):
    """The robot is taken off the plane without being asked; from the next step its weight is gone."""


@dataclass(frozen=True)
class JoinFault(
    MembershipFault, kind=ChangeKind.JOIN.value, description="the robot appears on the plane at its initial position"
):
    """The robot, listed under ``swarm.agents``, is not there before the fault step."""

    at: float | None = _time(
        None, _AT, unset=-1.0, null="only when it is added to a run that is steered", required=True
    )


@dataclass(frozen=True)
class FreezeFault(
    MembershipFault, kind=ChangeKind.FREEZE.value, description="the process is stopped, the robot stands still"
):
    """The robot's process is stopped (SIGSTOP); the robot stands still where it is."""


@dataclass(frozen=True)
class SettingFault(Fault):
    """Sets a number, the field `sets`, for the whole run at a step, until it is set again."""

    sets: ClassVar[str]

    at: float = _time(0.0, "time in s from which on it holds; the nearest step counts", required=True)
    until: float | None = _time(
        None, "time in s from which on it is 0 again", unset=-1.0, null="when it is set again, or never"
    )

    @property
    def value(self) -> float:
        """What is set."""
        return float(getattr(self, self.sets))


@dataclass(frozen=True)
class ReferenceFault(SettingFault, kind=REFERENCE, description="the angle wanted is offset", sets="offset"):
    """The angle wanted is above the parent controller's reference by an offset."""

    offset: float = setting(
        0.0,
        "what is added to the parent controller's reference, rad",
        above=-STEEPEST,
        below=STEEPEST,
        required=True,
    )


@dataclass(frozen=True)
class DisturbanceFault(
    SettingFault, kind=DISTURBANCE, description="a constant torque disturbs the plane", sets="torque"
):
    """A constant torque disturbs the plane, besides ``plane.disturbance`` and with its sign."""

    torque: float = setting(0.0, "torque, N m; a positive one turns the plane to smaller angles", required=True)


@dataclass(frozen=True)
class RobotFault(Fault):
    """Acts on robots and their messages for a while.

    A kind overrides what it does; a draw is a text that differs from robot to robot and from step to step.
    """

    announcement: ClassVar[str]

    when: ClassVar[tuple[str, str]] = "from", "to"

    at: float = _time(0.0, "time in s from which on it acts; the nearest step counts", name="from")
    until: float | None = _time(
        None, "time in s from which on it acts no more", name="to", unset=-1.0, null="to the end"
    )

    def hits(self, agent_id: int) -> bool:
        """Tell whether it is injected into a robot."""
        raise NotImplementedError

    def announced(self) -> tuple[tuple[float, str], ...]:
        """Return value and text of the events that announce it: its first setting, if it is not 0, and the text."""
        value = float(next(iter(self.effect().values()), 1.0))
        return ((value, self.announcement.format(self)),) if value else ()

    def loses(self, draw: str) -> bool:  # noqa: ARG002
        """Tell whether nothing reaches the robot in a step."""
        return False

    def late(self, draw: str) -> int:  # noqa: ARG002
        """Return how many steps later than usual the broadcasts of a step reach the robot."""
        return 0

    def doubles(self, draw: str) -> bool:  # noqa: ARG002
        """Tell whether what a robot says, or hears, in a step comes twice."""
        return False

    def clock_offset(self) -> int:
        """Return by how much the robot's clock is ahead, ns."""
        return 0

    def falsified(self, state: AgentState) -> AgentState:
        """Return what the robot says its state is."""
        return state

    def effect(self) -> dict[str, float]:
        """Return what says how it acts, whenever and on whomever: the settings that only its kind has."""
        return {name: getattr(self, name) for name in _own_settings(type(self))}


def _own_settings(kind: type[RobotFault]) -> list[str]:
    return [field.name for field in fields(kind) if field.name not in {"at", "until", "agent", "agents"}]


@dataclass(frozen=True)
class MessageFault(RobotFault):
    """Acts on what robots hear and say."""

    agents: tuple[int, ...] | None = setting(
        None, "ids of the robots that it hits", unset=(), null="all", item=1, minimum=1, maximum=65535
    )

    def __post_init__(self) -> None:
        """Refuse an end before the beginning, and robots that are named twice."""
        Fault.__post_init__(self)
        if self.agents is not None and not self.agents:
            raise SettingError("agents", "no robots are named", "name some, or leave out 'agents' for all")
        if self.agents is not None and len(set(self.agents)) < len(self.agents):
            twice = next(agent for agent in self.agents if self.agents.count(agent) > 1)
            raise SettingError("agents", f"robot {twice} is named twice", "name each robot once")

    def hits(self, agent_id: int) -> bool:
        """Tell whether it is injected into a robot."""
        return self.agents is None or agent_id in self.agents


@dataclass(frozen=True)
class LossFault(
    MessageFault,
    kind="loss",
    description="robots keep their previous command at random",
    announcement="loss of the broadcasts",
):
    """Robots miss broadcasts at random and keep their previous command."""

    probability: float = _probability("probability of a loss, for each robot and step")

    def loses(self, draw: str) -> bool:
        """Draw it."""
        return fraction(draw) < self.probability


@dataclass(frozen=True)
class DelayFault(
    MessageFault,
    kind="delay",
    description="robots use earlier broadcasts",
    announcement="delay of the broadcasts, steps",
):
    """Robots compute with broadcasts that are some steps old; their command is 0 until there are any."""

    steps: int = setting(0, "age of the broadcasts, steps", minimum=0, below=2**31, required=True)

    def late(self, draw: str) -> int:  # noqa: ARG002
        """Return the age."""
        return self.steps


@dataclass(frozen=True)
class DuplicationFault(
    MessageFault,
    kind="duplication",
    description="messages come twice at random",
    announcement="duplication of messages",
):
    """Robots hear broadcasts twice and say their state twice, at random."""

    probability: float = _probability(
        "probability that a robot hears the broadcasts of a step twice, and that it says its state twice"
    )

    def doubles(self, draw: str) -> bool:
        """Draw it."""
        return fraction(draw) < self.probability


@dataclass(frozen=True)
class ReorderingFault(
    MessageFault,
    kind="reordering",
    description="broadcasts come after later ones at random",
    announcement="reordering of the broadcasts within {0.steps:g} steps",
):
    """Broadcasts reach robots after later ones, at random; a robot acts on the newest that it has."""

    probability: float = _probability("probability that broadcasts come late, for each robot and step")
    steps: int = setting(1, "most steps by which they come late", minimum=1, below=2**31)

    def late(self, draw: str) -> int:
        """Draw whether they come late, and by how many steps."""
        if fraction(f"{draw}:reordering") >= self.probability:
            return 0
        return 1 + int(fraction(f"{draw}:late") * self.steps)


@dataclass(frozen=True)
class SingleRobotFault(RobotFault):
    """Acts on one robot."""

    agent: int = _robot()

    def hits(self, agent_id: int) -> bool:
        """Tell whether it is injected into a robot."""
        return self.agent == agent_id


@dataclass(frozen=True)
class ClockOffsetFault(
    SingleRobotFault,
    kind="clock_offset",
    description="the robot's stamps are off",
    announcement="offset of the clock, s",
):
    """The clock of a robot is wrong: the stamps of its states and events are off."""

    offset: float = setting(
        0.0,
        "by how much its clock is ahead, s",
        minimum=-LARGEST_OFFSET,
        maximum=LARGEST_OFFSET,
        whole_nanoseconds=True,
        required=True,
    )

    def clock_offset(self) -> int:
        """Return the offset, ns."""
        return round(Fraction(repr(self.offset)) * 10**9)


@dataclass(frozen=True)
class LieFault(SingleRobotFault, kind="lie", description="the robot says a false position or mass"):
    """A robot says a false position or mass; the plane feels the true ones."""

    position_offset: float = setting(0.0, "what it adds to its position, m")
    position_factor: float = setting(
        1.0, "by what it multiplies its position before; not 0", minimum=-LARGEST_FACTOR, maximum=LARGEST_FACTOR
    )
    mass_factor: float = setting(1.0, "by what it multiplies its mass", above=0.0, maximum=LARGEST_FACTOR)

    def __post_init__(self) -> None:
        """Refuse an end before the beginning, a lie that is true, and one that cannot be undone."""
        Fault.__post_init__(self)
        if abs(self.position_factor) < SMALLEST_FACTOR:
            raise SettingError(
                "position_factor",
                f"{self.position_factor!r} cannot be undone",
                f"give a number of at least {SMALLEST_FACTOR!r} in magnitude",
            )
        if (self.position_offset, self.position_factor, self.mass_factor) == (0.0, 1.0, 1.0):
            raise SettingError(
                "", "this robot tells the truth", "give 'position_offset', 'position_factor' or 'mass_factor'"
            )

    def announced(self) -> tuple[tuple[float, str], ...]:
        """Announce what is false."""
        told = (
            (self.position_offset, 0.0, "false position, m too much"),
            (self.position_factor, 1.0, "false position, factor"),
            (self.mass_factor, 1.0, "false mass, factor"),
        )
        return tuple((value, text) for value, true, text in told if value != true)

    def falsified(self, state: AgentState) -> AgentState:
        """Falsify position and mass."""
        position = state.position * self.position_factor + self.position_offset
        return state._replace(position=position, mass=state.mass * self.mass_factor)

    def true_state(self, state: AgentState) -> AgentState:
        """Return the state of which a falsified one was made.

        The position is divided as it was multiplied, so its last bits are those of the published one and not of the
        robot's own.
        """
        position = (state.position - self.position_offset) / self.position_factor
        return state._replace(position=position, mass=state.mass / self.mass_factor)


_ROBOT_FAULTS = {kind: each for kind, each in FAULTS.items() if issubclass(each, RobotFault)}


@dataclass(frozen=True, slots=True)
class InjectedFault:
    """A fault that acts on a robot in steps ``first`` to ``end - 1``, or to the end of the run.

    Parameters
    ----------
    fault : RobotFault
        How it acts; it has the defaults where it says when and on whom.
    """

    fault: RobotFault
    first: int = 0
    end: int | None = None

    @classmethod
    def of(cls, fault: RobotFault, first: int, end: int | None) -> InjectedFault:
        """Return a fault of a scenario as it acts on each robot that it hits."""
        return cls(type(fault)(**fault.effect()), first, end)

    def acts(self, step: int) -> bool:
        """Tell whether it acts in a step."""
        return self.first <= step and (self.end is None or step < self.end)

    def __str__(self) -> str:
        values = (repr(float(value)) for value in self.fault.effect().values())
        return " ".join((self.fault.kind, str(self.first), str(self.end or -1), *values))

    @classmethod
    def parse(cls, text: str) -> InjectedFault:
        """Read ``KIND FIRST END VALUE...``, such as ``loss 100 500 0.2``; -1 stands for no end.

        Raises
        ------
        InputError
            If the text is not of this form.
        """
        try:
            name, first, end, *numbers = text.split()
            kind = _ROBOT_FAULTS[name]
            effect = dict[str, Any]()
            for setting_name, number in zip(_own_settings(kind), numbers, strict=True):
                parameter = setting_of(kind, setting_name).parameter
                effect[setting_name] = parameter.check(type(parameter.default)(float(number)))  # type: ignore[arg-type]
            found = cls(kind(**effect), int(first), None if int(end) < 0 else int(end))
            if found.first >= 0:
                return found
        except (KeyError, ValueError, OverflowError, InputError):
            pass
        raise InputError(
            f"fault {text!r} is not of the form 'KIND FIRST END VALUE...', such as 'loss 100 500 0.2', with KIND "
            f"one of {', '.join(_ROBOT_FAULTS)}"
        )


class Falsification(NamedTuple):
    """A lie of one robot."""

    agent_id: int
    injected: InjectedFault

    def __str__(self) -> str:
        return f"{self.agent_id} {self.injected}"

    @classmethod
    def parse(cls, text: str) -> Falsification:
        """Read ``AGENT lie FIRST END OFFSET FACTOR FACTOR``.

        Raises
        ------
        InputError
            If the text is not of this form.
        """
        agent_id, _, rest = text.partition(" ")
        injected = InjectedFault.parse(rest)
        if not agent_id.isdecimal() or not isinstance(injected.fault, LieFault):
            raise InputError(f"lie {text!r} is not of the form 'AGENT lie FIRST END OFFSET FACTOR FACTOR'")
        return cls(int(agent_id), injected)


def true_state(state: AgentState, lies: Iterable[Falsification]) -> AgentState:
    """Return a robot's state as it is, without what injected faults have made of it."""
    for agent_id, injected in lies:
        if agent_id == state.agent_id and injected.acts(state.step) and isinstance(injected.fault, LieFault):
            state = injected.fault.true_state(state)
    return state


class RobotFaults:
    """All faults of one robot.

    Parameters
    ----------
    faults : iterable of InjectedFault
        At most one of a kind acts in a step.
    seed : int
        Seed of what is drawn.
    agent_id : int
        Id of the robot.
    """

    def __init__(self, faults: Iterable[InjectedFault], seed: int, agent_id: int) -> None:
        self._faults = tuple(faults)
        self._seed = seed
        self._agent_id = agent_id

    def acting(self, step: int) -> list[RobotFault]:
        """Return the faults that act in a step."""
        return [each.fault for each in self._faults if each.acts(step)]

    def draw(self, step: int) -> str:
        """Return the text of which everything that is random in a step is drawn."""
        return f"{self._seed}:{step}:{self._agent_id}"

    def double(self, step: int, what: str) -> bool:
        """Tell whether the robot's ``state`` of a step is published twice, or what is ``heard`` in it comes twice."""
        return any(fault.doubles(f"{self.draw(step)}:{what}") for fault in self.acting(step))

    def announced(self, step: int, *, first: bool) -> Iterator[tuple[float, str]]:
        """Yield value and text of the events of a step: of the faults that begin or, with value 0, end with it.

        In the robot's `first` step that is all that act.
        """
        for each in self._faults:
            if each.acts(step) and (first or each.first == step):
                yield from each.fault.announced()
            elif each.end == step and not first:
                yield from ((0.0, f"over: {text}") for _, text in each.fault.announced())
