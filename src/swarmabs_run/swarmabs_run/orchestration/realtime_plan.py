"""Which processes a scenario needs in real time, and with which parameters each is started."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_config import realtime
from swarmabs_config.graph import (
    CONTROLLER,
    COORDINATORS,
    NODES,
    OBSERVER,
    PLANE,
    REALTIME,
    RECORDER,
    ROBOT,
    agent_name,
    endpoints,
)
from swarmabs_core.declaration import values_of
from swarmabs_run.orchestration.plan import ProcessPlan, coordinator, recorder_parameters

if TYPE_CHECKING:
    from pathlib import Path

    from swarmabs_config.scenario import Scenario


def realtime_plan(
    scenario: Scenario, *, scenario_file: Path, bag: Path | None, logs: Path, split: Split = ONE_FILE
) -> tuple[ProcessPlan, ...]:
    """Return the processes of a scenario: the coordinators first, then the robots by id.

    All of them are told when step 0 begins.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    scenario_file : Path
        Where the resolved scenario stands, for the recorder.
    bag : Path, optional
        Folder of the bag; none if nothing is to be recorded.
    logs : Path
        Folder of the processes' logs, for the recorder.
    split : Split
        When the bag goes on in a new file.
    """
    schedule = realtime.schedule(scenario, 0)
    coordinators = {
        PLANE: _told(realtime.plane_config(scenario, schedule)),
        OBSERVER: _told(realtime.observer_config(scenario, schedule)),
        CONTROLLER: _told(realtime.controller_config(scenario, schedule)),
        RECORDER: {"period_ns": scenario.step_ns, "await_epoch": True, "last_step": scenario.steps}
        | recorder_parameters(scenario_file, bag, logs, split),
    }
    robot = endpoints(ROBOT, REALTIME)
    return (
        *(coordinator(node, REALTIME, parameters, scenario) for node, parameters in coordinators.items()),
        *(
            ProcessPlan(
                agent_name(config.agent_id),
                NODES[ROBOT].modules[REALTIME],
                COORDINATORS + index,
                _told(config),
                robot.publications,
                tuple(robot.subscriptions),
                (config.agent_id,),
            )
            for index, config in enumerate(realtime.agent_configs(scenario, schedule))
        ),
    )


def _told(config: object) -> dict[str, object]:
    """Return the parameters of a node that is told the epoch when all are there."""
    values: dict[str, object] = {**values_of(config)}
    del values["epoch_ns"]
    return values | {"await_epoch": True}
