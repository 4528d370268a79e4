"""Random scenarios with random faults; each depends on a seed and its number alone."""

from __future__ import annotations

import math
from random import Random
from typing import TYPE_CHECKING, Any

from swarmabs_bag.metadata import dump_yaml
from swarmabs_config.scenario import parse_scenario

if TYPE_CHECKING:
    from swarmabs_config.scenario import Scenario

FAULTS_UNTIL = 18.0
"""Time, s, at which the last fault is over."""
DURATION = 30.0
FEWEST, MOST = 4, 10
"""Numbers of robots that are drawn if none is given."""

_INERTIA = 0.0288  # kg m^2 of the robots at the start, as of the paper's four
_SHORT = 0.42  # m; robots come to its ends now and then
_CONTROLLERS: tuple[dict[str, Any], ...] = (
    {"type": "pd"},
    {"type": "lqr"},
    {"type": "arise", "trajectory": {"type": "sine"}},
    {"type": "arise", "trajectory": {"type": "constant"}},
)


def drawn_scenario(seed: int, number: int, robots: int | None = None) -> Scenario:
    """Draw a scenario.

    Parameters
    ----------
    seed : int
        Seed of the soak.
    number : int
        Number of the run in it.
    robots : int, optional
        How many robots there are; drawn if not given.
    """
    random = Random(f"{seed}:{number}")  # noqa: S311 - no secret
    count = robots or random.randint(FEWEST, MOST)
    agents = _agents(random, count)
    controller = random.choice(_CONTROLLERS)
    data: dict[str, Any] = {
        "schema": 1,
        "name": f"soak_{seed}_{number}",
        "duration": DURATION,
        "step": random.choice((0.01, 0.01, 0.02)),
        "seed": random.randrange(2**31),
        "plane": {
            "angle": _between(random, -0.15, 0.15),
            "disturbance": {"amplitude": 0.1 if controller["type"] == "arise" and _chance(random, 0.5) else 0.0},
        },
        "manifold": {"torque_max": 2.0},
        "controller": controller,
        "swarm": {"agents": agents},
        "faults": _faults(random, count),
    }
    if _chance(random, 0.3):
        data["swarm"]["sensor"] = {"noise": [1e-5, 1e-4]}
        data["plane"]["sensor"] = {"noise": [1e-5, 1e-4]}
    if _chance(random, 0.2):
        data["swarm"]["actuator_lag"] = 0.01
    if _chance(random, 0.3):
        data["limits"] = {"velocity": 1.0, "force": 5.0}
    if _chance(random, 0.3):
        data["plane"]["length"] = _SHORT
    return parse_scenario(dump_yaml(data), source=f"run {number} of seed {seed}").resolved()


def _agents(random: Random, count: int) -> list[dict[str, Any]]:
    """Return robots on alternating sides, together with the paper's inertia."""
    masses = [_between(random, 0.25, 0.75) for _ in range(count)]
    distance = math.sqrt(_INERTIA / math.fsum(masses))
    agents = []
    for index, mass in enumerate(masses):
        side = 1.0 if index % 2 else -1.0
        agent: dict[str, Any] = {"id": index + 1, "mass": mass, "kind": "single_integrator"}
        agent["position"] = round(side * distance * random.uniform(0.8, 1.2), 4)
        if _chance(random, 0.5):
            agent |= {"kind": "double_integrator", "damping": _between(random, 0.5, 1.5)}
        agents.append(agent)
    return agents


def _faults(random: Random, count: int) -> list[dict[str, Any]]:
    """Return faults after which at least two thirds of the robots, and three, are there and true."""
    ids = random.sample(range(1, count + 1), count)
    going = [ids.pop() for _ in range(random.randint(0, max(1, min(count // 3, count - 3))))]
    coming = [ids.pop() for _ in range(random.randint(0, count // 4))]
    faults: list[dict[str, Any]] = [
        {
            "kind": random.choice(("kill", "freeze", "leave", "remove")),
            "at": _between(random, 1.0, FAULTS_UNTIL),
            "agent": agent,
        }
        for agent in going
    ]
    faults += [{"kind": "join", "at": _between(random, 1.0, FAULTS_UNTIL), "agent": agent} for agent in coming]
    for kind, value in (("reference", "offset"), ("disturbance", "torque")):
        if _chance(random, 0.3):
            begin = _between(random, 0.0, FAULTS_UNTIL - 6.0)
            until = round(begin + random.uniform(0.1, 6.0), 2)
            faults.append({"kind": kind, "at": begin, "until": until, value: _between(random, -0.1, 0.1)})
    kinds = ("loss", "delay", "duplication", "reordering", "clock_offset", "lie")
    for kind in random.sample(kinds, random.randint(1, 4)):
        fault: dict[str, Any] = {"kind": kind, "from": _between(random, 0.0, FAULTS_UNTIL - 6.0)}
        fault["to"] = round(fault["from"] + random.uniform(0.1, 6.0), 2)
        if kind in {"clock_offset", "lie"}:
            # Who dies while lying is believed for ever, and no swarm recovers from that.
            fault["agent"] = random.choice(ids)
        elif _chance(random, 0.5):
            fault["agents"] = sorted(random.sample(range(1, count + 1), random.randint(1, count)))
        faults.append(fault | _severity(random, kind))
    return faults


def _severity(random: Random, kind: str) -> dict[str, Any]:
    """Return how bad a fault is."""
    if kind == "delay":
        return {"steps": random.randint(1, 3)}
    if kind == "reordering":
        return {"probability": _between(random, 0.05, 0.7), "steps": random.randint(1, 4)}
    if kind == "clock_offset":
        return {"offset": _between(random, -100.0, 100.0)}
    if kind == "lie":
        return {
            "position_offset": _between(random, -0.03, 0.03),
            "position_factor": _between(random, 0.85, 1.15),
            "mass_factor": _between(random, 0.8, 1.25),
        }
    return {"probability": _between(random, 0.05, 0.7)}


def _between(random: Random, low: float, high: float) -> float:
    return round(random.uniform(low, high), 4)


def _chance(random: Random, probability: float) -> bool:
    return random.random() < probability
