"""A swarm in real time whose processes get a quarter of the time while they start."""

import os
import signal
import threading
import time
from collections.abc import Collection
from pathlib import Path
from typing import Any

import pytest
from tests.processes import until
from tests.system.realtime import PATIENCE, Client, realtime_network, start_swarm

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

STOPPED, GOING, ROUNDS = 0.15, 0.05, 120
"""Time, s, for which all processes stand still in each round of the load, and for which they go on."""
ROBOTS = (1, 2, 3)
AT_MOST = 1000
"""States of the plane, 10 s of them, within which all robots have followed after the load."""
RECENT = 20
"""Steps by which the broadcasts that a robot follows may be behind its state."""


class Load(threading.Thread):
    """Lets processes stand still for most of the time, all at once, without keeping this machine busy."""

    def __init__(self, pids: Collection[int]) -> None:
        super().__init__()
        self._pids = pids

    def run(self) -> None:
        for _ in range(ROUNDS):
            for number, seconds in ((signal.SIGSTOP, STOPPED), (signal.SIGCONT, GOING)):
                for pid in self._pids:
                    os.kill(pid, number)
                time.sleep(seconds)


def states_of(client: Client) -> dict[int, dict[str, Any]]:
    """Return the newest state of each robot that was heard."""
    newest = client.look()["newest"]
    topics = {robot: f"swarm/agent_state {robot}" for robot in ROBOTS}
    return {robot: newest[topic] for robot, topic in topics.items() if topic in newest}


def following(client: Client) -> set[int]:
    """Return the robots whose newest command rests on recent broadcasts."""
    states = states_of(client)
    return {robot for robot, state in states.items() if 0 <= state["step"] - state["broadcast_step"] < RECENT}


def test_a_swarm_follows_soon_after_an_overload_at_its_start(tmp_path: Path) -> None:
    with realtime_network(tmp_path) as network:
        client = network.client()
        nodes = start_swarm(network, start_mode="stop")
        load = Load([node.pid for node in nodes.values()])
        load.start()
        load.join()
        until(lambda: client.look()["heard"].get("plane/state", 0) > 0, "the plane is heard", PATIENCE)
        until(lambda: len(states_of(client)) == len(ROBOTS), lambda: f"all robots in {states_of(client)}", PATIENCE)
        assert not following(client)
        before = client.look()["heard"]["plane/state"]
        assert client.trigger("swarm/reset") == [True, ""]
        # Not all at once: on a busy machine the one or the other may stop again for a moment.
        followed: set[int] = set()

        def follow() -> bool:
            followed.update(following(client))
            return followed == {*ROBOTS}

        until(follow, lambda: f"not only {followed} have followed: {states_of(client)}", PATIENCE)
        assert client.look()["heard"]["plane/state"] - before <= AT_MOST
