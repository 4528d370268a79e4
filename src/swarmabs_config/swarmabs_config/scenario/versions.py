"""Versions of the scenario's schema: how files of older ones are read (docs/compatibility.md)."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

from .errors import describe
from .fields import problem
from .yaml_tree import Plain

Upgrade: TypeAlias = Callable[[dict[str, Plain]], dict[str, Plain]]
"""Makes the content of a scenario of the next version from that of one version, all but ``schema``."""

UPGRADES: tuple[Upgrade, ...] = ()
"""The first leads from schema 1 to schema 2, and so on; there is one version so far."""

SCHEMA_VERSION = 1 + len(UPGRADES)


def upgraded(data: dict[str, Plain], upgrades: Sequence[Upgrade] = UPGRADES) -> dict[str, Plain]:
    """Return a scenario's content as one of the newest version.

    What has no version, or one that is not known, comes back as it is: the check of the fields refuses it.

    Parameters
    ----------
    data : dict
        The content of a scenario file.
    upgrades : sequence of callable
        One for each version but the newest.
    """
    version = data.get("schema")
    if type(version) is not int or not 1 <= version <= len(upgrades):
        return data
    for upgrade in upgrades[version - 1 :]:
        data = upgrade(data)
    return {**data, "schema": 1 + len(upgrades)}


def known_version(value: object) -> object:
    """Refuse, as a field's validator, every version but the newest."""
    if type(value) is int and value > SCHEMA_VERSION:
        raise problem(
            f"{describe(value)} is a newer version than this one reads ({SCHEMA_VERSION})",
            "update swarmabs",
        )
    if type(value) is not int or value != SCHEMA_VERSION:
        raise problem(f"expected {SCHEMA_VERSION}, found {describe(value)}", f"write 'schema: {SCHEMA_VERSION}'")
    return value
