"""The drive of a robot's node: its parameters, and the topic drive's endpoints over real DDS."""

from __future__ import annotations

import time
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64
from tests.plugin_packages import install
from tests.swarmabs_core.realtime.test_drives import STANDING
from tests.swarmabs_ros.nodes import given, realtime_settings_from, started_node

from agent_node.realtime import PARAMETERS, drive_of
from agent_node.topic_drive import TopicDrive, TopicLink
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.agent import RealtimeAgentConfig
from swarmabs_core.realtime.drives import TOPIC, Measurement, SimulatedDrive
from swarmabs_core.realtime.instruments import Joint, TiltSensor, TopicSettings
from swarmabs_ros.endpoints import LoopGroup
from swarmabs_ros.parameters import given_values, table_of

TOPICS = {"odom": Odometry, "imu": Imu, "joint_states": JointState}


def declared(*words: str) -> dict[str, Parameter]:
    with started_node(*words) as node:
        table = table_of(given_values(node), (), PARAMETERS)
    return {parameter.name: parameter for parameter in table if parameter.name.startswith("drive.")}


@pytest.mark.usefixtures("ros")
def test_the_drive_brings_its_settings_as_parameters(packages: Path) -> None:
    install(packages, "drive", "standing", STANDING)
    assert list(declared()) == ["drive.type"]
    topic = declared(*given(drive__type="topic"))
    assert list(topic)[1:] == [f"drive.{setting.name}" for setting in TOPIC.settings]
    standing = declared(*given(drive__type="standing"))
    assert standing["drive.type"].choices == ("simulated", "topic", "standing")
    assert list(standing)[1:] == ["drive.place"]
    with pytest.raises(InputError, match=r"parameter drive\.type: no drive 'wheels'"):
        declared(*given(drive__type="wheels"))


class Node:
    """What `make_drive` needs of a node."""

    def __init__(self, node: Any) -> None:
        self.create_subscription, self.create_publisher = node.create_subscription, node.create_publisher
        self.get_clock = node.get_clock
        self.loop_group = LoopGroup()


def test_a_simulated_drive_begins_where_the_parameters_say() -> None:
    config = RealtimeAgentConfig(kind=Kind.DOUBLE_INTEGRATOR, damping=0.5, position=0.2, velocity=-0.1)
    drive = drive_of(config, None)  # type: ignore[arg-type]
    assert isinstance(drive, SimulatedDrive)
    assert drive.read(5) == Measurement(5, 0.2, -0.1)


@pytest.mark.usefixtures("ros")
def test_a_topic_drive_gets_the_robot_s_constants() -> None:
    settings = realtime_settings_from(
        PARAMETERS,
        kind="double_integrator",
        mass=0.7,
        gravity=1.62,
        limits__force=0.1,
        drive__type="topic",
        drive__offset=0.25,
    )
    config = settings.made(RealtimeAgentConfig)
    with started_node(name="agent_007") as node:
        drive = drive_of(config, Node(node))  # type: ignore[arg-type]
        assert isinstance(drive, TopicDrive)
        assert (drive._body.mass, drive._body.gravity, drive._body.limits.force) == (0.7, 1.62, 0.1)
        assert drive.read(time.time_ns()) is None
        subscribed = {subscription.topic_name for subscription in node.subscriptions}
        assert subscribed == {"/agent_007/odom", "/agent_007/imu"}  # nothing of the swarm
    assert config.limits.velocity == inf


class Base:
    """The other end: publishes what sensors say, keeps what commands it gets."""

    def __init__(self, node: Any, command: Any, topic: str) -> None:
        self.publishers = {name: node.create_publisher(kind, f"~/{name}", 10) for name, kind in TOPICS.items()}
        self.subscription = node.create_subscription(command, topic, print, 10)

    def command(self) -> Any:
        """Wait for a command."""
        deadline = time.monotonic() + 10.0
        while (taken := self.subscription.handle.take_message(self.subscription.msg_type, False)) is None:
            assert time.monotonic() < deadline, "no command arrives"
            time.sleep(0.005)
        return taken[0]


SETTINGS = TopicSettings(
    topic="~/odom", command="twist", command_topic="~/cmd_vel", joint=Joint("wheel"), imu=TiltSensor("~/imu")
)


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(
    ("command", "kind", "message"),
    [
        ("twist", Kind.SINGLE_INTEGRATOR, TwistStamped),
        ("force", Kind.DOUBLE_INTEGRATOR, Float64),
        ("joint", Kind.SINGLE_INTEGRATOR, JointState),
        ("joint", Kind.DOUBLE_INTEGRATOR, JointState),
    ],
    ids=["twist", "force", "joint velocity", "joint effort"],
)
def test_commands_arrive_as_stock_messages(command: str, kind: Kind, message: Any) -> None:
    with started_node(name="agent_001") as node:
        base = Base(node, message, "/agent_001/cmd_vel")
        link = TopicLink(replace(SETTINGS, command=command), kind, node)
        deadline = time.monotonic() + 10.0
        while link._publisher.get_subscription_count() < 1:
            assert time.monotonic() < deadline, "endpoints do not meet"
            time.sleep(0.01)
        link.send(0.125)
        found = base.command()
        if message is Float64:
            assert found.data == 0.125
            return
        assert abs(time.time() - found.header.stamp.sec) < 60.0
        if message is TwistStamped:
            assert found.header.frame_id == "base_link"
            linear, angular = found.twist.linear, found.twist.angular
            assert [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z] == [0.125, 0, 0, 0, 0, 0]
        else:
            assert list(found.name) == ["wheel"]
            rates, efforts = ([0.125], []) if kind is Kind.SINGLE_INTEGRATOR else ([], [0.125])
            assert (list(found.position), list(found.velocity), list(found.effort)) == ([], rates, efforts)


@pytest.mark.usefixtures("ros")
def test_what_the_body_s_sensors_say_arrives() -> None:
    with started_node(name="agent_001") as node:
        base = Base(node, TwistStamped, "~/cmd_vel")
        link = TopicLink(SETTINGS, Kind.DOUBLE_INTEGRATOR, node)
        deadline = time.monotonic() + 10.0
        while any(base.publishers[name].get_subscription_count() < 1 for name in ("odom", "imu")):
            assert time.monotonic() < deadline, "endpoints do not meet"
            time.sleep(0.01)
        base.publishers["odom"].publish(Odometry())
        base.publishers["imu"].publish(Imu())
        found: list[Any] = []
        while len(found) < 2:
            assert time.monotonic() < deadline, f"only {found} arrived"
            found += link.take()
        assert sorted(type(each).__name__ for each in found) == ["Imu", "Odometry"]


@pytest.mark.usefixtures("ros")
def test_every_choice_of_a_setting_is_a_text_on_a_command_line() -> None:
    """ROS reads values as YAML, where y is a truth value."""
    for setting in TOPIC.settings:
        for choice in setting.choices or ():
            with started_node(*given(drive__probe=choice)) as node:
                assert node.get_parameter("drive.probe").value == choice
