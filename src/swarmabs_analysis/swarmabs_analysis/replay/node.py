"""Node ``replay_player``: replaces all nodes other than those under test in a replay."""

from __future__ import annotations

import sys
from pathlib import Path

from swarmabs_analysis.replay.player import Player, played
from swarmabs_analysis.replay.source import complete_steps
from swarmabs_bag.attached import attached_scenario
from swarmabs_bag.reader import open_bag
from swarmabs_config.graph import Endpoints, requested
from swarmabs_core.errors import InputError
from swarmabs_core.membership import Change
from swarmabs_core.nodes import NodeName
from swarmabs_core.parameters import Parameter
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.runner import Settings, run_node
from swarmabs_ros.status import StatusChannel

PARAMETERS = (
    Parameter("bag", "", "bag to replay"),
    Parameter("nodes", ("controller",), "nodes under test: parent, observer, controller, agent:N"),
    Parameter("window", 0, "steps by which the replay may be ahead of the recorder; 0: not recorded", minimum=0),
    Parameter("overrides", (), "changes of the bag's scenario, each a.b=value"),
    Parameter("ends", (), "ends of robots that the bag's scenario does not plan, each 'KIND AGENT STEP'"),
)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour and the endpoints.

    Raises
    ------
    InputError
        If the bag or the last step is missing.
    """
    last = settings.last_step()
    if not settings.text("bag") or last is None:
        raise InputError("parameters bag and last_step are required: give a bag and the last step of the replay")
    bag = open_bag(Path(settings.text("bag")), namespace=settings.namespace)
    scenario, changed = (attached_scenario(bag, given).resolved() for given in ((), settings.texts("overrides")))
    ends = [Change.parse(text) for text in settings.texts("ends")]
    nodes = [NodeName.parse(text) for text in settings.texts("nodes")]
    steps = complete_steps(bag, scenario, ends, changed)
    player = Player(steps, nodes, last_step=last, window=settings.integer("window"), family=scenario.family)
    depth = max(100, 4 * len(scenario.agents))
    subscriptions = {
        topic: requested(topic, depth=depth if topic is scenario.family.robot else 10) for topic in player.hears
    }
    return NodeSpec(player, Endpoints(played(nodes, scenario.family), subscriptions))


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node("replay_player", PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
