"""Node ``plane_markers``: shows a swarm on standard ROS topics and in Foxglove; it only subscribes to the swarm."""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rclpy.serialization import serialize_message

from swarmabs_bag.run.schemas import message_schema
from swarmabs_bag.shown.swarm_state import SwarmState
from swarmabs_config.scenario import load_scenario
from swarmabs_core.cdr import agent_id_of
from swarmabs_core.declaration import made_of, parameters_of, setting
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import EVENTS, PLANE_FAMILY
from swarmabs_ros.endpoints import profile
from swarmabs_ros.parameters import declare
from swarmabs_ros.start import SwarmNode, run_program
from swarmabs_view.listener import Listener
from swarmabs_view.ports import ADDRESS, need_foxglove
from swarmabs_view.visualization.ros_messages import (
    DESCRIPTION,
    Translator,
    available_topics,
    description,
    message_class,
)
from swarmabs_view.visualization.scene import Scene

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from typing_extensions import Self

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Topic
    from swarmabs_ros.status import StatusChannel
    from swarmabs_view.visualization.ros_messages import RosMessage, VisualTopic

    Publish = Callable[[VisualTopic, RosMessage], None]

RATE = 30.0


@dataclass(frozen=True, slots=True)
class ViewSettings:
    """Settings of the node."""

    scenario_file: str = setting("", "scenario file with the dimensions of the plane and the robots")
    rate: float = setting(RATE, "most frames per second of wall time", above=0.0, maximum=1000.0)
    ros: bool = setting(default=True, description="whether to publish on ROS topics")
    clock: bool = setting(default=False, description="whether to publish the time of the steps on clock")
    foxglove_port: int = setting(-1, "TCP port on 127.0.0.1 for Foxglove, 0: any; -1: none", minimum=-1, maximum=65535)


PARAMETERS = parameters_of(ViewSettings)
SHARE = 0.2
"""Largest fraction of a core for drawing; expensive frames are drawn less often."""
REPEAT = 1.0
"""Time between two descriptions, for clients that do not keep the last, s."""
BACKLOG = 64
"""Most queued messages for a slow Foxglove client; then the oldest are dropped."""
_SLICE = 0.05


def main(args: list[str] | None = None, wait: Callable[[float], bool] | None = None) -> int:
    """Run the node until it is stopped, and return the exit code of `run_program`.

    `wait` waits for a time (s) and returns True if the node must end; by default on SIGINT or SIGTERM.
    """

    def body(node: SwarmNode, _: StatusChannel) -> None:
        settings = made_of(ViewSettings, declare(node, PARAMETERS))
        scenario = _scenario(settings)
        listener = Listener(node, len(scenario.agents), (PLANE_FAMILY,))
        publish: list[Publish] = [ros_publisher(node)] if settings.ros else []
        port = settings.foxglove_port
        if port < 0:
            show(scenario, listener, publish, None, settings, wait or _until_signalled())
            return
        with FoxgloveServer(port, node.get_namespace(), listener.topics) as foxglove:
            sys.stderr.write(f"Foxglove: connect to ws://{ADDRESS}:{foxglove.port}\n")
            show(scenario, listener, [*publish, foxglove.publish], foxglove, settings, wait or _until_signalled())

    return run_program("plane_markers", SwarmNode, body, args)


def ros_publisher(node: SwarmNode) -> Publish:
    """Return a function that publishes on the visual topics of a node."""
    publishers = {
        topic: node.create_publisher(message_class(topic.ros_type), topic.name, profile(topic.qos))
        for topic in available_topics()
    }
    return lambda topic, message: publishers[topic].publish(message)


class FoxgloveServer:
    """A Foxglove server on the loopback interface for the visual topics and the swarm's own `topics`.

    Port 0 means any free port.

    Raises
    ------
    InputError
        If the package foxglove-sdk is not installed.
    RunError
        If the port is taken.
    """

    def __init__(self, port: int, namespace: str, topics: Iterable[Topic]) -> None:
        need_foxglove()
        import foxglove  # noqa: PLC0415 - optional

        self._context = context = foxglove.Context()
        types = {topic.name: topic.ros_type for topic in topics}
        types |= {topic.name: topic.ros_type for topic in available_topics()}
        self._channels = {}
        for name, ros_type in types.items():
            schema = foxglove.Schema(name=ros_type, encoding="ros2msg", data=message_schema(ros_type).text.encode())
            self._channels[name] = foxglove.Channel(
                f"{namespace.rstrip('/')}/{name}", schema=schema, message_encoding="cdr", context=context
            )
        self._description = b""
        try:
            self._server = foxglove.start_server(
                name="swarmabs", host=ADDRESS, port=port, context=context, message_backlog_size=BACKLOG
            )
        except RuntimeError as error:
            raise RunError(f"cannot serve Foxglove on {ADDRESS}:{port}: {error}; choose another port") from error
        self.port = int(self._server.port)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop()

    def publish(self, topic: VisualTopic, message: RosMessage) -> None:
        """Send a message of a visual topic."""
        payload = serialize_message(message)
        if topic is DESCRIPTION:
            self._description = payload
        self._channels[topic.name].log(payload)

    def forward(self, topic: Topic, payload: bytes) -> None:
        """Send a message of the swarm unchanged."""
        self._channels[topic.name].log(payload)

    def repeat(self) -> None:
        """Send the description of the plane again, for new clients."""
        self._channels[DESCRIPTION.name].log(self._description)


def show(
    scenario: Scenario,
    listener: Listener,
    publishers: Sequence[Publish],
    foxglove: FoxgloveServer | None,
    settings: ViewSettings,
    wait: Callable[[float], bool],
) -> None:
    """Show the swarm: a frame for each new step, at a limited rate."""
    scene, translator, swarm = Scene.of(scenario), Translator(), SwarmState.of(scenario)
    for publish in publishers:
        publish(*description(scene))
    repeated = time.monotonic()
    period, pause, shown = 1.0 / settings.rate, 0.0, None
    while not wait(pause):
        begun = time.monotonic()
        for own, payload in _hear(listener, swarm):
            if foxglove is not None:
                foxglove.forward(own, payload)
        frame = scene.frame(swarm)
        if frame is not None and frame.step != shown:
            shown = frame.step
            for topic, message in translator.messages(frame, clock=settings.clock):
                for publish in publishers:
                    publish(topic, message)
        if foxglove is not None and begun - repeated >= REPEAT:
            repeated = begun
            foxglove.repeat()
        cost = time.monotonic() - begun
        pause = max(period - cost, cost * (1.0 / SHARE - 1.0))


def _hear(listener: Listener, swarm: SwarmState) -> list[tuple[Topic, bytes]]:
    """Process the received messages; return the newest of each robot and broadcast, and all events."""
    newest: dict[tuple[Topic, int], bytes] = {}
    for number, (topic, message, payload) in enumerate(listener.poll()):
        swarm.add(message)
        newest[topic, number if topic is EVENTS else agent_id_of(message)] = payload
    return [(topic, payload) for (topic, _), payload in newest.items()]


def _scenario(settings: ViewSettings) -> Scenario:
    if not settings.scenario_file:
        raise InputError("parameter scenario_file is empty: give the scenario file")
    return load_scenario(Path(settings.scenario_file)).resolved()


def _until_signalled() -> Callable[[float], bool]:
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)

    def wait(seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while not stopped and (left := deadline - time.monotonic()) > 0.0:
            time.sleep(min(left, _SLICE))
        return stopped

    return wait


if __name__ == "__main__":
    sys.exit(main())
