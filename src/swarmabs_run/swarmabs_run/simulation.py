"""The whole system in one process: the same state machines that run as nodes, without ROS."""

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import TYPE_CHECKING

from swarmabs_bag.recording import RunCollector
from swarmabs_config import configure
from swarmabs_config.graph import CONTROLLER, LOCKSTEP, OBSERVER, OFFERED, PLANE, ROBOT, Option, endpoints
from swarmabs_core.behaviours import Controller, Observer, Plane, make_agent
from swarmabs_core.errors import RunError
from swarmabs_core.messages import MAIN_TOPICS, PLANE_STATE, TOPIC_OF
from swarmabs_core.parent_response import SumObserver
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from os import PathLike

    from swarmabs_bag.recording import RecordedStep, Step
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.arrays import RunArrays
    from swarmabs_core.behaviours import Behaviour
    from swarmabs_core.messages import Message, Messages, Topic


class Simulation:
    """Observer, plane, parent controller and robots of a scenario, connected by a queue.

    Parameters
    ----------
    scenario : Scenario
        What to simulate.
    """

    def __init__(self, scenario: Scenario) -> None:
        agents = [make_agent(config) for config in configure.agent_configs(scenario)]
        observer = Observer(configure.observer_config(scenario))
        plane = Plane(configure.plane_config(scenario))
        controller = Controller(
            configure.controller_config(scenario, recording_window=0), configure.parent_controller(scenario)
        )
        watching = set() if scenario.observer.type == SumObserver.type else {Option.WATCHING}
        nodes: list[tuple[Behaviour, str, frozenset[Option]]] = [
            (observer, OBSERVER, frozenset(watching)),
            (plane, PLANE, frozenset()),
            (controller, CONTROLLER, frozenset()),
        ]
        nodes += [(agent, ROBOT, frozenset({Option.FEELING} if PLANE_STATE in agent.needs else ())) for agent in agents]
        self._behaviours = tuple(behaviour for behaviour, *_ in nodes)
        self._subscribers: dict[Topic, list[Callable[[Message], Messages]]] = {topic: [] for topic in OFFERED[LOCKSTEP]}
        for behaviour, node, options in nodes:
            for topic in endpoints(node, LOCKSTEP, options).subscriptions:
                self._subscribers[topic].append(behaviour.handle)
        self._collector = RunCollector(
            configure.members(scenario), configure.schedule(scenario), scenario.steps, memory=2
        )

    def steps(self) -> Iterator[RecordedStep]:
        """Run, and yield every step as a bag would hold it.

        Raises
        ------
        RunError
            If the run fails, such as by a plane that turns over, or stalls.
        """
        queue: deque[Message] = deque()
        for behaviour in self._behaviours:
            queue.extend(behaviour.start())
        while queue:
            message = queue.popleft()
            yield from self._collector.add(Record.of(message))
            for handle in self._subscribers[TOPIC_OF[type(message)]]:
                queue.extend(handle(message))
        if not self._collector.finished:
            missing = ", ".join(self._collector.missing())
            raise RunError(f"the run stalls at step {self._collector.step}; missing: {missing}")


def simulated_steps(scenario: Scenario) -> Iterator[Step]:
    """Simulate a scenario, on arrays where all robots do the same all the time; the bits do not depend on it.

    Parameters
    ----------
    scenario : Scenario
        What to simulate.

    Yields
    ------
    Step
        Every step of the run, in order.

    Raises
    ------
    RunError
        If the run fails, such as by a plane that turns over.
    """
    # Nodes import this package too, and need no numpy.
    from swarmabs_run.vector_simulation import NotVectorisableError, VectorSimulation, vectorisable  # noqa: PLC0415

    done = 0
    if vectorisable(scenario):
        try:
            for step in VectorSimulation(scenario).steps():
                yield step
                done += 1
        except NotVectorisableError:
            pass
        else:
            return
    yield from islice(Simulation(scenario).steps(), done, None)


def simulate(scenario: Scenario | str | PathLike[str]) -> RunArrays:
    """Simulate a scenario in this process.

    Parameters
    ----------
    scenario : Scenario, str or path
        A scenario, or the YAML file of one.

    Returns
    -------
    RunArrays
        The messages of the run as arrays: angle, abstract, auxiliary and desired state by step, robots by step and id.

    Raises
    ------
    InputError
        If the file is not a valid scenario.
    RunError
        If the run fails, such as by a plane that turns over.

    Examples
    --------
    >>> from swarmabs_core import simulate
    >>> run = simulate("my_scenario.yaml")  # doctest: +SKIP
    >>> run.angle[-1]  # doctest: +SKIP
    """
    # Robots import this package too, and need neither numpy nor pydantic.
    from swarmabs_config.scenario import Scenario, load_scenario  # noqa: PLC0415
    from swarmabs_core.arrays import run_arrays, table  # noqa: PLC0415

    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    gathered = {topic: bytearray() for topic in MAIN_TOPICS}
    for step in simulated_steps(scenario):
        for topic, _, payload in step.stored():
            if topic in gathered:
                gathered[topic] += payload
    return run_arrays({topic: table(topic, payloads) for topic, payloads in gathered.items()})
