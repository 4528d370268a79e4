"""A run in lockstep with standbys has the bits of the simulation, whichever coordinator dies or stops, and when."""

from collections.abc import Callable
from functools import cache
from random import Random

import pytest
from tests.swarmabs_core.helpers import builtin
from tests.transport.network import script
from tests.transport.swarm import AGENTS, LONGEST_RUN, Cast, Swarm
from tests.transport.test_lockstep import STEERED, assert_planned, payloads, stored

from swarmabs_config.graph import CONTROLLER, OBSERVER, RECORDER, standby_name
from swarmabs_core.behaviours import Request
from swarmabs_core.messages import MAIN_TOPICS, Action
from swarmabs_ros.lockstep import Lockstep
from swarmabs_ros.pairs import LockstepLeadership
from swarmabs_run.run import RunOptions
from swarmabs_run.simulation import Simulation

PRIMARIES = (OBSERVER, CONTROLLER, RECORDER)
ALL = (*PRIMARIES, *map(standby_name, PRIMARIES))
WINDOW = 10
"""How many steps a run may be ahead of one of a pair here."""
FOR_EVER = 2 * LONGEST_RUN
Hit = Callable[[Swarm], None]


def kill(name: str) -> Hit:
    return lambda swarm: swarm.kill(name)


def freeze(name: str, seconds: float = FOR_EVER) -> Hit:
    return lambda swarm: swarm.freeze(name, seconds)


@cache
def cast_of(steps: int, *, packed: bool) -> Cast:
    scenario = builtin("pd_het_4", f"swarm.agents=[{', '.join(AGENTS)}]", f"duration={steps / 100}").resolved()
    changed = {name: {"pair_window": WINDOW} for name in ALL}
    for name in (CONTROLLER, standby_name(CONTROLLER)):
        changed[name] = changed[name] | {"recording_window": WINDOW}
    return Cast(scenario, RunOptions(packed=packed, standby=True), changed)


@cache
def expected(steps: int) -> list[object]:
    return stored(Simulation(cast_of(steps, packed=False).scenario).steps())


def check(swarm: Swarm, steps: int) -> None:
    """Run to the end; what a recorder has recorded, and all that anybody has published, is as simulated."""
    waiting = {node.name: node.spec.behaviour.missing() for node in swarm.nodes.values() if node.alive}
    assert swarm.run(), (swarm.problems, waiting)
    assert stored(swarm.recorded) == expected(steps)
    for topic in MAIN_TOPICS:
        assert {data for _, of, data in swarm.published if of is topic} == payloads(swarm.recorded)[topic], topic.name


def published_by(swarm: Swarm, name: str) -> int:
    return sum(number for (who, *_), number in swarm.published.items() if who == name)


def assert_survives(name: str, hit: Hit, turn: int, *, packed: bool) -> bool:
    """Hit one in a turn of a run of two steps; tell whether the run had not ended before."""
    swarm = Swarm(cast_of(2, packed=packed))
    swarm.run_turns(turn)
    if swarm.finished:
        return False
    hit(swarm)
    check(swarm, 2)
    return True


HITS = {f"{what} {name}": (name, hit(name)) for name in ALL for what, hit in (("kill", kill), ("freeze", freeze))}


@pytest.mark.parametrize("packed", [False, True], ids=["apart", "packed"])
@pytest.mark.parametrize("what", HITS)
def test_one_is_lost_at_some_moments(what: str, *, packed: bool) -> None:
    for turn in Random(what).sample(range(60), 3):
        assert assert_survives(*HITS[what], turn, packed=packed)


@pytest.mark.full
@pytest.mark.parametrize("packed", [False, True], ids=["apart", "packed"])
@pytest.mark.parametrize("what", HITS)
def test_one_is_lost_at_any_moment(what: str, *, packed: bool) -> None:
    survived = 0
    while assert_survives(*HITS[what], survived, packed=packed):
        survived += 1
    assert survived > 60


def hit_at_random(seed: int) -> Swarm:
    """Run 40 steps on a bad transport; at random moments one of each pair is killed, or stopped for a while or ever."""
    draw = Random(seed)
    swarm = Swarm(cast_of(40, packed=draw.random() < 0.5), script(seed, 200))
    for name in draw.sample(PRIMARIES, draw.randint(1, 3)):
        swarm.run_turns(draw.randint(0, 800))
        victim = draw.choice((name, standby_name(name)))
        if draw.random() < 0.3:
            swarm.kill(victim)
        else:
            swarm.freeze(victim, draw.choice((0.2, 1.0, 2.0, 4.0, FOR_EVER)))
    return swarm


@pytest.mark.parametrize("seed", range(6))
def test_some_are_lost_at_random(seed: int) -> None:
    check(hit_at_random(seed), 40)


@pytest.mark.full
@pytest.mark.timeout(0)
def test_many_are_lost_at_random() -> None:
    for seed in range(6, 1000):
        check(hit_at_random(seed), 40)


@pytest.mark.parametrize("name", PRIMARIES)
def test_one_is_lost_in_a_run_that_is_steered(name: str) -> None:
    overrides = f"swarm.agents=[{', '.join(AGENTS)}]", "duration=0.2", *STEERED.overrides
    cast_ = Cast(builtin("pd_het_4", *overrides).resolved(), RunOptions(steered=True, standby=True))
    swarm = Swarm(cast_, script(1, 40))
    for number, request in enumerate((Request(Action.ADD, 3), Request(Action.REFERENCE, 0, 0.1))):
        swarm.run_turns(100)
        swarm.steerer.ask(request)
        if number == 0:
            swarm.kill(name)
    assert swarm.run(), swarm.problems
    assert_planned(swarm, cast_)


def test_a_standby_is_silent_while_its_primary_lives() -> None:
    steps = 40
    swarm = Swarm(Cast(cast_of(steps, packed=True).scenario, RunOptions(packed=True, standby=True)))
    check(swarm, steps)
    signs = steps // 10 + 1
    for name in (OBSERVER, CONTROLLER):
        assert published_by(swarm, standby_name(name)) == signs
        assert not swarm.nodes[standby_name(name)].reports.troubles


@pytest.mark.parametrize("name", ALL)
def test_one_that_stopped_for_less_than_the_patience_of_its_peer_is_not_lost(name: str) -> None:
    swarm = Swarm(cast_of(40, packed=True))
    swarm.run_turns(300)
    swarm.freeze(name, 2.0)
    check(swarm, 40)
    node = swarm.nodes[name]
    while node.alive and node.spec.behaviour.awaits() and swarm.now < LONGEST_RUN:
        swarm.step()
    assert not node.behind
    assert swarm.now < LONGEST_RUN, "it has not caught up"


@pytest.mark.parametrize("name", [OBSERVER, CONTROLLER])
def test_one_that_has_missed_too_much_gives_up(name: str) -> None:
    swarm = Swarm(cast_of(180, packed=True))
    swarm.run_turns(300)
    swarm.freeze(name, 10.0)
    check(swarm, 180)
    node = swarm.nodes[name]
    while node.alive and swarm.now < LONGEST_RUN:
        swarm.step()
    assert node.behind


@pytest.mark.parametrize("name", [OBSERVER, CONTROLLER])
def test_a_standby_that_leads_is_as_fast_as_its_primary_and_falls_silent_when_that_is_back(name: str) -> None:
    swarm = Swarm(cast_of(40, packed=False))
    swarm.run_turns(300)
    swarm.freeze(name, 1.0)
    standby = swarm.nodes[standby_name(name)]
    while standby.spec.pair is not None and not standby.spec.pair.leading:
        swarm.step()
    assert swarm.now < 1.0
    check(swarm, 40)
    assert standby.spec.pair is not None and not standby.spec.pair.leading
    assert len(standby.reports.of("leads")) == 1


@pytest.mark.parametrize("name", PRIMARIES)
def test_a_run_that_has_lost_both_of_a_pair_stalls(name: str) -> None:
    swarm = Swarm(cast_of(40, packed=True))
    swarm.run_turns(100)
    swarm.kill(name)
    swarm.run_turns(100)
    swarm.kill(standby_name(name))
    assert not swarm.run(30.0)
    assert swarm.stalls()


def test_pair_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tests above find a standby that does not take over, and a primary that waits for ever."""
    monkeypatch.setattr(LockstepLeadership, "take_over", lambda _: False)
    monkeypatch.setattr(Lockstep, "_repeat", lambda *_: None)
    with pytest.raises(AssertionError):
        assert_survives(OBSERVER, kill(OBSERVER), 30, packed=False)
    monkeypatch.undo()
    monkeypatch.setattr(LockstepLeadership, "waits", lambda self, _: self.step - self._peer > WINDOW)
    swarm = Swarm(cast_of(40, packed=False))
    swarm.kill(standby_name(OBSERVER))
    with pytest.raises(AssertionError):
        check(swarm, 40)
