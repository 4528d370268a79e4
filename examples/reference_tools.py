"""Continuous-time solutions of the general method, for the tests of the example parent systems.

Nothing here comes from the packages under test: the equations are written down from the method alone, vectorised over
the robots, and SciPy integrates them to a tight tolerance. Robots follow their law at every instant, the command filter
(critically damped) sees the clipped request at every instant, and the parent is driven by the robots' true coordinates.

    a = sum phi_i(q_i),  S = sum_A J_i W_i^-1 J_i^T,  r = sum J_i xi_i,  e = a_d - a
    velocity robots      q_i' = xi_i + W_i^-1 J_i^T S^-1 (K e + a_d' - r)
    force robots         q_i'' = -sigma q_i' + W_i^-1 J_i^T S^-1 (K_p e + K_d e' + a_d'' + sigma a' - h)
    robots with a lag    as velocity robots, with the output of the drive as coordinate; command q_i + T_i q_i'
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
Constants = Mapping[str, Array]
GRAVITY = 9.81
BANDWIDTH = 50.0  # of the command filter, rad/s
STATUS = {"joins": "active", "leaves": "gone", "stands": "stands", "fails": "failed"}


@dataclass(frozen=True)
class Robots:
    """N robots of d coordinates: their kinds, start and constants (each an array of N)."""

    ids: tuple[int, ...]
    kinds: tuple[str, ...]
    coordinates: Array
    velocities: Array
    constants: Constants

    @classmethod
    def of(cls, agents: Sequence[Mapping[str, Any]]) -> "Robots":
        """Return the robots of a scenario's list `swarm.agents`."""
        q = np.array([agent["coordinates"] for agent in agents], dtype=float)
        v = np.array([agent.get("velocities", 0.0 * row) for agent, row in zip(agents, q, strict=True)], dtype=float)
        names = {name for agent in agents for name in agent["constants"]}
        constants = {name: np.array([agent["constants"].get(name, 0.0) for agent in agents]) for name in names}
        return cls(tuple(a["id"] for a in agents), tuple(a["kind"] for a in agents), q, v, constants)

    def with_kinds(self, *kinds: str) -> "Robots":
        """Return the same robots, their kinds replaced by the given ones in turn."""
        return replace(self, kinds=tuple(kinds[i % len(kinds)] for i in range(len(self.ids))))


@dataclass(frozen=True)
class Gains:
    """Gains of the laws, each a number or one per row of a."""

    k: float | Sequence[float]
    kp: float | Sequence[float] = 0.0
    kd: float | Sequence[float] = 0.0
    sigma: float = 1.0
    effort: float | None = None


class Event(NamedTuple):
    """What happens to a robot: it `joins`, it `leaves` with its weight, it `stands`, or its drive `fails`.

    A failed drive follows its lag to 0. The swarm counts on its last output until `known` seconds later.
    """

    time: float
    robot: int
    what: str
    known: float = 0.0


class Swarm(NamedTuple):
    """What the parent and its controller may depend on: a, a', a_d and the robots' spin."""

    value: Array
    rate: Array
    wanted: Array
    spin: float


class System:
    """A parent system in continuous time: start, functions that every system has, and methods with a usual answer."""

    parent: Array
    """State of the parent at the start, (n,)."""
    estimate: Array = np.zeros(0)
    """State of the controller at the start."""
    bounds: tuple[Array, Array]
    """Least and greatest request, (m,) each."""
    completion: tuple[Array, Array, Array]
    """a_d = c + L t + t^T F t of the filtered request t: c (k,), L (k, m), F (k, m, m) symmetric."""

    contribution: Callable[[Array, Constants], Array]
    """phi_i of q, (N, k)."""
    jacobian: Callable[[Array, Constants], Array]
    """J_i of q, (N, k, d)."""
    curvature: Callable[[Array, Constants], Array]
    """q_i'^T H_i q_i' of q', (N, k), the second derivatives H_i of phi_i being constant."""
    ask: Callable[[float, Array, Array, Swarm], tuple[Array, Array]]
    """The request, not yet clipped, and z', of time, x_p, z and the swarm."""
    derivative: Callable[[float, Array, Swarm], Array]
    """x_p' of time, x_p and the swarm."""

    def weight(self, c: Constants) -> Array:
        """Return W_i, (N,)."""
        return c["mass"]

    def own_motion(self, q: Array) -> Array:
        """Return xi_i, (N, d)."""
        return np.zeros_like(q)

    def limited(self, u: Array, law: "Law") -> Array:
        """Return the velocities within the limits of the drives, u being those of the law without."""
        del law
        return u

    def spin(self, q: Array, v: Array, c: Constants) -> float:
        """Return the angular momentum of the robots relative to the parent, if its motion needs it."""
        del q, v, c
        return 0.0

    def changed(self, x: Array, before: Swarm, after: Swarm) -> Array:
        """Return the parent's state after a robot has left in no time."""
        del before, after
        return x


class Law(NamedTuple):
    """Whom the law counts on, and its parts: q, J, W^-1 J^T, xi, constants, the a' wanted (v) and S^-1 (v - r)."""

    counted: NDArray[np.bool_]
    q: Array
    jacobian: Array
    pull: Array
    drift: Array
    constants: Constants
    demand: Array
    dual: Array


class Moment(NamedTuple):
    """All that holds at one instant."""

    swarm: Swarm
    believed: Array
    wanted_rate: Array
    velocities: Array
    request: Array
    derivative: Array


class Solution(NamedTuple):
    """Trajectories on the grid: a row per instant."""

    time: Array
    parent: Array
    estimate: Array
    request: Array
    filtered: Array
    wanted: Array
    wanted_rate: Array
    abstract: Array
    rate: Array
    coordinates: Array
    velocities: Array


@dataclass
class Loop:
    """The closed loop of a system and its robots; ``solve`` integrates it."""

    system: System
    robots: Robots
    gains: Gains
    force_law: str = "second_order"
    events: Sequence[Event] = ()
    status: list[str] = field(init=False)

    def __post_init__(self) -> None:
        joining = {event.robot for event in self.events if event.what == "joins"}
        self.status = ["gone" if robot in joining else "active" for robot in self.robots.ids]
        self.held = self.robots.coordinates.copy()
        second_order = self.force_law == "second_order"
        self.force = np.array([second_order and kind == "double_integrator" for kind in self.robots.kinds])
        sizes = (self.system.parent.size, self.system.estimate.size, *[self.system.bounds[0].size] * 2, self.held.size)
        self.cuts = np.cumsum(sizes)
        self.regroup()

    def regroup(self) -> None:
        """Sort the robots by their status."""
        status = np.array(self.status)
        self.active, self.failed, self.present = status == "active", status == "failed", status != "gone"
        self.counted = self.active | self.failed  # in S
        self.known = self.counted | (status == "stands")  # in what the swarm takes for a
        self.still, self.dead = (status == "stands") | (status == "gone"), self.failed | (status == "lost")
        self.there = {name: value[self.present] for name, value in self.robots.constants.items()}

    def unpack(self, y: Array) -> tuple[Array, ...]:
        """Return x_p, z, the filtered request and its rate, q and the force robots' q'."""
        *rest, q, v = np.split(y, self.cuts)
        moving = np.zeros_like(self.held)
        moving[self.force] = v.reshape(-1, self.held.shape[1])
        return *rest, q.reshape(self.held.shape), moving

    def lift(self, t: Array, t1: Array, t2: Array) -> tuple[Array, Array, Array]:
        """Return a_d, a_d' and a_d''."""
        c, linear, form = self.system.completion
        slope = linear + 2.0 * form @ t
        return c + (linear + form @ t) @ t, slope @ t1, slope @ t2 + 2.0 * (form @ t1) @ t1

    def at(self, time: float, y: Array) -> Moment:
        """Evaluate the closed loop at one instant."""
        system, gains, c = self.system, self.gains, self.robots.constants
        x, z, t, t1, q, moving = self.unpack(y)
        seen = np.where(self.failed[:, None], self.held, q)
        jacobian, inverse = system.jacobian(seen, c), 1.0 / system.weight(c)
        phi = system.contribution(seen, c)
        believed = phi[self.known].sum(axis=0)
        wanted, wanted_rate, _ = self.lift(t, t1, 0.0 * t)
        e, drift = wanted - believed, system.own_motion(seen)
        pull = inverse[:, None, None] * jacobian.transpose(0, 2, 1)  # W^-1 J^T, (N, d, k)
        gram = np.tensordot(jacobian[self.counted], pull[self.counted], ((0, 2), (0, 1)))
        flow = np.tensordot(jacobian[self.counted], drift[self.counted], ((0, 2), (0, 1)))

        demand = gains.k * e + wanted_rate
        dual = np.linalg.solve(gram, demand - flow)
        if gains.effort is not None:
            dual *= min(1.0, gains.effort / max(np.sqrt((demand - flow) @ dual), 1e-300))
        u = system.limited(drift + pull @ dual, Law(self.counted, seen, jacobian, pull, drift, c, demand, dual))
        v = np.where(self.force[:, None], moving, u)
        v[self.still] = 0.0
        if self.dead.any():
            v[self.dead] = -q[self.dead] / c["time_constant"][self.dead, None]
            phi, jacobian = system.contribution(q, c), system.jacobian(q, c)
        value = phi[self.present].sum(axis=0)
        rate = np.tensordot(jacobian[self.present], v[self.present], ((0, 2), (0, 1)))
        swarm = Swarm(value, rate, wanted, system.spin(q[self.present], v[self.present], self.there))
        request, estimate_rate = system.ask(time, x, z, swarm)
        t2 = BANDWIDTH**2 * (np.clip(request, *system.bounds) - t) - 2.0 * BANDWIDTH * t1
        acceleration = v[:0]
        if self.force.any():
            bend = system.curvature(v, c)[self.present].sum(axis=0)
            w = gains.kp * e + gains.kd * (wanted_rate - rate) + self.lift(t, t1, t2)[2]
            free = -gains.sigma * v + pull @ np.linalg.solve(gram, w + gains.sigma * rate - bend)
            acceleration = np.where(self.active[:, None], free, 0.0)[self.force]
        motion = system.derivative(time, x, swarm)
        derivative = np.concatenate([motion, estimate_rate, t1, t2, v.ravel(), acceleration.ravel()])
        return Moment(swarm, believed, wanted_rate, v, request, derivative)

    def start(self) -> Array:
        """Return the state at time 0: the filter rests at the first request."""
        system, m = self.system, self.system.bounds[0].size
        moving = self.robots.velocities[self.force]
        y = np.concatenate([system.parent, system.estimate, np.zeros(2 * m), self.held.ravel(), moving.ravel()])
        begin = system.parent.size + system.estimate.size
        y[begin : begin + m] = np.clip(self.at(0.0, y).request, *system.bounds)
        return y

    def apply(self, robot: int, status: str, time: float, y: Array) -> Array:
        """Return the state after a robot's change."""
        before, index = self.at(time, y).swarm, self.robots.ids.index(robot)
        self.held[index] = self.unpack(y)[4][index]
        self.status[index] = status
        self.regroup()
        x = self.system.changed(y[: self.cuts[0]], before, self.at(time, y).swarm)
        return np.concatenate([x, y[self.cuts[0] :]])

    def changes(self) -> Iterator[tuple[float, int, str]]:
        """Yield when the status of a robot changes, and to what."""
        for event in self.events:
            yield event.time, event.robot, STATUS[event.what]
            if event.what == "fails":
                yield event.time + event.known, event.robot, "lost"

    def solve(self, duration: float, *, step: float = 0.01, rtol: float = 1e-8, atol: float = 1e-9) -> Solution:
        """Integrate from 0 to the duration; a grid point at the time of an event has the values before it."""
        self.__post_init__()
        grid = np.round(step * np.arange(round(duration / step) + 1), 9)
        marks = [(round(time, 9), robot, status) for time, robot, status in sorted(self.changes()) if time < duration]
        y, begin = self.start(), 0.0
        rows, at = [y], [self.at(0.0, y)]
        for end, robot, status in [*marks, (grid[-1], 0, "")]:
            inside = grid[(grid > begin) & (grid <= end)]
            if end > begin:
                piece = solve_ivp(
                    lambda time, state: self.at(time, state).derivative, (begin, end), y, method="LSODA",
                    t_eval=np.union1d(inside, end), rtol=rtol, atol=atol, max_step=0.5,
                )  # fmt: skip
                if not piece.success:
                    raise ArithmeticError(piece.message)
                y, begin = piece.y[:, -1], end
                rows += list(piece.y.T[: inside.size])
                at += [self.at(time, state) for time, state in zip(inside, piece.y.T, strict=False)]
            if status:
                y = self.apply(robot, status, end, y)
        x, z, t, _, q, _ = (np.array(part) for part in zip(*(self.unpack(row) for row in rows), strict=True))
        swarms = [moment.swarm for moment in at]
        a, a_rate, wanted = (np.array([s[i] for s in swarms]) for i in range(3))
        wanted_rate, v, request = (np.array([m[i] for m in at]) for i in (2, 3, 4))
        return Solution(grid, x, z, request, t, wanted, wanted_rate, a, a_rate, q, v)
