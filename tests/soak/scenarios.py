"""Scenarios with faults, as hypothesis draws them; a swarm can recover from all of them."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from hypothesis import strategies as st

from swarmabs_bag.run.metadata import dump_yaml
from swarmabs_config.scenario import Scenario, parse_scenario

_INERTIA = 0.0288  # kg m^2 of the robots at the start, as of the paper's four
_SHORT = 0.42  # m; robots come to its ends now and then
_CONTROLLERS: tuple[dict[str, Any], ...] = (
    {"type": "pd"},
    {"type": "lqr"},
    {"type": "pid"},
    {"type": "arise", "trajectory": {"type": "sine"}},
    {"type": "arise", "trajectory": {"type": "constant"}},
)
_LONGEST_FAULT = 6.0
_KINDS = ("loss", "delay", "duplication", "reordering", "clock_offset", "lie")

Draw = Callable[[st.SearchStrategy[Any]], Any]


def between(low: float, high: float) -> st.SearchStrategy[float]:
    """Draw a number in steps of 0.0001."""
    return st.integers(round(low * 1e4), round(high * 1e4)).map(lambda number: number / 1e4)


def sometimes(value: Mapping[str, Any]) -> st.SearchStrategy[dict[str, Any]]:
    """Draw settings, or none."""
    return st.sampled_from(({}, {}, dict(value)))


@st.composite
def scenarios(draw: Draw, duration: float = 30.0, faults_until: float = 18.0) -> Scenario:
    """Draw a scenario that lasts so long (s), and whose last fault is over by then (s)."""
    count = draw(st.integers(4, 10))
    controller = draw(st.sampled_from(_CONTROLLERS))
    amplitude = draw(st.sampled_from((0.0, 0.1))) if controller["type"] == "arise" else 0.0
    noise = {"sensor": {"noise": [1e-5, 1e-4]}}
    noisy = draw(sometimes(noise))
    data = {
        "schema": 1,
        "name": "soak",
        "duration": duration,
        "step": draw(st.sampled_from((0.01, 0.01, 0.02))),
        "seed": draw(st.integers(0, 2**31 - 1)),
        "plane": {
            "angle": draw(between(-0.15, 0.15)),
            "disturbance": {"amplitude": amplitude},
            **noisy,
            **draw(sometimes({"length": _SHORT})),
        },
        "manifold": {"torque_max": 2.0},
        "controller": controller,
        "swarm": {"agents": draw(_agents(count)), **noisy, **draw(sometimes({"actuator_lag": 0.01}))},
        "faults": draw(_faults(count, faults_until)),
        **draw(sometimes({"limits": {"velocity": 1.0, "force": 5.0}})),
    }
    return parse_scenario(dump_yaml(data), source="what was drawn").resolved()


@st.composite
def _agents(draw: Draw, count: int) -> list[dict[str, Any]]:
    """Draw robots on alternating sides, together with the paper's inertia."""
    masses = [draw(between(0.25, 0.75)) for _ in range(count)]
    distance = math.sqrt(_INERTIA / math.fsum(masses))
    agents = []
    for index, mass in enumerate(masses):
        side = 1.0 if index % 2 else -1.0
        agent: dict[str, Any] = {"id": index + 1, "mass": mass, "kind": "single_integrator"}
        agent["position"] = round(side * distance * draw(between(0.8, 1.2)), 4)
        if draw(st.booleans()):
            agent |= {"kind": "double_integrator", "damping": draw(between(0.5, 1.5))}
        agents.append(agent)
    return agents


@st.composite
def _faults(draw: Draw, count: int, until: float) -> list[dict[str, Any]]:
    """Draw faults after which at least two thirds of the robots, and three, are there and true."""
    ids = draw(st.permutations(range(1, count + 1)))
    going = [ids.pop() for _ in range(draw(st.integers(0, max(1, min(count // 3, count - 3)))))]
    coming = [ids.pop() for _ in range(draw(st.integers(0, count // 4)))]
    faults: list[dict[str, Any]] = [
        {
            "kind": draw(st.sampled_from(("kill", "freeze", "leave", "remove"))),
            "at": draw(between(1.0, until)),
            "agent": agent,
        }
        for agent in going
    ]
    faults += [{"kind": "join", "at": draw(between(1.0, until)), "agent": agent} for agent in coming]
    for kind, value in (("reference", "offset"), ("disturbance", "torque")):
        if draw(st.booleans()):
            begin, end = draw(_interval(until))
            faults.append({"kind": kind, "at": begin, "until": end, value: draw(between(-0.1, 0.1))})
    for kind in draw(st.lists(st.sampled_from(_KINDS), min_size=1, max_size=4, unique=True)):
        begin, end = draw(_interval(until))
        fault = {"kind": kind, "from": begin, "to": end}
        if kind in {"clock_offset", "lie"}:
            # Who dies while lying is believed for ever, and no swarm recovers from that.
            fault["agent"] = draw(st.sampled_from(ids))
        elif draw(st.booleans()):
            some = st.lists(st.integers(1, count), min_size=1, unique=True)
            fault["agents"] = sorted(draw(some))
        faults.append(fault | draw(_severity(kind)))
    return faults


@st.composite
def _interval(draw: Draw, until: float) -> tuple[float, float]:
    """Draw begin and end of a fault, s."""
    begin = draw(between(0.0, until - _LONGEST_FAULT))
    return begin, round(begin + draw(between(0.1, _LONGEST_FAULT)), 2)


def _severity(kind: str) -> st.SearchStrategy[dict[str, Any]]:
    """Draw how bad a fault is."""
    settings: dict[str, dict[str, st.SearchStrategy[Any]]] = {
        "delay": {"steps": st.integers(1, 3)},
        "reordering": {"probability": between(0.05, 0.7), "steps": st.integers(1, 4)},
        "clock_offset": {"offset": between(-100.0, 100.0)},
        "lie": {
            "position_offset": between(-0.03, 0.03),
            "position_factor": between(0.85, 1.15),
            "mass_factor": between(0.8, 1.25),
        },
    }
    return st.fixed_dictionaries(settings.get(kind, {"probability": between(0.05, 0.7)}))
