"""Playback of a bag over DDS, by this project and by rosbag2, to nodes that know nothing of it or are under test."""

import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.processes import SEARCH_PATH, until
from tests.system.helpers import LONGEST, BagMessage, bag_messages, seconds, started_swarm, swarm
from tests.system.realtime import Client, started_client

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

FAULTS = "faults=[{at: 0.2, kind: join, agent: 4}, {at: 0.4, kind: kill, agent: 3}, {at: 0.6, kind: leave, agent: 2}]"
TYPES = {
    "/plane/state": "swarmabs_msgs/PlaneState",
    "/swarm/desired_abstract_state": "swarmabs_msgs/DesiredAbstractState",
    "/swarm/events": "swarmabs_msgs/SwarmEvent",
}
PADDING = 3
"""Bytes that a middleware may append."""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a recorded run with planned faults, short enough for the depth of every topic."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    assert swarm("simulate", "pd_het_4", "--set", seconds(0.9), "--set", FAULTS, "-o", folder).code == 0
    return folder


def listens(client: Client) -> None:
    for topic, kind in TYPES.items():
        client.hear(topic, kind)


def until_heard(client: Client, messages: Sequence[BagMessage]) -> int:
    """Wait until a node has heard these messages of its topics, byte for byte, and no other; return how many.

    A reliable reader, however slow, loses none as long as no topic has more messages than its depth of 100.
    """
    sent = {topic: [m.payload for m in messages if f"/{m.topic}" == topic] for topic in TYPES}
    assert all(0 < len(payloads) <= 100 for payloads in sent.values())

    def numbers() -> dict[str, int]:
        return {topic: len(texts) for topic, texts in client.payloads().items()}

    until(lambda: numbers() == {topic: len(sent[topic]) for topic in TYPES}, "everything is heard")
    for topic, texts in client.payloads().items():
        received = [bytes.fromhex(text) for text in texts]
        assert [data[: len(wanted)] for data, wanted in zip(received, sent[topic], strict=True)] == sent[topic], topic
        assert all(len(data) - len(wanted) <= PADDING for data, wanted in zip(received, sent[topic], strict=True))
    return sum(map(len, sent.values()))


def test_playback_reaches_a_stock_node_with_the_recorded_qos(recorded: Path, ros_network: dict[str, str]) -> None:
    part = ("--duration", 0.8, "--rate", 100, "--topics", ",".join(TYPES))
    with started_client(ros_network, "stock_node") as client:
        listens(client)
        with started_swarm("replay", recorded, "--wait", *part, "--json", env=os.environ | ros_network) as command:
            done = command.wait()
        assert done.code == 0, done.err
        offered = client.offered_by()
        assert offered["/plane/state"] == [["RELIABLE", "VOLATILE"]]
        assert offered["/swarm/events"] == [["RELIABLE", "TRANSIENT_LOCAL"]]
        heard = until_heard(client, [m for m in bag_messages(recorded) if m.step <= 80])
    assert done.summary()["messages"] == heard


@pytest.mark.parametrize(("nodes", "gain"), [(("agent:1", "observer"), None), (("controller",), 20.0)])
def test_nodes_under_test_that_are_started_by_hand_answer(
    nodes: tuple[str, ...], gain: float | None, recorded: Path, ros_network: dict[str, str]
) -> None:
    """They are started by the commands that are printed; with the gains of the recording they answer the same."""
    environment = os.environ | ros_network
    named = [word for node in nodes for word in ("--node", node)]
    with (
        ExitStack() as stack,
        started_swarm("replay", recorded, *named, "--expect-same", "--json", env=environment) as command,
    ):
        assert command.process.stderr is not None
        lines: list[str] = []
        while len(lines) < len(nodes):
            line = command.process.stderr.readline()
            assert line, "the playback has ended"
            lines += [line] if line.startswith("  python -m ") else []
        for line in lines:
            _, *words = shlex.split(line)
            words += [] if gain is None else ["-p", f"controller.gains:=[{gain}, 3.0]"]
            process = stack.enter_context(subprocess.Popen([sys.executable, *words], env=environment | SEARCH_PATH))
            stack.callback(process.kill)
        done = command.wait()
    verdict = done.summary()
    states = {"controller": 91, "agent:1": 91, "observer": 2 * 91}
    assert verdict["compared"] >= sum(states[node] for node in nodes)
    assert (done.code, verdict["same"]) == ((0, True) if gain is None else (1, False)), done.err
    if gain is not None:
        first = verdict["first_difference"]
        assert (first["step"], first["field"], first["replayed"]) == (0, "torque", pytest.approx(gain * 0.1, rel=1e-15))
        assert {row["topic"] for row in verdict["deviations"]} == {"swarm/desired_abstract_state"}


def test_playback_in_a_loop_ends_with_ctrl_c(recorded: Path, ros_network: dict[str, str]) -> None:
    with started_swarm("replay", recorded, "--loop", "--rate", 50, env=os.environ | ros_network) as command:
        assert command.process.stderr is not None
        until(lambda: "playing" in command.process.stderr.readline(), "the playback begins", 60.0)  # type: ignore[union-attr]
        os.kill(command.process.pid, signal.SIGINT)
        done = command.wait()
    assert done.code == 0, done.err
    assert done.out.endswith(" messages published\n")


def test_ros2_bag_play_plays_every_message(recorded: Path, ros_network: Mapping[str, str]) -> None:
    """It waits until the listener knows all topics: what is played before is lost on it."""
    ros2 = shutil.which("ros2")
    if ros2 is None or subprocess.run([ros2, "bag", "play", "--help"], capture_output=True, check=False).returncode:
        pytest.skip("there is no command ros2 with rosbag2 on PATH")
    environment = {**os.environ, **ros_network}
    options = ["--start-paused", "--disable-keyboard-controls", "--wait-for-all-acked", "20000"]
    words = [ros2, "bag", "play", str(recorded / "bag"), "--topics", *TYPES, *options]
    with started_client(ros_network, "stock_node") as client:
        listens(client)
        with subprocess.Popen(words, env=environment, stdin=subprocess.DEVNULL) as player:
            try:
                until(lambda: all(client.offered(topic) for topic in TYPES), "all topics are there")
                resume = [ros2, "service", "call", "/rosbag2_player/resume", "rosbag2_interfaces/srv/Resume"]
                subprocess.run(resume, env=environment, check=True, timeout=LONGEST, stdout=subprocess.DEVNULL)
                assert player.wait(LONGEST) == 0
            finally:
                player.kill()
        until_heard(client, bag_messages(recorded))
