"""The same messages over ZeroMQ: PUSH and PULL for the states, PUB and SUB for the broadcasts, over Unix sockets.

The sockets are in Linux's abstract namespace and leave no files. ZeroMQ loses nothing once all sockets are connected;
resending matters only in the first step, when a subscription may come too late. States that have arrived are kept
meanwhile: the agents that sent them wait for broadcasts, hear those that are resent for the late one, and so never send
theirs again.
"""

from __future__ import annotations

import os
import sys
from functools import partial

import zmq
from workers import SIZES, Workers, agent_of, arguments, blank, stamped, step_of

PATIENCE_MS = 500


def address(run: int, name: str) -> str:
    """Return the address of a socket of a program."""
    return f"ipc://@swarmabs-baseline-{run}-{name}"


def connected(context: zmq.Context[zmq.Socket[bytes]], kind: int, *addresses: str) -> zmq.Socket[bytes]:
    """Return a socket that is connected to these addresses."""
    socket = context.socket(kind)
    if kind == zmq.SUB:
        socket.setsockopt(zmq.SUBSCRIBE, b"")
    socket.setsockopt(zmq.RCVTIMEO, PATIENCE_MS)
    for where in addresses:
        socket.connect(where)
    return socket


def bound(context: zmq.Context[zmq.Socket[bytes]], kind: int, where: str) -> zmq.Socket[bytes]:
    """Return a socket that is bound to an address."""
    socket = context.socket(kind)
    socket.setsockopt(zmq.RCVTIMEO, PATIENCE_MS)
    socket.setsockopt(zmq.SNDHWM, 0)
    socket.setsockopt(zmq.RCVHWM, 0)
    socket.bind(where)
    return socket


def agent(run: int, number: int, workers: Workers) -> None:
    """Repeat: send a state, wait for the three broadcasts."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    to_observer = connected(context, zmq.PUSH, address(run, "observer"))
    to_plane = connected(context, zmq.PUSH, address(run, "plane"))
    broadcasts = connected(context, zmq.SUB, address(run, "sums"), address(run, "desired"))
    workers.ready()
    state, step = blank("agent", number), 0
    while True:
        data = stamped(state, step)
        to_observer.send(data)
        to_plane.send(data)
        missing = {SIZES["abstract"], SIZES["auxiliary"], SIZES["desired"]}
        while missing:
            try:
                heard = broadcasts.recv()
            except zmq.Again:
                to_observer.send(data)
                to_plane.send(data)
                continue
            if step_of(heard) == step:
                missing.discard(len(heard))
        step += 1


def gather(states: zmq.Socket[bytes], robots: int, step: int, seen: set[int]) -> bool:
    """Gather the states of all robots for a step, beyond those already seen; return False on a time-out."""
    while len(seen) < robots:
        try:
            data = states.recv()
        except zmq.Again:
            return False
        if step_of(data) == step:
            seen.add(agent_of(data))
    seen.clear()
    return True


def observer(run: int, robots: int, workers: Workers) -> None:
    """Repeat: gather the states, send two broadcasts."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    states = bound(context, zmq.PULL, address(run, "observer"))
    broadcasts = bound(context, zmq.PUB, address(run, "sums"))
    workers.ready()
    first, second, step = blank("abstract"), blank("auxiliary"), 0
    seen: set[int] = set()
    while True:
        if gather(states, robots, step, seen):
            step += 1
        if step:
            broadcasts.send(stamped(first, step - 1))
            broadcasts.send(stamped(second, step - 1))


def plane(run: int, robots: int, workers: Workers) -> None:
    """Repeat: gather the states, send the plane's state to the controller."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    states = bound(context, zmq.PULL, address(run, "plane"))
    to_controller = connected(context, zmq.PUSH, address(run, "controller"))
    workers.ready()
    message, step = blank("plane"), 0
    seen: set[int] = set()
    while True:
        if gather(states, robots, step, seen):
            step += 1
        if step:
            to_controller.send(stamped(message, step - 1))


def controller(run: int, workers: Workers) -> None:
    """Repeat: answer the plane's state with the third broadcast."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    plane_states = bound(context, zmq.PULL, address(run, "controller"))
    broadcasts = bound(context, zmq.PUB, address(run, "desired"))
    workers.ready()
    message, step = blank("desired"), 0
    while True:
        try:
            step = step_of(plane_states.recv())
            workers.made(step)
        except zmq.Again:
            pass
        broadcasts.send(stamped(message, step))


def main() -> int:
    """Run the baseline program."""
    robots, run = arguments().parse_args().robots, os.getpid()
    roles = {
        "abstraction_observer": partial(observer, run, robots),
        "plane_sim": partial(plane, run, robots),
        "parent_controller": partial(controller, run),
        **{f"agent_{number:03d}": partial(agent, run, number) for number in range(1, robots + 1)},
    }
    return Workers().serve(roles)


if __name__ == "__main__":
    sys.exit(main())
