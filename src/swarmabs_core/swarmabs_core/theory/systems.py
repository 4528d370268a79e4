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
from dataclasses import FrozenInstanceError, dataclass, field, replace
from functools import cached_property
from itertools import product
from math import nan
from typing import TYPE_CHECKING, TypeAlias, TypeVar

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
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from swarmabs_core.models import SystemAgentConfig

Array = NDArray[np.float64]
Path: TypeAlias = tuple[str, ...]
"""The names of attributes that lead from an object to a value in it."""
Numbers: TypeAlias = float | tuple[float, ...] | list[float]
Held = TypeVar("Held")
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

    These are the parent's state, values and rates of the filtered needs, the numbers in which the controller keeps its
    state, all coordinates, and the velocities of double integrators; `ends` are the indices at which each sort ends.
    """

    def __init__(self, setting: SystemSetting) -> None:
        first = setting.robots[0]
        self._named, self._ns, system = first.named, first.period_ns, first.named.instance
        self._laws = [
            RobotLaw(
                *(robot.named, robot.kind, robot.constants, robot.gains, self._ns / 1e9),
                second_order=robot.force_law != "velocity",
            )
            for robot in setting.robots
        ]
        self._motion = ParentMotion(first.named, self._ns / 1e9)
        self._forces = [n for n, robot in enumerate(setting.robots) if robot.kind.by_force]
        goal = dict(zip((row.name for row in system.tracked), system.reference(0.0), strict=True))
        x = [goal.get(row.name, value) for row, value in zip(system.parent, system.initial, strict=True)]
        near = tuple(value + 1e-3 * row.scale for value, row in zip(x, system.parent, strict=True))
        self._generator = SystemDesiredState(self._ns, first.named, first.gains, requests=setting.requests)
        at_start = _numbers_of(self._generator.controller)
        self._generator.advance(0, ParentState(0, 0, 0, system.initial))
        _, desired = self._generator.advance(self._ns, ParentState(0, 1, 0, near))
        numbers = _numbers_of(self._generator.controller)
        self._memory = {path: value for path, value in numbers.items() if value != at_start.get(path)}
        *_, (self._robots, _, _, _) = approach(first.named, setting.states, desired.value, first.gains)
        memory = _flat(self._memory.values())
        q = [value for robot in self._robots for value in robot.coordinates]
        span = [0.5 * (need.high - need.low) or 1.0 for need in setting.requests.needs(system)]
        needs = [value for value, _ in self._generator.filtered or ()]
        d = len(system.robot)
        parts = x, needs, np.zeros(len(needs)), memory, q, np.zeros(d * len(self._forces))
        self.start, self.ends = np.concatenate(parts), np.cumsum([len(part) for part in parts])
        places = [row.scale for row in system.robot] * (len(self._robots) + len(self._forces))
        spans = (
            np.array(span),
            setting.requests.bandwidth * np.array(span),
            np.where(memory, 1e3 * np.abs(memory), 1.0),
            places,
        )
        self.scales = np.concatenate([[row.scale for row in system.parent], *spans])

    def advance(self, state: Array) -> Array:
        """Return the state one period later."""
        x, needs, rates, memory, q, v = (part.tolist() for part in np.split(state, self.ends[:-1]))
        generator = copy.copy(self._generator)
        generator.controller = _with_numbers(self._generator.controller, _shaped(memory, self._memory))
        generator.filtered = list(zip(needs, rates, strict=True))
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
        numbers = _numbers_of(generator.controller)
        sorts = (
            *(moved, *zip(*generator.filtered, strict=True), _flat(numbers[path] for path in self._memory)),
            *(robot.coordinates for robot in after),
            *(after[n].velocities for n in self._forces),
        )
        return np.array(np.concatenate(sorts))

    def _placed(self, q: list[float], v: list[float]) -> list[RobotState]:
        d = len(self._named.instance.robot)
        speeds = {n: tuple(v[i * d : (i + 1) * d]) for i, n in enumerate(self._forces)}
        return [
            robot._replace(coordinates=tuple(q[n * d : (n + 1) * d]), velocities=speeds.get(n, (0.0,) * d))
            for n, robot in enumerate(self._robots)
        ]

    def error(self, state: Array) -> Array:
        """Return e = a_d - a in units of the rows' scales."""
        _, needs, _, _, q, v = (part.tolist() for part in np.split(state, self.ends[:-1]))
        abstract, _ = observed(self._named, 0, 0, self._placed(q, v), curvature=False)
        wanted, rows = self._named.complete(tuple(needs), self._generator.standing), self._named.instance.abstract
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
            if (rest := self._rest(noise)) is not None:
                return rest
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
    first = setting.robots[0]
    kinds = sorted({robot.kind.name.lower().replace("_", " ") + "s" for robot in setting.robots})
    notes = ["the loop is linearised at rest at the time of the second step; limits and the effort bound do not act"]
    if setting.faulty:
        notes.append("the theorems consider neither faults nor noise; the check covers the initial swarm and a delay")
    linear: list[Condition] = []
    if len(setting.robots) * len(first.coordinates) <= MOST:
        linear = _guarded("loop", lambda: _linearised(setting))
    else:
        notes.append(f"the loop at rest is evaluated for swarms with up to {MOST} coordinates only")
    margins = tuple(condition for condition in linear if condition.name != "loop")
    unknown = "" if margins else "evaluated at rest for single integrators and lags"
    if any(condition.verdict is Verdict.UNKNOWN for condition in linear):
        unknown = "no state of rest is known"
    completions = tuple(_guarded("completion", lambda: _completions(setting)))
    loops = loop_conditions(_loops(setting), setting.delay, first.period_ns / 1e9)
    sampled = (*loops, *(condition for condition in linear if condition.name == "loop"))
    theorems = (
        Theorem("GeneralStability", "the error of the abstract state and the parent, at rest", margins, unknown),
        Theorem("GeneralConstrainedStability", "abstract states that can be requested", completions),
    )
    beyond = Theorem("sampled_time", "beyond the paper: sampled time", sampled)
    return Report(setting.scenario, first.system, " and ".join(kinds), None, theorems, beyond, {}, {}, tuple(notes))


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
        size = len(setting.robots[0].named.instance.abstract)
        for kp, kd in sorted(set(zip(by_row(gains.kp, size), by_row(gains.kd, size), strict=True))):
            yield f"second order, {kp:g}, {kd:g}", double_integrator_loop(kp, kd), "e'' = -kp e - kd e', held"
        yield "unseen motion", single_integrator_loop(gains.sigma), "q'' = -sigma q' where a does not see it"


def _margins(setting: SystemSetting, loop: ClosedLoop, state: Array, slope: Array) -> Iterator[Condition]:
    """Yield the conditions on V_p and V_a; z are the numbers before the coordinates."""
    gains = setting.robots[0].gains
    h, n = setting.robots[0].period_ns / 1e9, int(loop.ends[3])
    error = loop.slope(loop.error, state)
    back = np.linalg.pinv(error[:, n:])
    parent, coupling = slope[:n, :n] - slope[:n, n:] @ back @ error[:, :n], slope[:n, n:] @ back
    leak = error @ slope[:, :n] - error @ slope[:, n:] @ back @ error[:, :n]
    # Numbers that have no effect, such as an integral that is not used, are not part of z.
    basis = subspace_outside(parent.T, 1.0, UNSEEN)
    parent, coupling, leak = basis.T @ parent @ basis, basis.T @ coupling, leak @ basis
    decay, radius = (
        min(x * (1.0 - 0.5 * h * x) for x in gains.k),
        float(np.abs(np.linalg.eigvals(parent)).max(initial=0.0)),
    )
    yield Condition("l", None, Form("l = K (1 - h K/2) > 0", decay, 0.0), {"k": gains.k, "period": h})
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
    first = setting.robots[0]
    named, system = first.named, first.named.instance
    ends, draw = [(need.low, need.high) for need in setting.requests.needs(system)], np.random.default_rng(0).uniform
    corners = product(*ends) if len(ends) <= 4 else zip(*ends, strict=True)
    needs = [tuple(min(max(0.0, low), high) for low, high in ends), *corners]
    needs += [tuple(float(draw(low, high)) for low, high in ends) for _ in range(4)]
    goals = [named.complete(values, named.nobody) for values in needs]
    paths = [list(approach(named, setting.states, goal, first.gains)) for goal in goals]
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
    if hasattr(system, "reach"):
        inside = [bool(system.reach(goal)) for goal in goals]
        outside = {"first_outside": needs[inside.index(False)]} if False in inside else {}
        form = Form("requests within the limits of the robots = all", sum(inside), len(needs), ">=")
        yield Condition("reach", None, form, outside)


def _numbers_of(part: object, path: Path = ()) -> dict[Path, Numbers]:
    """Return the attributes of an object, and of the objects in them, that are numbers, by their paths."""
    numbers: dict[Path, Numbers] = {}
    for name in (*getattr(part, "__dict__", ()), *getattr(type(part), "__slots__", ())):
        value, place = getattr(part, name, None), (*path, name)
        if isinstance(value, float) or (isinstance(value, (tuple, list)) and all(isinstance(x, float) for x in value)):
            numbers[place] = value
        elif len(path) < 2:
            numbers |= _numbers_of(value, place)
    return numbers


def _with_numbers(part: Held, numbers: Mapping[Path, Numbers]) -> Held:
    """Return a copy of an object that has other numbers at these paths; a frozen dataclass is made again."""
    attributes: dict[str, object] = {}
    for name in dict.fromkeys(path[0] for path in numbers):
        inner = {path[1:]: value for path, value in numbers.items() if path[0] == name}
        attributes[name] = inner[()] if () in inner else _with_numbers(getattr(part, name), inner)
    changed = copy.deepcopy(part)
    try:
        for name, value in attributes.items():
            setattr(changed, name, value)
    except FrozenInstanceError:
        return replace(part, **attributes)  # type: ignore[type-var]
    return changed


def _flat(numbers: Iterable[Numbers]) -> Array:
    return np.array([number for value in numbers for number in np.ravel(value)])


def _shaped(flat: list[float], like: Mapping[Path, Numbers]) -> dict[Path, Numbers]:
    """Return numbers in a row as values of the same types and lengths as others."""
    numbers, begin = dict[Path, Numbers](), 0
    for path, value in like.items():
        end = begin + np.size(value)
        numbers[path] = flat[begin] if isinstance(value, float) else type(value)(flat[begin:end])
        begin = end
    return numbers
