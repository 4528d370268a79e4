"""Keys, certificates, signatures and permissions, examined by openssl and as XML."""

from __future__ import annotations

import base64
import fnmatch
import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from tests.swarmabs_fleet.fleets import contents, deployed, example

from swarmabs_core.errors import InputError

_X25519_PRIVATE = bytes.fromhex("302e020100300506032b656e04220420")
"""What stands before a private X25519 key of 32 bytes in DER, RFC 8410."""


def openssl(*arguments: object, data: bytes | None = None) -> subprocess.CompletedProcess[bytes]:
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("there is no openssl here")
    return subprocess.run([program, *map(str, arguments)], input=data, capture_output=True, check=False)


@pytest.fixture(scope="module")
def tunnel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tunnel")
    return deployed(example("tunnel"), folder / "out", folder / "keys")


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hall")
    return deployed(example("sros2"), folder / "out", folder / "keys")


def wireguard(path: Path) -> tuple[dict[str, str], list[dict[str, str]]]:
    """Return the interface and the peers of a configuration."""
    sections = re.split(r"^\[(Interface|Peer)\]\n", path.read_text(), flags=re.MULTILINE)[1:]
    parsed = [dict(re.findall(r"^(\w+) = (.*)$", body, re.MULTILINE)) for body in sections[1::2]]
    assert sections[0] == "Interface" and set(sections[2::2]) == {"Peer"}
    return parsed[0], parsed[1:]


def test_public_keys_are_those_of_the_private_ones_and_peers_fit_together(tunnel: Path) -> None:
    files = {path.parts[-3]: wireguard(path) for path in tunnel.glob("*/wireguard/floor0.conf")}
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


@pytest.mark.parametrize("fixture", ["tunnel", "hall"])
def test_a_private_key_is_in_the_bundle_of_its_host_only(fixture: str, request: pytest.FixtureRequest) -> None:
    output: Path = request.getfixturevalue(fixture)
    files = contents(output)
    pattern = rb"PrivateKey = (\S+)|-----BEGIN PRIVATE KEY-----\n([^-]+)"
    secrets = {path: b"".join(key) for path, text in files.items() for key in re.findall(pattern, text)}
    assert len(secrets) == (4 if fixture == "tunnel" else 9)
    assert len(set(secrets.values())) == len(secrets)
    for path, secret in secrets.items():
        assert [other for other, text in files.items() if secret in text] == [path]
        assert (output / path).stat().st_mode & 0o7777 == 0o600
    if fixture == "hall":
        authority = (output.parent / "keys/hall/sros2/ca.key.pem").read_bytes()
        assert not [path for path, text in files.items() if authority.splitlines()[1] in text]


def enclaves(output: Path) -> dict[str, Path]:
    return {path.parent.name: path.parent for path in sorted(output.glob("*/keystore/enclaves/hall/*/cert.pem"))}


def test_certificates_are_issued_by_the_authority_for_their_own_key(hall: Path) -> None:
    found = enclaves(hall)
    assert set(found) == {
        "plane_driver",
        "abstraction_observer",
        "parent_controller",
        "discovery_server",
        "operator_base",
        "driver_base",
        "agent_001",
        "driver_arm_1",
        "agent_002",
    }
    for name, folder in found.items():
        ca = folder / "identity_ca.cert.pem"
        assert openssl("verify", "-x509_strict", "-CAfile", ca, ca).returncode == 0
        done = openssl("verify", "-CAfile", ca, folder / "cert.pem")
        assert done.returncode == 0, done.stderr
        subject = openssl("x509", "-in", folder / "cert.pem", "-noout", "-subject", "-nameopt", "RFC2253").stdout
        assert subject.decode().strip() == f"subject=CN=/hall/{name}"
        of_certificate = openssl("x509", "-in", folder / "cert.pem", "-noout", "-pubkey").stdout
        assert openssl("pkey", "-in", folder / "key.pem", "-pubout").stdout == of_certificate
        assert b"prime256v1" in openssl("x509", "-in", folder / "cert.pem", "-noout", "-text").stdout


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
    found = enclaves(hall)
    publishers = {
        "rt/hall/swarm/desired_abstract_state": {"parent_controller"},
        "rt/hall/swarm/abstract_state": {"abstraction_observer"},
        "rt/hall/swarm/auxiliary_state": {"abstraction_observer"},
        "rt/hall/plane/state": {"plane_driver"},
        "rt/hall/swarm/agent_state": {"agent_001", "agent_002"},
        "rt/hall/agent_001/transition_event": {"agent_001"},
        "rt/hall/agent_002/transition_event": {"agent_002"},
        "rt/swarm/desired_abstract_state": set(),
        "rq/hall/swarm/stopRequest": {"operator_base"},
        "rq/hall/agent_001/leaveRequest": {"operator_base"},
        "rq/hall/parent_controller/set_parametersRequest": {"operator_base"},
        "rt/cmd_vel": {"agent_001"},
        "rt/odom": {"driver_arm_1"},
        "rt/plane/encoder": {"driver_base"},
        "rt/hall/swarm/events": {
            *("plane_driver", "abstraction_observer", "parent_controller", "agent_001", "agent_002", "operator_base")
        },
        "rt/hall/diagnostics": {
            *("plane_driver", "abstraction_observer", "parent_controller", "agent_001", "agent_002")
        },
    }
    for topic, expected in publishers.items():
        assert {name for name, folder in found.items() if may(folder, "publish", topic)} == expected, topic
    everything = {
        "rt/hall/swarm/abstract_state",
        "rt/hall/swarm/auxiliary_state",
        "rt/hall/swarm/desired_abstract_state",
    }
    for topic in everything:
        assert may(found["agent_001"], "subscribe", topic)
    assert not may(found["agent_001"], "subscribe", "rt/hall/swarm/agent_state"), "robots do not see each other"
    assert set(rights(found["agent_001"], "publish")) == {
        "ros_discovery_info",
        "rt/rosout",
        "rt/parameter_events",
        "rt/hall/diagnostics",
        "rt/hall/swarm/agent_state",
        "rt/hall/swarm/events",
        "rt/hall/agent_001/*",
        "rr/hall/agent_001/*Reply",
        "rt/cmd_vel",
    }


def test_keys_of_another_authority_are_not_used(tmp_path: Path) -> None:
    deployed(example("sros2"), tmp_path / "out", tmp_path / "keys")
    folder = tmp_path / "keys" / "hall" / "sros2"
    for name in ("ca.key.pem", "ca.cert.pem"):
        (folder / name).unlink()
    with pytest.raises(InputError, match="does not fit its key or the authority"):
        deployed(example("sros2"), tmp_path / "again", tmp_path / "keys")
    assert not (tmp_path / "again").exists()
    (folder / "ca.key.pem").write_text("nonsense")
    (folder / "ca.key.pem").chmod(0o600)
    with pytest.raises(InputError, match=r"ca\.key\.pem holds no private key; restore it"):
        deployed(example("sros2"), tmp_path / "again", tmp_path / "keys")
