"""The sets A_A and A_P of the robots that take part: computed once for each membership, in the background."""

from __future__ import annotations

import time
from math import nan
from threading import Thread
from typing import TYPE_CHECKING

from swarmabs_bag.swarm_state import Members
from swarmabs_view.facts import regions
from swarmabs_view.protocol import Sets

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_view.protocol import Hello

    Work = Callable[[], None]

MOST = 64
"""Memberships of which the sets are kept."""
REST = 4.0
"""How many times as long as a computation no other one begins: of 21 different masses one takes a second."""


def in_background(work: Work) -> Thread:
    """Do something in a daemon thread, which rests afterwards."""

    def run() -> None:
        begun = time.monotonic()
        work()
        time.sleep(REST * (time.monotonic() - begun))

    thread = Thread(target=run, daemon=True)
    thread.start()
    return thread


class Shading:
    """What the page shades, by who takes part.

    Parameters
    ----------
    hello : Hello
        What is shown, with the sets of those who take part at first.
    run : callable
        Has a computation done, by default in the background.

    Attributes
    ----------
    first : Sets
        What stands in the hello.
    """

    def __init__(self, hello: Hello, run: Callable[[Work], Thread | None] = in_background) -> None:
        self._hello = hello
        self._run = run
        self._worker: Thread | None = None
        moving = [robot.id for robot in hello.robots if not robot.joins]
        self.first = Sets(moving=moving, standing=[], regions=hello.regions)
        self._known = {Members(tuple(moving), ()): self.first}

    def of(self, members: Members) -> Sets | None:
        """Return the sets of a membership, None as long as they are not computed."""
        if self._hello.plane is None or self._hello.manifold is None:
            return self.first  # nothing is known of this swarm
        found = self._known.get(members)
        if found is None and (self._worker is None or not self._worker.is_alive()):
            self._worker = self._run(lambda: self._compute(members))
        return found or self._known.get(members)

    def _compute(self, members: Members) -> None:
        plane, manifold = self._hello.plane, self._hello.manifold
        if plane is None or manifold is None:
            return
        mass = {robot.id: nan if robot.mass is None else robot.mass for robot in self._hello.robots}
        found = regions(
            [mass[robot] for robot in members.moving],
            plane.length,
            plane.gravity,
            manifold.torque_max,
            [(mass[robot], place) for robot, place in members.standing],
        )
        standing = [robot for robot, _ in members.standing]
        self._known[members] = Sets(moving=list(members.moving), standing=standing, regions=found)
        while len(self._known) > MOST:
            del self._known[next(iter(self._known))]
