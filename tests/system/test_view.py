"""A view beside a run: what it shows is what is recorded, and whatever becomes of it, the run is the same."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from pathlib import Path
from typing import Any

import psutil
import pytest
from aiohttp import ClientConnectionError, ClientSession, WSMsgType
from playwright.sync_api import expect, sync_playwright
from tests.processes import marked_processes, until
from tests.swarmabs_analysis.figures.conftest import ReadBag
from tests.swarmabs_view.conftest import browser_arguments, chromium
from tests.system.helpers import (
    Command,
    bag_messages,
    named_processes,
    seconds,
    simulated_digest,
    started_swarm,
    summary_of,
    swarm,
    until_stepping,
)

from swarmabs_core.cdr import decode
from swarmabs_core.messages import EventKind, SwarmEvent
from swarmabs_run.orchestration.run_files import environment_of_run, read_processes

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

LONG = seconds(100.0)
EVENTS = ("limits.velocity=0.02", "swarm.sensor.noise=[0.001, 0.001]")


def viewer_of(mark: str) -> psutil.Process | None:
    """Return the process of the view beside a run."""
    for pid in marked_processes(mark):
        try:
            process = psutil.Process(pid)
            if "swarmabs_view.sources" in process.cmdline():
                return process
        except psutil.Error:
            continue
    return None


def address(command: Command) -> str:
    """Return the address of the page that a run has printed, once it has."""
    assert command.process.stderr is not None
    for line in command.process.stderr:
        if line.startswith("view: "):
            return line.removeprefix("view: ").strip()
    raise AssertionError("the command has printed no address")


async def look(url: str, enough: Any) -> list[dict[str, Any]]:
    """Look as a page does, until there is enough or the server ends."""
    found: list[dict[str, Any]] = []
    async with ClientSession() as session:
        for _ in range(100):  # the server comes up while the processes of the run do
            try:
                page = await session.ws_connect(f"{url}socket", headers={"Origin": url.rstrip("/")})
                break
            except ClientConnectionError:
                await asyncio.sleep(0.1)
        async for message in page:
            if message.type is not WSMsgType.TEXT:
                break
            found.append(json.loads(message.data))
            if enough(found):
                break
        await page.close()
    return found


def kinds(found: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    return [message for message in found if message["type"] == kind]


def test_what_is_shown_of_a_run_is_what_is_recorded(folder: Path) -> None:
    overrides = (LONG, "faults=[{at: 50.0, kind: freeze, agent: 2}]")
    words = [part for override in overrides for part in ("--set", override)]
    with started_swarm("run", "-o", folder, "--view", *words) as command:
        found = asyncio.run(look(address(command), lambda _: False))
        finished = command.wait()
    assert finished.code == 0
    assert summary_of(folder)["digest"] == simulated_digest("pd_het_4", *overrides)
    bags = [place for place, message in enumerate(found) if message.get("source") == "bag"]
    found = found[: bags[0]] if bags else found  # where the view had the time to show the bag at the end, too
    read = ReadBag(folder)
    frames = kinds(found, "frame")
    assert [frame["step"] for frame in frames] == sorted(frame["step"] for frame in frames)
    angle, torque = read.column("/plane/state", "angle"), read.column("/swarm/abstract_state", "torque")
    inertia = read.column("/swarm/desired_abstract_state", "inertia")
    positions = [read.column("/swarm/agent_state", "position", robot) for robot in (1, 2, 3, 4)]
    # The view joins within a step: until all of one has come, there is a part.
    whole = [frame for frame in frames if None not in (frame["abstract"]["torque"], frame["desired"]["inertia"])]
    assert len(whole) > 10
    for frame in frames:
        step = frame["step"]
        assert frame["angle"] == angle[step]
        assert frame["abstract"]["torque"] in (None, torque[step])
        assert frame["desired"]["inertia"] in (None, inertia[step])
        for shown, recorded in zip(frame["robots"]["position"], positions, strict=True):
            # Best effort: of a robot the last state that came up to then, as a rule that of the step.
            assert shown is None or shown in recorded[: step + 1]
    for curves in kinds(found, "curves"):
        for time, value, sent in zip(curves["time"], curves["angle"], curves["torque"], strict=True):
            assert (value, sent) == (angle[round(time * 100)], torque[round(time * 100)])
    assert [event["kind"] for events in kinds(found, "events") for event in events["events"]] == ["DEAD"]
    processes = {one["name"]: one for health in kinds(found, "health") for one in health["processes"]}
    assert set(processes) == {
        *("orchestrator", "launcher", "plane_sim", "abstraction_observer", "parent_controller", "recorder"),
        *(f"agent_00{number}" for number in range(1, 5)),
    }


@pytest.mark.parametrize(
    "number", [signal.SIGSTOP, *(pytest.param(one, marks=pytest.mark.full) for one in (signal.SIGKILL, signal.SIGTERM))]
)
def test_a_view_that_dies_or_hangs_changes_nothing(folder: Path, mark: str, number: signal.Signals) -> None:
    overrides = (LONG, *EVENTS)
    words = [part for override in overrides for part in ("--set", override)]
    with started_swarm("run", "-o", folder, "--view", *words) as command:
        until_stepping(folder)
        viewer = viewer_of(mark)
        assert viewer is not None
        until(lambda: _subscribes(viewer), "the viewer has joined the network of the run", 30.0)
        viewer.send_signal(number)
        finished = command.wait()
    assert finished.code == 0, finished.err
    assert summary_of(folder)["digest"] == simulated_digest("pd_het_4", *overrides)


def _subscribes(viewer: psutil.Process) -> bool:
    """Tell whether a process has UDP sockets of DDS."""
    return any(connection.type.name == "SOCK_DGRAM" for connection in viewer.net_connections("inet4"))


def test_the_page_follows_a_run_into_its_bag(folder: Path) -> None:
    program = chromium()
    with started_swarm("run", "-o", folder, "--duration", 100_000) as run:
        until_stepping(folder)
        with (
            started_swarm("view", "--live", folder) as view,
            sync_playwright() as playwright,
            playwright.chromium.launch(executable_path=program, args=browser_arguments()) as browser,
        ):
            page = browser.new_page()
            assert view.process.stdout is not None
            page.goto(view.process.stdout.readline().strip())
            state = page.locator("#state")
            expect(state).to_have_attribute("data-phase", "running", timeout=30_000)
            expect(page.locator("#processes tbody tr")).to_have_count(10, timeout=30_000)
            expect(page.locator("#playback")).to_be_hidden()
            expect(page.locator("#step_rate")).not_to_have_text("–")
            expect(page.locator("#following")).to_have_text("4 of 4")
            run.process.terminate()
            run.wait()
            expect(state).to_have_attribute("data-phase", "recorded", timeout=30_000)
            expect(page.locator("#playback")).to_be_visible()
            read = ReadBag(folder)
            last = len(read.column("/plane/state", "angle")) - 1
            expect(page.locator("#step")).to_have_attribute("value", str(last))
            page.get_by_role("button", name="First step").click()
            expect(page.locator("#step")).to_have_attribute("value", "0")
            assert float(page.locator("#angle").get_attribute("value") or "nan") == 0.1
        view.process.wait(20)


def test_a_view_that_comes_later_sees_the_run_and_ends_by_itself(folder: Path) -> None:
    with started_swarm("run", "-o", folder, "--duration", 100_000) as run:
        until_stepping(folder)
        with started_swarm("view", "--live", folder) as view:
            assert view.process.stdout is not None
            url = view.process.stdout.readline().strip()
            found = asyncio.run(look(url, lambda got: len(kinds(got, "frame")) > 20 and kinds(got, "health")))
            run.process.terminate()
            assert run.wait().code == 1
            after = asyncio.run(look(url, lambda got: any(h["source"] == "bag" for h in kinds(got, "hello"))))
            view.process.terminate()
            assert view.wait().code == 0
    angle = ReadBag(folder).column("/plane/state", "angle")
    frames = kinds(found, "frame")
    # A run that is ended is ahead of its recorder: the last that was seen need not be in the bag.
    recorded = [frame for frame in frames if frame["step"] < len(angle)]
    assert recorded
    assert all(frame["angle"] == angle[frame["step"]] for frame in recorded)
    assert frames[-1]["step_rate"] > 0.0
    assert kinds(after, "hello")[-1]["playback"] is True
    again = swarm("view", "--live", folder)
    assert again.code == 2
    assert "this run is over; view its bag without --live" in again.err


def test_a_swarm_is_found_by_its_namespace(folder: Path) -> None:
    with started_swarm("run", "-o", folder, "--duration", 100_000) as run:
        until_stepping(folder)
        environment = {**os.environ, **environment_of_run(folder)}
        with started_swarm("view", "--live", "/", env=environment) as view:
            assert view.process.stdout is not None
            url = view.process.stdout.readline().strip()
            found = asyncio.run(
                look(url, lambda got: len(kinds(got, "frame")) > 20 and len(kinds(got, "hello")[-1]["robots"]) == 4)
            )
            view.process.terminate()
            view.wait()
        run.process.terminate()
        run.wait()
    hello = kinds(found, "hello")[-1]
    assert [(robot["id"], robot["kind"], robot["mass"]) for robot in hello["robots"]] == [
        (1, "single_integrator", 0.3552),
        (2, "single_integrator", 0.3532),
        (3, "double_integrator", 0.6762),
        (4, "double_integrator", 0.4596),
    ]
    angle = ReadBag(folder).column("/plane/state", "angle")
    assert all(frame["angle"] == angle[frame["step"]] for frame in kinds(found, "frame"))


def test_a_run_is_steered_from_the_page(folder: Path) -> None:
    program = chromium()
    absent = "faults=[{kind: join, at: null, agent: 4}]"
    words = ("--steer", "--rate", 1, "--view", "--duration", 100_000, "--set", absent)
    with started_swarm("run", "-o", folder, *words) as run:
        plain = address(run)
        assert run.process.stderr is not None
        with_token = run.process.stderr.readline().removeprefix("view, to steer: ").strip()
        assert with_token.startswith(f"{plain}#steer=")
        until_stepping(folder)
        with (
            sync_playwright() as playwright,
            playwright.chromium.launch(executable_path=program, args=browser_arguments()) as browser,
        ):
            asked: list[str] = []
            page = browser.new_page()
            page.on("request", lambda request: asked.append(request.url))
            page.goto(with_token)
            done = page.locator("#steered")
            page.get_by_label("Offset of the reference, rad").fill("0.05")
            page.get_by_role("button", name="Set reference").click()
            expect(done).to_contain_text("reference 0.05: from step ", timeout=30_000)
            expect(page.locator("#held-reference")).to_have_attribute("value", "0.05")
            expect(page.locator("#reference")).to_have_attribute("value", "0.05")
            page.get_by_label("Torque on the plane, N m").fill("99")
            page.get_by_role("button", name="Set disturbance").click()  # the browser itself refuses
            page.get_by_label("Torque on the plane, N m").fill("0.1")
            page.get_by_role("button", name="Set disturbance").click()
            expect(done).to_contain_text("disturbance 0.1: from step ")
            page.get_by_role("button", name="Add").click()
            expect(done).to_contain_text("add robot 4: from step ")
            page.get_by_label("Robot", exact=True).select_option("robot 3")
            page.get_by_role("button", name="Kill").click()
            expect(done).to_contain_text("kill robot 3: from step ")
            expect(page.get_by_label("Robot", exact=True).locator("option")).to_have_count(3)
            expect(page.locator("#steer-absent")).to_be_hidden()
            theme = page.locator("#theme").text_content()
            page.locator("#steer-reference-value").press("t")  # is typed, and no key of the page
            assert page.locator("#theme").text_content() == theme
            assert page.url == plain
            token = with_token.partition("=")[2]
            assert asked
            assert not any(token in url for url in asked)

            stranger = browser.new_context().new_page()
            stranger.goto(plain)
            expect(stranger.locator("#steering")).to_be_visible()
            expect(stranger.locator("#steer-controls")).to_be_hidden()
            stranger.get_by_label("Token, from the terminal of the run").fill("guessed")
            stranger.get_by_role("button", name="Use").click()
            stranger.get_by_role("button", name="Freeze").click()
            expect(stranger.locator("#steered")).to_contain_text("not done: the token is wrong")
            expect(stranger.locator("#steer-controls")).to_be_hidden()
            run.process.terminate()
            run.wait()
    events = [
        decode(SwarmEvent, message.payload) for message in bag_messages(folder) if message.topic == "swarm/events"
    ]
    steered = {(event.kind, event.agent_id, event.detail, event.value) for event in events}  # type: ignore[union-attr]
    assert steered >= {
        (EventKind.STEERING, 0, "reference", 0.05),
        (EventKind.STEERING, 0, "disturbance", 0.1),
    }
    ended = {(kind, agent) for kind, agent, _, _ in steered if agent}
    assert ended >= {(EventKind.JOINED, 4), (EventKind.DEAD, 3)}
    assert not any(agent in {1, 2} and kind == EventKind.DEAD for kind, agent in ended)
    verdict = swarm("verify", folder)
    assert verdict.code == 0, verdict.out + verdict.err


def test_without_being_asked_for_nothing_can_be_steered(folder: Path) -> None:
    wish = {"v": 1, "type": "steer", "token": "", "request": "r", "action": "kill", "agent": 1}

    async def attempt(url: str) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = []
        async with ClientSession() as session:
            page = await session.ws_connect(f"{url}socket", headers={"Origin": url.rstrip("/")})
            await page.send_json(wish)
            while len(kinds(found, "frame")) < 20:
                found.append(json.loads((await page.receive()).data))
            await page.close()
        return found

    with started_swarm("run", "-o", folder, "--duration", 100_000, "--view") as run:
        url = address(run)
        until_stepping(folder)
        found = asyncio.run(attempt(url))
        assert not (folder / "steer.sock").exists()
        run.process.terminate()
        run.wait()
    assert not kinds(found, "steering")
    assert not kinds(found, "answer")
    assert set(found[-1]["robots"]["status"]) <= {"active", None} if "robots" in found[-1] else True
    assert "swarm/events" not in {message.topic for message in bag_messages(folder)}


def test_a_command_that_is_killed_takes_the_view_with_it(folder: Path, mark: str) -> None:
    with started_swarm("run", "-o", folder, "--duration", 100_000, "--view") as command:
        until_stepping(folder)
        assert viewer_of(mark) is not None
        command.process.kill()
        command.process.wait()
        until(lambda: not marked_processes(mark), "everything of the run has ended")


def test_a_port_that_is_taken_refuses_the_run(folder: Path, tmp_path: Path) -> None:
    with started_swarm("run", "-o", folder, "--duration", 100_000, "--view") as command:
        port = address(command).rstrip("/").rpartition(":")[2]
        refused = swarm("run", "-o", tmp_path / "other", "--view", "--view-port", port)
        command.process.terminate()
        command.wait()
    assert refused.code == 2
    assert f"port {port} of 127.0.0.1: Address already in use" in refused.err
    assert not (tmp_path / "other").exists()


def test_processes_are_written_down_at_the_start(folder: Path, mark: str) -> None:
    with started_swarm("run", "-o", folder, "--duration", 100_000) as command:
        until_stepping(folder)
        written = read_processes(folder)
        assert written is not None
        assert written.items() >= named_processes(mark).items()
        assert written["orchestrator"] == command.pid
        command.process.terminate()
        command.wait()
