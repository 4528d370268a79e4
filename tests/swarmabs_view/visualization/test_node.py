"""The node that shows a swarm to RViz and Foxglove, in this process, and what starts it beside a run."""

import asyncio
import json
import os
import signal
import struct
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tests.processes import until
from tests.swarmabs_analysis.report.conftest import SCENARIO
from tests.swarmabs_bag.sample_run import AGENTS, PERIOD, make_step
from tests.swarmabs_ros.nodes import given
from tests.swarmabs_view.speaking import SpeakingNode
from visualization_msgs.msg import MarkerArray
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

from swarmabs_core.cdr import encode
from swarmabs_core.messages import PlaneState
from swarmabs_ros.endpoints import profile, unheard
from swarmabs_run.orchestration.run_files import ProgressReport, RunOverError
from swarmabs_view.ports import bound
from swarmabs_view.viewers import MARKERS_LOG
from swarmabs_view.visualization import node, run_markers
from swarmabs_view.visualization.ros_messages import VISUAL_TOPICS, message_class

ENOUGH = 3
"""Messages of each topic that are looked at."""
FOXGLOVE = ("/hall/plane/state", "/hall/plane/joint_states", "/hall/swarm/markers", "/hall/robot_description")


class Hearing(SpeakingNode):
    """Says what a swarm would, and hears what it is shown as."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.heard: dict[str, list[Any]] = {topic.name: [] for topic in VISUAL_TOPICS}
        there = [(topic, kind) for topic in VISUAL_TOPICS if (kind := message_class(topic.ros_type)) is not None]
        self._ears = {
            topic.name: (kind, self.create_subscription(kind, topic.name, unheard, profile(topic.qos)))
            for topic, kind in there
        }

    def listen(self) -> None:
        """Take what has come."""
        for name, (kind, subscription) in self._ears.items():
            while (taken := subscription.handle.take_message(kind, False)) is not None:
                self.heard[name].append(taken[0])


async def looked(port: int) -> tuple[dict[str, Any], dict[str, list[bytes]]]:
    """Do as Foxglove does: take what is advertised, subscribe to some of it, and wait for messages of each."""
    channels: dict[str, Any] = {}
    messages: dict[str, list[bytes]] = {topic: [] for topic in FOXGLOVE}
    async with connect(f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None) as link:
        async for frame in link:
            if isinstance(frame, str):
                document = json.loads(frame)
                if document["op"] == "advertise":
                    channels |= {channel["topic"]: channel for channel in document["channels"]}
                    asked = [
                        {"id": number, "channelId": channels[topic]["id"]}
                        for number, topic in enumerate(FOXGLOVE)
                        if topic in channels
                    ]
                    await link.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
            elif frame[0] == 1:  # a message: subscription, time, payload
                messages[FOXGLOVE[struct.unpack_from("<I", frame, 1)[0]]].append(frame[13:])
                if all(messages.values()):
                    break
    return channels, messages


@pytest.fixture
def nodes(ros: None, monkeypatch: pytest.MonkeyPatch) -> list[Hearing]:
    """Return the nodes that are started."""
    found: list[Hearing] = []

    def make(name: str) -> Hearing:
        found.append(Hearing(name))
        return found[-1]

    monkeypatch.setattr(node, "SwarmNode", make)
    return found


def arguments(tmp_path: Path, **parameters: str) -> list[str]:
    """Return the command line of the node for the sample run in the namespace /hall."""
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    given_ = given(scenario_file=str(tmp_path / "scenario.yaml"), rate="1000.0", **parameters)
    return ["--ros-args", "--disable-external-lib-logs", "-r", "__ns:=/hall", *given_]


def step_of(stamp: Any) -> int:
    return int(stamp.sec * 10**9 + stamp.nanosec) // PERIOD


def steps_of(messages: list[Any]) -> list[int]:
    return [step_of(message.header.stamp) for message in messages]


@pytest.mark.parametrize("on_topics", [True, False])
def test_a_swarm_is_shown_as_it_is_heard(
    nodes: list[Hearing], tmp_path: Path, capfd: pytest.CaptureFixture[str], *, on_topics: bool
) -> None:
    with bound(0) as free:
        port = free.getsockname()[1]
    seen: list[tuple[dict[str, Any], dict[str, list[bytes]]]] = []
    client = Thread(target=lambda: seen.append(asyncio.run(asyncio.wait_for(looked(port), 15.0))))
    flag = str(on_topics).lower()
    said: list[int] = []

    def wait(_: float) -> bool:
        if client.ident is None:
            client.start()
        time.sleep(0.005)  # the client is a thread of this process
        said.append(nodes[0].step())
        nodes[0].listen()
        enough = min(len(nodes[0].heard[name]) for name in ("plane/joint_states", "swarm/markers")) >= ENOUGH
        return (enough or not on_topics) and bool(seen)

    words = arguments(tmp_path, foxglove_port=str(port), ros=flag, clock=flag)
    assert node.main(words, wait) == 0
    heard = nodes[0].heard
    joints, markers = heard["plane/joint_states"], heard["swarm/markers"]
    assert f"Foxglove: connect to ws://127.0.0.1:{port}\n" in capfd.readouterr().err
    messages_said = (message for step in said for message in make_step(step))
    planes = {message.step: message for message in messages_said if isinstance(message, PlaneState)}
    if on_topics:
        assert heard["robot_description"][0].data.startswith("<?xml")
        assert heard["clock"] and {step_of(told.clock) for told in heard["clock"]} <= planes.keys()
        assert steps_of(joints) == sorted(set(steps_of(joints)))
        for joint, step in zip(joints, steps_of(joints), strict=True):
            assert (joint.position[0], joint.velocity[0]) == (planes[step].angle, planes[step].angular_velocity)
        assert [marker.id for marker in markers[-1].markers if marker.ns == "robots"] == list(AGENTS)
    else:
        assert not any(heard.values())
    client.join()
    ((channels, messages),) = seen
    types = {topic: channel["schemaName"] for topic, channel in channels.items()}
    assert types["/hall/swarm/markers"] == "visualization_msgs/msg/MarkerArray"
    assert types["/hall/plane/state"] == "swarmabs_msgs/msg/PlaneState"
    encodings = {(channel["encoding"], channel["schemaEncoding"]) for channel in channels.values()}
    assert encodings == {("cdr", "ros2msg")}
    plane, joint, array, description = (messages[topic][0] for topic in FOXGLOVE)
    assert plane in {encode(message) for message in planes.values()}
    assert list(deserialize_message(joint, JointState).name) == ["plane_tilt"]
    assert deserialize_message(array, MarkerArray).markers
    assert "<robot name=" in deserialize_message(description, String).data


def test_it_ends_when_it_is_told_to(nodes: list[Hearing], tmp_path: Path) -> None:
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def described() -> bool:
        if nodes:
            nodes[0].listen()
        return bool(nodes and nodes[0].heard["robot_description"])

    def end() -> None:
        until(described, "the plane is described", 15.0)
        os.kill(os.getpid(), signal.SIGTERM)

    ending = Thread(target=end)
    ending.start()
    assert node.main(arguments(tmp_path)) == 0
    ending.join()
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("ros")
def test_what_cannot_be_shown_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert node.main(["--ros-args", "--disable-external-lib-logs"], lambda _: True) == 2
    assert "error: parameter scenario_file is empty" in capfd.readouterr().err
    with bound(0) as taken:
        port = taken.getsockname()[1]
        assert node.main(arguments(tmp_path, foxglove_port=str(port)), lambda _: True) == 1
    assert f"error: cannot serve Foxglove on 127.0.0.1:{port}: " in capfd.readouterr().err


def told(phase: str) -> ProgressReport:
    return ProgressReport(phase, 0, 100, None, 0.0)


@pytest.fixture
def stdin() -> Iterator[int]:
    """Have a pipe as this process's standard input; return the end that can be written to."""
    kept, (read, write) = os.dup(0), os.pipe()
    os.dup2(read, 0)
    yield write
    os.dup2(kept, 0)
    for number in (kept, read):
        os.close(number)


@pytest.mark.parametrize(
    ("course", "shown"),
    [
        ([None, told("starting"), told("running")], True),
        ([told("closing")], True),
        ([None, told("over")], False),
        ([None, None], False),
        ([told("running"), RunOverError(Path())], False),
    ],
    ids=["starts", "closes", "is over", "is given up", "has just ended"],
)
def test_markers_wait_until_a_run_has_started_and_end_with_their_standard_input(
    course: list[Any], stdin: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, shown: bool
) -> None:
    calls: list[Any] = []

    def read(_: Path) -> ProgressReport | None:
        found: ProgressReport | None = course.pop(0)
        if not course and not shown:
            os.close(stdin)
        return found

    def environment(_: Path) -> dict[str, str]:
        if course:
            raise course[0]
        return {"SWARMABS_TEST": "joined"}

    def main(words: list[str], wait: Callable[[float], bool]) -> int:
        calls.append((words, os.environ["SWARMABS_TEST"], wait(0.01)))
        os.write(stdin, b"more")
        calls.append(wait(0.01))
        os.close(stdin)
        calls.append(wait(15.0))
        return 7

    (tmp_path / "o'run" / "logs").mkdir(parents=True)
    monkeypatch.setattr(sys, "argv", ["run_markers", "123", str(tmp_path / "o'run"), "ros:=true"])
    monkeypatch.setattr(os, "environ", os.environ.copy())
    for name, act in (("die_with_parent", calls.append), ("read_progress", read), ("environment_of_run", environment)):
        monkeypatch.setattr(run_markers, name, act)
    monkeypatch.setattr(node, "main", main)
    monkeypatch.setattr(os, "nice", calls.append)
    monkeypatch.setattr(os, "dup2", lambda _, number: calls.append(number))
    assert run_markers.main() == (7 if shown else 0)
    log = tmp_path / "o'run" / "logs" / MARKERS_LOG
    assert log.exists() == shown
    monkeypatch.undo()
    if not shown:
        assert calls == [123, 10]
        return
    file = f"scenario_file:='{tmp_path}/o''run/scenario.yaml'"
    words = ["--ros-args", "--disable-external-lib-logs", "--disable-rosout-logs", "-p", file, "-p", "ros:=true"]
    assert calls == [123, 10, 1, 2, (words, "joined", False), False, True]
