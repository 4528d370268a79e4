"""Fleet files: what is refused, with which words, and what the canonical text is."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
import yaml
from tests.swarmabs_fleet.fleets import EXAMPLES, ONE_HOST, edited

from swarmabs_config.fleet.loader import json_schema, load_fleet
from swarmabs_core.declaration import values_of
from swarmabs_core.errors import InputError
from swarmabs_core.realtime.drives import TOPIC
from swarmabs_core.realtime.instruments import TopicSettings

LAN = EXAMPLES["lan"].read_text(encoding="utf-8")


def line_of(text: str, part: str) -> int:
    """Return the line, counted from 1, of the first occurrence of a part."""
    return text[: text.index(part)].count("\n") + 1


TOMORROW = f"{datetime.now(timezone.utc) + timedelta(days=1):%Y-%m-%dT%H:%M:%SZ}"
REFUSED = {
    # what is replaced: by what, in the line of what, and the words of the refusal
    "no security": ("security: {level: none}", "", "schema", ("security", "'security' is missing", "level: none")),
    "misspelt level": ("level: none", "level: tunel", "level: tunel", ("security.level", "did you mean 'tunnel'?")),
    "misspelt key": ("position: 0.125}", "positon: 1}", "positon", ("robots.0.drive.positon", "'position'")),
    "misspelt drive": ("type: simulated", "type: topc", "topc", ("robots.0.drive.type", "did you mean 'topic'?")),
    "misspelt host": ("host: robot-3", "host: robt-3", "robt-3", ("robots.2.host", "did you mean 'robot-3'?")),
    "unknown section": ("network:", "newtork:", "newtork", ("newtork", "did you mean 'network'?")),
    "robot twice": ("id: 2", "id: 1", "id: 1, host: robot-2", ("robots.1.id", "twice", "(see line")),
    "host twice": ("name: robot-2", "name: robot-1", "192.168.10.12", ("hosts.2.name", "twice")),
    "address twice": (".12}", ".11}", "name: robot-2", ("hosts.2.address", "192.168.10.11", "twice")),
    "no address": ("192.168.10.12", "192.168.10.256", "robot-2", ("hosts.2.address", "no IPv4 address")),
    "a multicast address": ("192.168.10.12", "239.1.1.1", "robot-2", ("hosts.2.address", "no address of a host")),
    "loopback among hosts": ("192.168.10.12", "127.0.0.1", "robot-2", ("hosts.2.address", "loopback")),
    "a domain beyond the ports": ("domain: 40", "domain: 231", "domain", ("network.domain", "<= 230")),
    "no interface": ("interface: wlan0, ", "", "robot-1", ("hosts.1", "no interface for robot-1")),
    "off the plane": ("position: 0.125}", "position: 0.7}", "0.7", ("robots.0.drive.position", "off the plane")),
    "one point": ("position: -0.125}", "position: 0.125}", "robots:", ("robots", "stand at one point")),
    "negative mass": ("mass: 0.5104", "mass: -1", "mass: -1", ("robots.1.mass", "> 0")),
    "damping of a single integrator": ("mass: 0.3552", "mass: 1, damping: 1", "damping: 1,", ("robots.0", "damping")),
    "unknown scenario": ("scenario: pd_het_4", "scenario: pd_het_5", "pd_het_5", ("scenario", "pd_het_4?")),
    "a setting that is not": ("name: lan", "name: lan\nset: {plane.lenght: 2}", "lenght", ("plane.lenght", "'length'")),
    "faults": (
        "name: lan",
        "name: lan\nset: {faults: [{at: 1.0, kind: kill, agent: 1}]}",
        "scenario: pd",
        ("scenario", "faults", "real time"),
    ),
    "a newer file": ("schema: 1", "schema: 2", "schema: 2", ("schema", "newer", "update swarmabs")),
    "wheels with sros2": ("level: none", "level: sros2", "level: sros2", ("security.level", "no security plugins")),
    "no tunnel address": ("level: none", "level: tunnel", "name: base", ("hosts.0", "tunnel_address")),
    "an epoch that is not": ("name: lan", "name: lan\nepoch: yesterday", "epoch", ("epoch", "no time in UTC")),
    "an epoch before 1970": (
        "name: lan",
        "name: lan\nepoch: 1969-12-31T23:59:59Z",
        "epoch",
        ("epoch: '1969-12-31T23:59:59Z' is before 1970", "in the past"),
    ),
    "the first of all epochs": ("name: lan", "name: lan\nepoch: 0001-12-31T00:00:00Z", "epoch", ("before 1970",)),
    "an epoch beyond nodes": ("name: lan", "name: lan\nepoch: 2999-01-01T00:00:00Z", "epoch", ("has not begun",)),
    "an epoch tomorrow": ("name: lan", f"name: lan\nepoch: {TOMORROW}", "epoch", (TOMORROW, "has not begun", "past")),
    "loopback as interface": (
        "interface: eth0",
        "interface: lo",
        "name: base",
        ("hosts.0.interface: lo of base leads to no other host; name the interface that has the address 192.168.10.1",),
    ),
    "loopback as interface of all": ("interface: wlan0", "interface: lo", "interface: lo", ("network.interface: lo",)),
    "root": (
        "name: lan",
        "name: lan\ninstallation: {user: root}",
        "installation",
        ("installation.user: root may do everything", "e.g. swarmabs"),
    ),
    "root on one host": (".11}", ".11, user: root}", "name: robot-1", ("hosts.1.user: root may do everything",)),
    "the checkout's place": (
        "name: lan",
        "name: swarmabs\ninstallation: {prefix: /opt}",
        "installation",
        ("installation.prefix: the bundle would take the place of /opt/swarmabs", "e.g. /etc/swarmabs"),
    ),
    "around the checkout": (
        "name: lan",
        "name: opt\ninstallation: {prefix: /srv, checkout: /srv/opt/swarm}",
        "installation",
        ("the bundle would take the place of /srv/opt,",),
    ),
    "clocks too far apart": ("name: lan", "name: lan\ntime: {max_offset: 0.2}", "max_offset", ("time.max_offset",)),
    "server without host": ("discovery: static", "discovery: server", "discovery: server", ("network.discovery",)),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_mistake_is_named_with_file_line_field_and_remedy(case: str, tmp_path: Path) -> None:
    old, new, where, words = REFUSED[case]
    path = edited(tmp_path / "bad.yaml", LAN, (old, new))
    with pytest.raises(InputError) as caught:
        load_fleet(path)
    text = str(caught.value)
    assert text.startswith(f"{path}:{line_of(path.read_text(encoding='utf-8'), where)}: "), text
    assert "\n" not in text and "; " in text
    for word in words:
        assert word in text


HOSTILE = ("a b", "a;b", "$(id)", "`id`", "a'b", 'a\\"b', "../up", "a\\nb", "é", "%i")
PLACES = {
    "name: one": "",
    "name: base": "",
    "interface: lo": "",
    "prefix: /etc/swarmabs": "/",
    "namespace: /": "/",
    "user: nobody-here": "",
}
"""Fields whose text gets into scripts and units, with what a text there begins with."""


@pytest.mark.parametrize("text", HOSTILE)
@pytest.mark.parametrize("place", PLACES)
def test_no_text_that_a_shell_or_systemd_would_read_gets_in(place: str, text: str, tmp_path: Path) -> None:
    field = place.partition(": ")[0]
    base = ONE_HOST.replace("scenario:", "namespace: /\nscenario:")
    path = edited(tmp_path / "bad.yaml", base, (place, f'{field}: "{PLACES[place]}{text}"'))
    with pytest.raises(InputError, match=rf"{field}: '.*' is no "):
        load_fleet(path)


BODY = "drive: {type: topic, "
FIELDS = {
    # a piece of a fleet file with a mistake, in place of what, and the field that is named
    "a topic": ("drive: {type: simulated, position: 0.1}", f"{BODY}topic: 'a b'}}", "robots.0.drive.topic: 'a b' is"),
    "no text": (
        "drive: {type: simulated, position: 0.1}",
        f"{BODY}command_topic: 5}}",
        "robots.0.drive.command_topic:",
    ),
    "of the imu": (
        "drive: {type: simulated, position: -0.1}",
        f"{BODY}gravity: imu, imu: {{topic: /a-b}}}}",
        "robots.1.drive.imu.topic: '/a-b' is",
    ),
    "of the plane": ("plane: {host", "plane: {type: driver, topic: '%', host", "coordinators.plane.topic: '%' is"),
    "a setting": (
        "drive: {type: simulated, position: 0.1}",
        "drive: {type: plugin, name: a, settings: {'a b': 1}}",
        "robots.0.drive.settings.a b: 'a b' is no name of a setting",
    ),
    "a setting's value": (
        "drive: {type: simulated, position: 0.1}",
        "drive: {type: plugin, name: a, settings: {a: {}}}",
        "robots.0.drive.settings",
    ),
    "what is set": ("name: one", "name: one\nset: {'a b': 1}", "set.a b: 'a b' is no dotted path"),
}


@pytest.mark.parametrize("case", FIELDS)
def test_a_field_is_named_as_it_is_in_the_file(case: str, tmp_path: Path) -> None:
    old, new, field = FIELDS[case]
    path = edited(tmp_path / "bad.yaml", ONE_HOST, (old, new))
    with pytest.raises(InputError) as caught:
        load_fleet(path)
    text = str(caught.value)
    assert f": {field}" in text
    for internal in ("function-", "literal[", "[key]", "json", "+1 more", "check("):
        assert internal not in text, text


SINGLE, DOUBLE = "drive: {type: simulated, position: 0.1}", "drive: {type: simulated, position: -0.1}"


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
    _, double = drives(tmp_path)
    assert values_of(double) == {parameter.name: parameter.default for parameter in TOPIC.settings}


def test_the_weight_of_a_double_integrator_is_balanced_unless_it_is_said(tmp_path: Path) -> None:
    assert [drive.gravity for drive in drives(tmp_path)] == ["none", "imu"]
    assert [drive.gravity for drive in drives(tmp_path, ", gravity: none", ", gravity: none")] == ["none", "none"]


def test_bounds_of_what_is_believed_reach_the_node(tmp_path: Path) -> None:
    more = ", bandwidth: 40, max_jump: 0.02, age_limit: 0.2, imu: {max_rate: 3, max_jump: 0.1}"
    _, double = drives(tmp_path, double=more)
    assert (double.bandwidth, double.max_jump, double.age_limit) == (40.0, 0.02, 0.2)
    assert (double.imu.max_rate, double.imu.max_jump) == (3.0, 0.1)


@pytest.mark.parametrize(
    ("old", "drive", "error"),
    [
        (SINGLE, "gravity: imu", "robots.0.drive: gravity does not act on a single integrator; remove 'gravity: imu'"),
        (SINGLE, "command: joint", "robots.0.drive.joint.name: there is none; give the name of the joint"),
        (SINGLE, "joint: {scale: 0.0}", "robots.0.drive.joint.scale: 0 is not allowed; give m or m/rad"),
        (SINGLE, "reversed: true", "robots.0.drive.reversed: the orientation in an odometry says which way"),
        (DOUBLE, "max_jmp: 1", "robots.1.drive.max_jmp: unknown key 'max_jmp'; did you mean 'max_jump'?"),
        (DOUBLE, "age_limit: 0", "robots.1.drive.age_limit: 0 is out of range; give a number > 0"),
    ],
)
def test_settings_of_a_drive_are_checked(old: str, drive: str, error: str, tmp_path: Path) -> None:
    path = edited(tmp_path / "bad.yaml", ONE_HOST, (old, f"drive: {{type: topic, {drive}}}"))
    with pytest.raises(InputError, match=re.escape(f": {error}")):
        load_fleet(path)


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


def test_the_epoch_is_that_time(tmp_path: Path) -> None:
    loaded = load_fleet(edited(tmp_path / "f.yaml", LAN, ("name: lan", "name: lan\nepoch: 2026-03-01T12:30:05Z")))
    assert loaded.fleet.epoch_ns == 1772368205 * 10**9  # date -u -d 2026-03-01T12:30:05Z +%s


def test_too_many_robots_for_the_ports_of_a_host(tmp_path: Path) -> None:
    robot = "  - {{id: {}, host: base, kind: single_integrator, mass: 0.4, drive: {{position: {}, type: simulated}}}}\n"
    lines = "".join(robot.format(number, 0.1 * (-1) ** number) for number in range(10, 46))
    with pytest.raises(InputError, match="put at most 37 robots on one host"):
        load_fleet(edited(tmp_path / "f.yaml", ONE_HOST, ("coordinators:", f"{lines}coordinators:")))
    fewer = "".join(robot.format(number, 0.1 * (-1) ** number) for number in range(10, 45))
    load_fleet(edited(tmp_path / "f.yaml", ONE_HOST, ("coordinators:", f"{fewer}coordinators:")))


def test_the_schema_describes_every_field_and_asks_for_security() -> None:
    schema = json_schema()
    assert "security" in schema["required"]  # type: ignore[operator]
    properties = schema["properties"]
    assert isinstance(properties, dict)
    assert set(properties) >= {"hosts", "robots", "coordinators", "network", "security", "time", "installation"}
    assert all("description" in field for field in properties.values())
    levels = [choice["properties"]["level"]["const"] for choice in properties["security"]["oneOf"]]
    assert levels == ["none", "tunnel", "sros2"]
