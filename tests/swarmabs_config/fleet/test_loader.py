"""Fleet files: what is refused, with which words, and what the canonical text is."""

from contextlib import nullcontext
from datetime import datetime, timedelta, timezone
from itertools import count
from pathlib import Path

import pytest
import yaml
from tests.swarmabs_fleet.fleets import EXAMPLES, ONE_HOST, edited

from swarmabs_config.fleet.loader import json_schema, load_fleet
from swarmabs_config.fleet.participants import node_plans
from swarmabs_core.declaration import values_of
from swarmabs_core.errors import InputError
from swarmabs_core.realtime.drives import TOPIC
from swarmabs_core.realtime.instruments import TopicSettings

LAN, TUNNEL, CERTIFICATES = (EXAMPLES[name].read_text(encoding="utf-8") for name in ("lan", "tunnel", "sros2"))


KILL = "{at: 1.0, kind: kill, agent: 1}"
TOMORROW = f"{datetime.now(timezone.utc) + timedelta(days=1):%Y-%m-%dT%H:%M:%SZ}"
SLOW = """set: {realtime.takeover_after: 0.09}
coordinators:
  plane: {host: base}
  observer: {host: base, standby: robot-1}"""
REFUSED = [
    # what is replaced: by what, in the line of what, and the words of the refusal
    ("security: {level: none}", "", "schema", ("security", "'security' is missing", "level: none")),
    ("level: none", "level: tunel", "level: tunel", ("security.level", "did you mean 'tunnel'?")),
    ("position: 0.125}", "positon: 1}", "positon", ("robots.0.drive.positon", "'position'")),
    ("type: simulated", "type: topc", "topc", ("robots.0.drive.type", "did you mean 'topic'?")),
    ("host: robot-3", "host: robt-3", "robt-3", ("robots.2.host", "did you mean 'robot-3'?")),
    ("network: {", "newtork: {", "newtork: {", ("newtork", "did you mean 'network'?")),
    ("id: 2", "id: 1", "id: 1, host: robot-2", ("robots.1.id", "twice", "(see line")),
    ("name: robot-2", "name: robot-1", "192.168.10.12", ("hosts.2.name", "twice")),
    (".12}", ".11}", "name: robot-2", ("hosts.2.address", "192.168.10.11", "twice")),
    ("192.168.10.12", "192.168.10.256", "robot-2", ("hosts.2.address", "not an IPv4 address")),
    ("192.168.10.12", "239.1.1.1", "robot-2", ("hosts.2.address", "not the address of a host")),
    ("192.168.10.12", "127.0.0.1", "robot-2", ("hosts.2.address", "loopback")),
    ("domain: 40", "domain: 231", "domain", ("network.domain", "<= 230")),
    ("interface: wlan0, ", "", "robot-1", ("hosts.1", "no interface for robot-1")),
    ("position: 0.125}", "position: 0.7}", "0.7", ("robots.0.drive.position", "off the plane")),
    ("position: -0.125}", "position: 0.125}", "robots:", ("robots", "at one point")),
    ("mass: 0.5104", "mass: -1", "mass: -1", ("robots.1.mass", "> 0")),
    ("mass: 0.3552", "mass: 1, damping: 1", "damping: 1,", ("robots.0", "damping")),
    ("scenario: pd_het_4", "scenario: pd_het_5", "pd_het_5", ("scenario", "pd_het_4?")),
    ("schema: 1", "schema: 2", "schema: 2", ("schema", "newer", "update swarmabs")),
    ("level: none", "level: sros2", "level: sros2", ("security.level", "no security plugins")),
    ("level: none", "level: tunnel", "name: base", ("hosts.0", "tunnel_address")),
    ("interface: eth0", "interface: lo", "name: base", ("hosts.0.interface: lo on base", ".1")),
    ("interface: wlan0", "interface: lo", "interface: lo", ("network.interface: lo",)),
    (".11}", ".11, user: root}", "name: robot-1", ("hosts.1.user: nodes must not run as root",)),
    ("static", "static, server: base", "static, server", ("network.server", "'discovery: static'")),
    ("discovery: static", "discovery: server", "discovery: server", ("network.discovery",)),
    (
        "r: {host: base}\n  c",
        "r: {host: base, standby: base}\n  c",
        "standby",
        ("observer.standby: base also", "another"),
    ),
    (
        "host: base}\n  r",
        "host: base, standby: robt-3}\n  r",
        "standby",
        ("controller.standby", "did you mean 'robot-3'?"),
    ),
    ("recorder: {host: base}", "recorder: {standby: robot-1}", "recorder", ("coordinators.recorder", "host")),
    (
        "coordinators:\n  plane: {host: base}\n  observer: {host: base}",
        SLOW,
        "scenario: pd",
        ("realtime.takeover_after: 0.09 s is too long", "'set' changes values"),
    ),
]
ADDED = [
    # what is added to the fleet's name, in the line of what, and the words of the refusal
    ("lan\nset: {plane.lenght: 2}", "lenght", ("plane.lenght", "'length'")),
    (f"lan\nset: {{faults: [{KILL}]}}", "scenario: pd", ("scenario", "faults", "real time")),
    ("lan\nset: {coordination: each_robot}", "observer: {", ("coordinators.observer", "without observer", "remove it")),
    ("lan\nepoch: yesterday", "epoch", ("epoch", "not a time in UTC")),
    ("lan\nepoch: 1969-12-31T23:59:59Z", "epoch", (":59Z' is before 1970",)),
    ("lan\nepoch: 0001-12-31T00:00:00Z", "epoch", ("before 1970",)),
    ("lan\nepoch: 2999-01-01T00:00:00Z", "epoch", ("in the future",)),
    (f"lan\nepoch: {TOMORROW}", "epoch", (TOMORROW, "in the future", "past")),
    ("lan\nepoch: 2026-13-01T00:00:00Z", "epoch", ("epoch: '2026-13",)),
    ("lan\nepoch: 20260301T123005Z", "epoch", ("epoch", "not a time in UTC")),
    ("lan\ninstallation: {user: root}", "installation", ("user: nodes must not run as root", "e.g. swarmabs")),
    ("swarmabs\ninstallation: {prefix: /opt}", "installation", ("replace /opt/swarmabs,", "e.g. /etc/swarmabs")),
    ("opt\ninstallation: {prefix: /srv, checkout: /srv/opt/x}", "installation", ("replace /srv/opt,",)),
    ("lan\ntime: {max_offset: 0.2}", "max_offset", ("time.max_offset",)),
]


@pytest.mark.parametrize(
    ("old", "new", "where", "words"),
    [*REFUSED, *(("name: lan", f"name: {text}", where, words) for text, where, words in ADDED)],
    ids=count(),  # the same for all processes that share the tests: a text has the time in it
)
def test_a_mistake_is_named_with_file_line_field_and_remedy(
    old: str, new: str, where: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    path = edited(tmp_path / "bad.yaml", LAN, (old, new))
    with pytest.raises(InputError) as caught:
        load_fleet(path)
    text = str(caught.value)
    written = path.read_text(encoding="utf-8")
    line = written[: written.index(where)].count("\n") + 1
    assert text.startswith(f"{path}:{line}: "), text
    assert "\n" not in text and "; " in text
    for word in words:
        assert word in text


PLACES = {
    **dict.fromkeys(("name: one", "name: base", "interface: lo", "user: nobody-here"), ""),
    **dict.fromkeys(("prefix: /etc/swarmabs", "namespace: /"), "/"),
}
"""Fields whose text gets into scripts and units, with what a text there begins with."""


@pytest.mark.parametrize("place", PLACES)
def test_no_text_that_a_shell_or_systemd_would_read_gets_in(place: str, tmp_path: Path) -> None:
    field = place.partition(": ")[0]
    base = ONE_HOST.replace("scenario:", "namespace: /\nscenario:")
    for text in ("a b", "a;b", "$(id)", "`id`", "a'b", 'a\\"b', "../up", "a\\nb", "é", "%i"):
        path = edited(tmp_path / "bad.yaml", base, (place, f'{field}: "{PLACES[place]}{text}"'))
        with pytest.raises(InputError, match=rf"{field}: '.*' is not "):
            load_fleet(path)


SINGLE, DOUBLE = "drive: {type: simulated, position: 0.1}", "drive: {type: simulated, position: -0.1}"
PLUGIN = "drive: {type: plugin, name: a, settings: "
TOPICS = "drive: {type: topic, "
FIELDS = [
    # a piece of a fleet file with a mistake, in place of what, and the field that is named
    ("[{name: base, address: 127.0.0.1, interface: lo}]", "[]", "hosts: no hosts"),
    (f"  - {{id: 2, host: base, kind: double_integrator, mass: 0.5, damping: 0.8, {DOUBLE}}}\n", "", "robots: a swarm"),
    ("robots:", "swarm_mass: 0.89\nrobots:", "swarm_mass: 0.89 kg is less than"),
    ("mass: 0.4", "mas: 0.4", "robots.0.mas: unknown key 'mas'; did you mean 'mass'?"),
    (SINGLE, SINGLE.replace("0.1}", "0.1, velocity: 1}"), "robots.0: a single integrator starts at velocity 0"),
    (SINGLE, f"{SINGLE}, limits: {{force: 1}}", "robots.0: a single integrator has no force"),
    (SINGLE, f"{SINGLE}, limits: {{lane: 0.51}}", "robots.0.limits.lane: 0.51 m"),
    ("127.0.0.1", "192.0.2.1", "hosts.0.interface: lo on base reaches no other host"),
    (SINGLE, TOPICS + "topic: 'a b'}", "robots.0.drive.topic: 'a b' is"),
    (SINGLE, TOPICS + "command_topic: 5}", "robots.0.drive.command_topic:"),
    (SINGLE, TOPICS + "command_topic: agent_002/state}", "robots.0.drive.command_topic: agent_002/state is a topic of"),
    (SINGLE, TOPICS + "topic: standby/swarm/standing}", "robots.0.drive.topic: standby/swarm/standing is a topic"),
    (DOUBLE, TOPICS + "topic: /swarm/removals}", "robots.1.drive.topic: /swarm/removals is a topic of the swarm"),
    ("plane: {host", "plane: {type: driver, topic: plane/state, host", "coordinators.plane.topic: plane/state is a"),
    (DOUBLE, TOPICS + "gravity: imu, imu: {topic: /a-b}}", "robots.1.drive.imu.topic: '/a-b'"),
    ("plane: {host", "plane: {type: driver, topic: '%', host", "coordinators.plane.topic: '%' is"),
    (SINGLE, PLUGIN + "{'a b': 1}}", "robots.0.drive.settings.a b: 'a b' is not a valid setting name"),
    *((SINGLE, PLUGIN + f"{{a: {bad}}}}}", "robots.0.drive.settings: a: ") for bad in ("{}", "[]", "[1, 2.0]", "null")),
    *((SINGLE, PLUGIN + f"{{a: {far}}}}}", "robots.0.drive.settings: a: ") for far in (2**63, -(2**63) - 1, "1.1e12")),
    *((SINGLE, PLUGIN + f"{{{name}: 1}}}}", "robots.0.drive.settings: a setting") for name in ("type", "name")),
    (SINGLE, "drive: {type: plugin, name: topic}", "robots.0.drive.name: 'topic'"),
    ("name: one", "name: one\nset: {'a b': 1}", "set.a b: 'a b' is not a dotted path"),
    (SINGLE, TOPICS + "gravity: imu}", "robots.0.drive: gravity does not act on a single integrator; remove"),
    (SINGLE, TOPICS + "command: joint}", "robots.0.drive.joint.name: it is empty; give the name of the joint"),
    (SINGLE, TOPICS + "joint: {scale: 0.0}}", "robots.0.drive.joint.scale: 0 is not allowed; give m or m/rad"),
    (SINGLE, TOPICS + "reversed: true}", "robots.0.drive.reversed: the orientation in the odometry"),
    (DOUBLE, TOPICS + "max_jmp: 1}", "robots.1.drive.max_jmp: unknown key 'max_jmp'; did you mean 'max_jump'?"),
    (DOUBLE, TOPICS + "age_limit: 0}", "robots.1.drive.age_limit: 0 is out of range; give a number > 0"),
]
OF_A_TUNNEL = [
    ("10.83.0.12", "10.83.0.11", "hosts.2.tunnel_address: tunnel address 10.83.0.11"),
    ("10.83.0.12", "127.0.0.1", "hosts.2.tunnel_address: 127.0.0.1"),
    ("domain: 41", "domain: 41, discovery: multicast", "network.discovery: a tunnel carries no multicast"),
    ("interface: floor0", "interface: lo", "security.interface: lo is the loopback interface"),
    ("interface: floor0", "interface: wlan0", "security.interface: wlan0 is already the network interface"),
    ("level: tunnel, interface: floor0, port: 51820", "level: none", "hosts.0.tunnel_address: 'security: {level"),
]


@pytest.mark.parametrize(
    ("fleet", "old", "new", "field"),
    [*((ONE_HOST, *case) for case in FIELDS), *((TUNNEL, *case) for case in OF_A_TUNNEL)],
)
def test_a_field_is_named_as_it_is_in_the_file(fleet: str, old: str, new: str, field: str, tmp_path: Path) -> None:
    path = edited(tmp_path / "bad.yaml", fleet, (old, new))
    with pytest.raises(InputError) as caught:
        load_fleet(path)
    text = str(caught.value)
    assert f": {field}" in text
    for internal in ("function-", "literal[", "[key]", "json", "check("):
        assert internal not in text, text


def drives(folder: Path, single: str = "", double: str = "") -> tuple[TopicSettings, TopicSettings]:
    """Return the topic drives of a fleet of a single and a double integrator, each with further settings."""
    changes = ((SINGLE, f"drive: {{type: topic{single}}}"), (DOUBLE, f"drive: {{type: topic{double}}}"))
    loaded = load_fleet(edited(folder / "fleet.yaml", ONE_HOST, *changes))
    (folder / "again.yaml").write_text(loaded.fleet_text, encoding="utf-8")
    (folder / "scenario.yaml").write_text(loaded.scenario_text, encoding="utf-8")
    assert load_fleet(folder / "again.yaml").fleet.robots == loaded.fleet.robots
    first, second = (robot.drive for robot in loaded.fleet.members)
    assert isinstance(first, TopicSettings)
    assert isinstance(second, TopicSettings)
    return first, second


def test_a_drive_has_the_same_settings_and_defaults_in_the_fleet_file_as_in_the_node(tmp_path: Path) -> None:
    single, double = drives(tmp_path)
    assert values_of(double) == {parameter.name: parameter.default for parameter in TOPIC.settings}
    # The weight of a double integrator is balanced unless it is said.
    assert [drive.gravity for drive in (single, double)] == ["none", "imu"]
    assert [drive.gravity for drive in drives(tmp_path, ", gravity: none", ", gravity: none")] == ["none", "none"]
    more = ", bandwidth: 40, max_jump: 0.02, age_limit: 0.2, imu: {max_rate: 3, max_jump: 0.1}"
    _, double = drives(tmp_path, double=more)
    assert (double.bandwidth, double.max_jump, double.age_limit) == (40.0, 0.02, 0.2)
    assert (double.imu.max_rate, double.imu.max_jump) == (3.0, 0.1)


def test_a_plugin_is_given_whatever_a_parameter_can_be(tmp_path: Path) -> None:
    given = f"{{a: {2**63 - 1}, b: [{-(2**63)}, 1], c: -1.0e+12, d: [x, y], e: true}}"
    loaded = load_fleet(edited(tmp_path / "fleet.yaml", ONE_HOST, (SINGLE, f"{PLUGIN}{given}}}")))
    expected = {"a": 2**63 - 1, "b": (-(2**63), 1), "c": -1e12, "d": ("x", "y"), "e": True}
    assert loaded.fleet.members[0].drive.parameters == expected  # type: ignore[union-attr]


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_load_and_their_canonical_text_means_the_same(name: str, tmp_path: Path) -> None:
    loaded = load_fleet(EXAMPLES[name])
    (tmp_path / "fleet.yaml").write_text(loaded.fleet_text, encoding="utf-8")
    (tmp_path / "scenario.yaml").write_text(loaded.scenario_text, encoding="utf-8")
    again = load_fleet(tmp_path / "fleet.yaml")
    assert (again.fleet_text, again.scenario_text) == (loaded.fleet_text, loaded.scenario_text)
    # As another reader of YAML sees the example itself.
    given = yaml.safe_load(EXAMPLES[name].read_text(encoding="utf-8"))
    assert [agent.mass for agent in loaded.scenario.agents] == [robot["mass"] for robot in given["robots"]]
    assert loaded.scenario.name == given["name"] == loaded.fleet.name
    loaded = load_fleet(edited(tmp_path / "f.yaml", LAN, ("name: lan", "name: lan\nepoch: 2026-03-01T12:30:05Z")))
    assert loaded.fleet.epoch_ns == 1772368205 * 10**9  # date -u -d 2026-03-01T12:30:05Z +%s
    for stem, fleet in (("9-a", "9-a"), ("ä b", "fleet__b"), ("-" * 99, f"fleet{'-' * 27}")):
        unnamed = edited(tmp_path / f"{stem}.yaml", LAN, ("name: lan\n", ""))
        assert load_fleet(unnamed).fleet.name == fleet


IDLE = "  - {name: idle, address: 192.168.10.99, interface: eth0}\nrobots:"


@pytest.mark.parametrize(
    ("fleet", "change", "warnings"),
    [
        (LAN, ("robots:", IDLE), ["idle", "security is none"]),
        (TUNNEL, ("controller: {host", "controller: {host"), []),
        (TUNNEL, ("controller: {host", "controller: {start_mode: run, host"), ["start_mode is run"]),
    ],
)
def test_what_is_doubtful_is_said(fleet: str, change: tuple[str, str], warnings: list[str], tmp_path: Path) -> None:
    found = load_fleet(edited(tmp_path / "fleet.yaml", fleet, change)).warnings()
    assert [words in text for text, words in zip(found, warnings, strict=True)] == [True] * len(warnings)


def test_the_mass_of_a_swarm_may_be_that_of_its_robots(tmp_path: Path) -> None:
    loaded = load_fleet(edited(tmp_path / "f.yaml", ONE_HOST, ("robots:", "swarm_mass: 0.9\nrobots:")))
    assert loaded.fleet.swarm_mass == sum(robot.mass for robot in loaded.fleet.robots) == 0.9


def test_certificates_exclude_a_discovery_server(tmp_path: Path) -> None:
    path = edited(tmp_path / "fleet.yaml", CERTIFICATES, ("discovery: static", "discovery: server, server: base"))
    with pytest.raises(InputError, match=r"network\.discovery.*: with 'level: sros2' .*; use 'discovery: static'"):
        load_fleet(path)


def test_a_standby_is_a_node_of_its_own_with_the_participant_of_its_primary() -> None:
    fleet = load_fleet(EXAMPLES["standby"]).fleet
    assert [
        (plan.name, plan.host, plan.participant, plan.pair) for plan in node_plans(fleet) if plan.robot is None
    ] == [
        ("plane_driver", "encoder", 0, "single"),
        ("abstraction_observer", "base", 1, "primary"),
        ("abstraction_observer_standby", "spare", 1, "standby"),
        ("parent_controller", "base", 2, "primary"),
        ("parent_controller_standby", "spare", 2, "standby"),
        ("recorder", "base", 3, "primary"),
        ("recorder_standby", "spare", 3, "standby"),
    ]


@pytest.mark.parametrize("discovery", ["static", "server, server: base"])
def test_each_node_has_its_module_and_its_participant(discovery: str, tmp_path: Path) -> None:
    fleet = load_fleet(
        edited(tmp_path / "fleet.yaml", ONE_HOST, ("discovery: static", f"discovery: {discovery}"))
    ).fleet
    assert [(plan.name, plan.module, plan.host, plan.participant, plan.role) for plan in node_plans(fleet)] == [
        ("plane_sim", "plane_sim.realtime", "base", 0, "coordinator"),
        ("abstraction_observer", "abstraction_observer.realtime", "base", 1, "coordinator"),
        ("parent_controller", "parent_controller.realtime", "base", 2, "coordinator"),
        ("recorder", "swarmabs_bag.recorder.realtime", "base", 3, "coordinator"),
        *([("discovery_server", "swarmabs_fleet.discovery_server", "base", 5, "server")] * (discovery != "static")),
        ("agent_001", "agent_node.realtime", "base", 8, "robot"),
        ("agent_002", "agent_node.realtime", "base", 9, "robot"),
    ]


def test_too_many_robots_for_the_ports_of_a_host(tmp_path: Path) -> None:
    robot = "  - {{id: {}, host: base, kind: single_integrator, mass: 0.4, drive: {{position: {}, type: simulated}}}}\n"
    for last, refused in ((45, True), (44, False)):
        lines = "".join(robot.format(number, 0.1 * (-1) ** number) for number in range(10, last + 1))
        path = edited(tmp_path / "f.yaml", ONE_HOST, ("coordinators:", f"{lines}coordinators:"))
        with pytest.raises(InputError, match="put at most 37 robots on one host") if refused else nullcontext():
            load_fleet(path)


def test_the_schema_describes_every_field_and_asks_for_security() -> None:
    schema = json_schema()
    assert "security" in schema["required"]  # type: ignore[operator]
    properties = schema["properties"]
    assert isinstance(properties, dict)
    assert set(properties) >= {"hosts", "robots", "coordinators", "network", "security", "time", "installation"}
    assert all("description" in field for field in properties.values())
    levels = [choice["properties"]["level"]["const"] for choice in properties["security"]["oneOf"]]
    assert levels == ["none", "tunnel", "sros2"]
