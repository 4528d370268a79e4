"""Keys, certificates and signatures as openssl sees them; the rights of the enclaves against what the nodes use."""

import base64
import fnmatch
import os
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Collection
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from tests.processes import until
from tests.swarmabs_fleet.bundle_processes import ended, installed, running, variables
from tests.swarmabs_fleet.fleets import EXAMPLES, ONE_HOST, contents, deployed, edited, example
from tests.system.realtime import Client, started_client

from swarmabs_config.fleet.loader import LoadedFleet, load_fleet
from swarmabs_config.fleet.participants import node_plans
from swarmabs_core.errors import InputError
from swarmabs_core.realtime.base import Schedule
from swarmabs_fleet.bundle import deploy
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_fleet.operate import HealthMonitor, OperatorClient, Target
from swarmabs_fleet.permissions import Rights, host_rights, node_rights
from swarmabs_run.orchestration.network import claimed_domain

_X25519_PRIVATE = bytes.fromhex("302e020100300506032b656e04220420")
"""What stands before a private X25519 key of 32 bytes in DER, RFC 8410."""


def openssl(*arguments: object, data: bytes | None = None) -> subprocess.CompletedProcess[bytes]:
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("there is no openssl here")
    return subprocess.run([program, *map(str, arguments)], input=data, capture_output=True, check=False)


@pytest.fixture
def hall(examples: dict[str, Path]) -> Path:
    return examples["sros2"]


def wireguard(path: Path) -> tuple[dict[str, str], list[dict[str, str]]]:
    """Return the interface and the peers of a configuration."""
    sections = re.split(r"^\[(Interface|Peer)\]\n", path.read_text(), flags=re.MULTILINE)[1:]
    parsed = [dict(re.findall(r"^(\w+) = (.*)$", body, re.MULTILINE)) for body in sections[1::2]]
    assert sections[0] == "Interface" and set(sections[2::2]) == {"Peer"}
    return parsed[0], parsed[1:]


def test_public_keys_are_those_of_the_private_ones_and_peers_fit_together(examples: dict[str, Path]) -> None:
    files = {path.parts[-3]: wireguard(path) for path in examples["tunnel"].glob("*/wireguard/floor0.conf")}
    assert set(files) == {"base", "cart-1", "cart-2", "cart-3"}
    public = {}
    for host, (interface, _) in files.items():
        secret = base64.b64decode(interface["PrivateKey"], validate=True)
        assert len(secret) == 32
        done = openssl("pkey", "-inform", "DER", "-pubout", "-outform", "DER", data=_X25519_PRIVATE + secret)
        assert done.returncode == 0, done.stderr
        public[host] = base64.b64encode(done.stdout[-32:]).decode()
    assert len(set(public.values())) == 4
    for host, (interface, found) in files.items():
        meets = {peer["PublicKey"] for peer in found}
        others = set(public) - {host} if host == "base" else {"base"}
        assert meets == {public[other] for other in others}, "robots have a tunnel to the coordinators only"
        for peer in found:
            (other,) = (name for name, key in public.items() if key == peer["PublicKey"])
            assert peer["AllowedIPs"] == files[other][0]["Address"]
            assert peer["Endpoint"].endswith(":51820")
        assert interface["ListenPort"] == "51820"
        fence = "/etc/swarmabs/floor/fence.sh"
        assert (interface["PreUp"], interface["PostDown"]) == (f"{fence} up", f"{fence} down")


@pytest.mark.parametrize(("name", "keys"), [("tunnel", 4), ("sros2", 8)])
def test_a_private_key_is_in_the_bundle_of_its_host_only(name: str, keys: int, examples: dict[str, Path]) -> None:
    files = contents(output := examples[name])
    pattern = rb"PrivateKey = (\S+)|-----BEGIN PRIVATE KEY-----\n([^-]+)"
    secrets = {path: b"".join(key) for path, text in files.items() for key in re.findall(pattern, text)}
    assert len(secrets) == len(set(secrets.values())) == keys
    for path, secret in secrets.items():
        assert [other for other, text in files.items() if secret in text] == [path]
        assert (output / path).stat().st_mode & 0o7777 == 0o600
    if name == "sros2":
        authority = (output.parent / "keys/hall/sros2/ca.key.pem").read_bytes()
        assert not [path for path, text in files.items() if authority.splitlines()[1] in text]


SPEAKERS = ("plane_driver", "abstraction_observer", "parent_controller", "agent_001", "agent_002")


def enclaves(output: Path) -> dict[str, Path]:
    return {path.parent.name: path.parent for path in sorted(output.glob("*/keystore/enclaves/hall/*/cert.pem"))}


def test_certificates_are_issued_by_the_authority_for_their_own_key(hall: Path) -> None:
    folders = enclaves(hall)
    assert set(folders) == {*SPEAKERS, "operator_base", "driver_base", "driver_arm_1"}
    for name, folder in folders.items():
        ca = folder / "identity_ca.cert.pem"
        assert openssl("verify", "-x509_strict", "-CAfile", ca, ca).returncode == 0
        done = openssl("verify", "-x509_strict", "-CAfile", ca, folder / "cert.pem")
        assert done.returncode == 0, done.stderr
        subject = openssl("x509", "-in", folder / "cert.pem", "-noout", "-subject", "-nameopt", "RFC2253").stdout
        assert subject.decode().strip() == f"subject=CN=/hall/{name}"
        of_certificate = openssl("x509", "-in", folder / "cert.pem", "-noout", "-pubkey").stdout
        assert openssl("pkey", "-in", folder / "key.pem", "-pubout").stdout == of_certificate
        assert b"prime256v1" in openssl("x509", "-in", folder / "cert.pem", "-noout", "-text").stdout


def accepted(folder: Path, certificate: Path) -> bool:
    """Say whether an enclave's files accept a certificate, as Fast DDS asks OpenSSL."""
    lists = ("-crl_check", "-CRLfile", folder / "crl.pem")
    return openssl("verify", *lists, "-CAfile", folder / "identity_ca.cert.pem", certificate).returncode == 0


@pytest.mark.system
def test_revoked_certificates_are_refused_by_all_and_replaced(own: Callable[[str], Path], tmp_path: Path) -> None:
    before = own("sros2")
    keys = before.parent / "keys"
    assert not list(before.glob("**/crl.pem")), "without a revocation there is no list"
    with pytest.raises(InputError, match=r"has no certificate of 'arm-3'; did you mean 'arm-"):
        deploy(example("sros2"), tmp_path / "out", keys, ["arm-1", "arm-3"])
    lost = {name: folder / "cert.pem" for name, folder in enclaves(before).items()}
    for step, names, refused in (
        ("one", ["agent_002"], {"agent_002"}),
        ("two", ["arm-1"], {"agent_001", "agent_002", "driver_arm_1"}),
        ("later", [], {"agent_001", "agent_002", "driver_arm_1"}),
    ):
        deploy(example("sros2"), tmp_path / step, keys, names)
        for folder in (found := enclaves(tmp_path / step)).values():
            assert {name for name, certificate in lost.items() if not accepted(folder, certificate)} == refused
            assert all(accepted(folder, other / "cert.pem") for other in found.values())
    (keys / "hall/sros2/crl.pem").write_text("nonsense")
    with pytest.raises(InputError, match=r"crl\.pem is not a certificate revocation list; restore it"):
        deploy(example("sros2"), tmp_path / "out", keys)
    with pytest.raises(InputError, match="security tunnel has no certificates to revoke"):
        deploy(example("tunnel"), tmp_path / "out", tmp_path / "others", ["base"])
    assert not (tmp_path / "out").exists()


def test_signatures_hold_and_cover_what_stands_beside_them(hall: Path) -> None:
    for folder in enclaves(hall).values():
        ca = folder / "permissions_ca.cert.pem"
        for name in ("governance", "permissions"):
            message = folder / f"{name}.p7s"
            done = openssl("smime", "-verify", "-text", "-in", message, "-CAfile", ca)
            assert done.returncode == 0, done.stderr
            signed = done.stdout.replace(b"\r\n", b"\n")
            assert ET.fromstring(signed).tag == "dds"
            if name == "permissions":
                assert signed == (folder / "permissions.xml").read_bytes()
            forged = message.read_bytes().replace(b"<id>42</id>", b"<id>43</id>")
            assert forged != message.read_bytes()
            assert openssl("smime", "-verify", "-text", "-CAfile", ca, data=forged).returncode != 0


def rights(folder: Path, what: str) -> list[str]:
    root = ET.fromstring((folder / "permissions.xml").read_bytes())
    assert root.findtext(".//default") == "DENY"
    assert root.findtext(".//subject_name") == f"CN=/hall/{folder.name}"
    assert [element.text for element in root.findall(".//allow_rule/domains/id")] == ["42"]
    return [element.text or "" for element in root.findall(f".//allow_rule/{what}//topic")]


def may(folder: Path, what: str, topic: str) -> bool:
    return any(fnmatch.fnmatchcase(topic, right) for right in rights(folder, what))


def test_who_may_publish_what(hall: Path) -> None:
    folders = enclaves(hall)
    publishers = {
        "rt/hall/swarm/desired_abstract_state": {"parent_controller"},
        "rt/hall/swarm/abstract_state": {"abstraction_observer"},
        "rt/hall/swarm/auxiliary_state": {"abstraction_observer"},
        "rt/hall/plane/state": {"plane_driver"},
        "rt/hall/swarm/agent_state": set(),
        "rt/hall/swarm/removals": {"abstraction_observer", "operator_base"},
        **{
            f"rt/hall/{robot}/{name}": {robot}
            for robot in ("agent_001", "agent_002")
            for name in ("state", "events", "transition_event")
        },
        "rt/swarm/desired_abstract_state": set(),
        "rq/hall/swarm/stopRequest": {"operator_base"},
        "rq/hall/agent_001/leaveRequest": {"operator_base"},
        "rq/hall/parent_controller/set_parametersRequest": {"operator_base"},
        "rt/cmd_vel": {"agent_001"},
        "rt/odom": {"driver_arm_1"},
        "rt/plane/encoder": {"driver_base"},
        "rt/hall/swarm/events": {*SPEAKERS} - {"agent_001", "agent_002"},
        "rt/hall/diagnostics": {*SPEAKERS},
    }
    for topic, expected in publishers.items():
        assert {name for name, folder in folders.items() if may(folder, "publish", topic)} == expected, topic
    robot = folders["agent_001"]
    for state in ("abstract_state", "auxiliary_state", "desired_abstract_state"):
        assert may(robot, "subscribe", f"rt/hall/swarm/{state}")
    assert set(rights(robot, "publish")) == {
        *("ros_discovery_info", "rt/rosout", "rt/parameter_events", "rt/hall/diagnostics"),
        *("rt/hall/agent_001/*", "rr/hall/agent_001/*Reply", "rt/cmd_vel"),
    }


ROBOTS = (1, 10, 100, 1000, 65535)
BY_COORDINATORS = (
    *("plane/state", "swarm/abstract_state", "swarm/auxiliary_state", "swarm/desired_abstract_state", "swarm/events"),
    *("recording/basis", "swarm/removals", "swarm/agent_state"),
    *("standby/swarm/abstract_state", "standby/swarm/auxiliary_state", "standby/swarm/desired_abstract_state"),
    "standby/recording/basis",
)


def signed_rights(folder: Path) -> dict[str, list[str]]:
    """Return what an enclave may publish and subscribe to, by what its authority has signed."""
    ca = folder / "permissions_ca.cert.pem"
    done = openssl("smime", "-verify", "-text", "-in", folder / "permissions.p7s", "-CAfile", ca)
    assert done.returncode == 0, done.stderr
    root = ET.fromstring(done.stdout.replace(b"\r\n", b"\n"))
    assert (root.findtext(".//default"), root.findall(".//deny_rule")) == ("DENY", [])
    return {
        what: [element.text or "" for element in root.findall(f".//allow_rule/{what}//topic")]
        for what in ("publish", "subscribe")
    }


@pytest.mark.parametrize("namespace", ["/", "/hall"])
def test_no_robots_key_speaks_for_another_node(namespace: str, tmp_path: Path) -> None:
    """The topics are written out here, so that a mistake in the graph of the swarm is no excuse."""
    kinds = ("{type: topic}", "{type: simulated, position: 0.1}")
    robots = "".join(
        f"  - {{id: {i}, host: {host}, kind: single_integrator, mass: 0.4, drive: {kinds[n % 2]}}}\n"
        for n, (i, host) in enumerate(zip(ROBOTS, ("base", "cart", "cart", "cart", "base"), strict=True))
    )
    listed = ONE_HOST[ONE_HOST.index("  - {id: 1") : ONE_HOST.index("coordinators:")]
    changes = [(listed, robots), ("level: none", "level: sros2"), ("installation: {", "installation: {ros: sourced, ")]
    changes.append(("hosts: [", "hosts: [{name: cart, address: 10.0.0.2, interface: eth0}, "))
    changes.append(("address: 127.0.0.1, interface: lo", "address: 10.0.0.1, interface: eth0"))
    changes.append(("scenario:", f"namespace: {namespace}\nscenario:"))
    doubled = ("observer", "controller", "recorder")
    changes += [(f"{name}: {{host: base}}", f"{name}: {{host: base, standby: cart}}") for name in doubled]
    out = deployed(load_fleet(edited(tmp_path / "one.yaml", ONE_HOST, *changes)), tmp_path / "out", tmp_path / "keys")
    found = {
        path.parent.name: signed_rights(path.parent) for path in out.glob("*/keystore/enclaves/**/permissions.p7s")
    }
    names = [f"agent_{i:03d}" for i in ROBOTS]
    operators = {"operator_base", "operator_cart"}
    observers, recorders = ({name, f"{name}_standby"} for name in ("abstraction_observer", "recorder"))
    controllers = {"parent_controller", "parent_controller_standby"}
    coordinators = {"plane_sim", *observers, *controllers, *recorders}
    assert found.keys() == {*names, *coordinators, *operators, "driver_base", "driver_cart"}
    inside = namespace.rstrip("/")

    def may(what: str, topic: str) -> set[str]:
        return {name for name, has in found.items() if any(fnmatch.fnmatchcase(topic, right) for right in has[what])}

    for name in names:
        for topic in ("state", "events"):
            assert may("publish", f"rt{inside}/{name}/{topic}") == {name}
        assert may("subscribe", f"rt{inside}/{name}/state") == coordinators - controllers | operators
        readers = observers | recorders | operators
        assert may("subscribe", f"rt{inside}/{name}/events") == readers
        assert may("publish", f"rr{inside}/{name}/leaveReply") == {name}
        assert may("publish", f"rq{inside}/{name}/leaveRequest") == operators
    for topic in BY_COORDINATORS:
        assert may("publish", f"rt{inside}/{topic}") <= coordinators | operators
    for topic, publisher in (
        ("swarm/abstract_state", "abstraction_observer"),
        ("swarm/auxiliary_state", "abstraction_observer"),
        ("swarm/desired_abstract_state", "parent_controller"),
    ):
        assert may("publish", f"rt{inside}/{topic}") == {publisher}
        assert may("publish", f"rt{inside}/standby/{topic}") == {f"{publisher}_standby"}
    assert may("publish", f"rt{inside}/swarm/removals") == observers | operators
    assert may("subscribe", f"rt{inside}/swarm/removals") == observers | recorders | operators
    for service in ("swarm/stop", "standby/swarm/stop", "swarm/reset", "abstraction_observer/change_state"):
        assert may("publish", f"rq{inside}/{service}Request") == operators


def test_a_standby_speaks_on_topics_of_standbys_only(tmp_path: Path) -> None:
    pair = [
        (f"  {name}: {{host: base}}", f"  {name}: {{host: base, standby: arm-1}}")
        for name in ("observer", "controller")
    ]
    fleet = load_fleet(edited(tmp_path / "hall.yaml", EXAMPLES["sros2"].read_text(encoding="utf-8"), *pair)).fleet
    granted = {name: rights for host in fleet.hosts for name, rights in host_rights(HostPlan(fleet, host.name)).items()}
    assert {name for name in granted if name.startswith("operator")} == {"operator_base", "operator_arm_1"}
    assert granted["operator_base"] == granted["operator_arm_1"]
    shared = {"ros_discovery_info", "rt/parameter_events", "rt/rosout", "rt/hall/diagnostics", "rt/hall/swarm/events"}
    shared.add("rt/hall/swarm/removals")
    for name, topics in (
        (
            "abstraction_observer",
            {"swarm/abstract_state", "swarm/auxiliary_state", "swarm/standing", "recording/basis"},
        ),
        ("parent_controller", {"swarm/desired_abstract_state", "recording/basis"}),
    ):
        standby = {topic for topic in granted[f"{name}_standby"].publish if topic.startswith("rt/")} - shared
        assert standby == {*(f"rt/hall/standby/{topic}" for topic in topics), f"rt/hall/{name}_standby/*"}
        assert not {topic for topic in granted[name].publish if "standby" in topic}, "the primary has its usual rights"
        for topic in topics - {"recording/basis", "swarm/standing"}:
            assert {f"rt/hall/{topic}", f"rt/hall/standby/{topic}"} <= {*granted["agent_002"].subscribe}
    assert {f"rq/hall/standby/swarm/{name}Request" for name in ("stop", "reset")} <= {
        *granted["parent_controller_standby"].subscribe
    }
    assert not {topic for topic in granted["parent_controller_standby"].subscribe if topic.startswith("rq/hall/swarm")}


def test_keys_of_another_authority_are_not_used(own: Callable[[str], Path], tmp_path: Path) -> None:
    keys = own("sros2").parent / "keys"
    folder = keys / "hall" / "sros2"
    for name in ("ca.key.pem", "ca.cert.pem"):
        (folder / name).unlink()
    with pytest.raises(InputError, match="does not match its key or the authority"):
        deployed(example("sros2"), tmp_path / "again", keys)
    of_ed25519 = openssl("genpkey", "-algorithm", "ed25519").stdout
    for name, content, words in (
        ("ca.cert.pem", b"nonsense", r"ca\.cert\.pem does not contain a certificate; restore it"),
        ("ca.key.pem", b"nonsense", r"ca\.key\.pem does not contain a private key; restore it"),
        ("ca.key.pem", of_ed25519, r"ca\.key\.pem contains a key that is not an elliptic-curve key; restore it"),
    ):
        (folder / name).write_bytes(content)
        (folder / name).chmod(0o600)
        with pytest.raises(InputError, match=words):
            deployed(example("sros2"), tmp_path / "again", keys)
    assert not (tmp_path / "again").exists()


DISCOVERY_INFO = "ros_discovery_info"
"""Used by each process for itself, so that it is no node's."""

Endpoints = dict[str, list[str]]


def fleet_of(plane: str, domain: int, folder: Path) -> LoadedFleet:
    """Return a fleet in a namespace with all kinds of nodes that have rights."""
    changes = [("domain: 7", f"domain: {domain}"), ("/etc/swarmabs", f"{folder}/etc"), ("level: none", "level: sros2")]
    changes.append(("installation: {", "installation: {ros: sourced, "))
    changes.append(("scenario:", "namespace: /hall\nscenario:"))
    if plane != "simulated":
        changes.append((", recorder: {host: base}", ""))
        changes.append(("plane: {host", f"plane: {{type: driver, {plane}, host"))
        changes.append(("type: simulated, position: 0.1", "type: topic, topic: /odom, command_topic: cmd_vel"))
        changes.append(("type: simulated, position: -0.1", "type: topic, gravity: imu"))
    return load_fleet(edited(folder / "one.yaml", ONE_HOST, *changes))


def used_by_nodes(loaded: LoadedFleet, folder: Path) -> dict[str, Endpoints]:
    """Start all nodes of the fleet's one host, and return their endpoints."""
    bundle = installed(loaded, folder)
    names = [node.name for node in node_plans(loaded.fleet)]
    with running(bundle, folder) as units:
        for name, unit in units.items():
            assert unit.said(b"READY=1", b"WATCHDOG=1"), f"{name}: {unit.complaint()}"
        environment = {**os.environ, **variables(bundle / "nodes/operator.env"), "ROS_LOG_DIR": str(folder / "ros")}
        with started_client(environment, "stock_node") as client:
            endpoints = settled(client, names)
        assert set(ended(units)) == {0}
    return endpoints


def settled(client: Client, names: Collection[str]) -> dict[str, Endpoints]:
    """Return the endpoints of all nodes as DDS calls them, once they are known: they become so one by one."""
    found: dict[str, Endpoints] = {}
    changed = time.monotonic()

    def known() -> bool:
        nonlocal found, changed
        before, found = found, {name: client.topics(name, "/hall", True) for name in client.nodes()}
        if found != before:
            changed = time.monotonic()
        return found.keys() == set(names) and time.monotonic() - changed > 2.0

    until(known, "the same endpoints have been known for a while")
    return found


def rights_of(loaded: LoadedFleet) -> dict[str, Rights]:
    return {node.name: node_rights(loaded.fleet, node) for node in node_plans(loaded.fleet)}


def differences(used: dict[str, Endpoints], rights: dict[str, Rights]) -> dict[str, list[str]]:
    """Return, by node, the endpoints without a right, and the rights without an endpoint."""
    found = {}
    for name, has in rights.items():
        for what, granted in (("publishes", has.publish), ("hears", has.subscribe)):
            topics = {*used[name][what], DISCOVERY_INFO}
            lacking = [t for t in topics if not any(fnmatch.fnmatchcase(t, right) for right in granted)]
            idle = [right for right in granted if not any(fnmatch.fnmatchcase(t, right) for t in topics)]
            texts = [f"{what} {t} without a right" for t in lacking] + [f"no longer {what} {right}" for right in idle]
            found[name] = sorted(found.get(name, []) + texts)
    return {name: texts for name, texts in found.items() if texts}


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.parametrize("plane", ["simulated", "topic: /encoder", pytest.param("source: imu", marks=pytest.mark.full)])
def test_every_node_may_do_what_it_does_and_no_more(plane: str, tmp_path: Path, nothing_survives: str) -> None:
    with claimed_domain() as domain:
        loaded = fleet_of(plane, domain, tmp_path)
        assert differences(used_by_nodes(loaded, tmp_path), rights_of(loaded)) == {}


class _AskedFor(Exception):  # noqa: N818 - it is no error
    """What a node was asked for."""


class Recording:
    """A node that makes nothing, but says by which topic of DDS it would."""

    def create_client(self, _: object, service: str) -> None:
        raise _AskedFor("publish", f"rq/hall/{service}Request", "subscribe", f"rr/hall/{service}Reply")

    def create_publisher(self, _: object, topic: str, *__: object) -> None:
        raise _AskedFor("publish", f"rt/hall/{topic}")

    def create_subscription(self, _: object, topic: str, *__: object) -> None:
        raise _AskedFor("subscribe", f"rt/hall/{topic}")


def test_the_operator_may_do_what_the_commands_do(tmp_path: Path) -> None:
    rights = host_rights(HostPlan(fleet_of("topic: /encoder", 7, tmp_path).fleet, "base"))["operator_base"]
    swarm = Target("one", "/hall", {}, (2,), {}, schedule=Schedule(10_000_000, 0))
    client = OperatorClient(Recording(), swarm)  # type: ignore[arg-type]
    actions: list[Callable[[], object]] = [
        lambda: client.carried_away(2, 1.0).__enter__(),
        lambda: client.listen(HealthMonitor({}), 1.0, lambda: False),
        *(lambda name=name: client.call(name, 1.0) for name in ("swarm/stop", "swarm/reset", "agent_001/leave")),  # type: ignore[misc]
    ]
    for action in actions:
        with pytest.raises(_AskedFor) as asked:
            action()
        words = asked.value.args
        for what, topic in zip(words[::2], words[1::2], strict=True):
            assert any(fnmatch.fnmatchcase(topic, right) for right in getattr(rights, what)), (what, topic)
    # As `ros2 service call` names its node.
    assert any(fnmatch.fnmatchcase("rr/_ros2cli_1/get_parametersReply", right) for right in rights.publish)
    assert not any(fnmatch.fnmatchcase("rt/hall/swarm/desired_abstract_state", right) for right in rights.publish)


def test_a_driver_has_the_other_side_of_what_its_node_has(tmp_path: Path) -> None:
    granted = host_rights(HostPlan(fleet_of("source: imu", 7, tmp_path).fleet, "base"))
    published, heard = (
        [topic for topic in topics if "driver_base" not in topic]
        for topics in (granted["driver_base"].publish, granted["driver_base"].subscribe)
    )
    assert published[4:] == ["rt/hall/plane_driver/imu", "rt/odom", "rt/hall/agent_002/odom", "rt/hall/agent_002/imu"]
    assert heard[2:] == ["rt/hall/cmd_vel", "rt/hall/agent_002/force"]
