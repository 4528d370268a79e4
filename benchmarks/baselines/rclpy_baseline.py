"""The baseline of a run over DDS: only its messages, over rclpy, in the fastest known way.

It uses wait sets instead of an executor, serialised messages, and no callbacks, services or rosout; it waits first for
the message that arrives last. After a time-out a process resends its last messages, so a lost packet stops nothing.
"""

from __future__ import annotations

import os
import sys
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from workers import Patience, Workers, agent_of, arguments, blank, stamped, step_of

from swarmabs_msgs import msg

if TYPE_CHECKING:
    from collections.abc import Callable

TOPICS = {
    "agent": (msg.AgentState, "swarm/agent_state"),
    "plane": (msg.PlaneState, "plane/state"),
    "abstract": (msg.AbstractState, "swarm/abstract_state"),
    "auxiliary": (msg.AuxiliaryState, "swarm/auxiliary_state"),
    "desired": (msg.DesiredAbstractState, "swarm/desired_abstract_state"),
}
PARTICIPANT = "SWARMABS_PARTICIPANT"
"""Environment variable from which the DDS profile reads the participant id."""
FIRST_AGENT = 8


class Endpoints:
    """A node with its publishers and subscriptions."""

    def __init__(self, name: str, participant: int) -> None:
        os.environ[PARTICIPANT] = str(participant)
        quiet = ["--ros-args", "--disable-external-lib-logs", "--disable-rosout-logs"]
        rclpy.init(args=quiet, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node(
            name,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self._met: list[Callable[[], bool]] = []

    def publisher(self, topic: str, *, readers: int, reliable: bool = False) -> Callable[[bytes], None]:
        """Return the function that publishes on a topic."""
        kind, name = TOPICS[topic]
        publisher = self._node.create_publisher(kind, name, _qos(10, reliable=reliable))
        self._met.append(lambda: publisher.get_subscription_count() >= readers)
        publish: Callable[[bytes], None] = publisher.publish
        return publish

    def reader(self, topic: str, *, writers: int = 1, depth: int = 10) -> Reader:
        """Subscribe to a topic."""
        kind, name = TOPICS[topic]
        subscription = self._node.create_subscription(kind, name, lambda _: None, _qos(depth), raw=True)
        self._met.append(lambda: subscription.get_publisher_count() >= writers)
        return Reader(subscription.handle, kind, self._node.context.handle)

    def meet(self) -> None:
        """Wait until all matching endpoints are discovered."""
        while not all(met() for met in self._met):
            time.sleep(0.02)


class Reader:
    """A subscription with a private wait set."""

    def __init__(self, handle: Any, kind: Any, context: Any) -> None:
        self._handle, self._kind = handle, kind
        self._wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, context)

    def take(self) -> bytes | None:
        """Return the next message, None if there is none."""
        taken = self._handle.take_message(self._kind, True)
        return None if taken is None else taken[0]

    def wait(self, seconds: float) -> bool:
        """Wait for a message; return whether there is one."""
        self._wait_set.clear_entities()
        self._wait_set.add_subscription(self._handle)
        self._wait_set.wait(int(seconds * 1e9))
        return bool(self._wait_set.get_ready_entities("subscription"))

    def until(self, step: int, patience: Patience, resend: Callable[[], None], *, wait_first: bool) -> None:
        """Wait until the message of a step has arrived."""
        if wait_first and not self.wait(patience.seconds):
            resend()
        while (data := self.take()) is None or step_of(data) < step:
            if data is None and not self.wait(patience.seconds):
                resend()


def _qos(depth: int, *, reliable: bool = False) -> QoSProfile:
    reliability = QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT
    return QoSProfile(history=QoSHistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability)


def agent(number: int, workers: Workers) -> None:
    """Repeat: send a state, wait for the three broadcasts."""
    ends = Endpoints(f"agent_{number:03d}", FIRST_AGENT + number - 1)
    publish = ends.publisher("agent", readers=2)
    # Waits first for the message that arrives last; the others have then usually arrived.
    last, *others = (ends.reader(topic) for topic in ("desired", "abstract", "auxiliary"))
    ends.meet()
    workers.ready()
    state, patience, step = blank("agent", number), Patience(), 0
    while True:
        data = stamped(state, step)
        publish(data)
        again = partial(publish, data)
        last.until(step, patience, again, wait_first=True)
        for reader in others:
            reader.until(step, patience, again, wait_first=False)
        patience.step()
        step += 1


def gather(reader: Reader, robots: int, step: int, patience: Patience, resend: Callable[[], None]) -> None:
    """Wait until the states of all robots for a step have arrived."""
    seen: set[int] = set()
    while len(seen) < robots:
        data = reader.take()
        if data is None:
            if not reader.wait(patience.seconds):
                resend()
        elif step_of(data) == step:
            seen.add(agent_of(data))
    patience.step()


def observer(robots: int, reliable: bool, workers: Workers) -> None:  # noqa: FBT001 - called through partial
    """Repeat: gather the states, send two broadcasts."""
    ends = Endpoints("abstraction_observer", 1)
    abstract, auxiliary = (
        ends.publisher(topic, readers=robots, reliable=reliable) for topic in ("abstract", "auxiliary")
    )
    states = ends.reader("agent", writers=robots, depth=10 * robots)
    ends.meet()
    workers.ready()
    first, second, patience, step = blank("abstract"), blank("auxiliary"), Patience(), 0
    sent = (b"", b"")

    def repeat() -> None:
        if step:
            abstract(sent[0])
            auxiliary(sent[1])

    while True:
        gather(states, robots, step, patience, repeat)
        sent = stamped(first, step), stamped(second, step)
        step += 1
        repeat()


def plane(robots: int, reliable: bool, workers: Workers) -> None:  # noqa: FBT001
    """Repeat: gather the states, send the plane's state to the controller."""
    ends = Endpoints("plane_sim", 0)
    publish = ends.publisher("plane", readers=1, reliable=reliable)
    states = ends.reader("agent", writers=robots, depth=10 * robots)
    ends.meet()
    workers.ready()
    message, patience, step, sent = blank("plane"), Patience(), 0, b""

    def repeat() -> None:
        if step:
            publish(sent)

    while True:
        gather(states, robots, step, patience, repeat)
        sent = stamped(message, step)
        step += 1
        repeat()


def controller(robots: int, reliable: bool, workers: Workers) -> None:  # noqa: FBT001
    """Repeat: answer the plane's state with the third broadcast."""
    ends = Endpoints("parent_controller", 2)
    publish = ends.publisher("desired", readers=robots, reliable=reliable)
    plane_states = ends.reader("plane")
    ends.meet()
    workers.ready()
    message, patience, step, sent = blank("desired"), Patience(), 0, b""

    def repeat() -> None:
        if step:
            publish(sent)

    while True:
        plane_states.until(step, patience, repeat, wait_first=True)
        patience.step()
        workers.made(step)
        sent = stamped(message, step)
        step += 1
        repeat()


def main() -> int:
    """Run the baseline program."""
    parser = arguments()
    parser.add_argument("--reliable-broadcasts", action="store_true")
    given = parser.parse_args()
    for kind, _ in TOPICS.values():
        kind.__class__.__import_type_support__()
    robots, reliable = given.robots, given.reliable_broadcasts
    roles = {
        "plane_sim": partial(plane, robots, reliable),
        "abstraction_observer": partial(observer, robots, reliable),
        "parent_controller": partial(controller, robots, reliable),
        **{f"agent_{number:03d}": partial(agent, number) for number in range(1, robots + 1)},
    }
    return Workers().serve(roles)


if __name__ == "__main__":
    sys.exit(main())
