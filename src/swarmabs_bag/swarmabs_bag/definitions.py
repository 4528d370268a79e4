"""Which definitions of the swarm's messages can be read from a bag, by their type hashes (docs/compatibility.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_bag.errors import UnknownTypeError
from swarmabs_config.scenario.errors import printable, shorten

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_bag.channels import BagChannel

READABLE = {
    "swarmabs_msgs/msg/AgentState": ("RIHS01_920c20b49337933ad2a2a54073afa24dac7f0bf85b89c0d8dd1b57ebfc9011bc",),
    "swarmabs_msgs/msg/PlaneState": ("RIHS01_eb50ea2ec4166fc2bcb82d6d93a165895a6769696f9119a68ef5631216479631",),
    "swarmabs_msgs/msg/AbstractState": ("RIHS01_d95f247c2589dc4f0829654e4f27b3962f02586fe75af371aa28dd2eabbaa7fd",),
    "swarmabs_msgs/msg/AuxiliaryState": ("RIHS01_52d6abf330048f23e1dfe0c338ba3a94672fa727da8cc3a240be1862e5e4e14d",),
    "swarmabs_msgs/msg/DesiredAbstractState": (
        "RIHS01_8d0ba0d2bda583bda9b0e7c060dfa8a7a61a5c5f1136fef6732eaf73845a4374",
    ),
    "swarmabs_msgs/msg/SwarmEvent": ("RIHS01_fed027d673123455049e51599995fd5dc6fefa15802f457c22ec5640bc24a2ae",),
    "swarmabs_msgs/msg/Basis": ("RIHS01_1251f0667986052e75e8fc930c843c888e9779334f8dbb913468a7921d9366b7",),
}
"""Hashes of the recorded types, that of today last. None is ever taken out."""


def check_definitions(path: object, channels: Iterable[BagChannel]) -> None:
    """Check that the messages of a bag are of definitions that are known.

    A channel without a hash passes: its messages are read as those of today, and their sizes checked.

    Raises
    ------
    UnknownTypeError
        If a hash is not known; the text names topic, type and hash.
    """
    for channel in channels:
        known = READABLE.get(channel.ros_type)
        if channel.topic is not None and channel.type_hash and known is not None and channel.type_hash not in known:
            raise UnknownTypeError(
                f"{path}: {printable(shorten(channel.name))} has a definition of {channel.ros_type} that this version "
                f"does not know ({channel.type_hash[:80]!r}); use the version that wrote it (see the command info), "
                "or a newer one"
            )
