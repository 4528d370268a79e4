"""A model of the cost of a step by the number of robots, fitted to a result, and its extrapolation to many hosts.

The fit rests on measurements; extrapolated values are marked as derived.
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
"""Assumed network time, ms, of the messages of a step: a round trip through a switch."""
COORDINATORS: Final = ("plane", "observer", "controller", "recorder")


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line ``a + b N`` in ms: the fixed cost of a step and the cost of each robot."""

    a: float
    b: float

    def at(self, robots: float) -> float:
        """Return the cost of a step, ms."""
        return self.a + self.b * robots


def fitted(points: Sequence[tuple[float, float]]) -> Line:
    """Fit a line with non-negative coefficients to points (N, ms) by least squares of the relative error.

    Parameters
    ----------
    points : sequence of tuple
        At least two swarm sizes; all costs above 0.
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
    """Measured cost of a step, ms.

    Parameters
    ----------
    robots : int
        Number of robots.
    step : float
        Wall time.
    cpu : dict
        Processor time by role; for agents the sum over all.
    """

    robots: int
    step: float
    cpu: dict[str, float]

    @property
    def coordinators(self) -> float:
        """Total processor time of the coordinators."""
        return sum(cost for role, cost in self.cpu.items() if role != AGENTS)


def costs(rows: Sequence[Row]) -> list[Cost]:
    """Return the costs of the product's runs that were long enough for two samples."""
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
    """Lines fitted to the measurements.

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
    """Fit the lines; None with fewer than two swarm sizes."""
    if len({cost.robots for cost in found}) < 2:
        return None
    roles = sorted({role for cost in found for role in cost.cpu})
    points = {role: [(cost.robots, cost.cpu[role]) for cost in found if cost.cpu.get(role)] for role in roles}
    return Model(
        fitted([(cost.robots, cost.step) for cost in found]),
        {role: fitted(seen) for role, seen in points.items() if len(seen) > 1},
    )


def spread_out(known: Model, robots: int, hosts: int, cores: int, *, relays: bool) -> float:
    """Derive the time, ms, of a step with robots on many hosts and the coordinators on a separate host.

    Each role has the processor time measured on one host. The robots of a host share its cores; observer, plane and
    recorder work in parallel, the controller after the plane; the network adds `ROUND_TRIP`. Without relays the
    coordinators receive one message per robot. With relays a process on each host receives the states of its robots,
    at the observer's cost per state, and the coordinators receive one message per host.
    """
    nothing = Line(0.0, 0.0)
    lines = {role: known.roles.get(role, nothing) for role in (*COORDINATORS, AGENTS)}
    here = -(-robots // hosts)
    compute = lines[AGENTS].at(here) / min(cores, here)
    gathering = [lines["observer"], lines["plane"]] if relays else [lines[r] for r in ("observer", "plane", "recorder")]
    gathered = max(line.at(hosts if relays else robots) for line in gathering)
    relayed = lines["observer"].b * here if relays else 0.0
    return compute + relayed + gathered + lines["controller"].a + ROUND_TRIP
