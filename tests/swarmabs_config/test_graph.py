"""The graph agrees with what nodes know of each other."""

from swarmabs_config.graph import CONTROLLER, GRAPH, LOCKSTEP, OBSERVER, PLANE_DRIVER, Option, services
from swarmabs_core.messages import FAMILIES
from swarmabs_core.nodes import NodeKind
from swarmabs_core.publishers import PUBLISHER


def test_each_topic_with_one_publisher_has_it_in_the_graph() -> None:
    kinds = dict.fromkeys((PLANE_DRIVER, *(family.node for family in FAMILIES)), NodeKind.PARENT)
    kinds |= {OBSERVER: NodeKind.OBSERVER, CONTROLLER: NodeKind.CONTROLLER}
    found = {
        topic: {kinds.get(end.node) for end in link.writers if end.driver in {None, LOCKSTEP}}
        for link in GRAPH
        for topic in link.topics
        if topic in PUBLISHER
    }
    assert found == {topic: {node.kind} for topic, node in PUBLISHER.items()}


def test_a_standby_offers_services_under_names_that_its_primary_does_not_have() -> None:
    assert services(CONTROLLER) == ("swarm/stop", "swarm/reset", "~/release")
    assert services(CONTROLLER, frozenset({Option.STANDBY})) == (
        "standby/swarm/stop",
        "standby/swarm/reset",
        "~/release",
    )
