"""WireGuard between test hosts: the userspace implementation, configured by its cross-platform interface.

Without the kernel's module and its tools: `wireguard-go` gives the device, and a socket takes the configuration
(https://www.wireguard.com/xplatform/). Keys are made by openssl.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.hosts.cluster import Host
from tests.processes import until

PORT = 51820
_SOCKET = "/run/wireguard/wg0.sock"
_CONFIGURE = """
import socket, sys
with socket.socket(socket.AF_UNIX) as device:
    device.connect(sys.argv[1])
    device.sendall(sys.stdin.buffer.read())
    answer = device.recv(4096)
sys.exit(0 if answer == b"errno=0\\n\\n" else repr(answer))
"""


def program() -> str | None:
    """Return the program, which is called wireguard if `go install golang.zx2c4.com/wireguard@latest` made it."""
    found = [shutil.which(name) for name in ("wireguard-go", "wireguard")]
    return next(filter(None, [os.environ.get("WIREGUARD_GO"), *found]), None)


def why_no_tunnel() -> str | None:
    """Return why test hosts cannot have a tunnel here, or nothing if they can."""
    if program() is None:
        return "no wireguard-go on the search path or in WIREGUARD_GO: go install golang.zx2c4.com/wireguard@latest"
    if shutil.which("openssl") is None:
        return "no openssl, which makes the keys"
    if not Path("/dev/net/tun").exists():
        return "this kernel has no TUN devices"
    return None


@dataclass(frozen=True)
class Keys:
    """A pair of X25519 keys, in hexadecimal digits."""

    private: str
    public: str

    @classmethod
    def new(cls) -> Keys:
        """Make a pair. The last 32 bytes of either file are the key."""
        pem = subprocess.run(["openssl", "genpkey", "-algorithm", "X25519"], check=True, capture_output=True).stdout
        read = ("openssl", "pkey", "-outform", "DER")
        private, public = (
            subprocess.run([*read, *more], input=pem, check=True, capture_output=True).stdout[-32:].hex()
            for more in ((), ("-pubout",))
        )
        return cls(private, public)


def start_tunnel(host: Host, address: str, own: Keys, peers: Mapping[str, tuple[Keys, str]]) -> subprocess.Popen[Any]:
    """Give a host the interface wg0.

    Parameters
    ----------
    host : Host
        The host.
    address : str
        Its address in the tunnel.
    own : Keys
        Its keys.
    peers : mapping
        Keys and outer address of the others by their address in the tunnel.
    """
    device = host.start([program(), "--foreground", "wg0"], env={"LOG_LEVEL": "error"})
    until(lambda: host.start(["test", "-S", _SOCKET]).wait() == 0, f"{host.name} has a tunnel device")
    lines = ["set=1", f"private_key={own.private}", f"listen_port={PORT}"]
    for inner, (keys, outer) in peers.items():
        lines += [f"public_key={keys.public}", f"endpoint={outer}:{PORT}", f"allowed_ip={inner}/32"]
    configure = host.start([sys.executable, "-c", _CONFIGURE, _SOCKET], stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    _, error = configure.communicate("\n".join(lines) + "\n\n")
    assert configure.returncode == 0, error
    host.ip("address", "add", f"{address}/24", "dev", "wg0")
    host.ip("link", "set", "wg0", "up", "mtu", "1420")
    return device
