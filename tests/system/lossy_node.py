"""Any node of a run, except that one message in a hundred never arrives."""

from __future__ import annotations

import importlib
import random
import sys
from typing import Any

from swarmabs_core.messages import Topic
from swarmabs_ros import runner
from swarmabs_ros.endpoints import Receiver

LOSS = 0.01
MODULES = {
    "plane_sim": "plane_sim.node",
    "abstraction_observer": "abstraction_observer.node",
    "parent_controller": "parent_controller.node",
    "recorder": "swarmabs_bag.recorder.node",
}


class LossyReceiver:
    """Loses messages on the way from the middleware to the node."""

    def __init__(self, receiver: Receiver, seed: str) -> None:
        self._receiver = receiver
        self._random = random.Random(seed)

    def take(self, topic: Topic) -> bytes | None:
        while (data := self._receiver.take(topic)) is not None:
            if self._random.random() >= LOSS:
                return data
            sys.stdout.write(f"lost: {topic.name}\n")
            sys.stdout.flush()  # a node that lingers is killed at the end
        return None

    def wait(self, topics: tuple[Topic, ...], timeout: float) -> bool:
        return self._receiver.wait(topics, timeout)

    def publisher_count(self, topic: Topic) -> int:
        return self._receiver.publisher_count(topic)


def main(arguments: list[str]) -> int:
    """Run the node that the command line names."""
    name = next(word.removeprefix("__node:=") for word in arguments if word.startswith("__node:="))
    real = runner.receiver

    def receiver(*parts: Any) -> LossyReceiver:
        return LossyReceiver(real(*parts), name)

    runner.receiver = receiver
    return int(importlib.import_module(MODULES.get(name, "agent_node.node")).main(arguments))
