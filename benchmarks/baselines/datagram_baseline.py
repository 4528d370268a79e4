"""The same messages over Unix datagram sockets: the speed of the kernel without a messaging library.

The sockets are in Linux's abstract namespace and leave no files. A full receive queue blocks the sender, so
nothing is lost.
"""

from __future__ import annotations

import os
import socket
import sys
from functools import partial
from typing import TYPE_CHECKING

from workers import SIZES, Workers, agent_of, arguments, blank, stamped, step_of

if TYPE_CHECKING:
    from collections.abc import Sequence

LARGEST = 256


def address(run: int, name: str) -> bytes:
    """Return the address of a socket of a program."""
    return b"\0" + f"swarmabs-baseline-{run}-{name}".encode()


def bound(run: int, name: str) -> socket.socket:
    """Return the socket of a process."""
    made = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    made.bind(address(run, name))
    return made


def agent(run: int, number: int, workers: Workers) -> None:
    """Repeat: send a state, wait for the three broadcasts."""
    mine = bound(run, f"agent-{number}")
    workers.ready()
    targets = address(run, "observer"), address(run, "plane")
    state, step = blank("agent", number), 0
    while True:
        data = stamped(state, step)
        for target in targets:
            mine.sendto(data, target)
        missing = {SIZES["abstract"], SIZES["auxiliary"], SIZES["desired"]}
        while missing:
            heard = mine.recv(LARGEST)
            if step_of(heard) == step:
                missing.discard(len(heard))
        step += 1


def gather(mine: socket.socket, robots: int, step: int) -> None:
    """Wait until the states of all robots for a step have arrived."""
    seen: set[int] = set()
    while len(seen) < robots:
        data = mine.recv(LARGEST)
        if step_of(data) == step:
            seen.add(agent_of(data))


def agent_addresses(run: int, robots: int) -> Sequence[bytes]:
    """Return the addresses of all robots."""
    return [address(run, f"agent-{number}") for number in range(1, robots + 1)]


def observer(run: int, robots: int, workers: Workers) -> None:
    """Repeat: gather the states, send two broadcasts."""
    mine, agents = bound(run, "observer"), agent_addresses(run, robots)
    workers.ready()
    first, second, step = blank("abstract"), blank("auxiliary"), 0
    while True:
        gather(mine, robots, step)
        for data in (stamped(first, step), stamped(second, step)):
            for target in agents:
                mine.sendto(data, target)
        step += 1


def plane(run: int, robots: int, workers: Workers) -> None:
    """Repeat: gather the states, send the plane's state to the controller."""
    mine, target = bound(run, "plane"), address(run, "controller")
    workers.ready()
    message, step = blank("plane"), 0
    while True:
        gather(mine, robots, step)
        mine.sendto(stamped(message, step), target)
        step += 1


def controller(run: int, robots: int, workers: Workers) -> None:
    """Repeat: answer the plane's state with the third broadcast."""
    mine, agents = bound(run, "controller"), agent_addresses(run, robots)
    workers.ready()
    message = blank("desired")
    while True:
        step = step_of(mine.recv(LARGEST))
        workers.made(step)
        data = stamped(message, step)
        for target in agents:
            mine.sendto(data, target)


def main() -> int:
    """Run the baseline program."""
    robots, run = arguments().parse_args().robots, os.getpid()
    roles = {
        "abstraction_observer": partial(observer, run, robots),
        "plane_sim": partial(plane, run, robots),
        "parent_controller": partial(controller, run, robots),
        **{f"agent_{number:03d}": partial(agent, run, number) for number in range(1, robots + 1)},
    }
    return Workers().serve(roles)


if __name__ == "__main__":
    sys.exit(main())
