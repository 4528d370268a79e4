"""Which processes a scenario needs in real time, and with which parameters each is started."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_bag.splitting import ONE_FILE, Split
from swarmabs_config import configure
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
from swarmabs_config.realtime import bounds
from swarmabs_run.orchestration.plan import (
    ProcessPlan,
    agent_parameters,
    controller_parameters,
    coordinator,
    plane_parameters,
)

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
    realtime = scenario.realtime
    swarm_mass = bounds(scenario).swarm_mass
    clock: dict[str, object] = {
        "period_ns": scenario.step_ns,
        "await_epoch": True,
        "clock_tolerance": realtime.clock_tolerance,
    }
    swarm: dict[str, object] = {"members": configure.members(scenario), "gravity": scenario.plane.gravity}
    length: dict[str, object] = {"plane_length": scenario.plane.length}
    coordinators = {
        PLANE: clock | swarm | plane_parameters(scenario) | {"length": scenario.plane.length},
        OBSERVER: clock
        | swarm
        | length
        | {
            "ksd": scenario.swarm.gains.ksd,
            "swarm_mass": swarm_mass,
            "state_age_limit": realtime.state_age_limit,
            "start": realtime.start,
            "quorum": min(realtime.quorum or 0, len(scenario.agents)),
        },
        CONTROLLER: clock
        | length
        | controller_parameters(scenario)
        | {"gravity": scenario.plane.gravity, "plane_age_limit": realtime.plane_age_limit},
        RECORDER: {
            "period_ns": scenario.step_ns,
            "await_epoch": True,
            "last_step": scenario.steps,
            "scenario_file": str(scenario_file),
            "bag": str(bag or ""),
            "max_bag_size": split.bytes,
            "max_bag_duration_ns": split.nanoseconds,
            "logs": str(logs),
        },
    }
    told = {
        "swarm_mass": swarm_mass,
        "lane_margin": realtime.lane_margin,
        "broadcast_age_limit": realtime.broadcast_age_limit,
    }
    robot = endpoints(ROBOT, REALTIME)
    return (
        *(coordinator(node, REALTIME, parameters, scenario) for node, parameters in coordinators.items()),
        *(
            ProcessPlan(
                agent_name(config.agent_id),
                NODES[ROBOT].modules[REALTIME],
                COORDINATORS + index,
                clock | agent_parameters(config) | told,
                robot.publications,
                tuple(robot.subscriptions),
                (config.agent_id,),
            )
            for index, config in enumerate(configure.agent_configs(scenario))
        ),
    )
