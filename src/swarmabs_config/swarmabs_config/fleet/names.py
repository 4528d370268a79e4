"""Texts of a fleet file that end up in paths, units and scripts: a few letters, and never anything a shell reads."""

from __future__ import annotations

import ipaddress
from typing import TYPE_CHECKING, Annotated, TypeAlias

from pydantic import AfterValidator

from swarmabs_config.scenario.errors import show
from swarmabs_config.scenario.fields import problem
from swarmabs_config.scenario.texts import WORD, matching

if TYPE_CHECKING:
    from collections.abc import Callable


def _address(*, loopback: bool) -> Callable[[str], str]:
    def check(text: str) -> str:
        try:
            address = ipaddress.IPv4Address(text)
        except ValueError:
            raise problem(f"{show(text)} is no IPv4 address", "write four numbers, e.g. 192.168.10.1") from None
        if address.is_multicast or address.is_unspecified or address.is_reserved:
            raise problem(f"{text} is no address of a host", "give the address of the host's interface")
        if address.is_loopback and not loopback:
            raise problem(f"{text} is on loopback, where no other host is", "give one of the tunnel, e.g. 10.83.0.1")
        return text

    return check


def _not_root(text: str) -> str:
    if text == "root":
        raise problem("root may do everything on its host", "name an account for the nodes alone, e.g. swarmabs")
    return text


def _network(text: str) -> str:
    try:
        ipaddress.IPv4Network(text)
    except ValueError:
        raise problem(f"{show(text)} is no IPv4 network", "write e.g. 192.168.1.5 or 192.168.1.0/24") from None
    return text


Address: TypeAlias = Annotated[str, AfterValidator(_address(loopback=True))]
TunnelAddress: TypeAlias = Annotated[str, AfterValidator(_address(loopback=False))]
Network: TypeAlias = Annotated[str, AfterValidator(_network)]

Interface: TypeAlias = Annotated[
    str,
    matching(
        r"[A-Za-z0-9][A-Za-z0-9_.-]*", "name of a network interface", "write e.g. eth0; see 'ip link' on the host", 15
    ),
]

Account: TypeAlias = Annotated[
    str,
    matching(r"[a-z_][a-z0-9_-]*", "name of an account", "use small letters, digits, - and _", 31),
    AfterValidator(_not_root),
]

FolderPath: TypeAlias = Annotated[
    str,
    matching(
        r"(?!.*/\.{1,2}(/|$))(/[A-Za-z0-9._-]+)+",
        "absolute path",
        "write e.g. /opt/swarmabs; letters, digits, '.', '-' and '_', without '..'",
    ),
]
"""An absolute path that needs no quotes anywhere; never the root."""

Namespace: TypeAlias = Annotated[
    str, matching(rf"/|(/{WORD})+", "ROS namespace", "write / or e.g. /hall_a; letters, digits and _")
]
PluginName: TypeAlias = Annotated[
    str,
    matching(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", "name of an entry point", "use letters, digits, '_', '.' and '-'", 80),
]
SettingName: TypeAlias = Annotated[
    str,
    matching(rf"{WORD}(\.{WORD})*", "name of a setting", "use letters, digits and _; dots nest", 80),
]


def path_of(namespace: str, name: str) -> str:
    """Return the absolute name of what a node in a namespace calls by a relative or absolute name."""
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"
