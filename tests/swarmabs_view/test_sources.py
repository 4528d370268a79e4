"""What live pages are shown: a run from before its start into its bag, and a swarm that is only heard."""

import asyncio
import io
import os
import re
import socket
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import rclpy
from tests.processes import until
from tests.swarmabs_analysis.report.conftest import SCENARIO, write
from tests.swarmabs_bag.sample_run import make_run
from tests.swarmabs_core.helpers import agent_state
from tests.swarmabs_view.speaking import SpeakingNode, eventually

from swarmabs_bag.run_folder import RunFolder
from swarmabs_bag.shown.swarm_state import SwarmState
from swarmabs_config.graph import own_topic
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError
from swarmabs_core.messages import AGENT_STATE, PlaneState
from swarmabs_ros.endpoints import advertise
from swarmabs_ros.start import initialise
from swarmabs_run.orchestration.run_files import ProgressFile, write_network, write_processes
from swarmabs_view import sources
from swarmabs_view.listener import Listener
from swarmabs_view.protocol import Curves, Events, Frame, Health, Hello, Message, State, Steering
from swarmabs_view.sources import RunView, SwarmView, show_live
from swarmabs_view.steering_bridge import SteeredSession


@pytest.mark.usefixtures("ros")
def test_a_listener_hears_a_namespace_and_takes_nothing_for_a_message_that_is_none() -> None:
    state = SwarmState()
    initialise("view", ["--ros-args", "--disable-external-lib-logs", "-r", "__ns:=/some/swarm"])
    try:
        node = SpeakingNode("hearer")
        assert node.get_namespace() == "/some/swarm"
        listener = Listener(node, 3)
        own = advertise(node, own_topic(AGENT_STATE, 700))
        alone = agent_state(700, 5)
        heard_alone: list[object] = []

        def complete() -> bool:
            last = node.step()
            node.say(PlaneState(0, last, 0.0, 0.0), bytes_lost=8)
            for state_of in (700, 701):
                own.publish(encode(alone._replace(agent_id=state_of)))
            for heard in listener.poll():
                if heard.message.step == 5 and getattr(heard.message, "agent_id", 0) >= 700:
                    heard_alone.append((heard.topic, heard.message))
                assert heard.topic in listener.topics
                assert heard.payload == encode(heard.message)
                state.add(heard.message)
            found = state.instant() is not None and state.event_count == 1 and listener.malformed > 0
            return found and bool(heard_alone)

        until(complete, "all has been heard", 15.0)
        assert {*heard_alone} == {(AGENT_STATE, alone)}, "on its own topic a robot speaks only for itself"
        node.destroy_node()  # type: ignore[no-untyped-call]
    finally:
        rclpy.try_shutdown()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunFolder:
    """Return the folder of a run that is about to begin; who looks at it keeps priority and environment."""
    (tmp_path / "run").mkdir()
    monkeypatch.setattr(os, "nice", lambda _: 0)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    monkeypatch.setattr(sources, "SUMMARY_SECONDS", 0.3)
    return RunFolder(tmp_path / "run")


class Page:
    """What a page has been told of a run."""

    def __init__(self, view: RunView | SwarmView) -> None:
        self._session = view.session()
        self.told: list[Message] = []

    def last(self, kind: type[Message]) -> Any:
        """Return the latest message of a kind, None if there is none."""
        self.told += self._session.poll(asyncio.get_running_loop().time())
        return next((message for message in reversed(self.told) if isinstance(message, kind)), None)


def follows(view: RunView | SwarmView, work: Callable[[Page], Awaitable[None]]) -> None:
    """Have a page look while the view follows its swarm."""

    async def main() -> None:
        following = asyncio.ensure_future(view.follow())
        try:
            await work(Page(view))
        finally:
            following.cancel()
            await asyncio.wait([following])

    asyncio.run(main())


@pytest.mark.usefixtures("ros")
def test_a_run_is_shown_from_before_its_start_into_its_bag(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes: list[SpeakingNode] = []

    def make(name: str) -> SpeakingNode:
        nodes.append(SpeakingNode(name))
        return nodes[-1]

    monkeypatch.setattr(sources, "SwarmNode", make)

    async def work(page: Page) -> None:
        assert (page.last(Hello).title, page.last(Hello).robots) == ("run", [])
        assert page.last(State) == State(phase="waiting", text="the processes are starting")
        folder.logs.mkdir()
        await eventually(lambda: page.last(Hello).robots == [], "the scenario is not there yet")
        folder.scenario.write_text(SCENARIO)
        await eventually(lambda: page.last(Hello).title == "sample", "the scenario is known")
        assert [robot.id for robot in page.last(Hello).robots] == [1, 2, 7]
        assert page.last(Frame) is None
        write_network(folder.logs, int(os.environ["ROS_DOMAIN_ID"]), 20)
        await eventually(lambda: page.last(Frame), "the first step is shown, which nobody has sent yet")
        scenario = parse_scenario(SCENARIO)
        assert (page.last(Frame).step, page.last(Frame).values[0]) == (0, scenario.plane.angle)
        assert page.last(Frame).robots.coordinates == [[agent.position] for agent in scenario.agents]
        assert page.last(Curves).time == []
        write_processes(folder.logs, {"launcher": os.getpid()})
        await eventually(lambda: nodes, "the view listens")
        assert nodes[0].get_namespace() == "/"
        await eventually(lambda: nodes[0].step() and page.last(Frame) and page.last(Events).events, "it is shown")
        assert page.last(State) == State(phase="running", text="")
        await eventually(lambda: page.last(Health), "the processes are looked at")
        assert {one.name for one in page.last(Health).processes} == {"orchestrator", "launcher"}
        write(folder.bag, make_run(10), scenario=SCENARIO)
        folder.write_summary({"status": "ok"})
        await eventually(lambda: page.last(Hello).source == "bag", "the bag is shown")
        await eventually(lambda: page.last(Frame).step == 10, "its last step")

    follows(RunView(folder.path), work)
    assert not rclpy.ok()


@pytest.mark.parametrize(
    ("summary", "bag", "text"),
    [
        ('{"status": "failed"}', None, "the run has ended: failed"),
        ('{"status": "ok"}', b"no bag", "the run has ended; its bag cannot be shown: .*"),
        ("{}", None, "the run has ended; its bag cannot be shown: 'status'"),
        (None, None, "the run has ended without a summary"),
    ],
)
def test_how_a_run_ends_that_was_not_seen(folder: RunFolder, summary: str | None, bag: bytes | None, text: str) -> None:
    folder.logs.mkdir()
    if bag is not None:
        folder.bag.mkdir()
        (folder.bag / "bag_0.mcap").write_bytes(bag)
    if summary is None:
        folder.scenario.write_text(SCENARIO)
        write_network(folder.logs, 5, 8)
        write_processes(folder.logs, {})
        ProgressFile(folder.logs).over()
    else:
        folder.summary.write_text(summary)

    async def work(page: Page) -> None:
        await eventually(lambda: re.fullmatch(text, page.last(State).text), text)
        assert page.last(State).phase == "ended"

    follows(RunView(folder.path), work)


def test_a_run_is_steered_by_those_who_know_the_token(folder: RunFolder) -> None:
    view = RunView(folder.path, "secret")
    assert isinstance(view.session(), SteeredSession)
    assert Steering(open=False) in view.session().poll(0.0)
    for each in (view, RunView(folder.path)):
        with pytest.raises(TimeoutError):
            asyncio.run(asyncio.wait_for(each.steer(), 0.05))


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Have no page served; return what would be."""
    found: list[tuple[Any, ...]] = []
    monkeypatch.setattr(sources, "serve", lambda *things, ready=None: found.append((*things, ready)))
    return found


def test_who_is_served_what(folder: RunFolder, served: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch) -> None:
    listened: list[tuple[Any, ...]] = []

    async def listen(*asked: Any) -> None:
        listened.append(asked)

    monkeypatch.setattr(sources, "listen", listen)
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    listener: Any = object()
    show_live("/some/swarm", listener, print)
    (shown, session, follow, ready) = served.pop()
    assert (shown, ready) == (listener, print)
    (hello, *_) = session().poll(0.0)
    assert (hello.title, hello.place) == ("swarm /some/swarm", "namespace /some/swarm of ROS domain 7")
    asyncio.run(follow())
    ((_, namespace, over),) = listened
    assert (namespace, over()) == ("/some/swarm", False)

    folder.logs.mkdir()
    write_network(folder.logs, 5, 8)
    show_live(str(folder.path), listener, print)
    assert served.pop()[1]().poll(0.0)[0].title == "run"
    ProgressFile(folder.logs).over()
    with pytest.raises(InputError, match=r"this run is over; view its bag with \./scripts/swarm view "):
        show_live(str(folder.path), listener, print)
    with pytest.raises(InputError, match=r"--live some/swarm is neither a run folder nor a namespace"):
        show_live("some/swarm", listener, print)


def test_a_viewer_serves_a_run_until_its_standard_input_ends(
    folder: RunFolder, served: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    number = socket.socket().detach()
    monkeypatch.setattr(sys, "argv", ["sources", str(folder.path), str(number)])
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"secret\n{}")))
    assert sources.main() == 0
    (shown, session, *tasks, ready) = served.pop()
    assert (shown.fileno(), len(tasks), ready) == (-1, 3, None)
    assert isinstance(session(), SteeredSession)

    read, write = os.pipe2(os.O_NONBLOCK)

    async def end() -> None:
        waiting = asyncio.ensure_future(sources.closed(read))
        os.write(write, b"more")
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(asyncio.shield(waiting), 0.05)
        os.close(write)
        await asyncio.wait_for(waiting, 5.0)

    asyncio.run(end())
    os.close(read)
