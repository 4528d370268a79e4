"""Somebody in the network of a fleet without encryption who plays its observer and parent controller.

Usage: python -m tests.hosts.intruder EPOCH_NS PERIOD_NS

Robots believe him when the real ones are gone; he opens the latch of those that are stopped. He says "ready", and goes
on until he is ended.
"""

import sys
import time
from pathlib import Path

import rclpy
from rclpy.node import Node
from tests.hosts.namespaces import say

from swarmabs_config.fleet.checked import Fleet
from swarmabs_config.fleet.participants import node_plans
from swarmabs_config.graph import REALTIME
from swarmabs_config.ports import metatraffic_port
from swarmabs_core.cdr import encode
from swarmabs_core.messages import TOPIC_OF, AbstractState, AuxiliaryState, DesiredAbstractState, Message, Mode
from swarmabs_core.realtime.controller import RESET_SECONDS
from swarmabs_ros.endpoints import advertise
from swarmabs_run.orchestration.network import FIRST_FREE, Discovery, dds_environment, network_profile_xml

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


def broadcasts(now: int, step: int, mode: Mode) -> list[Message]:
    """Return those of a step: of a swarm that is made up, and that shall be as far from the axis as can be."""
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
    epoch, period = map(int, sys.argv[1:])
    rclpy.init(args=["--ros-args", "--disable-external-lib-logs"])
    node = Node("stranger", enable_rosout=False, start_parameter_services=False)
    kinds = (AbstractState, AuxiliaryState, DesiredAbstractState)
    publishers = {message: advertise(node, TOPIC_OF[message], REALTIME) for message in kinds}
    reset_until = time.time_ns() + round(RESET_SECONDS * 1e9)

    def intrude() -> None:
        now = time.time_ns()
        mode = Mode.RESET if now < reset_until else Mode.RUN
        for message in broadcasts(now, (now - epoch) // period, mode):
            publishers[type(message)].publish(encode(message))

    node.create_timer(period / 1e9, intrude)
    say("ready")
    rclpy.spin(node)


if __name__ == "__main__":
    main()
