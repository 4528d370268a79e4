"""What a step costs by the number of robots, fitted to a result, and what follows for robots on many hosts.

The fit is measured; what follows from it for swarms that nobody has run is derived, and says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import fsum
from statistics import median
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    Row = Mapping[str, Any]

AGENTS: Final = "agents"
ROUND_TRIP: Final = 0.5
"""Assumed time, ms, that messages of a step are on their way between hosts: there and back through a switch."""
COORDINATORS: Final = ("plane", "observer", "controller", "recorder")


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line ``a + b N`` in ms: what a step costs whatever N is, and what each robot adds."""

    a: float
    b: float

    def at(self, robots: float) -> float:
        """Return the cost of a step, ms."""
        return self.a + self.b * robots


def fitted(points: Sequence[tuple[float, float]]) -> Line:
    """Fit a line to points (N, ms) so that the squares of its relative errors are least; it falls nowhere below 0.

    Parameters
    ----------
    points : sequence of tuple
        Of at least two numbers of robots; all costs above 0.
    """
    ones = [1.0 / cost for _, cost in points]
    slopes = [robots / cost for robots, cost in points]
    oo, ss = fsum(x * x for x in ones), fsum(x * x for x in slopes)
    os = fsum(x * y for x, y in zip(ones, slopes, strict=True))
    o, s = fsum(ones), fsum(slopes)
    determinant = oo * ss - os * os
    a, b = (o * ss - s * os) / determinant, (oo * s - os * o) / determinant
    if a < 0.0:
        return Line(0.0, s / ss)
    if b < 0.0:
        return Line(o / oo, 0.0)
    return Line(a, b)


@dataclass(frozen=True, slots=True)
class Cost:
    """What was measured of a step of so many robots, ms.

    Parameters
    ----------
    robots : int
        How many.
    step : float
        Its wall time.
    cpu : dict
        Processor time by role; that of the agents is the sum of all.
    """

    robots: int
    step: float
    cpu: dict[str, float]

    @property
    def coordinators(self) -> float:
        """Processor time of the coordinators together."""
        return sum(cost for role, cost in self.cpu.items() if role != AGENTS)


def costs(rows: Sequence[Row]) -> list[Cost]:
    """Return what the product's runs have cost, of those that were long enough to look twice."""
    found = []
    for row in rows:
        loads = [repeat["product"]["load"] for repeat in row["repeats"] if repeat["product"]["load"] is not None]
        if loads:
            roles = sorted({role for load in loads for role in load["cpu_share"]})
            cpu = {
                role: median(
                    1000.0 * load["cpu_share"].get(role, 0.0) * load["seconds"] / load["steps"] for load in loads
                )
                for role in roles
            }
            step = 1000.0 / row["summary"]["steps_per_second"]["product"]["median"]
            found.append(Cost(row["robots"], step, cpu))
    return found


@dataclass(frozen=True, slots=True)
class Model:
    """Lines through what was measured.

    Parameters
    ----------
    step : Line
        Wall time of a step.
    roles : dict
        Processor time by role.
    """

    step: Line
    roles: dict[str, Line]


def model(found: Sequence[Cost]) -> Model | None:
    """Fit the lines; None if there are not at least two numbers of robots."""
    if len({cost.robots for cost in found}) < 2:
        return None
    roles = sorted({role for cost in found for role in cost.cpu})
    points = {role: [(cost.robots, cost.cpu[role]) for cost in found if cost.cpu.get(role)] for role in roles}
    return Model(
        fitted([(cost.robots, cost.step) for cost in found]),
        {role: fitted(seen) for role, seen in points.items() if len(seen) > 1},
    )


def spread_out(known: Model, robots: int, hosts: int, cores: int, *, relays: bool) -> float:
    """Derive the time, ms, of a step of robots on many hosts; the coordinators have a host of their own.

    Each role's processor time is what it was measured to be on one host. The robots of a host share its cores;
    observer, plane and recorder work at the same time, the controller after the plane; the network adds `ROUND_TRIP`.
    Without relays the slowest of the coordinators takes one message per robot. With them a process on each host takes
    its robots' states, at the observer's cost of each, and the coordinators take one message per host.
    """
    nothing = Line(0.0, 0.0)
    lines = {role: known.roles.get(role, nothing) for role in (*COORDINATORS, AGENTS)}
    here = -(-robots // hosts)
    compute = lines[AGENTS].at(here) / min(cores, here)
    gathering = [lines["observer"], lines["plane"]] if relays else [lines[r] for r in ("observer", "plane", "recorder")]
    gathered = max(line.at(hosts if relays else robots) for line in gathering)
    relayed = lines["observer"].b * here if relays else 0.0
    return compute + relayed + gathered + lines["controller"].a + ROUND_TRIP
