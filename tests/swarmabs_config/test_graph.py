"""The graph agrees with what nodes know of each other."""

import pytest

from swarmabs_config.graph import CONTROLLER, LOCKSTEP, RECORDER, Option, endpoints, services
from swarmabs_config.publishers import PUBLISHER
from swarmabs_core.messages import EVENTS, PLANE_FAMILY, STANDING, SYSTEM, SYSTEM_FAMILY, Family
from swarmabs_core.nodes import NodeKind


@pytest.mark.parametrize(("family", "option"), [(PLANE_FAMILY, set()), (SYSTEM_FAMILY, {Option.SYSTEM})])
def test_the_recorder_reads_what_a_bag_in_lockstep_holds(family: Family, option: set[Option]) -> None:
    read = endpoints(RECORDER, LOCKSTEP, frozenset({Option.CHANGING, *option})).subscriptions
    assert {*family.recorded, EVENTS} == {*read}


@pytest.mark.parametrize("family", [PLANE_FAMILY, SYSTEM_FAMILY])
def test_each_recorded_topic_but_that_of_robots_has_one_publisher(family: Family) -> None:
    main = {
        family.parent: NodeKind.PARENT,
        family.abstract: NodeKind.OBSERVER,
        family.auxiliary: NodeKind.OBSERVER,
        STANDING: NodeKind.OBSERVER,
        family.desired: NodeKind.CONTROLLER,
    }
    expected = main | dict.fromkeys({SYSTEM} & {*family.once}, NodeKind.PARENT)
    published = {topic: PUBLISHER[topic].kind for topic in family.recorded if topic is not family.robot}
    assert published.items() >= expected.items()
    assert published.keys() - expected.keys() == {*family.further}


def test_a_standby_offers_services_under_names_that_its_primary_does_not_have() -> None:
    assert services(CONTROLLER) == ("swarm/stop", "swarm/reset", "~/release")
    assert services(CONTROLLER, frozenset({Option.STANDBY})) == (
        "standby/swarm/stop",
        "standby/swarm/reset",
        "~/release",
    )
