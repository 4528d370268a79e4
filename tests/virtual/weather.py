"""The network of a virtual fleet: the fate of a message depends on the seed and on its number on its link only."""

from __future__ import annotations

from collections.abc import Iterable
from random import Random

from tests.virtual.schedule import ALL, Fault

_SHORTEST, _SPREAD = 200_000, 600
"""Time under way, ns: at least so long, and up to 1024 times so much longer."""
_BITS = 1 << 20


class Weather:
    """Fates of messages. On a link that nothing happens to, each is under way for 0.2 to 0.8 ms."""

    def __init__(self, seed: int, names: Iterable[str]) -> None:
        self._names = {name: number for number, name in enumerate(names)}
        self._seed = seed
        self._numbers: dict[tuple[str, str], int] = {}
        self._effects: list[tuple[Fault, frozenset[str] | None, frozenset[str] | None]] = []

    def begin(self, fault: Fault) -> None:
        """Let a fault of links begin."""
        sender, receiver = fault.ends
        self._effects.append((fault, _group(sender), _group(receiver)))

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._effects = [effect for effect in self._effects if effect[0] is not fault]

    def arrivals(self, sender: str, receiver: str, step: int, draw: Random) -> Iterable[int]:
        """Return after which times (ns) a message arrives; none if it is lost."""
        link = sender, receiver
        number = self._numbers[link] = self._numbers.get(link, 0) + 1
        names = self._names
        # The hash of a tuple of integers is the same in every process.
        fate = hash((self._seed, names[sender], names[receiver], number))
        usual = _SHORTEST + (fate & 1023) * _SPREAD
        return self._changed(link, fate >> 10, usual) if self._effects else (usual,)

    def _changed(self, link: tuple[str, str], fate: int, usual: int) -> Iterable[int]:
        sender, receiver = link
        times = [usual]
        for count, (fault, senders, receivers) in enumerate(self._effects):
            if (senders is not None and sender not in senders) or (receivers is not None and receiver not in receivers):
                continue
            share = hash((fate, count)) % _BITS / _BITS
            if fault.kind == "cut" or (fault.kind == "loss" and share < fault.value):
                return ()
            if fault.kind == "slow":
                times = [time + round(fault.value * 1e9) for time in times]
            elif fault.kind == "late":
                times = [time + round(share * fault.value * 1e9) for time in times]
            elif fault.kind == "again" and share < 0.5:
                times += [usual + round(fault.value * 1e9)]
        return times


def _group(names: str) -> frozenset[str] | None:
    """Return the nodes that a text names, None for all."""
    return None if names == ALL else frozenset(names.split(","))
