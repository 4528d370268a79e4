"""A virtual fleet in real time to which something is done, and what holds for it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from tests.soak.disturbances import CLOCKS, Disturbance
from tests.soak.invariants import Invariant, Recovers, Violation, WithinLimits
from tests.soak.trial import not_repeated, violations
from tests.virtual_fleet import EPOCH, VirtualFleet

from swarmabs_analysis.verification.realtime import RealtimeVerification
from swarmabs_bag.realtime import RealtimeWorld
from swarmabs_bag.recording import Digest, RecordedStep
from swarmabs_config import realtime as configure
from swarmabs_config.configure import members
from swarmabs_config.model.controllers import AriseConfig
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import encode
from swarmabs_core.messages import NEVER, TOPIC_OF, AgentState, Status
from swarmabs_core.record import Record
from swarmabs_core.sensing import RobotSensor
from swarmabs_core.trajectory import Constant

END_STOP = 0.5
"""Angle of the end stops that planes have here: a swarm that stands still lets them fall, rad."""
_ROUNDING = 1e-9


def of_a_fleet(scenario: Scenario) -> Scenario:
    """Return a scenario without what there is in lockstep only."""
    controller = scenario.controller
    if isinstance(controller, AriseConfig):  # a reference that begins anew after each reset has no fixed error
        controller = controller.model_copy(update={"trajectory": Constant()})
    swarm = scenario.swarm.model_copy(update={"actuator_lag": 0.0, "sensor": RobotSensor()})
    plane = replace(scenario.plane, end_stop=END_STOP)
    changed = {"swarm": swarm, "plane": plane, "controller": controller, "faults": ()}
    return scenario.model_copy(update=changed)


def fleet_steps(scenario: Scenario, disturbed: Sequence[Disturbance]) -> Iterator[RecordedStep]:
    """Let a fleet go on while this is done to it, and yield what was published in each period."""
    fleet = VirtualFleet(scenario, seed=scenario.seed)
    left = list(disturbed)
    for step in range(scenario.steps + 1):
        end = (step + 1) * scenario.period
        while left and left[0].time < end:
            disturbance = left.pop(0)
            fleet.run(disturbance.time - fleet.time)
            disturbance.do(fleet)
        fleet.run(end - fleet.time)
        published, fleet.published = fleet.published, []
        yield RecordedStep(
            step,
            tuple(
                Record(TOPIC_OF[type(message)], getattr(message, "agent_id", 0), message, encode(message))
                for _, _, message in published
            ),
        )


def fleet_violations(scenario: Scenario, disturbed: Sequence[Disturbance]) -> list[Violation]:
    """Run a fleet and return what does not hold."""
    last = max((round(disturbance.time / scenario.period) for disturbance in disturbed), default=0)
    invariants: list[Invariant] = [StaysWithin(scenario), NothingDoubtful(scenario), WithinLimits(scenario)]
    invariants.append(FleetRecovers(scenario, last))
    # Where a clock is set back, a node makes some steps twice, and bodies here go on by the world's clock.
    if not set(CLOCKS) & {disturbance.kind for disturbance in disturbed}:
        invariants.append(FollowsFromItsBasis(scenario))

    def steps() -> Iterator[RecordedStep]:
        return fleet_steps(scenario, disturbed)

    digest = Digest()
    found = violations(steps, invariants, digest.update)
    return found or list(not_repeated(steps, digest.hexdigest()))


class StaysWithin(Invariant):
    """No robot is nearer to the plane's end than it may come."""

    def __init__(self, scenario: Scenario) -> None:
        self._lane = max(0.0, 0.5 * scenario.plane.length - scenario.realtime.lane_margin)

    def check(self, step: RecordedStep) -> Iterator[Violation]:
        """Look at all positions."""
        for record in step.records:
            state = record.message
            if not isinstance(state, AgentState):
                continue
            if abs(state.position) > self._lane + _ROUNDING:
                yield Violation("lane", step.step, state.agent_id, f"{state.position:.6g} m is outside of its lane")


class NothingDoubtful(Invariant):
    """A robot acts on broadcasts that are young enough by its own clock, and on none after STOP."""

    def __init__(self, scenario: Scenario) -> None:
        clock = configure.schedule(scenario, EPOCH)
        self._age = clock.steps(scenario.realtime.broadcast_age_limit)
        self._ahead = clock.ahead(scenario.realtime.clock_tolerance)
        self._before: dict[int, int] = {}

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
            if not -self._ahead <= age <= self._age:
                text = f"acts in step {decided} on broadcasts of step {state.broadcast_step}"
                yield Violation("stale data", step.step, state.agent_id, text)


class FollowsFromItsBasis(Invariant):
    """Every message is, bit for bit, what follows from what it says that it was computed from."""

    def __init__(self, scenario: Scenario) -> None:
        world = RealtimeWorld(configure.schedule(scenario, EPOCH), members(scenario), plane=True)
        self._verification = RealtimeVerification(scenario, world)
        self._period_ns = scenario.step_ns

    def check(self, step: RecordedStep) -> Iterator[Violation]:
        """Take all messages."""
        for record in step.records:
            self._verification.add(record.topic, EPOCH + step.step * self._period_ns, record.payload)
        yield from ()

    def finish(self) -> Iterator[Violation]:
        """Yield the first message that does not follow."""
        self._verification.finish()
        difference = self._verification.found.difference
        if difference is not None:
            yield Violation("verification", difference.step, difference.agent, str(difference))


class FleetRecovers(Recovers):
    """The plane is where it should be soon after the last disturbance, and all robots that are there follow."""

    def __init__(self, scenario: Scenario, last_fault: int) -> None:
        super().__init__(scenario)
        self._last_fault = last_fault
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
