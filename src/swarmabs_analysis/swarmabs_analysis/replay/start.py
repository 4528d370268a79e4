"""How nodes of a recorded run are started to be tested against it."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from swarmabs_analysis.replay.playback import namespace_of
from swarmabs_analysis.verification.trial import check_nodes
from swarmabs_bag.attached import attached_scenario
from swarmabs_bag.run_folder import RunFolder
from swarmabs_config.graph import CONTROLLER, OBSERVER
from swarmabs_core.errors import InputError
from swarmabs_core.messages import STANDING
from swarmabs_core.nodes import NodeKind, agent_name
from swarmabs_run.orchestration.plan import plan
from swarmabs_run.run import RunOptions

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from swarmabs_bag.reader import BagReader
    from swarmabs_core.nodes import NodeName

_PROCESSES = {NodeKind.OBSERVER: OBSERVER, NodeKind.CONTROLLER: CONTROLLER}


def start_commands(bag: BagReader, nodes: Collection[NodeName]) -> Iterator[str]:
    """Yield for each node the command that starts it with the parameters of the recorded run.

    Nothing if the bag has no scenario that can be loaded, such as a bag that rosbag2 has recorded.

    Raises
    ------
    InputError
        If the scenario lacks one of the nodes, or has none of them because each robot coordinates the swarm by itself.
    """
    try:
        scenario = attached_scenario(bag).resolved()
    except InputError:
        return
    if scenario.decentralised:
        raise InputError(
            f"{bag.path}: each robot of this run coordinates the swarm by itself, so no node is tested in a playback; "
            "leave out --node, or use verify"
        )
    check_nodes(nodes, scenario)
    processes = {process.name: process for process in plan(scenario, RunFolder(bag.path), RunOptions(packed=False))}
    names = {**_PROCESSES, NodeKind.PARENT: scenario.family.node}
    # In a playback there are no recorder to wait for, and no fixed number of counterparts.
    changed: dict[str, object] = {"recording_window": 0, "match": ()}
    if STANDING not in bag.topics():
        changed["division"] = 0
    for node in nodes:
        process = processes[agent_name(node.agent_id) if node.kind is NodeKind.AGENT else names[node.kind]]
        process.parameters.update({name: value for name, value in changed.items() if name in process.parameters})
        arguments = process.arguments(namespace_of(bag))
        yield shlex.join(["python", "-m", process.module, *arguments])
