"""The manifest of a bundle: its files, the versions it was made with, and what can be checked on its host."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Annotated

from pydantic import BeforeValidator, Field, PlainSerializer, ValidationError

from swarmabs_bag.definitions import READABLE
from swarmabs_config.fleet.names import Account, Address, FolderPath, Interface
from swarmabs_config.fleet.participants import nodes_on, ports
from swarmabs_config.scenario.fields import AsTuple, Model
from swarmabs_config.scenario.text_file import read_text
from swarmabs_config.scenario.texts import Name
from swarmabs_core.errors import InputError
from swarmabs_fleet.places import Places

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from swarmabs_config.fleet.loader import LoadedFleet

MANIFEST, SUMS = "manifest.json", "SHA256SUMS"
FORMAT = 1
"""Version of the bundle's layout."""


def _octal(value: object) -> object:
    """Read a mode, which is written as people know it."""
    return int(value, 8) if isinstance(value, str) and value.isdecimal() else value


class FileFacts(Model):
    """A file as it was written."""

    sha256: str = Field(description="SHA-256 of its content")
    mode: Annotated[int, BeforeValidator(_octal), PlainSerializer("{:04o}".format)] = Field(
        description="its mode, an octal text"
    )


class Manifest(Model):
    """What is known of a bundle."""

    bundle: int = Field(description="version of this format")
    fleet: Name = Field(description="name of the fleet")
    host: Name = Field(description="name of the host")
    domain: int = Field(description="ROS domain")
    interface: Interface = Field(description="interface that DDS uses")
    address: Address = Field(description="its address")
    ports: Annotated[tuple[int, ...], AsTuple] = Field(description="UDP ports of the nodes")
    nodes: Annotated[tuple[str, ...], AsTuple] = Field(description="the nodes")
    modules: Annotated[tuple[str, ...], AsTuple] = Field(description="the modules that the nodes run")
    security: str = Field(description="level of security")
    ros: str = Field(description="wheels or sourced")
    checkout: FolderPath = Field(description="checkout on the host")
    installed: FolderPath = Field(description="folder of the installed bundle")
    user: Account = Field(description="account of the nodes")
    max_offset: float = Field(description="largest error of the clock, s")
    versions: dict[str, str] = Field(description="versions it was made with")
    files: dict[str, FileFacts] = Field(description="its files")


def manifest_of(loaded: LoadedFleet, host: str, files: Mapping[str, FileFacts]) -> Manifest:
    """Return the manifest of a host's bundle; before it is made there are no files."""
    fleet = loaded.fleet
    nodes = nodes_on(fleet, host)
    places = Places.of(fleet, host)
    return Manifest(
        bundle=FORMAT,
        fleet=fleet.name,
        host=host,
        domain=fleet.network.domain,
        interface=fleet.interface(host),
        address=fleet.address(host),
        ports=tuple(sorted(port for node in nodes for port in ports(fleet, node))),
        nodes=tuple(node.name for node in nodes),
        modules=tuple(sorted({node.module for node in nodes})),
        security=fleet.security.level,
        ros=fleet.ros(host),
        checkout=fleet.installation.checkout,
        installed=places.installed,
        user=fleet.user(host),
        max_offset=fleet.time.max_offset,
        versions=versions(),
        files=dict(files),
    )


def versions() -> dict[str, str]:
    """Return what the hosts of a fleet must have in common: the version, and the definitions of the messages."""
    try:
        own = version("swarmabs_core")
    except PackageNotFoundError:
        own = "unknown"
    return {"swarmabs": own} | {name.rpartition("/")[2]: hashes[-1] for name, hashes in READABLE.items()}


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a bundle.

    Raises
    ------
    InputError
        If it is missing, damaged, or of a newer format.
    """
    path = folder / MANIFEST
    text = read_text(path, "manifest", "JSON")
    try:
        data = json.loads(text)
        if isinstance(data, dict) and isinstance(data.get("bundle"), int) and data["bundle"] > FORMAT:
            raise InputError(f"{path} is of a newer format than this one reads ({FORMAT}); update swarmabs")
        return Manifest.model_validate(data)
    except (ValueError, RecursionError, ValidationError) as error:
        raise InputError(f"{path} is no manifest of a bundle; deploy again") from error
