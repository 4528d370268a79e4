"""WireGuard: a key pair per host, and for each host the peers it has to meet and no others."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from swarmabs_config.fleet.participants import node_plans
from swarmabs_fleet.places import FENCE, Places, tunnel_heading
from swarmabs_fleet.rendering import render

if TYPE_CHECKING:
    from swarmabs_config.fleet.model import Fleet
    from swarmabs_fleet.keys import Keys


def tunnel_peers(fleet: Fleet, host: str) -> list[str]:
    """Return the hosts that a host has a tunnel to: robots to the coordinators, coordinators to all."""
    central = {node.host for node in node_plans(fleet) if node.robot is None}
    return [other.name for other in fleet.hosts if other.name != host and (host in central or other.name in central)]


def configuration(fleet: Fleet, host: str, keys: Keys) -> str:
    """Return the configuration of a host, as wg-quick reads it; it holds the host's private key."""
    return render(
        "wireguard.conf",
        fleet=fleet,
        host=host,
        heading=tunnel_heading(fleet),
        fence=f"{Places.of(fleet, host).installed}/{FENCE}",
        private=private_key(keys, host),
        peers={peer: public_key(keys, peer) for peer in tunnel_peers(fleet, host)},
    )


def private_key(keys: Keys, host: str) -> str:
    """Return the private key of a host in base64, made at the first call."""
    return keys.kept(f"wireguard/{host}.key", _new_key).decode().strip()


def public_key(keys: Keys, host: str) -> str:
    """Return the public key of a host in base64."""
    secret = X25519PrivateKey.from_private_bytes(base64.b64decode(private_key(keys, host), validate=True))
    return base64.b64encode(secret.public_key().public_bytes_raw()).decode()


def _new_key() -> bytes:
    return base64.b64encode(X25519PrivateKey.generate().private_bytes_raw()) + b"\n"
