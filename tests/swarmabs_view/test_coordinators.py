"""Who leads and who stands by, as pages get it: from the diagnostics of the nodes, some of which tell of links."""

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from playwright.sync_api import Page, expect
from tests.processes import until
from tests.swarmabs_view.conftest import PageServer

from swarmabs_config.graph import CONTROLLER, DIAGNOSTICS, OBSERVER, SILENCE, standby_name
from swarmabs_core.hearing import Hearing
from swarmabs_core.pair_role import role_values
from swarmabs_core.realtime.base import Health, Level
from swarmabs_ros.managed import diagnostic_array
from swarmabs_ros.start import SwarmNode, initialise
from swarmabs_view.coordinators import DiagnosedRoles
from swarmabs_view.linked_robots import DiagnosedLinks
from swarmabs_view.listener import DiagnosticsListener
from swarmabs_view.protocol import Coordinator, CoordinatorPair, Coordinators, Links

TOLD = (
    (OBSERVER, role_values("primary", "leads", 7.0)),
    ("agent_001", (("x", "y"),)),
    ("agent_002", Hearing((1,), 1, {1: 4, 2: 0}, (), majority=True).values()),
)


def shown(message: Coordinators | None) -> list[tuple[str, int | None, str, int | None]]:
    assert message is not None
    return [(p.primary.role, p.primary.seconds, p.standby.role, p.standby.seconds) for p in message.pairs]


def test_in_real_time_one_whose_diagnostics_end_is_silent() -> None:
    heard = DiagnosedRoles()
    heard.hear("agent_001", {"status": "ACTIVE"}, 0.0)
    assert heard.message(0.0) is None
    heard.hear(OBSERVER, dict(role_values("primary", "leads", 40.4)), 100.0)
    assert shown(heard.message(101.5)) == [("leads", 41, "is silent", None)]
    heard.hear(standby_name(OBSERVER), dict(role_values("standby", "stands by", 3.0)), 101.0)
    assert shown(heard.message(102.0)) == [("leads", 42, "stands by", 4)]
    assert shown(heard.message(100.6 + SILENCE)) == [("is silent", 3, "stands by", 5)]


@pytest.mark.usefixtures("ros")
def test_diagnostics_are_heard_on_the_topic_of_the_nodes() -> None:
    initialise("view", ["--ros-args", "--disable-external-lib-logs", "-r", "__ns:=/some/swarm"])
    try:
        node = SwarmNode("hearer")
        publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        listener, roles, links = DiagnosticsListener(node), DiagnosedRoles(), DiagnosedLinks()

        def complete() -> bool:
            for name, values in TOLD:
                publisher.publish(diagnostic_array(name, Health(Level.OK, "fine", values), 0))
            for found in listener.poll():
                roles.hear(*found, 0.0)
                links.hear(*found, 0.0)
            return roles.message(0.0) is not None and links.message(0.0) is not None

        until(complete, "a role has been heard", 15.0)
        assert shown(roles.message(0.0)) == [("leads", 7, "is silent", None)]
        assert [robot.hears for robot in (links.message(0.0) or Links(robots=[])).robots] == [[1]]
        node.destroy_node()  # type: ignore[no-untyped-call]
    finally:
        rclpy.try_shutdown()


def test_the_page_has_a_table_of_them_where_there_are_any(page: Page, page_server: PageServer) -> None:
    page_server.open()
    panel = page.locator("#coordinators-panel")
    expect(panel).to_be_hidden()
    lost = Coordinator(role="is lost", seconds=75, ok=False)
    leads = Coordinator(role="leads", seconds=4, ok=True)
    unheard = Coordinator(role="is silent", seconds=None, ok=False)
    pairs = [
        CoordinatorPair(name=OBSERVER, primary=lost, standby=leads),
        CoordinatorPair(name=CONTROLLER, primary=leads, standby=unheard),
    ]
    page_server.send(Coordinators(pairs=pairs))
    expect(panel.locator("tbody tr")).to_have_text(
        [
            "abstraction observeris lost for 1 min 15 sleads for 4 s",
            "parent controllerleads for 4 sis silent",
        ]
    )
    expect(panel.locator("td.bad")).to_have_count(2)
    expect(panel.locator("b")).to_have_text(["leads", "leads"])
    for width in (390, 1280):
        page.set_viewport_size({"width": width, "height": 844})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
