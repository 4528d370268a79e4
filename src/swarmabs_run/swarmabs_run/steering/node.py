"""Node ``steering``: takes requests from a socket and publishes the changes that take effect at each step of a run."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_config.graph import LOCKSTEP
from swarmabs_config.scenario import Scenario
from swarmabs_core.behaviours import Decision, SteeringConfig, SteeringController
from swarmabs_core.cdr import decode
from swarmabs_core.declaration import setting
from swarmabs_core.errors import InputError
from swarmabs_core.membership import Change
from swarmabs_core.messages import PARENT_STATES, Action, Messages, Topic
from swarmabs_core.steering import DISTURBANCE, ENDS, REFERENCE, STEERER
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.runner import LockstepProgram, Settings
from swarmabs_ros.scenario_file import ScenarioFile
from swarmabs_ros.status import StatusChannel
from swarmabs_run.run import SLOWEST_STEP
from swarmabs_run.steering.server import PAUSES, PUSH, ROBOTS, VALUED, RequestQueue, SteeringServer

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True, slots=True)
class SteeringSettings(ScenarioFile):
    """Settings of the node."""

    folder: str = setting("", "folder of the run, for the socket")
    step_seconds: float = setting(
        0.0,
        "shortest wall time of a step on average, {unit}; 0: as fast as possible",
        unit="s",
        minimum=0.0,
        maximum=SLOWEST_STEP,
    )
    paused: bool = setting(default=False, description="whether the run is paused at its first step")
    restarts: bool = setting(default=False, description="whether another run starts when a client asks for it")


PARAMETERS = (SteeringSettings,)

_NAMES = {action: name for name, action in (*VALUED.items(), *ROBOTS.items()) if name != "leave"}

CATCH_UP = 0.2
"""Longest delay, s, that a paced run makes up for by faster steps: moments in which other programs have the cores."""


class Pace:
    """Delays the steering messages so that a step takes `seconds` of wall time on average, or longer.

    A run that is late catches up by at most `CATCH_UP`, and not at all after a pause. The digest does not change.
    """

    def __init__(
        self,
        controller: SteeringController,
        seconds: float,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._controller = controller
        self._seconds = seconds
        self._now = now
        self._sleep = sleep
        self._due = 0.0

    def hear(self, topic: Topic, data: bytes) -> Messages:
        """Pass a message to the controller; the plane's state of a new step only when the next step is due."""
        message = decode(topic.message, data)
        if self._controller.paused:
            self._due = 0.0
        elif isinstance(message, PARENT_STATES) and message.step == self._controller.step:
            now = self._now()
            self._due = max(now - CATCH_UP, (self._due or now) + self._seconds)
            self._sleep(max(self._due - now, 0.0))
        return self._controller.handle(message)


def steering_config(scenario: Scenario) -> SteeringConfig:
    """Return the steering configuration; a disturbance of the plane is limited to the largest torque of the swarm."""
    largest = configure.largest_requests(scenario)
    return SteeringConfig(
        members=configure.members(scenario),
        period_ns=scenario.step_ns,
        last_step=scenario.steps,
        schedule=configure.schedule(scenario),
        offsets=configure.step_changes(scenario, REFERENCE),
        torques=configure.step_changes(scenario, DISTURBANCE),
        largest_offset=largest[REFERENCE],
        largest_torque=largest[DISTURBANCE],
        family=scenario.family,
    )


def describe(decision: Decision) -> str:
    """Describe a granted request in one line."""
    action, agent_id, value, steps = decision.request
    if steps and decision.step is not None:
        return f"{PUSH} {value:g} in the steps {decision.step} to {decision.step + steps - 1}"
    return f"{_NAMES[action]} {agent_id or f'{value:g}'} from step {decision.step} on"


def make(settings: Settings, status: StatusChannel) -> NodeSpec:
    """Return the behaviour and its work while idle.

    Raises `InputError` if the scenario or the folder is not given, and `RunError` if the folder cannot hold a socket.
    """
    own = settings.declared(SteeringSettings)
    if not own.scenario_file or not own.folder:
        raise InputError("parameters scenario_file and folder: give the resolved scenario and the folder of the run")
    scenario = own.load()
    config = steering_config(scenario)

    def report(decision: Decision) -> None:
        request, step = decision.request, decision.step
        kind = ENDS.get(Action(request.action))
        change = "" if kind is None or step is None else str(Change(step - 1, request.agent_id, kind))
        status.send("steered", text=describe(decision), change=change)

    def act(action: str) -> None:
        if action in PAUSES:
            status.send("paused", paused=PAUSES[action], step=controller.step)
        else:
            status.send("restart", action=action)

    controller = SteeringController(config)
    if own.paused:
        controller.pause(paused=True)
        act("pause")
    facts = {
        "steps": scenario.steps,
        "step_time": scenario.step,
        "largest_reference": config.largest_offset,
        "largest_disturbance": config.largest_torque,
        "restarts": own.restarts,
    }
    requests = RequestQueue(controller, scenario.step_ns, facts, report, act)
    SteeringServer(Path(own.folder), requests).start()
    hear = Pace(controller, own.step_seconds).hear if own.step_seconds else None
    ends = settings.endpoints(STEERER, LOCKSTEP, *configure.options_for(scenario))
    return NodeSpec(controller, ends, on_idle=lambda _: requests.work(), hear=hear)


main = LockstepProgram(STEERER, PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())
