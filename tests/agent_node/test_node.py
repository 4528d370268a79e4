"""The adapters of a robot, and of several in one process."""

from pathlib import Path
from typing import Any, cast

import pytest
from geometry_msgs.msg import Twist, TwistStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.time import Time
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64, Header
from tests.agent_node.fake_node import NOW, FakeNode
from tests.plugin_packages import install
from tests.swarmabs_core.test_drive import STANDING
from tests.swarmabs_ros.nodes import given, realtime_settings_from, settings_from, started_node

from agent_node import group, node
from agent_node.realtime import PARAMETERS, drive_of, make
from agent_node.topic_drive import TopicDrive
from swarmabs_config.scenario import dump_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core import messages as msg
from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Value
from swarmabs_core.realtime.agent import RealtimeAgent, RealtimeAgentConfig
from swarmabs_core.realtime.base import AGENT_PHASE
from swarmabs_core.realtime.drives import TOPIC, Drive, Measurement
from swarmabs_ros.managed import RealtimeNode
from swarmabs_ros.parameters import table_of
from swarmabs_ros.status import StatusChannel

CHANNEL = StatusChannel("agent_node")


@pytest.fixture
def scenario_file(tmp_path: Path, request: pytest.FixtureRequest) -> str:
    """Return the file of a scenario with four robots, the last two double integrators."""
    resolved = find_scenario("pd_het_4", getattr(request, "param", ())).resolved()
    (tmp_path / "scenario.yaml").write_text(dump_scenario(resolved), encoding="utf-8")
    return str(tmp_path / "scenario.yaml")


def test_a_single_integrator_has_neither_damping_nor_velocity() -> None:
    for name, value in (("damping", 0.5), ("velocity", -0.1)):
        with pytest.raises(InputError, match=rf"parameter {name}: not applicable to a single integrator"):
            node.make(settings_from(node.PARAMETERS, kind="single_integrator", **{name: value}), CHANNEL)


@pytest.mark.parametrize(
    ("scenario_file", "values", "hears"),
    [
        ((), {}, msg.BROADCASTS),
        (("plane.robot_gravity=true",), {}, (*msg.BROADCASTS, msg.PLANE_STATE)),
        ((), {"packed": True}, (msg.BROADCAST,)),
        ((), {"steered": True}, (*msg.BROADCASTS, msg.STEERING)),
    ],
    indirect=["scenario_file"],
)
def test_a_group_speaks_for_its_robots_and_hears_what_a_robot_hears(
    scenario_file: str, values: dict[str, Value], hears: tuple[msg.Topic, ...]
) -> None:
    spec = group.make(settings_from(group.PARAMETERS, scenario_file=scenario_file, agent_ids=(2, 4), **values), CHANNEL)
    assert spec.endpoints is not None
    assert set(spec.endpoints.publications) == {msg.AGENT_STATE, msg.EVENTS}
    assert set(spec.endpoints.subscriptions) == set(hears)
    assert set(spec.behaviour.awaits()) <= set(hears)
    assert [state.agent_id for state in spec.behaviour.start() if isinstance(state, msg.AgentState)] == [2, 4]


def test_a_group_needs_a_scenario_that_has_its_robots(scenario_file: str) -> None:
    for ids in ((1, 9), (9,)):
        with pytest.raises(InputError, match="no robot 9"):
            group.make(settings_from(group.PARAMETERS, scenario_file=scenario_file, agent_ids=ids), CHANNEL)
    with pytest.raises(InputError, match="scenario_file"):
        group.make(settings_from(group.PARAMETERS), CHANNEL)


def names_of_the_drive(**values: Value) -> list[str]:
    table = table_of(values, (), PARAMETERS)
    return [parameter.name for parameter in table if parameter.name.startswith("drive.")]


def test_the_drive_brings_its_settings_as_parameters(packages: Path) -> None:
    install(packages, "drive", "standing", STANDING)
    assert names_of_the_drive() == ["drive.type"]
    topic = names_of_the_drive(**{"drive.type": "topic"})
    assert topic == ["drive.type", *(f"drive.{setting.name}" for setting in TOPIC.settings)]
    assert names_of_the_drive(**{"drive.type": "standing"}) == ["drive.type", "drive.place"]
    with pytest.raises(InputError, match=r"parameter drive\.type: there is no drive 'wheels'"):
        names_of_the_drive(**{"drive.type": "wheels"})


@pytest.mark.usefixtures("ros")
def test_every_choice_of_a_setting_is_a_text_on_a_command_line() -> None:
    """ROS reads values as YAML, where y is a truth value."""
    choices = [choice for setting in TOPIC.settings for choice in setting.choices or ()]
    words = {f"drive__probe{index}": choice for index, choice in enumerate(choices)}
    with started_node(*given(**words)) as node:
        values_seen = [node.get_parameter(name.replace("__", ".")).value for name in words]
    assert values_seen == choices


def drive_with(node: FakeNode, **values: Value) -> Drive:
    settings = realtime_settings_from(PARAMETERS, agent_id=7, **values)
    return drive_of(settings.declared(RealtimeAgentConfig), cast("RealtimeNode", node))


def test_a_robot_that_is_told_to_leave_and_to_join_again_leaves_and_joins() -> None:
    values: dict[str, Value] = {"kind": "double_integrator", "damping": 0.5, "position": 0.2, "velocity": -0.1}
    settings = realtime_settings_from(PARAMETERS, agent_id=7, **values)
    node = cast("RealtimeNode", FakeNode())
    assert drive_of(settings.declared(RealtimeAgentConfig), node).read(5) == Measurement(5, 0.2, -0.1)
    with pytest.raises(InputError, match="damping"):
        make(realtime_settings_from(PARAMETERS, damping=0.1), node)
    spec = make(settings, node)
    assert isinstance(spec.behaviour, RealtimeAgent)
    assert spec.phase == AGENT_PHASE
    told = [*spec.services["~/leave"](NOW), *spec.services["~/join"](NOW)]
    events = [(event.kind, event.agent_id) for event in told if isinstance(event, msg.SwarmEvent)]
    assert events == [(msg.EventKind.LEFT, 7), (msg.EventKind.JOINED, 7)]


JOINT: dict[str, Value] = {"drive__command": "joint", "drive__joint__name": "wheel", "drive__gravity": "none"}


STAMP = Time(nanoseconds=NOW).to_msg()
ALONG = TwistStamped(header=Header(stamp=STAMP, frame_id="base_link"), twist=Twist(linear=Vector3(x=0.125)))
WHEEL = {"header": Header(stamp=STAMP), "name": ["wheel"]}


@pytest.mark.parametrize(
    ("kind", "values", "topic", "message"),
    [
        ("single_integrator", {}, "~/cmd_vel", ALONG),
        ("double_integrator", {"drive__gravity": "none"}, "~/force", Float64(data=0.125)),
        ("single_integrator", JOINT, "~/joint_command", JointState(**WHEEL, velocity=[0.125])),
        ("double_integrator", JOINT, "~/joint_command", JointState(**WHEEL, effort=[0.125])),
    ],
)
def test_commands_are_stock_messages(kind: str, values: dict[str, Value], topic: str, message: object) -> None:
    node = FakeNode()
    drive = drive_with(node, kind=kind, drive__type="topic", drive__stamp="arrival", **values)
    assert drive.read(NOW) is None
    node.sensors["~/odom"].append(odometry())
    assert drive.read(NOW) == Measurement(NOW, 0.0, 0.0)
    drive.write(0.125, NOW)
    assert node.published == {topic: [message]}


def odometry() -> Any:
    return Odometry(header=Header(frame_id="odom"))


@pytest.mark.parametrize(("stamp", "age"), [("header", 0.25), ("arrival", 0.0)])
def test_a_topic_drive_hears_base_and_imu_and_knows_the_robot_s_constants(stamp: str, age: float) -> None:
    node = FakeNode()
    values: dict[str, Value] = {"mass": 0.7, "gravity": 1.62, "limits__force": 0.1, "drive__offset": 0.25}
    drive = drive_with(node, kind="double_integrator", drive__type="topic", drive__stamp=stamp, **values)
    assert isinstance(drive, TopicDrive)
    assert node.sensors.keys() == {"~/odom", "~/imu"}  # nothing of the swarm
    imu = Imu(header=Header(frame_id="imu_link"), angular_velocity=Vector3(y=-0.5))
    for sensor, message in {"odom": odometry(), "imu": imu}.items():
        message.header.stamp.sec = NOW // 1_000_000_000
        node.sensors[f"~/{sensor}"].append(message)
    measured = drive.read(NOW)
    assert measured is not None and measured == pytest.approx((NOW - age * 1e9, 0.25, 0.0))
    assert drive.report()[0] == ("tilt, rad", "0.000000")
    drive.write(1.0, measured.stamp)  # less the centrifugal force m p w^2
    drive.write(0.05, measured.stamp)
    assert [sent.data for sent in node.published["~/force"]] == pytest.approx([0.1, 0.05 - 0.7 * 0.25 * 0.25])
