"""A view beside a run: what it shows is what is recorded, and whatever becomes of it, the run is the same."""

import asyncio
import html
import json
import os
import re
import signal
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from aiohttp import ClientConnectionError, ClientSession, WSMsgType
from playwright.sync_api import Browser, expect, sync_playwright
from tests.processes import marked_processes, until
from tests.swarmabs_view.conftest import browser_arguments, chromium
from tests.system import helpers as runs

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.run_folder import RunFolder
from swarmabs_core.messages import EventKind
from swarmabs_run.orchestration.run_files import read_progress
from swarmabs_run.steering.client import SteeringClient

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]

Received = list[dict[str, Any]]
PATIENCE = 60_000
"""Time, ms, within which the page must show what takes far less on a machine that is not busy."""


@contextmanager
def opened_browser() -> Iterator[Browser]:
    program = chromium()
    with (
        sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=program, args=browser_arguments()) as browser,
    ):
        yield browser


async def look(url: str, enough: Callable[[Received], object], said: dict[str, Any] | None = None) -> Received:
    """Look as a page does, until there is enough or the server ends; it may say something at the beginning."""
    received: Received = []
    async with ClientSession() as session:
        for _ in range(600):  # the server comes up while the processes of the run do
            try:
                page = await session.ws_connect(f"{url}socket", headers={"Origin": url.rstrip("/")})
                break
            except ClientConnectionError:
                await asyncio.sleep(0.1)
        if said is not None:
            await page.send_json(said)
        async for message in page:
            if message.type is not WSMsgType.TEXT:
                break
            received.append(json.loads(message.data))
            if enough(received):
                break
        await page.close()
    return received


def kinds(received: Received, kind: str) -> Received:
    return [message for message in received if message["type"] == kind]


FREEZE = "faults=[{at: 5.0, kind: freeze, agent: 2}]"
NOISE = ("limits.velocity=0.02", "swarm.sensor.noise=[0.001, 0.001]")
UNASKED = {"v": 2, "type": "steer", "token": "", "request": "r", "action": "kill", "agent": 1}


def whole(received: Received) -> Received:
    """Return the frames with all of a step: the view joins within one, and until all has come there is a part."""
    return [f for f in kinds(received, "frame") if None not in (f["values"][3], f["values"][6])]


def seen_enough(received: Received) -> bool:
    complete = whole(received)
    return (
        len(complete) > 10
        and complete[-1]["step"] > 520
        and "DEAD" in event_kinds(received)
        and bool(kinds(received, "curves") and kinds(received, "health"))
    )


def event_kinds(received: Received) -> set[str]:
    return {event["kind"] for message in kinds(received, "events") for event in message["events"]}


def steps_of(folder: Path) -> int:
    """Return the latest step of a run, 0 before the first."""
    progress = read_progress(RunFolder(folder).logs)
    return 0 if progress is None else progress.step


def test_what_is_shown_of_a_run_is_what_is_recorded_and_it_does_not_need_its_view(folder: Path, mark: str) -> None:
    """Nor does it take orders that were not asked for."""
    overrides = (runs.FOREVER, FREEZE, *NOISE)
    words = [part for override in overrides for part in ("--set", override)]
    with runs.started_swarm("run", "-o", folder, "--view", *words) as command:
        received = asyncio.run(look(runs.view_address(command), seen_enough, UNASKED))
        assert seen_enough(received)
        (viewer,) = (
            process
            for process in map(psutil.Process, marked_processes(mark))
            if "swarmabs_view.sources" in process.cmdline()
        )
        viewer.send_signal(signal.SIGSTOP)
        seen = kinds(received, "frame")[-1]["step"]
        until(lambda: steps_of(folder) > seen + 500, "the run makes steps without its view")
        command.process.terminate()
        command.wait()
    assert runs.summary_of(folder)["status"] == "interrupted"
    verdict = runs.swarm("verify", folder)
    assert verdict.code == 0, verdict.out + verdict.err
    assert not kinds(received, "steering")
    assert not kinds(received, "answer")
    recorded, frames = load_arrays(folder), kinds(received, "frame")
    assert [frame["step"] for frame in frames] == sorted(frame["step"] for frame in frames)
    assert whole(received)
    for frame in frames:
        step = frame["step"]
        assert frame["values"][0] == recorded.angle[step]
        assert frame["values"][3] in (None, recorded.abstract.torque[step])
        assert frame["values"][6] in (None, recorded.desired.inertia[step])
        for shown, positions in zip(frame["robots"]["position"], recorded.agents.position.T, strict=True):
            # Best effort: of a robot the last state that came up to then, as a rule that of the step.
            assert shown is None or shown[0] in positions[: step + 1]
    for curves in kinds(received, "curves"):
        for time, value, sent in zip(curves["time"], curves["values"][0], curves["values"][3], strict=True):
            step = round(time * 100)
            assert (value, sent) == (recorded.angle[step], recorded.abstract.torque[step])
    processes = {one["name"] for health in kinds(received, "health") for one in health["processes"]}
    assert processes == {
        *("orchestrator", "launcher", "plane_sim", "abstraction_observer", "parent_controller", "recorder"),
        *(f"agent_00{number}" for number in range(1, 5)),
    }


def test_the_page_follows_a_run_into_its_bag(folder: Path) -> None:
    with runs.started_swarm("run", "-o", folder, "--set", runs.FOREVER) as run:
        runs.until_stepping(folder)
        with runs.started_swarm("view", "--live", folder) as view, opened_browser() as browser:
            page = browser.new_page()
            assert view.process.stdout is not None
            page.goto(view.process.stdout.readline().strip())
            state = page.locator("#state")
            expect(state).to_have_attribute("data-phase", "running", timeout=PATIENCE)
            expect(page.locator("#processes tbody tr")).to_have_count(10, timeout=PATIENCE)
            expect(page.locator("#playback")).to_be_hidden()
            expect(page.locator("#step_rate")).not_to_have_text("–")
            expect(page.locator("#following")).to_have_text("4 of 4")
            run.process.terminate()
            run.wait()
            expect(state).to_have_attribute("data-phase", "recorded", timeout=PATIENCE)
            expect(page.locator("#playback")).to_be_visible()
            last = len(load_arrays(folder).angle) - 1
            expect(page.locator("#step")).to_have_attribute("value", str(last))
            page.get_by_role("button", name="First step").click()
            expect(page.locator("#step")).to_have_attribute("value", "0")
            assert float(page.locator("#parent-0").get_attribute("value") or "nan") == 0.1
            view.process.terminate()
            assert view.wait().code == 0


def test_a_run_is_steered_from_the_page(folder: Path) -> None:
    absent = "faults=[{kind: join, at: null, agent: 4}]"
    words = ("--steer", "--rate", 1, "--view", "--set", runs.FOREVER, "--set", absent)
    with runs.started_swarm("run", "-o", folder, *words) as run:
        plain = runs.view_address(run)
        assert run.process.stderr is not None
        with_token = run.process.stderr.readline().removeprefix("view, to steer: ").strip()
        assert with_token.startswith(f"{plain}#steer=")
        runs.until_stepping(folder)
        with opened_browser() as browser:
            asked: list[str] = []
            page = browser.new_page()
            page.on("request", lambda request: asked.append(request.url))
            page.goto(with_token)
            done = page.locator("#steered")
            page.get_by_label("Reference offset, rad").fill("0.05")
            page.get_by_role("button", name="Set reference").click()
            expect(done).to_contain_text("reference 0.05: from step ", timeout=PATIENCE)
            expect(page.locator("#held-reference")).to_have_attribute("value", "0.05")
            expect(page.locator("#reference-0")).to_have_attribute("value", "0.05")
            page.get_by_label("Disturbance, N m").fill("99")
            page.get_by_role("button", name="Set disturbance").click()  # the browser itself refuses
            page.get_by_label("Disturbance, N m").fill("0.1")
            page.get_by_role("button", name="Set disturbance").click()
            expect(done).to_contain_text("disturbance 0.1: from step ")
            box = page.locator("#plane").bounding_box()
            assert box is not None
            across, down = box["x"] + 0.8 * box["width"], box["y"] + 0.5 * box["height"]
            page.mouse.move(across, down)
            page.mouse.down()
            page.mouse.move(across, down + 0.1 * box["height"], steps=3)
            page.mouse.up()
            expect(done).to_contain_text(re.compile(r"push \d\.\d: from step "))
            page.get_by_role("button", name="Pause").click()
            expect(page.locator("#state")).to_have_text(re.compile("paused: at step "), timeout=PATIENCE)
            page.get_by_role("button", name="Add").click()
            expect(done).to_contain_text("add robot 4: from step ")
            page.get_by_label("Robot", exact=True).select_option("robot 3")
            page.get_by_role("button", name="Kill").click()
            expect(done).to_contain_text("kill robot 3: from step ")
            listed = page.get_by_label("Robot", exact=True).locator("option")
            expect(listed).to_have_text(["robot 1", "robot 2", "robot 3: dead", "robot 4"])
            expect(page.get_by_label("Robot to add").locator("option")).to_be_disabled()
            expect(page.locator("#state")).to_have_text(re.compile("paused: at step "))  # it has taken some steps
            page.locator("#plane-panel").press(" ")
            expect(page.locator("#state")).to_have_text("running", timeout=PATIENCE)
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
            stranger.get_by_label("Token, as printed in the terminal of the run").fill("guessed")
            stranger.get_by_role("button", name="Use").click()
            expect(stranger.locator("#steered")).to_contain_text("The token is wrong", timeout=PATIENCE)
            expect(stranger.locator("#steer-controls")).to_be_hidden()
            run.process.terminate()
            run.wait()
    steered = {(event.kind, event.agent_id, event.detail, event.value) for event in runs.events(folder)}
    assert steered >= {(EventKind.STEERING, 0, "reference", 0.05), (EventKind.STEERING, 0, "disturbance", 0.1)}
    torques = [event.value for event in runs.events(folder) if event.detail == "disturbance"]
    assert (len(torques), torques[0], torques[2]) == (3, 0.1, 0.1)
    assert torques[1] > 0.1, "the right side was pulled down"
    ended = {(kind, agent) for kind, agent, _, _ in steered if agent}
    assert ended >= {(EventKind.JOINED, 4), (EventKind.DEAD, 3)}
    assert not any(agent in {1, 2} and kind == EventKind.DEAD for kind, agent in ended)
    verdict = runs.swarm("verify", folder)
    assert verdict.code == 0, verdict.out + verdict.err


def test_a_demo_opens_a_page_that_can_steer_and_leaves_nothing_behind(folder: Path, tmp_path: Path) -> None:
    """The browser is a script that keeps what it is told to open: a file with the secret, which is then removed."""
    browser, opened, told = (tmp_path / name for name in ("browser", "opened", "told"))
    browser.write_text(f'#!/bin/sh\necho "$1" > "{told}"\ncp "${{1#file://}}" "{opened}"\n')
    browser.chmod(0o755)
    environment = {**os.environ, "BROWSER": f"{browser} %s"}
    with runs.started_swarm("demo", "20", "-o", folder, env=environment) as command:
        runs.until_stepping(folder)
        until(opened.exists, "the browser has been started")
        page = Path(told.read_text().strip().removeprefix("file://"))
        assert page.stat().st_mode & 0o077 == 0
        address = html.unescape(opened.read_text()).partition("url=")[2].partition('"')[0]
        url, hash_, token = address.partition("#steer=")
        assert hash_ and token and token not in told.read_text()
        assert b"<html" in urllib.request.urlopen(url).read()
        with SteeringClient(folder) as client:
            assert client.ask({"action": "status"})["members"] == [*range(1, 21)]
        os.kill(command.process.pid, signal.SIGINT)
        done = command.wait()
    assert (done.code, page.exists(), page.parent.exists()) == (0, False, False)
    assert "error:" not in done.err
    assert runs.summary_of(folder)["status"] == "interrupted"
    assert load_arrays(folder).agents.ids.tolist() == [*range(1, 21)]


def test_a_demo_starts_again_beside_the_curve_on_the_same_page(folder: Path) -> None:
    following = folder.with_name(f"{folder.name}-2")
    with runs.started_swarm("demo", "--no-browser", "-o", folder) as command, opened_browser() as browser:
        runs.view_address(command)
        assert command.process.stderr is not None
        page = browser.new_page()
        page.goto(command.process.stderr.readline().removeprefix("view, to steer: ").strip())
        page.get_by_role("button", name="Start beside the curve").click(timeout=PATIENCE)
        expect(page.locator("#state")).to_have_text("paused: at step 0", timeout=PATIENCE)
        expect(page.locator("#place")).to_have_text(str(following))
        assert runs.summary_of(folder)["reason"] == "ended to start again"
        page.get_by_role("button", name="Resume").click()
        expect(page.locator("#state")).to_have_text("running", timeout=PATIENCE)
        runs.until_stepping(following)
        os.kill(command.process.pid, signal.SIGINT)
        assert command.wait().code == 0
    for bag in (folder, following):
        verdict = runs.swarm("verify", bag)
        assert verdict.code == 0, verdict.out + verdict.err
    usual, beside = (load_arrays(bag).abstract.inertia[0] for bag in (folder, following))
    assert beside > 5.0 * usual
