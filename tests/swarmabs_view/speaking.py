"""A swarm that speaks on the topics of ROS, by the very node that listens: nobody has to be found in the network."""

import asyncio
import time
from collections.abc import Callable
from itertools import count

from tests.swarmabs_bag.sample_run import make_run, make_step

from swarmabs_core.cdr import encode
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, TOPIC_OF, Message, SwarmEvent
from swarmabs_ros.endpoints import advertise
from swarmabs_ros.start import SwarmNode

EVENT = next(message for message in make_run(3) if isinstance(message, SwarmEvent))


class SpeakingNode(SwarmNode):
    """Publishes what a swarm in its namespace would."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._steps = count()
        self._own = {topic: advertise(self, topic) for topic in (*MAIN_TOPICS, EVENTS)}

    def step(self) -> int:
        """Say all of the next step of the sample run, and with the fourth its event; return its number."""
        step = next(self._steps)
        self.say(*make_step(step), *([EVENT] if step == 3 else []))
        return step

    def say(self, *messages: Message, bytes_lost: int = 0) -> None:
        """Publish messages, of which the last bytes may be lost."""
        for message in messages:
            payload = encode(message)
            self._own[TOPIC_OF[type(message)]].publish(payload[: len(payload) - bytes_lost])


async def eventually(condition: Callable[[], object], what: str, seconds: float = 15.0) -> None:
    """Do as `tests.processes.until` does, while the loop goes on."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"not within {seconds:g} s: {what}"
        await asyncio.sleep(0.005)
