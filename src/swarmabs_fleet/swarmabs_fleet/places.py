"""Where things are on a host once its bundle is installed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from swarmabs_config.fleet.model import Fleet

UNIT_FOLDER = "/etc/systemd/system"
WIREGUARD_FOLDER = "/etc/wireguard"
FENCE = "fence.sh"
"""Script of a bundle that lets in by the tunnel only what is for the address in it."""
SOURCED_PYTHON = "/usr/bin/python3"


@dataclass(frozen=True, slots=True)
class Places:
    """Paths on one host.

    Parameters
    ----------
    installed : str
        Folder of the installed bundle.
    state : str
        Folder of what nodes write.
    python : str
        Interpreter of the nodes.
    """

    installed: str
    state: str
    python: str

    @classmethod
    def of(cls, fleet: Fleet, host: str) -> Places:
        """Return the paths on a host of a fleet."""
        own = f"{fleet.installation.checkout}/.venv/bin/python"
        return cls(
            installed=f"{fleet.installation.prefix}/{fleet.name}",
            state=f"/var/lib/{state_folder(fleet)}",
            python=own if fleet.ros(host) == "wheels" else SOURCED_PYTHON,
        )


def state_folder(fleet: Fleet) -> str:
    """Return the folder below ``/var/lib``, and the first part of the names of all units."""
    return f"swarmabs-{fleet.name}"


def unit_name(fleet: Fleet, node: str) -> str:
    """Return the name of a node's unit."""
    return f"swarmabs-{fleet.name}-{node}.service"


def target_name(fleet: Fleet) -> str:
    """Return the name of the unit that starts and stops all nodes of a host."""
    return f"swarmabs-{fleet.name}.target"


def enclave(fleet: Fleet, name: str) -> str:
    """Return the name of a node's security enclave."""
    return f"/{fleet.name}/{name}"


def tunnel_heading(fleet: Fleet) -> str:
    """Return the first line of a tunnel's configuration, by which scripts know it as their own."""
    return f"# swarmabs fleet {fleet.name}"
