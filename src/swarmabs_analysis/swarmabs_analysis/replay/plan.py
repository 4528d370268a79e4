"""Which processes a live replay needs: the nodes under test, the recorder, and the player for all others."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

from swarmabs_analysis.replay.player import Player
from swarmabs_config import configure
from swarmabs_config.graph import CONTROLLER, FIRST_SPARE, OBSERVER, PLANE, RECORDER, agent_name
from swarmabs_core.messages import AGENT_STATE, EVENTS, MAIN_TOPICS, RECORDING_PROGRESS
from swarmabs_core.publishers import NodeKind
from swarmabs_run.orchestration.plan import ProcessPlan, expect_counterparts

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from swarmabs_analysis.replay.source import Source
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Topic
    from swarmabs_core.publishers import NodeName

PLAYER = "replay_player"

_NAMES = {NodeKind.PLANE: PLANE, NodeKind.OBSERVER: OBSERVER, NodeKind.CONTROLLER: CONTROLLER}


def process_name(node: NodeName) -> str:
    """Return the name of the process in which a node lives."""
    return agent_name(node.agent_id) if node.kind is NodeKind.AGENT else _NAMES[node.kind]


def played(nodes: Collection[NodeName]) -> tuple[Topic, ...]:
    """Return the topics that the player publishes."""
    answered = Player(iter(()), nodes, last_step=0).hears
    return (EVENTS, *(topic for topic in MAIN_TOPICS if topic is AGENT_STATE or topic not in answered))


def replay_plan(
    processes: Sequence[ProcessPlan],
    scenario: Scenario,
    source: Source,
    nodes: Collection[NodeName],
    provenance: Mapping[str, object],
) -> tuple[ProcessPlan, ...]:
    """Return the processes of a live replay.

    Parameters
    ----------
    processes : sequence of ProcessPlan
        Those of a run of the same scenario.
    scenario : Scenario
        The scenario of the replay.
    source : Source
        What is replayed.
    nodes : collection of NodeName
        The nodes under test.
    provenance : mapping
        What the new bag says of where it comes from.
    """
    by_name = {process.name: process for process in processes}
    recorder = by_name[RECORDER]
    shared = {name: recorder.parameters[name] for name in ("period_ns", "last_step", "stall_timeout")}
    shared |= {name: recorder.parameters[name] for name in ("repeat_after", "repeat_steps")}
    player = ProcessPlan(
        PLAYER,
        "swarmabs_analysis.replay.node",
        FIRST_SPARE,
        shared
        | {
            "bag": str(source.bag.path.resolve()),
            "nodes": tuple(str(node) for node in nodes),
            "window": configure.recording_window(scenario),
            "ends": tuple(str(change) for change in source.ends),
        },
        played(nodes),
        (*Player(iter(()), nodes, last_step=0).hears, RECORDING_PROGRESS),
    )
    told = recorder.parameters | {
        "replay": json.dumps(provenance),
        "ends": tuple(str(change) for change in source.ends if change.step <= scenario.steps),
    }
    tested = [by_name[process_name(node)] for node in nodes]
    for process in tested:
        for change in source.ends:
            if change.agent_id in process.agents:  # it falls silent by itself: nobody stops it this time
                process.parameters.update(end=change.kind.value, end_step=change.step)
    planned = (player, *tested, replace(recorder, parameters=told))
    expect_counterparts(planned)
    return planned
