r"""The theory for parent systems of installed packages, as far as differences and samples can tell.

The law gives :math:`\dot a = v`, so the error e of the abstract state obeys its own equation and only disturbs the
parent. With h the period, z the state of parent, filter and controller, and the loop linearised at rest, there is a
:math:`V_p = z^T P z` with

.. math:: \Delta V_p \le -h (c_1 |z|^2 - c_2 |z| |e| - c_5 |e|^2) \qquad V_a = |e|^2/2, \quad \Delta V_a \le -h l |e|^2

so :math:`V_p + \kappa V_a` decreases for every :math:`\kappa > c_5/l + c_2^2/(4 l c_1)`. If the parent disturbs the
error by at most :math:`c_3 |z|`, it does so for some kappa if :math:`c_2 c_3 < c_1 l`.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swarmabs_core.errors import RunError, one_line
from swarmabs_core.messages import NEVER, ParentState, RobotState, Status, SwarmBroadcast
from swarmabs_core.systems.check import NEAR, approach
from swarmabs_core.systems.desired import Requests, SystemDesiredState
from swarmabs_core.systems.law import SINGULAR, RobotLaw, by_row
from swarmabs_core.systems.motion import ParentMotion
from swarmabs_core.systems.swarm import observed
from swarmabs_core.theory.linear_algebra import discrete_lyapunov, subspace_outside
from swarmabs_core.theory.report import Condition, Form, Report, Theorem, Verdict
from swarmabs_core.theory.sampled_data import Loop, double_integrator_loop, loop_conditions, single_integrator_loop

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from swarmabs_core.models import SystemAgentConfig

Array = NDArray[np.float64]
UNSEEN = 1e-6
"""Largest distance from 1 of an eigenvalue that belongs to motion which the abstract state does not see."""
MOST = 120
"""Most coordinates of a swarm whose loop is linearised."""
_STEP = 1e-5
_NOISE = (1e-8, 1e-12)
"""Relative singular values of the slope below which Newton's method leaves out motion: what differences cannot tell
from none; then, because slow motion of a parent with fast robots is as small, only what rounding gives."""


@dataclass(frozen=True)
class SystemSetting:
    """The properties of a scenario that the theory uses."""

    scenario: str
    robots: tuple[SystemAgentConfig, ...]  # of the start
    delay: int  # of the broadcasts, in steps
    faulty: bool
    requests: Requests = field(default_factory=Requests)

    @cached_property
    def states(self) -> list[RobotState]:
        """The robots at step 0."""
        return [robot.body().state(0, NEVER, Status.ACTIVE) for robot in self.robots]


class ClosedLoop:
    """One period of the sampled closed loop, at the time of the second step, as a function of all numbers in it.

    These are the parent's state, values and rates of the filtered needs, the numbers that the controller keeps, all
    coordinates, and the velocities of double integrators; `ends` are the indices at which each sort ends.
    """

    def __init__(self, setting: SystemSetting) -> None:
        one = setting.robots[0]
        self._named, self._ns, made = one.named, one.period_ns, one.named.made
        self._laws = [
            RobotLaw(*(one.named, r.kind, r.constants, r.gains, self._ns / 1e9), second_order=r.force_law != "velocity")
            for r in setting.robots
        ]
        self._motion = ParentMotion(one.named, self._ns / 1e9)
        self._forces = [n for n, each in enumerate(setting.robots) if each.kind.by_force]
        goal = dict(zip((row.name for row in made.tracked), made.reference(0.0), strict=True))
        x = [goal.get(row.name, value) for row, value in zip(made.parent, made.initial, strict=True)]
        near = tuple(value + 1e-3 * row.scale for value, row in zip(x, made.parent, strict=True))
        self._generator = SystemDesiredState(self._ns, one.named, one.gains, requests=setting.requests)
        fresh = _kept(self._generator.controller)
        self._generator.advance(0, ParentState(0, 0, 0, made.initial))
        _, desired = self._generator.advance(self._ns, ParentState(0, 1, 0, near))
        kept = {at: value for at, (*_, value) in _kept(self._generator.controller).items()}
        self._memory = [at for at, value in kept.items() if at not in fresh or value != fresh[at][2]]
        *_, (self._robots, _, _, _) = approach(one.named, setting.states, desired.value, one.gains)
        memory = np.array([number for at in self._memory for number in np.ravel(kept[at])])
        q = [value for robot in self._robots for value in robot.coordinates]
        span = [0.5 * (need.high - need.low) or 1.0 for need in setting.requests.needs(made)]
        needs = [value for value, _ in self._generator.filtered or ()]
        d = len(made.robot)
        parts = x, needs, np.zeros(len(needs)), memory, q, np.zeros(d * len(self._forces))
        self.start, self.ends = np.concatenate(parts), np.cumsum([len(part) for part in parts])
        places = [row.scale for row in made.robot] * (len(self._robots) + len(self._forces))
        spans = (
            np.array(span),
            setting.requests.bandwidth * np.array(span),
            np.where(memory, 1e3 * np.abs(memory), 1.0),
            places,
        )
        self.scales = np.concatenate([[row.scale for row in made.parent], *spans])

    def advance(self, state: Array) -> Array:
        """Return the state one period later."""
        x, needs, rates, memory, q, v = (part.tolist() for part in np.split(state, self.ends[:-1]))
        generator = copy.copy(self._generator)
        generator.controller = copy.deepcopy(generator.controller)
        generator.filtered = list(zip(needs, rates, strict=True))
        for owner, name, value in map(_kept(generator.controller).__getitem__, self._memory):
            given, memory = memory[: np.size(value)], memory[np.size(value) :]
            object.__setattr__(owner, name, given[0] if isinstance(value, float) else type(value)(given))
        _, desired = generator.advance(self._ns, ParentState(self._ns, 1, 0, tuple(x)))
        robots, after = self._placed(q, v), []
        heard = SwarmBroadcast(0, 0, *observed(self._named, 0, 0, robots, curvature=bool(v)), desired)
        for law, robot in zip(self._laws, robots, strict=True):
            start = robot.coordinates, robot.velocities
            if (rate := law.rate(*start, heard)) is None:
                raise RunError("the Gram matrix is singular")
            command = law.command(*start, rate)
            end = law.advance(*start, command)
            after.append(robot._replace(coordinates=end[0], velocities=end[1], command=command))
        moved = self._motion.advance(self._ns / 1e9, tuple(x), list(zip(robots, after, strict=True)))
        kept = _kept(generator.controller)
        sorts = (
            *(moved, *zip(*generator.filtered, strict=True), *(np.ravel(kept[at][2]) for at in self._memory)),
            *(robot.coordinates for robot in after),
            *(after[n].velocities for n in self._forces),
        )
        return np.array(np.concatenate(sorts))

    def _placed(self, q: list[float], v: list[float]) -> list[RobotState]:
        d = len(self._named.made.robot)
        speeds = {n: tuple(v[i * d : (i + 1) * d]) for i, n in enumerate(self._forces)}
        return [
            robot._replace(coordinates=tuple(q[n * d : (n + 1) * d]), velocities=speeds.get(n, (0.0,) * d))
            for n, robot in enumerate(self._robots)
        ]

    def error(self, state: Array) -> Array:
        """Return e = a_d - a in units of the rows' scales."""
        _, needs, _, _, q, v = (part.tolist() for part in np.split(state, self.ends[:-1]))
        abstract, _ = observed(self._named, 0, 0, self._placed(q, v), curvature=False)
        wanted, rows = self._named.complete(tuple(needs), self._generator.standing), self._named.made.abstract
        return np.array([(b - a) / row.scale for a, b, row in zip(abstract.value, wanted, rows, strict=True)])

    def slope(self, function: Callable[[Array], Array], state: Array) -> Array:
        """Return the derivative of a function by the state, in units of its scales."""
        shifts = _STEP * np.diag(self.scales)
        return np.stack([(function(state + h) - function(state - h)) / (2.0 * _STEP) for h in shifts], axis=1)

    def rest(self) -> tuple[Array, Array]:
        """Return a state that does not change, found by Newton's method, and the slope of `advance`, both scaled.

        Raises
        ------
        RunError
            If it finds none.
        """
        for noise in _NOISE:
            if (found := self._rest(noise)) is not None:
                return found
        raise RunError("no state of rest was found near the start")

    def _rest(self, noise: float) -> tuple[Array, Array] | None:
        """Return what `rest` does, without motion whose singular values are below a part of the largest one."""
        state, scales, last = self.start, self.scales, 0.0
        for _ in range(50):
            gap = (self.advance(state) - state) / scales
            size = float(np.abs(gap).max())
            if not size < 0.1 * last:
                slope = self.slope(self.advance, state) / scales[:, np.newaxis]
            if size < 1e-10:
                return state, self.slope(self.advance, state) / scales[:, np.newaxis]
            state = np.array(state - scales * np.linalg.lstsq(slope - np.eye(len(state)), gap, rcond=noise)[0])
            last = size
        return None


def check_system(setting: SystemSetting) -> Report:
    """Evaluate the general theorems and the conditions for sampled time at a state of rest."""
    one = setting.robots[0]
    kinds = sorted({robot.kind.name.lower().replace("_", " ") + "s" for robot in setting.robots})
    notes = ["the loop is linearised at rest at the time of the second step; limits and the effort bound do not act"]
    if setting.faulty:
        notes.append("the theorems consider neither faults nor noise; the check covers the initial swarm and a delay")
    linear: list[Condition] = []
    if len(setting.robots) * len(one.coordinates) <= MOST:
        linear = _guarded("loop", lambda: _linearised(setting))
    else:
        notes.append(f"the loop at rest is evaluated for swarms with up to {MOST} coordinates only")
    margins = tuple(condition for condition in linear if condition.name != "loop")
    unknown = "" if margins else "evaluated at rest for single integrators and lags"
    if any(condition.verdict is Verdict.UNKNOWN for condition in linear):
        unknown = "no state of rest is known"
    completions = tuple(_guarded("completion", lambda: _completions(setting)))
    loops = loop_conditions(_loops(setting), setting.delay, one.period_ns / 1e9)
    sampled = (*loops, *(condition for condition in linear if condition.name == "loop"))
    theorems = (
        Theorem("GeneralStability", "the error of the abstract state and the parent, at rest", margins, unknown),
        Theorem("GeneralConstrainedStability", "abstract states that can be requested", completions),
    )
    beyond = Theorem("sampled_time", "beyond the paper: sampled time", sampled)
    return Report(setting.scenario, one.system, " and ".join(kinds), None, theorems, beyond, {}, {}, tuple(notes))


def _guarded(name: str, conditions: Callable[[], Iterator[Condition]]) -> list[Condition]:
    """Return conditions, or one that could not be evaluated if the system, which is foreign code, raises anything."""
    try:
        return list(conditions())
    except Exception as error:  # noqa: BLE001
        return [Condition(name, None, Form("it can be evaluated", nan, nan, unknown=True), {}, one_line(error))]


def _linearised(setting: SystemSetting) -> Iterator[Condition]:
    loop = ClosedLoop(setting)
    state, slope = loop.rest()
    roots = np.linalg.eigvals(slope)
    seen = [abs(root) for root in roots.tolist() if _is_seen(root.real, root.imag)]
    form = Form("spectral radius of one step at rest < 1", max(seen, default=0.0), 1.0, "<")
    yield Condition("loop", None, form, {"numbers": len(roots), "unseen": len(roots) - len(seen)})
    if not any(robot.kind.by_force for robot in setting.robots):
        yield from _margins(setting, loop, state, slope)


def _loops(setting: SystemSetting) -> Iterator[tuple[str, Loop, str]]:
    gains, forces = setting.robots[0].gains, {robot.kind.by_force for robot in setting.robots}
    second_order = True in forces and setting.robots[0].force_law != "velocity"
    if False in forces or not second_order:
        yield "first order", single_integrator_loop(max(gains.k)), "e[k+1] = e[k] - K h e[k-n], largest K"
    if second_order:
        size = len(setting.robots[0].named.made.abstract)
        for kp, kd in sorted(set(zip(by_row(gains.kp, size), by_row(gains.kd, size), strict=True))):
            yield f"second order, {kp:g}, {kd:g}", double_integrator_loop(kp, kd), "e'' = -kp e - kd e', held"
        yield "unseen motion", single_integrator_loop(gains.sigma), "q'' = -sigma q' where a does not see it"


def _margins(setting: SystemSetting, loop: ClosedLoop, state: Array, slope: Array) -> Iterator[Condition]:
    """Yield the conditions on V_p and V_a; z are the numbers before the coordinates."""
    one = setting.robots[0]
    h, n = one.period_ns / 1e9, int(loop.ends[3])
    error = loop.slope(loop.error, state)
    back = np.linalg.pinv(error[:, n:])
    parent, coupling = slope[:n, :n] - slope[:n, n:] @ back @ error[:, :n], slope[:n, n:] @ back
    leak = error @ slope[:, :n] - error @ slope[:, n:] @ back @ error[:, :n]
    # Numbers that have no effect, such as an integral that is not used, are not part of z.
    basis = subspace_outside(parent.T, 1.0, UNSEEN)
    parent, coupling, leak = basis.T @ parent @ basis, basis.T @ coupling, leak @ basis
    decay, radius = (
        min(x * (1.0 - 0.5 * h * x) for x in one.gains.k),
        float(np.abs(np.linalg.eigvals(parent)).max(initial=0.0)),
    )
    yield Condition("l", None, Form("l = K (1 - h K/2) > 0", decay, 0.0), {"k": one.gains.k, "period": h})
    yield Condition("V_p", None, Form("spectral radius of the parent with a = a_d < 1", radius, 1.0, "<"))
    if radius < 1.0 and decay > 0.0:
        p = discrete_lyapunov(parent.T, h * np.eye(len(parent)))
        c2, c5 = (float(np.linalg.norm(m.T @ p @ coupling, 2)) / h for m in (2.0 * parent, coupling))
        c3, kappa = float(np.linalg.norm(leak, 2)) / h, c5 / decay + c2 * c2 / (4.0 * decay)
        inputs = {"c1": 1.0, "c2": c2, "c3": c3, "c5": c5, "l": decay, "smallest_kappa": kappa}
        yield Condition("margin", None, Form("c2 c3 < c1 l", c2 * c3, decay, "<"), inputs)


def _is_seen(real: float, imaginary: float) -> bool:
    return abs(complex(real, imaginary) - 1.0) > UNSEEN


def _completions(setting: SystemSetting) -> Iterator[Condition]:
    """Yield conditions on completions of needs, and on the robots on their way from the start to them."""
    one, made = setting.robots[0], setting.robots[0].named.made
    ends, draw = [(need.low, need.high) for need in setting.requests.needs(made)], np.random.default_rng(0).uniform
    corners = product(*ends) if len(ends) <= 4 else zip(*ends, strict=True)
    needs = [tuple(min(max(0.0, low), high) for low, high in ends), *corners]
    needs += [tuple(float(draw(low, high)) for low, high in ends) for _ in range(4)]
    goals = [one.named.complete(each, one.named.nobody) for each in needs]
    paths = [list(approach(one.named, setting.states, goal, one.gains)) for goal in goals]
    reached = [path[-1][3] < NEAR for path in paths]
    missed = {"first_missed": needs[reached.index(False)]} if False in reached else {}
    form = Form("requests that the robots reach = all", sum(reached), len(needs), ">=")
    yield Condition("completion", None, form, missed)
    steps = [step for path in paths for step in path]
    inputs = {
        "largest_effort": max(effort for _, _, effort, _ in steps),
        "largest_coordinate": max(abs(x) for robots, _, _, _ in steps for robot in robots for x in robot.coordinates),
    }
    pivot = min(gram.least for _, gram, _, _ in steps)
    yield Condition("Gram matrix", None, Form("least scaled pivot on the way", pivot, SINGULAR), inputs)
    if hasattr(made, "reach"):
        inside = [bool(made.reach(goal)) for goal in goals]
        outside = {"first_outside": needs[inside.index(False)]} if False in inside else {}
        form = Form("requests within the limits of the robots = all", sum(inside), len(needs), ">=")
        yield Condition("reach", None, form, outside)


def _kept(part: Any, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], tuple[Any, str, Any]]:
    """Return where an object keeps numbers: owner, name and value of each attribute, by its path."""
    found: dict[tuple[str, ...], tuple[Any, str, Any]] = {}
    for name in (*getattr(part, "__dict__", ()), *getattr(type(part), "__slots__", ())):
        value, at = getattr(part, name, None), (*path, name)
        if isinstance(value, float) or (isinstance(value, (tuple, list)) and all(isinstance(x, float) for x in value)):
            found[at] = part, name, value
        elif len(path) < 2:
            found |= _kept(value, at)
    return found
