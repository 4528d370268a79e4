"""A bag for RViz and Foxglove: the messages of a recorded run, and frames computed from them."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from rclpy.serialization import serialize_message

from swarmabs_bag.attached import PROVENANCE_FILE, SCENARIO_FILE, attached_scenario
from swarmabs_bag.errors import DamagedBagError, NotABagError, UnknownTypeError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run.channels import check_definitions
from swarmabs_bag.run.schemas import message_schema
from swarmabs_bag.run.writer import BagWriter
from swarmabs_bag.run_folder import new_folder
from swarmabs_bag.shown.swarm_state import SwarmState
from swarmabs_config.graph import LOCKSTEP, OFFERED, REALTIME
from swarmabs_core.cdr import decode
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import BASIS, PlaneState, Topic
from swarmabs_view.visualization.ros_messages import CLOCK, Translator, available_topics, description
from swarmabs_view.visualization.scene import Scene

if TYPE_CHECKING:
    from pathlib import Path

    from swarmabs_view.visualization.ros_messages import RosMessage, VisualTopic

_KEPT = (SCENARIO_FILE, PROVENANCE_FILE)
"""Attachments copied to the new bag, so that it can be verified and repeated."""
_TOLERANCE = 1e-6
"""Fraction of the frame period by which a frame may be early, because periods are not exact in binary."""


def write_markers(path: Path, folder: Path, *, rate: float = 30.0, namespace: str | None = None) -> Path:
    """Write a copy of a bag with added frames, completely or not at all, and return its folder.

    There are at most `rate` frames per second of recorded time. The folder must be new or empty.

    Raises
    ------
    InputError
        If it is not the bag of a swarm with its scenario, or the folder exists.
    RunError
        If the bag is damaged or the disk fails.
    """
    bag = open_bag(path, namespace=namespace)
    if bag.namespace is None:
        raise NotABagError(f"{bag.path} is not the bag of a swarm: it has none of its topics; name another bag")
    scenario = attached_scenario(bag).resolved()
    scene, translator, swarm = Scene.of(scenario), Translator(), SwarmState.of(scenario)
    check_definitions(bag.path, bag.channels)
    own = bag.topics()
    drawn = {topic: Topic(topic.name, PlaneState, topic.ros_type) for topic in _recordable()}
    with (
        new_folder(folder) as part,
        BagWriter(
            part,
            topics=(*own, *drawn.values()),
            attachments={name: text for name in _KEPT if (text := bag.attachment(name)) is not None},
            namespace=bag.namespace,
            qos=OFFERED[REALTIME if BASIS in own else LOCKSTEP] | {topic: shown.qos for shown, topic in drawn.items()},
        ) as writer,
    ):
        now, period = bag.start, 1e9 / rate

        def write(shown: VisualTopic, message: RosMessage) -> None:
            if shown in drawn:
                writer.write(drawn[shown], now, serialize_message(message))

        write(*description(scene))
        due = float(now)

        def draw() -> float:
            """Draw a frame if one is due, and return when the next is due."""
            if now < due - _TOLERANCE * period:
                return due
            frame = scene.frame(swarm)
            for shown, message in translator.messages(frame, clock=False) if frame is not None else ():
                write(shown, message)
            return max(due + period, float(now))

        for channel, stored in bag.stored_messages():
            if channel.topic is None:
                continue
            if stored.log_time > now:  # all earlier messages have been read
                due = draw()
                now = stored.log_time
            writer.write(channel.topic, stored.log_time, stored.payload, stored.publish_time)
            try:
                swarm.add(decode(channel.topic.message, stored.payload))
            except MalformedMessageError as error:
                raise DamagedBagError(
                    f"{bag.path}: {channel.name} at {stored.log_time / 1e9:.9g} s: {error}"
                ) from error
        draw()
    return folder


def _recordable() -> list[VisualTopic]:
    """Return the topics whose definitions are installed, except the clock, which a player publishes itself."""
    topics = []
    for topic in available_topics():
        with suppress(UnknownTypeError):
            message_schema(topic.ros_type)
            topics.append(topic)
    return [topic for topic in topics if topic is not CLOCK]
