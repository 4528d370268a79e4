"""Node ``plane_markers``: shows a swarm on the standard topics of ROS and to Foxglove; of the swarm it only hears."""

from __future__ import annotations

import signal
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_bag.swarm_state import SwarmState
from swarmabs_config.scenario import load_scenario
from swarmabs_core.cdr import agent_id_of
from swarmabs_core.errors import InputError
from swarmabs_core.messages import EVENTS
from swarmabs_core.parameters import Parameter
from swarmabs_ros.parameters import declare
from swarmabs_ros.program import SwarmNode, run_program
from swarmabs_ros.runner import Settings
from swarmabs_view.listener import Listener
from swarmabs_view.ports import ADDRESS
from swarmabs_view.visualization.description import plane_urdf
from swarmabs_view.visualization.ros_messages import Translator, description
from swarmabs_view.visualization.scene import Scene
from swarmabs_view.visualization.sinks import FoxgloveSink, RosSink

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Topic
    from swarmabs_ros.status import StatusChannel
    from swarmabs_view.visualization.sinks import Sink

RATE = 30.0
PARAMETERS = (
    Parameter("scenario_file", "", "file of the scenario, with the plane's and the robots' dimensions"),
    Parameter("rate", RATE, "most frames per second of wall time", above=0.0, maximum=1000.0),
    Parameter("ros", default=True, description="whether to publish on topics of ROS"),
    Parameter("clock", default=False, description="whether to publish the time of the steps as clock"),
    Parameter("foxglove_port", -1, "TCP port on 127.0.0.1 for Foxglove, 0: any; -1: none", minimum=-1, maximum=65535),
)
SHARE = 0.2
"""Largest part of a core that drawing takes: where a frame costs more, there are fewer."""
REPEAT = 1.0
"""Time, s, between two descriptions for clients that do not keep the last."""
_SLICE = 0.05


def main(args: list[str] | None = None, wait: Callable[[float], bool] | None = None) -> int:
    """Run the node until it is told to stop.

    Parameters
    ----------
    args : list of str, optional
        Command line without the program's name.
    wait : callable, optional
        Waits for a time (s) and returns True if the node is to end; by default until SIGINT or SIGTERM.

    Returns
    -------
    int
        Exit code: 0 fine, 1 failed, 2 a parameter or the Fast DDS profile was refused.
    """

    def body(node: SwarmNode, _: StatusChannel) -> None:
        settings = Settings(declare(node, PARAMETERS), node.get_namespace())
        scenario = _scenario(settings)
        listener = Listener(node, len(scenario.agents))
        with ExitStack() as stack:
            sinks: list[Sink] = []
            if settings.flag("ros"):
                sinks.append(RosSink(node))
                stack.callback(sinks[-1].close)
            if settings.integer("foxglove_port") >= 0:
                served = FoxgloveSink(settings.integer("foxglove_port"), settings.namespace, listener.topics)
                sinks.append(served)
                stack.callback(served.close)
                sys.stderr.write(f"Foxglove finds the swarm at ws://{ADDRESS}:{served.port}\n")
            show(scenario, listener, sinks, settings, wait or _until_signalled())

    return run_program("plane_markers", SwarmNode, body, args)


def show(
    scenario: Scenario, listener: Listener, sinks: Sequence[Sink], settings: Settings, wait: Callable[[float], bool]
) -> None:
    """Show the swarm, a frame whenever there is a new step and it is time for one."""
    scene, translator, swarm = Scene.of(scenario), Translator(), SwarmState.of(scenario)
    urdf = description(plane_urdf(scene.layout, scenario.plane.inertia))
    for sink in sinks:
        sink.publish(*urdf)
    repeated = time.monotonic()
    period, pause, shown = 1.0 / settings.number("rate"), 0.0, None
    while not wait(pause):
        begun = time.monotonic()
        _hear(listener, swarm, sinks)
        frame = scene.frame(swarm)
        if frame is not None and frame.step != shown:
            shown = frame.step
            for topic, message in translator.messages(frame, clock=settings.flag("clock")):
                for sink in sinks:
                    sink.publish(topic, message)
        if begun - repeated >= REPEAT:
            repeated = begun
            for sink in sinks:
                sink.repeat()
        cost = time.monotonic() - begun
        pause = max(period - cost, cost * (1.0 / SHARE - 1.0))


def _hear(listener: Listener, swarm: SwarmState, sinks: Sequence[Sink]) -> None:
    """Take what has come; sinks get the newest of each robot and each broadcast, and all events."""
    newest: dict[tuple[Topic, int], bytes] = {}
    for number, (topic, message, payload) in enumerate(listener.poll()):
        swarm.add(message)
        newest[topic, number if topic is EVENTS else agent_id_of(message)] = payload
    for (topic, _), payload in newest.items():
        for sink in sinks:
            sink.forward(topic, payload)


def _scenario(settings: Settings) -> Scenario:
    if not settings.text("scenario_file"):
        raise InputError("parameter scenario_file: give the file of the scenario")
    return load_scenario(Path(settings.text("scenario_file"))).resolved()


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
