"""The tools of rosbag2 on the bag of a run: what ``ros2 bag`` says of it and plays is what another reader finds in it.

Where ROS 2 is not installed with rosbag2, the independent implementation of its format answers instead.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader
from tests.system.helpers import LONGEST, bag_messages, seconds, swarm
from tests.system.playback import TOPICS, assert_heard, listening

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

FAULTS = "faults=[{at: 0.4, kind: kill, agent: 3}]"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run with events, short enough for the depth of every topic."""
    folder = tmp_path_factory.mktemp("rosbag2") / "run"
    assert swarm("simulate", "pd_het_4", "--set", seconds(0.9), "--set", FAULTS, "-o", folder).code == 0
    return folder


@pytest.fixture(scope="module")
def ros2() -> str:
    """Return the command ``ros2``, if it can play bags."""
    found = shutil.which("ros2")
    if found is None:
        pytest.skip("the command ros2 is not on PATH")
    words = [found, "bag", "play", "--help"]
    tried = subprocess.run(words, capture_output=True, text=True, check=False, timeout=LONGEST)
    if tried.returncode != 0:
        pytest.skip(f"{found} has no rosbag2: {(tried.stderr.strip() or 'no reason given').splitlines()[-1]}")
    return found


def test_what_rosbag2_would_play_is_what_was_recorded(run: Path) -> None:
    """By ``metadata.yaml`` and the file together, in order of time, byte for byte."""
    messages = bag_messages(run)
    with Reader(run / "bag") as reader:
        assert reader.message_count == len(messages)
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        played = [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages()]
    assert played == [(f"/{m.topic}", m.log_time, m.payload) for m in messages]
    assert counts == Counter(f"/{m.topic}" for m in messages)


def test_ros2_bag_info_counts_every_topic(ros2: str, run: Path) -> None:
    words = [ros2, "bag", "info", str(run / "bag")]
    told = subprocess.run(words, capture_output=True, text=True, check=False, timeout=LONGEST)
    assert told.returncode == 0, told.stderr
    with Reader(run / "bag") as reader:
        expected = {(c.topic, c.msgtype, str(c.msgcount)) for c in reader.connections}
        assert re.search(rf"Messages: +{reader.message_count}\b", told.stdout), told.stdout
    assert set(re.findall(r"Topic: (\S+) \| Type: (\S+) \| Count: (\d+)", told.stdout)) == expected


def test_ros2_bag_play_plays_every_message(
    ros2: str, run: Path, tmp_path: Path, ros_network: dict[str, str], mark: str
) -> None:
    """It waits until the listener knows all topics: what is played before is lost on it."""
    del mark  # only for what it checks afterwards
    environment = {**os.environ, **ros_network}
    options = ["--start-paused", "--disable-keyboard-controls", "--wait-for-all-acked", "20000"]
    words = [ros2, "bag", "play", str(run / "bag"), "--topics", *TOPICS, *options]
    with listening(tmp_path / "heard.json", ros_network) as listener:
        with subprocess.Popen(words, env=environment, stdin=subprocess.DEVNULL) as player:
            try:
                assert listener.stdout is not None
                assert listener.stdout.readline() == "all topics are there\n"
                resume = [ros2, "service", "call", "/rosbag2_player/resume", "rosbag2_interfaces/srv/Resume"]
                subprocess.run(resume, env=environment, check=True, timeout=LONGEST, stdout=subprocess.DEVNULL)
                assert player.wait(LONGEST) == 0
            finally:
                player.kill()
        assert listener.wait(LONGEST) == 0
    assert_heard(tmp_path / "heard.json", bag_messages(run))
