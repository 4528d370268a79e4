"""Cost of signed states among robots without coordinators: signatures by time, checks, bytes, and share of a core.

No suite of `swarm bench`, whose environment lacks cryptography: ``python -m benchmarks.sealing`` prints its result.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from random import Random
from statistics import fmean
from typing import Any

from benchmarks.common import Settings, program, spread, tell
from cryptography.hazmat.primitives.asymmetric import ec

from swarmabs_config import realtime as configure
from swarmabs_config.scenario import PlaneScenario, load_scenario
from swarmabs_config.scenarios import builtin_scenarios
from swarmabs_config.seals import EcdsaSeals
from swarmabs_core.messages import PARENT, AgentState, Message, Messages, PlaneState, Relay
from swarmabs_core.realtime.agent import RealtimeAgent
from swarmabs_core.realtime.base import PLANE_PHASE, Schedule
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_core.realtime.drives import Body, SimulatedDrive
from swarmabs_core.realtime.observer import RealtimeObserver
from swarmabs_core.realtime.peer import RealtimePeer
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_core.realtime.relayed import read
from swarmabs_core.realtime.seals import Seals, sealed_plane

PERIOD = 0.02
_ROBOTS = (8, 50)
_LINKS = (("all", 0.0), ("all", 0.5), ("random", 0.0))
_DEGREE = 6
_WARM_UP, _MEASURED = 40, 20
"""Periods: until all robots follow, and those measured."""
_CONTENT = bytes(range(70))


@dataclass(slots=True)
class _Counting:
    """Keys that count their use."""

    seals: Seals
    signed: int = 0
    checked: int = 0

    def sign(self, content: bytes) -> bytes:
        self.signed += 1
        return self.seals.sign(content)

    def holds(self, author: int, content: bytes, signature: bytes) -> bool:
        self.checked += 1
        return self.seals.holds(author, content, signature)


@dataclass(slots=True)
class _Cost:
    """What the robots of a swarm took: time of the processor (s), and what they sent and held, per robot and period."""

    seconds: list[float] = field(default_factory=list)
    checks: float = 0.0
    content: float = 0.0
    states: float = 0.0
    age: float = 0.0


def measure(settings: Settings) -> dict[str, Any]:
    """Measure one signature and one check, then swarms with and without."""
    keys = {author: ec.derive_private_key(1 + author, ec.SECP256R1()) for author in range(max(_ROBOTS) + 1)}
    public = {author: key.public_key() for author, key in keys.items()}
    seals = {author: EcdsaSeals(key, public) for author, key in keys.items()}
    own = seals[1]
    signature = own.sign(_CONTENT)
    calls = {"sign": partial(own.sign, _CONTENT), "check": partial(own.holds, 1, _CONTENT, signature)}
    single = {name: spread(_microseconds(call) for _ in range(settings.repeat)) for name, call in calls.items()}
    rows = []
    for robots in _ROBOTS:
        for links, loss in _LINKS:
            tell(f"{robots} robots, links {links}, loss {loss:g}: states without and with signatures")
            scenario = _scenario(robots, links, loss)
            pairs = [[_swarm(scenario, {}), _swarm(scenario, seals)] for _ in range(settings.repeat)]
            rows.append(_row(robots, links, loss, pairs, single))
    return {"sealing": rows}


def _row(robots: int, links: str, loss: float, pairs: list[list[_Cost]], single: dict[str, Any]) -> dict[str, Any]:
    summary = {
        **{f"{name}_microseconds": times for name, times in single.items()},
        "share": spread(fmean(cost.seconds) / PERIOD for cost, _ in pairs),
        "sealed_share": spread(fmean(cost.seconds) / PERIOD for _, cost in pairs),
        **{
            f"{prefix}{name}": spread(getattr(pair[which], name) for pair in pairs)
            for which, prefix in enumerate(("", "sealed_"))
            for name in ("checks", "content", "states", "age")
        },
    }
    return {"robots": robots, "links": links, "loss": loss, "summary": summary}


def _microseconds(call: Callable[[], object]) -> float:
    """Return the time of a call in the fastest of some passes."""
    fastest = math.inf
    for _ in range(20):
        begun = time.perf_counter_ns()
        for _ in range(100):
            call()
        fastest = min(fastest, (time.perf_counter_ns() - begun) / 1e5)
    return fastest


def _scenario(robots: int, links: str, loss: float) -> PlaneScenario:
    degree = f", degree: {_DEGREE}" if links == "random" else ""
    overrides = (
        "coordination=each_robot",
        f"step={PERIOD}",
        "swarm.agents=null",
        f"swarm.generate.single_integrator={robots}",
        f"links={{type: {links}{degree}, loss: {loss}}}",
    )
    return configure.check_realtime(load_scenario(builtin_scenarios()["pd_het_4"], overrides).resolved())


def _swarm(scenario: PlaneScenario, keys: dict[int, EcdsaSeals]) -> _Cost:
    """Let a swarm run in this process: in each period robots tick, then hear each other, then the plane."""
    clock = configure.schedule(scenario, 0)
    seals = {author: _Counting(key) for author, key in keys.items()}
    plane = sealed_plane(RealtimePlane(configure.plane_config(scenario, clock)), seals.get(PARENT), clock)
    configs = {a.id: configure.peer_config(scenario, clock, a.id) for a in scenario.agents}
    peers = _peers(scenario, clock, seals)
    draw, cost = Random(1), _Cost()
    for step in range(1, _WARM_UP + _MEASURED):
        begun = time.process_time(), sum(counted.checked for counted in seals.values())
        now = clock.begin(step)
        said = {robot: peer.tick(now) for robot, peer in peers.items()}
        relays = {robot: message for robot, m in said.items() for message in m if isinstance(message, Relay)}
        for robot, peer in peers.items():
            for neighbour in configs[robot].neighbours:
                peer.hear(relays[neighbour], now)
        between = time.process_time()
        for message in _states(said):
            plane.hear(message, now)
        (told,) = (
            m for m in plane.tick(clock.begin(step, PLANE_PHASE)) if isinstance(m, Relay if keys else PlaneState)
        )
        resumed = time.process_time()
        for peer in peers.values():
            if draw.random() >= scenario.links.loss:
                peer.hear(told, clock.begin(step, PLANE_PHASE))
        if step >= _WARM_UP:
            cost.seconds.append((time.process_time() - resumed + between - begun[0]) / len(peers))
            cost.checks += (sum(counted.checked for counted in seals.values()) - begun[1]) / len(peers) / _MEASURED
            _add(cost, relays, len(peers))
    return cost


def _add(cost: _Cost, relays: dict[int, Relay], robots: int) -> None:
    """Add what a period's relays say, as shares of the mean."""
    share = 1.0 / (robots * _MEASURED)
    for relay in relays.values():
        told = read(relay, robots)
        cost.content += share * len(relay.content)
        cost.states += share * len(told.motions)
        cost.age += share * float((relay.step - told.held).mean())


def _states(said: dict[int, Messages]) -> list[Message]:
    return [message for messages in said.values() for message in messages if isinstance(message, AgentState)]


def _peers(scenario: PlaneScenario, clock: Schedule, seals: dict[int, _Counting]) -> dict[int, RealtimePeer]:
    law, observing = configure.controller_config(scenario, clock), configure.observer_config(scenario, clock)
    peers = {}
    for robot, agent in zip(configure.agent_configs(scenario, clock), scenario.agents, strict=True):
        body = Body(robot.agent_id, robot.kind, clock, robot.mass, robot.damping, agent.position, agent.velocity)
        hosted = RealtimeController(law, law.make_law), RealtimeAgent(robot, SimulatedDrive(body))
        config = configure.peer_config(scenario, clock, agent.id)
        peers[agent.id] = RealtimePeer(config, RealtimeObserver(observing), *hosted, seals.get(agent.id))
    return peers


if __name__ == "__main__":
    sys.exit(program(measure))
