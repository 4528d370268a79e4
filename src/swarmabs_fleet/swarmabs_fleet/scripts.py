"""What installs, uninstalls, restarts and fences a bundle on its host: POSIX shell that is given nothing to interpret.

Names and paths stand in single quotes at the top and in double quotes where they are used; what they may be made of is
checked when the fleet file is read (`names`). With DESTDIR everything goes below that folder, and accounts and services
are left alone, as packagers expect it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_fleet.places import FENCE, UNIT_FOLDER, WIREGUARD_FOLDER, state_folder, target_name, tunnel_heading
from swarmabs_fleet.rendering import render

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_config.fleet.model import Fleet

SCRIPTS = ("install.sh", "uninstall.sh", "restart.sh", FENCE)


def scripts(fleet: Fleet, host: str) -> dict[str, str]:
    """Return the scripts of a host's bundle by name."""
    values = {
        "fleet": fleet.name,
        "host": host,
        "prefix": fleet.installation.prefix,
        "user": fleet.user(host),
        "checkout": fleet.installation.checkout,
        "ros": fleet.ros(host),
        "setup": fleet.installation.setup,
        "target": target_name(fleet),
        "tunnel": fleet.tunnel.interface if fleet.tunnel else "",
        "address": fleet.address(host),
        "interface": fleet.interface(host),
        "tunnel_heading": tunnel_heading(fleet),
        "state": f"/var/lib/{state_folder(fleet)}",
        "unit_folder": UNIT_FOLDER,
        "wireguard_folder": WIREGUARD_FOLDER,
    }
    return {name: render(name, **values) for name in SCRIPTS}


def checksums(sums: Sequence[tuple[str, str]]) -> str:
    """Return the list of files and their SHA-256 as ``sha256sum --check`` reads it."""
    return "".join(f"{digest}  {path}\n" for path, digest in sums)
