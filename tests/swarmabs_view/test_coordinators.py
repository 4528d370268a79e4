"""Who leads and who stands by, as pages get it: from diagnostics in real time, and of earlier runs in lockstep."""

import json
import shutil
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from playwright.sync_api import Page, expect
from tests.processes import until
from tests.swarmabs_view.conftest import PageServer, told

from swarmabs_config.graph import CONTROLLER, DIAGNOSTICS, OBSERVER, RECORDER, SILENCE, standby_name
from swarmabs_core.messages import EventKind
from swarmabs_core.pair_role import role_values
from swarmabs_core.realtime.base import Health, Level
from swarmabs_ros.managed import diagnostic_array
from swarmabs_ros.start import SwarmNode, initialise
from swarmabs_view.coordinators import (
    ROLES_FILE,
    DiagnosedRoles,
    Role,
    coordinators_at,
    read_roles,
    takeovers,
)
from swarmabs_view.listener import DiagnosticsListener
from swarmabs_view.playback import PlaybackSession, open_recording
from swarmabs_view.protocol import Coordinator, CoordinatorPair, Coordinators, Seek

SECOND = standby_name(RECORDER)
FIRST = [
    *(Role(0, node, "leads") for node in (OBSERVER, CONTROLLER)),
    *(Role(0, standby_name(node), "stands by") for node in (OBSERVER, CONTROLLER)),
    *(Role(0, node, "records") for node in (RECORDER, SECOND)),
]
ROLES = [
    *FIRST,
    Role(10, standby_name(CONTROLLER), "leads", f"{CONTROLLER} was stopped"),
    Role(10, CONTROLLER, "is silent"),
    Role(14, CONTROLLER, "leads", "publishes again"),
    Role(14, standby_name(CONTROLLER), "stands by"),
    Role(20, RECORDER, "is lost", "was killed by SIGKILL"),
]
"""A run in lockstep whose controller is replaced for a while, and which then loses its recorder."""


def shown(message: Coordinators | None) -> list[tuple[str, int | None, str, int | None]]:
    assert message is not None
    return [(p.primary.role, p.primary.seconds, p.standby.role, p.standby.seconds) for p in message.pairs]


def test_the_roles_of_a_run_are_those_of_the_step_shown() -> None:
    plain = ("leads", 5, "stands by", 5)
    assert shown(coordinators_at(ROLES, 5, 1.0)) == [plain, plain, ("records", 5, "records", 5)]
    assert shown(coordinators_at(ROLES, 12, 1.0))[1] == ("is silent", 2, "leads", 2)
    (_, controller, recorder) = shown(coordinators_at(ROLES, 30, 0.5))
    assert (controller, recorder) == (("leads", 8, "stands by", 8), ("is lost", 5, "records", 15))
    assert coordinators_at((), 5, 1.0) is None


def test_a_page_shows_those_in_the_logs_of_an_earlier_run_with_takeovers_as_events(run: Path, tmp_path: Path) -> None:
    without = PlaybackSession(open_recording(run))
    assert not told(without.poll(0.0), Coordinators)
    folder = shutil.copytree(run, tmp_path / "run")
    (folder / "logs").mkdir(exist_ok=True)
    (folder / "logs" / ROLES_FILE).write_text(json.dumps([role._asdict() for role in ROLES]))
    recording = open_recording(folder)
    leading = [e for e in recording.events.events if e.kind == EventKind.LEADING.name]
    assert [(e.step, e.detail) for e in leading] == [
        (10, f"{standby_name(CONTROLLER)}: {CONTROLLER} was stopped"),
        (14, f"{CONTROLLER}: publishes again"),
        (20, f"{SECOND}: {RECORDER} was killed by SIGKILL"),
    ]
    steps = [event.step for event in recording.events.events]
    assert steps == sorted(steps)
    assert len(steps) == len(without.recording.events.events) + 3
    playback = PlaybackSession(recording)
    playback.control(Seek(v=2, type="seek", step=12))
    (coordinators,) = told(playback.poll(0.0), Coordinators)
    assert shown(coordinators)[1][::2] == ("is silent", "leads")
    (folder / "logs" / ROLES_FILE).write_text('[{"when": 5}]')
    assert read_roles(folder / "logs") == []


def test_no_recorder_takes_over_that_is_lost_itself() -> None:
    assert not takeovers([*FIRST, *(Role(step, node, "is lost") for step, node in ((5, SECOND), (6, RECORDER)))])


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
        listener, roles = DiagnosticsListener(node), DiagnosedRoles()

        def complete() -> bool:
            for name, values in ((OBSERVER, role_values("primary", "leads", 7.0)), ("agent_001", (("x", "y"),))):
                publisher.publish(diagnostic_array(name, Health(Level.OK, "fine", values), 0))
            for found in listener.poll():
                roles.hear(*found, 0.0)
            return roles.message(0.0) is not None

        until(complete, "a role has been heard", 15.0)
        assert shown(roles.message(0.0)) == [("leads", 7, "is silent", None)]
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
