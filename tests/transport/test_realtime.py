"""Whatever the transport does to a fleet for a while: nothing doubtful is done, all follows, and the fleet recovers."""

from collections.abc import Callable, Iterator
from functools import cache, partial
from random import Random
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from tests.soak.invariants import Invariant, Violation, WithinLimits, states
from tests.swarmabs_core.helpers import builtin
from tests.transport.network import LARGEST, Act, Script, script, scripts, turns
from tests.transport.swarm import AGENTS
from tests.virtual.fleet import EPOCH, Network, VirtualFleet

from swarmabs_analysis.verification.realtime import RealtimeVerification
from swarmabs_bag.realtime_world import RealtimeWorld
from swarmabs_bag.run.realtime_gatherer import RealtimeCollector
from swarmabs_bag.run.step import Step
from swarmabs_config import realtime as configure
from swarmabs_config.configure import members
from swarmabs_config.graph import CONTROLLER
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import encode
from swarmabs_core.messages import NEVER, TOPIC_OF, AgentState, Status
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime.broadcasts import BroadcastInbox
from swarmabs_core.realtime.modes import RESET_SECONDS
from swarmabs_core.record import Record

BEGIN, AT_WORST, CALM = 0.26, 0.7, 0.54
"""Time, s: before the script begins, for which it goes on at most, and after it."""
AWAY, WRONG = 0.25, 2.0
"""Time, s, for which a node is away, cut off, or has a wrong clock, and by how much the clock is wrong at most."""
LATEST = 0.08
"""Time, s, by which a message is late at most."""

ROBOTS = tuple(agent_name(i) for i in (1, 2, 3))


class Period(NamedTuple):
    """A period with the messages that were sent in it, of whatever step; for invariants it is like a step."""

    step: int
    records: tuple[Record, ...]


class StaysWithin(Invariant):
    """No robot is nearer to the plane's end than it may come."""

    def __init__(self, scenario: Scenario) -> None:
        self._lane = max(0.0, 0.5 * scenario.plane.length - scenario.realtime.lane_margin)

    def check(self, step: Step | Period) -> Iterator[Violation]:
        for state in states(step):
            if abs(state.position) > self._lane + 1e-9:
                yield Violation("lane", step.step, state.agent_id, f"{state.position:.6g} m is outside of its lane")


class NothingDoubtful(Invariant):
    """A robot acts on broadcasts that are young enough by its own clock, and on none after STOP."""

    def __init__(self, scenario: Scenario) -> None:
        clock = configure.schedule(scenario, EPOCH)
        self._age = clock.steps(scenario.realtime.broadcast_age_limit)
        self._ahead = clock.ahead(scenario.realtime.clock_tolerance)
        self._before: dict[int, int] = {}

    def check(self, step: Step | Period) -> Iterator[Violation]:
        for state in states(step):
            decided, self._before[state.agent_id] = self._before.get(state.agent_id), state.step
            if state.broadcast_step == NEVER:
                continue
            if state.status == Status.LEFT or decided is None:
                yield Violation("stale data", step.step, state.agent_id, "acts without having heard or taking part")
                continue
            age = decided - state.broadcast_step
            if not -self._ahead <= age <= self._age:
                text = f"acts in step {decided} on broadcasts of step {state.broadcast_step}"
                yield Violation("stale data", step.step, state.agent_id, text)


class FollowsFromItsBasis(Invariant):
    """Every message is, bit for bit, what follows from what it says that it was computed from."""

    def __init__(self, scenario: Scenario) -> None:
        clock = configure.schedule(scenario, EPOCH)
        world = RealtimeWorld(clock, members(scenario), plane=True)
        self._collector = RealtimeCollector(members(scenario), clock)
        self._verification = RealtimeVerification(scenario, world)
        self._period_ns = scenario.step_ns

    def check(self, step: Step | Period) -> Iterator[Violation]:
        time = EPOCH + step.step * self._period_ns
        for record in step.records:
            for kept in self._collector.add(record, time):
                self._verification.add(kept.topic, time, kept.payload)
        yield from ()

    def finish(self) -> Iterator[Violation]:
        self._verification.finish()
        difference = self._verification.result.difference
        if difference is not None:
            yield Violation("verification", difference.step, difference.agent, str(difference))


class ScriptedNetwork(Network):
    """A network, and machines, that go by a script: each turn of it is a message on its way to a node."""

    def __init__(self, fleet: VirtualFleet, doings: Script) -> None:
        super().__init__()
        self._fleet = fleet
        self._script = turns(doings)

    def arrivals(self, sender: str, receiver: str, step: int, draw: Random) -> list[int]:
        usual = super().arrivals(sender, receiver, step, draw)
        deviation = next(self._script)
        if deviation is None:
            return usual
        _, act, which = deviation
        share = which / LARGEST
        late = [time + round(share * LATEST * 1e9) for time in usual]
        if act is Act.LOSE:
            return []
        if act is Act.OTHER:
            return late
        if act is Act.TWICE:
            return usual + late
        self._trouble(act, receiver, share)
        return usual

    def _trouble(self, act: Act, name: str, share: float) -> None:
        """Cut a node off, let it have a wrong clock or die, or let an operator stop the swarm or send a robot away."""
        fleet = self._fleet
        told, begin, end = (name, "leave", "join") if name in ROBOTS else (CONTROLLER, "stop", "reset")
        troubles: dict[Act, tuple[Callable[[], None], Callable[[], None]]] = {
            Act.PASS: (partial(self.cut.add, name), partial(self.cut.discard, name)),
            Act.RUN: (partial(fleet.set_clock, name, (2.0 * share - 1.0) * WRONG), partial(fleet.set_clock, name, 0.0)),
            Act.FREEZE: (partial(fleet.kill, name), partial(fleet.revive, name)),
            Act.LATE: (lambda: fleet.later(0.0, partial(fleet.call, told, begin)), partial(fleet.call, told, end)),
        }
        do, undo = troubles[act]
        do()
        fleet.later(AWAY if act is Act.RUN else share * AWAY, undo)


@cache
def scenario() -> Scenario:
    return builtin(
        "pd_het_4", f"swarm.agents=[{', '.join(AGENTS)}]", "step=0.02", "plane.end_stop=0.5", "duration=2"
    ).resolved()


def gone_through(doings: Script, seed: int = 1) -> VirtualFleet:
    """Return a fleet that has gone through a script, and then was left alone for a while."""
    fleet = VirtualFleet(scenario(), seed=seed)
    fleet.run(BEGIN)
    fleet.network = ScriptedNetwork(fleet, doings)
    fleet.run(AT_WORST)
    fleet.network = Network()
    for name in fleet.names:
        fleet.set_clock(name, 0.0)
        fleet.revive(name)
    acts = {act for _, act, _ in doings}
    if Act.LATE in acts:  # who was away when it was told is told again
        if Act.RUN in acts:  # a STOP of a clock that was ahead is in force until that time has come
            fleet.run(WRONG)
        for name in ROBOTS:
            fleet.call(name, "join")
        fleet.call(CONTROLLER, "reset")
        fleet.run(RESET_SECONDS)
    fleet.run(CALM)
    return fleet


def periods(fleet: VirtualFleet) -> Iterator[Period]:
    by_period: dict[int, list[Record]] = {}
    for time, _, message in fleet.published:
        record = Record(TOPIC_OF[type(message)], getattr(message, "agent_id", 0), message, encode(message))
        by_period.setdefault(time // scenario().step_ns, []).append(record)
    for step, records in by_period.items():
        yield Period(step, tuple(records))


def wrongs(doings: Script) -> list[str]:
    fleet = gone_through(doings)
    invariants = [NothingDoubtful(scenario()), WithinLimits(scenario())]
    # Where a clock is set back, a node makes some steps twice and none for a while, and bodies here move by the
    # world's clock: nothing brakes them.
    if not any(act is Act.RUN for _, act, _ in doings):
        invariants += [StaysWithin(scenario()), FollowsFromItsBasis(scenario())]
    texts = [
        str(violation) for step in periods(fleet) for invariant in invariants for violation in invariant.check(step)
    ]
    texts += [str(violation) for invariant in invariants for violation in invariant.finish()]
    newest = {m.agent_id: m for _, _, m in fleet.published if isinstance(m, AgentState)}
    texts += [f"{i} does not follow at the end" for i, state in newest.items() if state.broadcast_step == NEVER]
    return texts


@pytest.mark.parametrize("block", range(2))
def test_a_fleet_bears_each_interleaving(block: int) -> None:
    assert [(seed, texts) for seed in range(10 * block, 10 * block + 10) if (texts := wrongs(script(seed, 40)))] == []


@pytest.mark.full
@pytest.mark.timeout(0)
@pytest.mark.parametrize("block", range(2, 150))
def test_a_fleet_bears_many_more(block: int) -> None:
    test_a_fleet_bears_each_interleaving(block)


@pytest.mark.full
@pytest.mark.timeout(0)
@given(doings=scripts())
@settings(max_examples=200, derandomize=True, database=None, deadline=None)
def test_a_fleet_bears_what_hypothesis_thinks_of(doings: Script) -> None:
    assert wrongs(doings) == []


def test_the_same_script_gives_the_same_bits_and_another_does_not() -> None:
    runs = [gone_through(script(seed, 40)).published for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]


def test_a_robot_that_acts_on_old_broadcasts_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BroadcastInbox, "problem", lambda self, _: "" if self.newest is not None else "nothing heard")
    assert "stale data" not in str(wrongs([]))
    assert any("stale data" in str(wrongs(script(seed, 40))) for seed in range(10))
