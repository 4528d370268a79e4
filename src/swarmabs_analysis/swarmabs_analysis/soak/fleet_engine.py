"""The engine of a soak in real time: a virtual fleet to which things happen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_analysis.soak.happenings import CLOCKS, drawn_happenings
from swarmabs_analysis.soak.invariants import Invariant, Recovers, Violation, WithinLimits
from swarmabs_analysis.verification.realtime import RealtimeVerification
from swarmabs_bag.realtime_recording import RECORDED
from swarmabs_bag.recording import RecordedStep
from swarmabs_config import realtime as configure
from swarmabs_config.scenario.controllers import AriseConfig, ConstantTrajectory
from swarmabs_core.cdr import encode
from swarmabs_core.messages import NEVER, TOPIC_OF, AgentState, Status
from swarmabs_core.record import Record
from swarmabs_run.virtual_fleet import EPOCH, VirtualFleet

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_config.scenario import Scenario

END_STOP = 0.5
"""Angle of the end stops that planes have here: a swarm that stands still lets them fall, rad."""
_ROUNDING = 1e-9


class FleetEngine:
    """All nodes in real time, with clocks and a network of their own."""

    name = "virtual fleet"
    verifiable = False
    topics = RECORDED

    def prepare(self, scenario: Scenario) -> Scenario:
        """Return the scenario without what there is in lockstep only."""
        controller = scenario.controller
        if isinstance(controller, AriseConfig):  # a reference that begins anew after each reset has no fixed error
            controller = controller.model_copy(update={"trajectory": ConstantTrajectory()})
        swarm = scenario.swarm.model_copy(update={"actuator_lag": 0.0, "sensor": type(scenario.swarm.sensor)()})
        plane = scenario.plane.model_copy(update={"end_stop": END_STOP})
        changed = {"swarm": swarm, "plane": plane, "controller": controller, "faults": ()}
        return scenario.model_copy(update=changed)

    def kinds(self, scenario: Scenario) -> list[str]:
        """Return what happens to a fleet, in words."""
        return sorted(happening.kind for happening in drawn_happenings(scenario) if happening.kind is not None)

    def steps(self, scenario: Scenario) -> Iterator[RecordedStep]:
        """Let a fleet go on, and yield what was published in each period."""
        fleet = VirtualFleet(scenario, seed=scenario.seed)
        left = drawn_happenings(scenario)
        for step in range(scenario.steps + 1):
            end = (step + 1) * scenario.period
            while left and left[0].time < end:
                happening = left.pop(0)
                fleet.run(happening.time - fleet.time)
                happening.do(fleet)
            fleet.run(end - fleet.time)
            published, fleet.published = fleet.published, []
            yield RecordedStep(
                step,
                tuple(
                    Record(TOPIC_OF[type(message)], getattr(message, "agent_id", 0), message, encode(message))
                    for _, _, message in published
                ),
            )

    def invariants(self, scenario: Scenario) -> tuple[Invariant, ...]:
        """Return all invariants."""
        found = (StaysWithin(scenario), NothingDoubtful(scenario), WithinLimits(scenario), FleetRecovers(scenario))
        # Where a clock is set back, a node makes some steps twice, and bodies here go on by the world's clock.
        one_clock = not set(CLOCKS) & set(self.kinds(scenario))
        return (*found, FollowsFromItsBasis(scenario)) if one_clock else found


class StaysWithin(Invariant):
    """No robot is nearer to the plane's end than it may come."""

    def __init__(self, scenario: Scenario) -> None:
        self._lane = configure.lane_limit(scenario)
        self._farthest = 0.0

    def check(self, step: RecordedStep) -> Iterator[Violation]:
        """Look at all positions."""
        for record in step.records:
            state = record.message
            if not isinstance(state, AgentState):
                continue
            self._farthest = max(self._farthest, abs(state.position))
            if abs(state.position) > self._lane + _ROUNDING:
                yield Violation("lane", step.step, state.agent_id, f"{state.position:.6g} m is outside of its lane")

    def figures(self) -> dict[str, float | None]:
        """Return how far from the axis a robot came, m."""
        return {"farthest": self._farthest}


class NothingDoubtful(Invariant):
    """A robot acts on broadcasts that are young enough by its own clock, and on none after STOP."""

    def __init__(self, scenario: Scenario) -> None:
        clock = configure.schedule(scenario, EPOCH)
        self._age = clock.steps(scenario.realtime.broadcast_age_limit)
        self._ahead = clock.ahead(scenario.realtime.clock_tolerance)
        self._before: dict[int, int] = {}
        self._oldest = 0

    def check(self, step: RecordedStep) -> Iterator[Violation]:
        """Compare the step in which each command was computed with that of its broadcasts."""
        for record in step.records:
            state = record.message
            if not isinstance(state, AgentState):
                continue
            decided, self._before[state.agent_id] = self._before.get(state.agent_id), state.step
            if state.broadcast_step == NEVER:
                continue
            if state.status == Status.LEFT or decided is None:
                yield Violation("stale data", step.step, state.agent_id, "acts without having heard or taking part")
                continue
            age = decided - state.broadcast_step
            self._oldest = max(self._oldest, age)
            if not -self._ahead <= age <= self._age:
                text = f"acts in step {decided} on broadcasts of step {state.broadcast_step}"
                yield Violation("stale data", step.step, state.agent_id, text)

    def figures(self) -> dict[str, float | None]:
        """Return the greatest age, in steps, of broadcasts on which a robot has acted."""
        return {"oldest_broadcasts": self._oldest}


class FollowsFromItsBasis(Invariant):
    """Every message is, bit for bit, what follows from what it says that it was computed from."""

    def __init__(self, scenario: Scenario) -> None:
        self._verification = RealtimeVerification(scenario, configure.schedule(scenario, EPOCH))
        self._period_ns = scenario.step_ns

    def check(self, step: RecordedStep) -> Iterator[Violation]:
        """Take all messages."""
        for record in step.records:
            self._verification.add(record.topic, EPOCH + step.step * self._period_ns, record.payload)
        yield from ()

    def finish(self) -> Iterator[Violation]:
        """Yield the first message that does not follow."""
        self._verification.finish()
        difference = self._verification.difference
        if difference is not None:
            yield Violation("verification", difference.step, difference.agent, str(difference))

    def figures(self) -> dict[str, float | None]:
        """Return how many messages were found right, and how many could not be judged."""
        found = self._verification
        return {"verified": found.messages, "not_checkable": found.not_checkable.total()}


class FleetRecovers(Recovers):
    """The plane is where it should be within a bound after the last happening, and all robots that are there follow."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        happenings = drawn_happenings(scenario)
        self._last_fault = max((round(h.time / scenario.period) for h in happenings), default=0)
        self._newest: dict[int, AgentState] = {}
        self._last = scenario.steps

    def check(self, step: RecordedStep) -> Iterator[Violation]:
        """Note since when the error is small, and what each robot says of itself at the end."""
        yield from super().check(step)
        if step.step == self._last:
            self._newest = {r.agent_id: r.message for r in step.records if isinstance(r.message, AgentState)}

    def finish(self) -> Iterator[Violation]:
        """Yield how long the recovery took, if it took too long, and who does not follow."""
        yield from super().finish()
        for agent_id, state in sorted(self._newest.items()):
            if state.broadcast_step == NEVER:
                yield Violation("recovery", self._last, agent_id, f"does not follow: {Status(state.status).name}")
