"""Which processes a scenario needs in real time, and with which parameters each is started."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_bag.realtime_recording import RECORDED
from swarmabs_bag.splitting import ONE_FILE, Split
from swarmabs_config import configure
from swarmabs_config.realtime import bounds
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BASIS,
    BROADCASTS,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
)
from swarmabs_run.orchestration.dds_profile import CONTROLLER_PARTICIPANT, COORDINATORS
from swarmabs_run.orchestration.plan import (
    CONTROLLER,
    OBSERVER,
    PLANE,
    RECORDER,
    ProcessPlan,
    agent_name,
    agent_parameters,
    controller_parameters,
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
    return (
        ProcessPlan(
            PLANE,
            "plane_sim.realtime",
            0,
            clock | swarm | plane_parameters(scenario) | {"length": scenario.plane.length},
            (EVENTS, BASIS, PLANE_STATE),
            (AGENT_STATE,),
        ),
        ProcessPlan(
            OBSERVER,
            "abstraction_observer.realtime",
            1,
            clock
            | swarm
            | length
            | {
                "ksd": scenario.swarm.gains.ksd,
                "swarm_mass": swarm_mass,
                "state_age_limit": realtime.state_age_limit,
                "start": realtime.start,
                "quorum": min(realtime.quorum or 0, len(scenario.agents)),
            },
            (EVENTS, BASIS, ABSTRACT_STATE, AUXILIARY_STATE),
            (AGENT_STATE, EVENTS),
        ),
        ProcessPlan(
            CONTROLLER,
            "parent_controller.realtime",
            CONTROLLER_PARTICIPANT,
            clock
            | length
            | controller_parameters(scenario)
            | {"gravity": scenario.plane.gravity, "plane_age_limit": realtime.plane_age_limit},
            (EVENTS, BASIS, DESIRED_ABSTRACT_STATE),
            (PLANE_STATE, ABSTRACT_STATE),
        ),
        ProcessPlan(
            RECORDER,
            "swarmabs_bag.recorder.realtime",
            3,
            {
                "period_ns": scenario.step_ns,
                "await_epoch": True,
                "last_step": scenario.steps,
                "scenario_file": str(scenario_file),
                "bag": str(bag or ""),
                "max_bag_size": split.bytes,
                "max_bag_duration_ns": split.nanoseconds,
                "logs": str(logs),
            },
            (),
            RECORDED,
        ),
        *(
            ProcessPlan(
                agent_name(config.agent_id),
                "agent_node.realtime",
                COORDINATORS + index,
                clock
                | agent_parameters(config)
                | {
                    "swarm_mass": swarm_mass,
                    "lane_margin": realtime.lane_margin,
                    "broadcast_age_limit": realtime.broadcast_age_limit,
                },
                (EVENTS, AGENT_STATE),
                BROADCASTS,
                (config.agent_id,),
            )
            for index, config in enumerate(configure.agent_configs(scenario))
        ),
    )
