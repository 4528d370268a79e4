"""Somebody in the network of a fleet without encryption who sends the robots what he likes.

Usage: python -m tests.hosts.intruder KIND SEED EPOCH_NS PERIOD_NS AGENT_ID...

With `flood` he forges anything for the steps around now: of every robot, and of all who command them; true-looking or
nonsense. With `lead` he plays observer and parent controller, so well that robots believe him when the real ones are
gone; he opens the latch of those that are stopped. He says "ready", and goes on until he is ended.
"""

from __future__ import annotations

import sys
import time
from math import inf, nan
from pathlib import Path
from random import Random
from typing import Any

import rclpy
from rclpy.node import Node
from tests.hosts.namespaces import say

from swarmabs_config.fleet.checked import Fleet
from swarmabs_config.fleet.participants import node_plans
from swarmabs_config.graph import REALTIME
from swarmabs_config.ports import metatraffic_port
from swarmabs_core.cdr import encode
from swarmabs_core.messages import (
    TOPIC_OF,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    Kind,
    Message,
    Mode,
    PlaneState,
    Status,
)
from swarmabs_core.realtime.controller import RESET_SECONDS
from swarmabs_ros.endpoints import advertise
from swarmabs_run.orchestration.network import FIRST_FREE, Discovery, dds_environment, network_profile_xml

_PACE = 0.004
MASSES = (0.4, 0.4)
"""Of the swarm that he makes up, kg: less than there is, so that it is believed."""


def environment(folder: Path, fleet: Fleet, address: str) -> dict[str, str]:
    """Return the environment of one who announces himself to all nodes of a fleet, of which he knows all addresses."""
    domain = fleet.network.domain
    known = tuple((fleet.address(node.host), metatraffic_port(domain, node.participant)) for node in node_plans(fleet))
    profile = folder / "intruder.xml"
    text = network_profile_xml(address, Discovery(peers=known), participant=FIRST_FREE)
    profile.write_text(text, encoding="utf-8")
    return {**dds_environment(fleet.network.domain, str(profile)), "ROS_LOG_DIR": "/run"}


def flood(draw: Random, now: int, step: int, mode: Mode, ids: list[int]) -> list[Message]:
    """Return one message, of any kind and mode."""

    def number() -> float:
        return draw.choice((0.0, nan, inf, -1e300, draw.gauss(0.0, 0.1), draw.gauss(0.0, 1.0), draw.gauss(0.0, 10.0)))

    def numbers(size: int) -> list[float]:
        return [number() for _ in range(size)]

    step = max(0, step + draw.randint(-8, 8) if draw.random() < 0.9 else draw.getrandbits(63))
    what = draw.randrange(5)
    if what == 0:
        # A robot that always says the same looks the truest.
        place = number() if draw.random() < 0.5 else draw.uniform(-0.5, 0.5)
        identity = (draw.choice([*ids, 4711]), draw.choice(list(Kind)), draw.choice(list(Status)))
        return [AgentState(now, step, max(0, step - 1), *identity, 0.4, 0.5, place, number(), number())]
    if what == 1:
        return [AbstractState(now, step, 2, *numbers(4))]
    if what == 2:
        return [AuxiliaryState(now, step, *numbers(8))]
    if what == 3:
        return [DesiredAbstractState(now, step, draw.choice(list(Mode)), *numbers(8))]
    return [PlaneState(now, step, number(), number())]


def lead(draw: Random, now: int, step: int, mode: Mode, ids: list[int]) -> list[Message]:
    """Return the broadcasts of a step: of a swarm that is made up, and that shall be as far from the axis as can be."""
    a, b = MASSES
    place = 0.1
    s0, s1, s2 = a * a + b * b, (a * a - b * b) * place, (a * a + b * b) * place * place
    spread = 4.0 * a * a * b * b * place * place
    return [
        AbstractState(now, step, 2, 0.0, (a + b) * place * place, 0.0, 0.0),
        AuxiliaryState(now, step, s0, s1, s2, spread, 0.1, 0.0, 0.1 * place * place, 0.0),
        DesiredAbstractState(now, step, mode, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ]


def main() -> None:
    kind, seed, epoch, period, *ids = sys.argv[1:]
    make: Any = {"flood": flood, "lead": lead}[kind]
    rclpy.init(args=["--ros-args", "--disable-external-lib-logs"])
    node = Node("stranger", enable_rosout=False, start_parameter_services=False)
    kinds = (AgentState, AbstractState, AuxiliaryState, DesiredAbstractState, PlaneState)
    publishers = {message: advertise(node, TOPIC_OF[message], REALTIME) for message in kinds}
    draw, last = Random(seed), -1
    reset_until = time.time_ns() + round(RESET_SECONDS * 1e9)
    say("ready")
    while True:
        now = time.time_ns()
        step = (now - int(epoch)) // int(period)
        if kind == "flood" or step > last:
            last = step
            mode = Mode.RESET if now < reset_until else Mode.RUN
            for message in make(draw, now, step, mode, list(map(int, ids))):
                publishers[type(message)].publish(encode(message))
        time.sleep(_PACE)


if __name__ == "__main__":
    main()
