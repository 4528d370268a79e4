"""DDS through a tunnel: nothing of it is seen on the wire. `test_fence` shows that nobody gets past the tunnel.

WireGuard's userspace implementation needs no module of the kernel; a socket takes its configuration
(https://www.wireguard.com/xplatform/).
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from tests.hosts.cluster import Host, hosts
from tests.hosts.test_dds import DOMAIN, talking
from tests.processes import until

from swarmabs_config.ports import metatraffic_port
from swarmabs_run.orchestration.network import FIRST_FREE, Discovery, network_profile_xml

# `go install golang.zx2c4.com/wireguard@latest` calls it wireguard.
PROGRAM = next(filter(None, [os.environ.get("WIREGUARD_GO"), *map(shutil.which, ("wireguard-go", "wireguard"))]), None)
WITHOUT = "no wireguard-go on the search path or in WIREGUARD_GO: go install golang.zx2c4.com/wireguard@latest"

pytestmark = [
    pytest.mark.system,
    pytest.mark.timeout(300),
    pytest.mark.usefixtures("possible"),
    pytest.mark.skipif(PROGRAM is None, reason=WITHOUT),
    pytest.mark.skipif(not Path("/dev/net/tun").exists(), reason="this kernel has no TUN devices"),
]

INNER = ("10.84.0.1", "10.84.0.2")
PORT = 51820
_SOCKET = "/run/wireguard/wg0.sock"
_CONFIGURE = """
import socket, sys
with socket.socket(socket.AF_UNIX) as device:
    device.connect(sys.argv[1])
    device.sendall(sys.stdin.buffer.read())
    sys.stdout.buffer.write(device.recv(4096))
"""


def join(host: Host, inner: str, own: X25519PrivateKey, peers: Mapping[str, tuple[X25519PrivateKey, Host]]) -> None:
    """Give a host the interface wg0 with an address and a key; others have theirs, by their addresses there."""
    host.start([PROGRAM, "--foreground", "wg0"], env={"LOG_LEVEL": "error"})
    until(lambda: host.start(["test", "-S", _SOCKET]).wait() == 0, f"{host.name} has a tunnel device")
    lines = ["set=1", f"private_key={own.private_bytes_raw().hex()}", f"listen_port={PORT}"]
    for address, (key, other) in peers.items():
        public = key.public_key().public_bytes_raw().hex()
        lines += [f"public_key={public}", f"endpoint={other.address}:{PORT}", f"allowed_ip={address}/32"]
    configure = host.start([sys.executable, "-c", _CONFIGURE, _SOCKET], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert configure.communicate("\n".join(lines) + "\n\n")[0] == "errno=0\n\n"
    host.ip("address", "add", f"{inner}/24", "dev", "wg0")
    host.ip("link", "set", "wg0", "up", "mtu", "1420")


def join_both(one: Host, other: Host) -> None:
    """Connect two hosts by a tunnel."""
    keys = [X25519PrivateKey.generate(), X25519PrivateKey.generate()]
    join(one, INNER[0], keys[0], {INNER[1]: (keys[1], other)})
    join(other, INNER[1], keys[1], {INNER[0]: (keys[0], one)})


def test_dds_is_in_the_tunnel_only(tmp_path: Path) -> None:
    with hosts(2) as pair:
        join_both(*pair)
        inner = dict(zip(pair, INNER, strict=False))
        peers = Discovery(peers=tuple((address, metatraffic_port(DOMAIN, 0)) for address in inner.values()))
        with talking(pair, tmp_path, lambda host: network_profile_xml(inner[host], peers, FIRST_FREE)):
            for host in pair:
                assert host.listening() == {("udp", address) for address in (inner[host], "0.0.0.0", "[::]")}
        assert pair.switches[0].dds_messages() == 0
