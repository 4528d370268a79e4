"""Node ``steering``: takes requests from a socket, and orders for each step of a run what is changed from it on."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

from swarmabs_config import configure
from swarmabs_config.scenario import Scenario, load_scenario
from swarmabs_core.behaviours import Decision, SteeringConfig, SteeringController
from swarmabs_core.controllers import OffsetController
from swarmabs_core.errors import InputError
from swarmabs_core.membership import Change
from swarmabs_core.messages import Action, Message, Messages, PlaneState, Topic
from swarmabs_core.parameters import Parameter
from swarmabs_core.steering import DISTURBANCE, ENDS, REFERENCE, STEERER
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.runner import Settings, run_node
from swarmabs_ros.status import StatusChannel
from swarmabs_run.run import SLOWEST_STEP
from swarmabs_run.steering.server import ROBOTS, VALUED, RequestQueue, SteeringServer

PARAMETERS = (
    Parameter("scenario_file", "", "file of the resolved scenario"),
    Parameter("folder", "", "folder of the run, for the socket"),
    Parameter(
        "step_seconds",
        0.0,
        "shortest wall time of a step, s; 0: as fast as possible",
        minimum=0.0,
        maximum=SLOWEST_STEP,
    ),
)

LARGEST_OFFSET = 1.0
"""Largest offset of the reference that may be asked for, rad: a run ends at 1.5 rad."""

_NAMES = {action: name for name, action in (*VALUED.items(), *ROBOTS.items()) if name != "leave"}


class Paced:
    """What steers a run, holding each order back until its step is due; every bit of the run is the same.

    A step takes `seconds` of wall time at least; `clock` returns a time in s, and `sleep` waits for some.
    """

    def __init__(
        self,
        controller: SteeringController,
        seconds: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._controller = controller
        self._seconds = seconds
        self._clock = clock
        self._sleep = sleep
        self._due = 0.0

    def start(self) -> Messages:
        """Start what steers."""
        self._due = self._clock()
        return self._controller.start()

    def handle(self, message: Message) -> Messages:
        """Hand a message on; with the plane's state of a new step not before the next step is due.

        A run that is late is not made up for: the next step is due its time after this one.
        """
        if isinstance(message, PlaneState) and message.step == self._controller.step:
            wait = self._due + self._seconds - self._clock()
            if wait > 0.0:
                self._sleep(wait)
            self._due = max(self._due + self._seconds, self._clock())
        return self._controller.handle(message)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for what it waits for."""
        return self._controller.awaits()

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and what is missing for it."""
        return self._controller.missing()


def steering_config(scenario: Scenario) -> SteeringConfig:
    """Return the configuration of what steers a run: no more torque disturbs the plane than the swarm may exert."""
    steerable = isinstance(configure.parent_controller(scenario), OffsetController)
    return SteeringConfig(
        members=configure.members(scenario),
        period_ns=scenario.step_ns,
        last_step=scenario.steps,
        schedule=configure.schedule(scenario),
        offsets=configure.step_changes(scenario, REFERENCE),
        torques=configure.step_changes(scenario, DISTURBANCE),
        largest_offset=LARGEST_OFFSET if steerable else 0.0,
        largest_torque=scenario.manifold.torque_max,
    )


def in_words(decision: Decision) -> str:
    """Say in one line what was granted."""
    action, agent_id, value = decision.request
    return f"{_NAMES[action]} {agent_id or f'{value:g}'} from step {decision.step} on"


def make(settings: Settings, status: StatusChannel) -> NodeSpec:
    """Return the behaviour, and what it does when it is idle.

    Raises `InputError` if there is no scenario, or no folder, and `RunError` if the folder cannot hold a socket.
    """
    if not settings.text("scenario_file") or not settings.text("folder"):
        raise InputError("parameters scenario_file and folder: give the resolved scenario and the folder of the run")
    scenario = load_scenario(Path(settings.text("scenario_file")))
    config = steering_config(scenario)

    def tell(decision: Decision) -> None:
        request, step = decision.request, decision.step
        kind = ENDS.get(Action(request.action))
        change = "" if kind is None or step is None else str(Change(step - 1, request.agent_id, kind))
        status.send("steered", text=in_words(decision), change=change)

    controller = SteeringController(config)
    facts = {
        "steps": scenario.steps,
        "step_time": scenario.step,
        "largest_reference": config.largest_offset,
        "largest_disturbance": config.largest_torque,
    }
    requests = RequestQueue(controller, scenario.step_ns, facts, tell)
    SteeringServer(Path(settings.text("folder")), requests).start()
    seconds = settings.number("step_seconds")
    behaviour = Paced(controller, seconds) if seconds else controller
    return NodeSpec(behaviour, on_idle=requests.work)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(STEERER, PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
