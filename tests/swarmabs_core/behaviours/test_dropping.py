"""Robots without an observer agree on going on without silent ones, wherever these end, as an observer would decide."""

import re
from random import Random

import pytest
from tests.swarmabs_core.behaviours.peers_in_time import LATE, SECONDS, World, central
from tests.swarmabs_core.helpers import builtin

from swarmabs_config import configure
from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_core.cdr import decode
from swarmabs_core.membership import Membership
from swarmabs_core.messages import AgentState

STEPS = 12
SWARM = """
schema: 1
name: dropping
duration: {duration}
coordination: {coordination}
links: {links}
faults: {faults}
lockstep: {{on_stall: drop}}
swarm:
  generate: {{single_integrator: {one}, double_integrator: {two}, seed: 3}}
"""
LINKS = ("{}", "{loss: 0.3}", "{type: ring}", "{type: ring, loss: 0.3}", "{type: ring, sensing: [1, 2]}")
MORE = ("{type: random, degree: 4}", "{type: random, degree: 4, loss: 0.3, sensing: [1, 2]}")


STOPPED = (
    r"step \d+: (robot \d+ does not reach robots [\d, ]+ any more; those left \([\d, ]+\) are no majority and stop"
    r"|no robot is left that hears the parent)"
)


def swarm(robots: int, links: str, coordination: str = "each_robot", faults: str = "[]") -> Scenario:
    size = {"one": robots // 2, "two": robots - robots // 2}
    words = {"coordination": coordination, "links": links, "faults": faults}
    return parse_scenario(SWARM.format(duration=STEPS / 100, **words, **size))


def recorded(world: World) -> dict[str, set[bytes]]:
    """Return what a bag holds: without what robots have said too late."""
    drops = world.drops

    def counts(payload: bytes) -> bool:
        state = decode(AgentState, payload)
        assert isinstance(state, AgentState)
        return state.step < drops.get(state.agent_id, STEPS + 1)

    states = set(filter(counts, world.recorded["swarm/agent_state"]))
    return world.recorded | {"swarm/agent_state": states}


def finished(world: World) -> bool:
    return len(world.recorded.get("swarm/desired_abstract_state", ())) == STEPS + 1


def there_in(world: World, step: int) -> tuple[set[int], set[int]]:
    """Return the robots that were not dropped before a step, and those of them that count: not who has yet to join."""
    members = configure.members(world.scenario)
    there = {robot for robot in members if world.drops.get(robot, step) >= step}
    return there, there & {*Membership(members, configure.schedule(world.scenario)).publishing(step)}


def are_majority(side: set[int], part: set[int]) -> bool:
    """Return whether robots are a majority of others, or half of them with the lowest."""
    return 2 * len(side & part) > len(part) or (2 * len(side & part) == len(part) and min(part) in side)


def may_go_on(world: World, scenario: Scenario, step: int) -> bool:
    """Return whether a majority of those in a step, or half with the lowest, is in contact and hears the plane."""
    there, part = there_in(world, step)
    left, links = {robot for robot in there if robot not in world.dead}, configure.links(scenario)
    while left:
        side = new = {min(left)}
        while new:
            near = {other for one in new for other in links.of(one) if not {(one, other), (other, one)} & world.cut}
            new = (near & left) - side
            side = side | new
        if are_majority(side, part) and not side.isdisjoint(scenario.links.sensing or side):
            return True
        left = left - side
    return False


def course(seed: int) -> tuple[World, Scenario, str, int]:
    """Run a swarm of which some robots end, each after a number of messages that it sends."""
    draw = Random(seed)
    robots = draw.randint(4, 12)
    links = draw.choice(LINKS if robots < 6 else LINKS + MORE)
    scenario = swarm(robots, links)
    world = World(scenario, draw, loss=draw.choice((0.0, 0.0, 0.05)))
    for robot in draw.sample(range(1, robots + 1), draw.randint(1, robots // 2)):
        world.end_at(robot, draw.randint(1, 100))
    world.run(60.0)
    return world, scenario, links, robots


def check(seed: int) -> bool:
    """Check a course; return whether the run was finished."""
    world, _, links, robots = course(seed)
    return judged(world, swarm(robots, links, "central"))


def judged(world: World, usual: Scenario) -> bool:
    """Check a run that is over against the usual one, with an observer; return whether it was finished."""
    if finished(world):
        found, wanted = recorded(world), central(usual, world.drops)
        assert found == wanted, f"on {', '.join(t for t in sorted(found | wanted) if found.get(t) != wanted.get(t))}"
        for step in {*world.drops.values()}:
            _, part = there_in(world, step)
            rest = {robot for robot in part if world.drops.get(robot) != step}
            assert are_majority(rest, part), f"robots {rest} have gone on in step {step} without a majority of {part}"
        assert {*world.drops} <= world.dead | {*world.stopped}, f"drops {world.drops}, but {world.dead} have ended"
        return True
    problems = [why for robot, why in world.stopped.items() if robot not in world.drops]
    left = {*configure.members(world.scenario)} - world.dead - {*world.drops} - {*world.stopped}
    assert not left, f"robots {left} wait for ever"
    assert problems, "does not end"
    strange = [problem for problem in problems if not re.match(STOPPED, problem)]
    assert not strange, strange
    step = int(problems[0].split()[1][:-1])
    assert not may_go_on(world, world.scenario, step), f"stops in step {step}, although a majority is left"
    return False


def test_wherever_robots_end_the_others_go_on_as_an_observer_would_or_are_no_majority() -> None:
    outcomes = [check(seed) for seed in range(8)]
    assert 4 <= sum(outcomes) < 8


def test_a_robot_that_speaks_for_all_may_end_with_each_of_its_last_messages() -> None:
    scenario, usual = swarm(4, "{}"), swarm(4, "{}", "central")
    world = World(scenario, Random(1))
    world.run(4 * SECONDS)
    number = len(world.said_by(1))
    assert finished(world)
    for ends in range(number - 12, number):
        world = World(scenario, Random(1))
        world.end_at(1, ends)
        world.run(4 * SECONDS)
        assert judged(world, usual), ends


@pytest.mark.full
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("first", range(1000, 2000, 100))
def test_in_many_more_courses(first: int) -> None:
    assert sum(check(seed) for seed in range(first, first + 100)) > 50


def test_a_frozen_robot_finds_out_that_it_was_dropped_and_disturbs_nobody() -> None:
    """It is the one that speaks for all, and is frozen wherever it is in a step."""
    scenario, usual = swarm(5, "{}"), swarm(5, "{}", "central")
    for number in range(10):
        world = World(scenario, Random(number))
        world.run(0.1 + 0.003 * number)
        world.frozen.add(1)
        world.run(4 * SECONDS)
        assert finished(world) and {*world.drops} == {1}
        world.frozen.clear()
        world.run(4 * SECONDS)
        assert re.fullmatch(
            r"step \d+: the others have dropped robot 1, because it did not answer \(lockstep.on_stall\); robot \d is "
            r"at step \d+|step \d+: robot 1 does not reach robots 2, 3, 4, 5 any more; .*",
            world.stopped.pop(1),
        )
        assert not world.stopped
        assert recorded(world) == central(usual, world.drops)


def test_a_minority_that_is_cut_off_stops_and_the_others_go_on() -> None:
    scenario = swarm(7, "{type: listed, pairs: [1 2, 2 3, 3 4, 4 5, 5 6, 6 7]}")
    world = World(scenario, Random(1))
    world.end_at(3, 30)
    world.run(10.0)
    assert finished(world)
    assert {*world.stopped} == {1, 2} and {*world.drops} == {1, 2, 3}
    assert "robot 2 does not reach robots 3, 4, 5, 6, 7 any more; those left (1, 2) are no majority" in world.stopped[2]


def test_a_slow_robot_is_not_dropped() -> None:
    scenario = swarm(5, "{type: ring}")
    world = World(scenario, Random(2))
    world.run(0.1)
    world.frozen.add(4)
    world.run(SECONDS - 3 * LATE)
    world.frozen.clear()
    world.run(10.0)
    assert finished(world) and not world.drops and not world.stopped


def test_a_new_speaker_repeats_what_the_recorder_may_lack() -> None:
    scenario = builtin("pd_het_4", "duration=0.12", "coordination=each_robot", "lockstep={on_stall: drop}")
    world = World(scenario, Random(3), window=True)
    world.progress(4)
    world.end_at(1, 60)
    world.run(10.0)
    assert {*world.drops} == {1}
    (step,) = world.drops.values()
    speaker = [message.step for message in world.said_by(2) if type(message).__name__ == "DesiredAbstractState"]
    assert speaker[: step - 5] == list(range(5, step)), "those before step 5 are recorded"
