"""What holds in every step of a run, whatever is injected; checked from the messages alone, of each run of a soak."""

from collections.abc import Callable, Iterator
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.run.digest import Digest
from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.scenario import Scenario
from swarmabs_core.errors import RunError
from swarmabs_core.faults import RobotFault, RobotFaults, true_state
from swarmabs_core.messages import NEVER, AgentState, EventKind, Kind, PlaneState, Status, SwarmEvent
from swarmabs_run.simulation import Simulation

RECOVERED_BELOW = 0.01
"""Error of the angle, rad, below which a swarm counts as recovered."""
RECOVERY_BOUND = 8.0
"""Time, s, after the last fault within which a swarm has recovered for good."""
MOST_VIOLATIONS = 20
"""More of them say nothing new about a run."""

Steps = Callable[[], Iterator[Step]]


def states(step: Step) -> Iterator[AgentState]:
    """Yield the robots' states of a step."""
    yield from (record.message for record in step.records if isinstance(record.message, AgentState))


class Violation(NamedTuple):
    """An invariant that does not hold: its name, where, and what is there instead."""

    invariant: str
    step: int | None
    agent: int | None
    text: str


class Invariant:
    """Something that holds in every step."""

    def check(self, step: Step) -> Iterator[Violation]:
        """Take a step; yield what is wrong with it."""
        raise NotImplementedError

    def finish(self) -> Iterator[Violation]:
        """Yield what is wrong with the whole run."""
        yield from ()


class StaysInLane(Invariant):
    """No robot leaves the plane without a ``LIMIT_HIT`` of the plane in that step."""

    def __init__(self, scenario: Scenario) -> None:
        self._lies = configure.falsifications(scenario)
        self._half = scenario.plane.length / 2
        self._outside: set[int] = set()

    def check(self, step: Step) -> Iterator[Violation]:
        events = [record.message for record in step.records if isinstance(record.message, SwarmEvent)]
        hits = (event for event in events if event.kind == EventKind.LIMIT_HIT)
        said = {event.agent_id for event in hits if "out of range" in event.detail}
        for message in states(step):
            position = true_state(message, self._lies).position
            if abs(position) <= self._half:
                self._outside.discard(message.agent_id)
            elif message.agent_id not in self._outside:
                self._outside.add(message.agent_id)
                if message.agent_id not in said:
                    text = f"{position:.6g} m is off the plane, and no event says so"
                    yield Violation("lane", step.step, message.agent_id, text)


class NothingStale(Invariant):
    """A robot acts on the newest complete set that has reached it, by the draws of its faults, and on nothing older."""

    def __init__(self, scenario: Scenario) -> None:
        self._faults = {
            config.agent_id: RobotFaults(config.faults, config.seed, config.agent_id)
            for config in configure.agent_configs(scenario)
        }
        self._newest: dict[int, int] = {}
        self._coming: dict[int, dict[int, int]] = {}

    def check(self, step: Step) -> Iterator[Violation]:
        for state in states(step):
            wanted = NEVER
            if state.agent_id in self._coming:
                wanted = self._reached(state.agent_id, step.step - 1)
            self._coming.setdefault(state.agent_id, {})
            stopped = state.status != Status.ACTIVE and state.broadcast_step == NEVER
            if not stopped and state.broadcast_step != wanted:
                text = f"acts on step {_shown(state.broadcast_step)}, but has {_shown(wanted)}"
                yield Violation("stale data", step.step, state.agent_id, text)

    def _reached(self, agent_id: int, step: int) -> int:
        """Return the newest set that has reached a robot in a step."""
        faults, coming = self._faults[agent_id], self._coming[agent_id]
        acting, draw = faults.acting(step), faults.draw(step)
        coming[step] = step + sum(fault.late(draw) for fault in acting)
        come = [sent for sent, at in coming.items() if at <= step]
        for sent in come:
            del coming[sent]
        if come and not any(fault.loses(draw) for fault in acting):
            self._newest[agent_id] = max(self._newest.get(agent_id, -1), *come)
        return self._newest.get(agent_id, NEVER)


def _shown(step: int) -> str:
    return "none" if step == NEVER else str(step)


class WithinLimits(Invariant):
    """All numbers are finite, and no command is beyond what the drive can do."""

    def __init__(self, scenario: Scenario) -> None:
        velocity, force = scenario.limits.velocity, scenario.limits.force
        self._largest = {Kind.SINGLE_INTEGRATOR: velocity, Kind.DOUBLE_INTEGRATOR: force}

    def check(self, step: Step) -> Iterator[Violation]:
        for record in step.records:
            message = record.message
            if not all(isfinite(value) for value in message if isinstance(value, float)):
                yield Violation("finite numbers", step.step, record.agent_id or None, f"{record.topic.name}: {message}")
            if isinstance(message, AgentState) and abs(message.command) > self._largest[Kind(message.kind)]:
                yield Violation("limits", step.step, message.agent_id, f"the command is {message.command:.6g}")


class Recovers(Invariant):
    """The plane is where it should be within a bound after the last fault, and stays there."""

    def __init__(self, scenario: Scenario) -> None:
        self._reference = configure.reference(scenario)
        self._period = scenario.step_ns / 1e9
        self._last_fault = last_fault(scenario)
        self._away: int | None = None
        self._end = 0

    def check(self, step: Step) -> Iterator[Violation]:
        for record in step.records:
            if isinstance(record.message, PlaneState):
                self._end = step.step
                error = self._reference(step.step * self._period) - record.message.angle
                if not abs(error) < RECOVERED_BELOW:
                    self._away = step.step
        yield from ()

    def finish(self) -> Iterator[Violation]:
        took = -1.0 if self._away is None else (self._away - self._last_fault) * self._period
        if self._away == self._end or took > RECOVERY_BOUND:
            text = f"the error is not below {RECOVERED_BELOW} rad until {took:g} s after the last fault"
            yield Violation("recovery", self._last_fault, None, text)


def last_fault(scenario: Scenario) -> int:
    """Return the step in which the last fault happens or ends; the last step for faults that do not end."""
    steps = []
    for fault in scenario.faults:
        begin, end = scenario.fault_steps(fault)
        if isinstance(fault, RobotFault):
            steps.append(scenario.steps if end is None else min(end, scenario.steps))
        elif fault.at is not None:
            steps += [begin, begin if end is None else min(end, scenario.steps)]
    return max(steps, default=0)


def lockstep_violations(scenario: Scenario, steps: Steps | None = None) -> list[Violation]:
    """Run a scenario in lockstep and return what does not hold; its bag is verified too."""
    steps = steps or (lambda: (single for part in Simulation(scenario).steps() for single in part.singly()))
    with TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        recording = Recording(scenario, bag, driver="simulate")
        violated = violations(scenario, steps(), recording.add)
        if violated:
            recording.abort("an invariant does not hold")
            return violated
        digest = str(recording.close()["digest"])
        verdict, again = BagToVerify(bag).verify(), Digest()
    for step in steps():
        again.update(step)
    if (difference := verdict.difference) is not None:
        violated.append(Violation("verification", difference.step, difference.agent, str(difference)))
    elif not verdict.ok or verdict.digest != digest:
        violated.append(
            Violation("verification", None, None, f"{verdict.problem}, digest {verdict.digest}, not {digest}")
        )
    if again.hexdigest() != digest:
        violated.append(Violation("repetition", None, None, f"a second run has {again.hexdigest()}, and not {digest}"))
    return violated


def violations(
    scenario: Scenario, steps: Iterator[Step], record: Callable[[Step], None] = lambda _: None
) -> list[Violation]:
    """Watch a run, and return what does not hold in it."""
    violated: list[Violation] = []
    invariants = (StaysInLane(scenario), NothingStale(scenario), WithinLimits(scenario), Recovers(scenario))
    try:
        for step in steps:
            record(step)
            for invariant in invariants:
                violated.extend(invariant.check(step))
            if len(violated) > MOST_VIOLATIONS:
                return violated
    except RunError as error:
        return [*violated, Violation("run", None, None, str(error))]
    for invariant in invariants:
        violated.extend(invariant.finish())
    return violated
