"""A bag with markers, read by another library and compared with the messages that it was made from."""

import cmath
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from tests.swarmabs_bag.realtime_bags import realtime_bag

from swarmabs_bag.attached import SCENARIO_FILE
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run.writer import BagWriter
from swarmabs_cli import main
from swarmabs_core.messages import PLANE_STATE, relay_topic
from swarmabs_view.visualization.ros_messages import message_class

MARKERS, JOINTS = "/swarm/markers", "/plane/joint_states"
THICKNESS = 0.02


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("bags")
    faults = "faults=[{at: 1.0, kind: leave, agent: 2}]"
    assert main(["simulate", "--duration", "2", "--set", faults, "-o", str(folder / "run"), "--json"]) == 0
    assert main(["markers", str(folder / "run"), "-o", str(folder / "shown"), "--rate", "20"]) == 0
    return folder / "run" / "bag", folder / "shown"


@pytest.fixture(scope="module")
def found(bags: tuple[Path, Path]) -> dict[str, list[tuple[int, Any]]]:
    messages: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([bags[1]], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, time, data in reader.messages():
            messages.setdefault(connection.topic, []).append((time, reader.deserialize(data, connection.msgtype)))
    return messages


def test_the_run_is_the_same(bags: tuple[Path, Path]) -> None:
    run, shown = (open_bag(path) for path in bags)
    assert list(run.messages()) == list(shown.messages())
    assert main(["verify", str(bags[1])]) == 0


def test_what_robots_pass_on_is_there_too(tmp_path: Path) -> None:
    overrides = ("--duration", "0.2", "--set", "coordination=each_robot")
    assert main(["simulate", *overrides, "-o", str(tmp_path / "run"), "--json"]) == 0
    assert main(["markers", str(tmp_path / "run"), "-o", str(tmp_path / "shown")]) == 0
    run, shown = (open_bag(tmp_path / name) for name in ("run", "shown"))
    assert list(run.messages()) == list(shown.messages())
    assert relay_topic(4) in shown.topics()


def test_frames_come_at_their_rate_and_the_joint_is_that_of_the_plane(found: dict[str, list[tuple[int, Any]]]) -> None:
    times = [time for time, _ in found[MARKERS]]
    assert times == [50_000_000 * index for index in range(41)]
    assert [time for time, _ in found[JOINTS]] == times
    ((time, description),) = found["/robot_description"]
    assert time == 0 and description.data.startswith("<?xml") and "plane_tilt" in description.data
    assert ("/tf" in found) == (message_class("tf2_msgs/msg/TFMessage") is not None)
    planes = dict(found["/plane/state"])
    for time, joint in found[JOINTS]:
        assert joint.name == ["plane_tilt"]
        assert (joint.position[0], joint.velocity[0]) == (planes[time].angle, planes[time].angular_velocity)
        assert joint.header.stamp.sec * 10**9 + joint.header.stamp.nanosec == time


def test_markers_stand_where_plain_geometry_says(found: dict[str, list[tuple[int, Any]]]) -> None:
    planes = dict(found["/plane/state"])
    robots = {(time, state.agent_id): state for time, state in found["/swarm/agent_state"]}
    lanes: dict[int, set[float]] = {}
    compared = 0
    for time, array in found[MARKERS]:
        angle = planes[time].angle
        turn = cmath.exp(0.5j * angle)
        markers = {(marker.ns, marker.id): marker for marker in array.markers}
        assert all(marker.header.frame_id == "world" for marker in array.markers)
        for agent_id in (1, 2, 3, 4):
            if agent_id == 2 and time >= 10**9:
                gone = markers.get(("robots", 2))
                assert gone is None or gone.action == gone.DELETE
                continue
            marker, state = markers["robots", agent_id], robots[time, agent_id]
            middle = (state.position + 1j * (THICKNESS + marker.scale.z) / 2.0) * turn**2
            assert (marker.pose.position.x, marker.pose.position.z) == pytest.approx((middle.real, middle.imag))
            # About -y, by half the angle: positive angles lift the positive end.
            assert (marker.pose.orientation.w, marker.pose.orientation.y) == pytest.approx((turn.real, -turn.imag))
            lanes.setdefault(agent_id, set()).add(marker.pose.position.y)
            compared += 1
        assert markers["plane", 0].scale.x == 1.0
    assert compared == 20 + 3 * 41
    assert all(len(lane) == 1 for lane in lanes.values()) and len(set().union(*lanes.values())) == 4
    assert sum(marker.action == marker.DELETE for _, array in found[MARKERS] for marker in array.markers) == 2


def test_a_bag_of_a_run_in_real_time(tmp_path: Path) -> None:
    bag = realtime_bag(tmp_path / "bag")
    assert main(["markers", str(bag), "-o", str(tmp_path / "shown")]) == 0
    run, shown = open_bag(bag), open_bag(tmp_path / "shown")
    assert list(run.messages()) == list(shown.messages())
    published = [[m.publish_time for c, m in each.stored_messages() if c.topic is not None] for each in (run, shown)]
    assert published[0] == published[1]
    counts = {channel.name: channel.message_count for channel in shown.channels}
    assert counts[MARKERS] == counts[JOINTS] > 10
    assert main(["verify", str(tmp_path / "shown")]) == main(["verify", str(bag)]) == 0


def test_a_broken_message_is_damage(bags: tuple[Path, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    scenario = open_bag(bags[0]).attachment(SCENARIO_FILE)
    assert scenario is not None
    with BagWriter(tmp_path / "bag", topics=(PLANE_STATE,), attachments={SCENARIO_FILE: scenario}) as writer:
        writer.write(PLANE_STATE, 0, b"\x00\x01\x00\x00short")
    assert main(["markers", str(tmp_path / "bag"), "-o", str(tmp_path / "shown")]) == 1
    assert "/plane/state at 0 s" in capfd.readouterr().err
    assert not (tmp_path / "shown").exists()
