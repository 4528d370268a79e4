"""Bags, servers of them as real processes, and a real browser."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import pytest
from playwright.sync_api import Browser, Page, WebSocketRoute, expect, sync_playwright
from tests.swarmabs_analysis.figures.conftest import record

from swarmabs_bag.shown.swarm_state import Instant, RobotIdentity, RobotStatus, ShownRobot
from swarmabs_core.messages import Kind
from swarmabs_core.systems import PLANE_TABLES
from swarmabs_view.presenter import Presenter
from swarmabs_view.protocol import Curves, Frame, Hello, Message, RobotInfo, State

PRESENTER = Presenter(PLANE_TABLES)

HELLO = Hello(
    source="swarm",
    title="sample",
    place="here",
    period=None,
    last_step=None,
    system=PRESENTER.system,
    robots=[],
    plane=None,
    manifold=None,
    regions=None,
    playback=False,
)
MessageT = TypeVar("MessageT", bound=Message)
NUMBERS = {
    "angle": "parent-0",
    "angular_velocity": "parent-1",
    "reference": "reference-0",
    "error": "error-0",
    "torque": "abstract-0",
    "inertia": "abstract-1",
    "desired_torque": "desired-0",
    "desired_inertia": "desired-1",
}
"""Where the page has the numbers of the plane."""
COMMAND = (sys.executable, "-m", "swarmabs_cli", "view")
CHANGES = ("duration=4.0", "faults=[{at: 1.0, kind: kill, agent: 1}, {at: 2.0, kind: leave, agent: 2}]")


def told(said: Iterable[Message], kind: type[MessageT]) -> list[MessageT]:
    """Return the messages of a kind."""
    return [message for message in said if isinstance(message, kind)]


def robot_info(robot: int, kind: str = "single_integrator", mass: float | None = 0.1) -> RobotInfo:
    """Return a robot on the plane, of unknown damping."""
    return RobotInfo(id=robot, kind=kind, constants=[mass, None])


def frame_of(
    step: int,
    angle: float,
    robots: Sequence[tuple[float, RobotStatus]],
    *,
    reference: float = 0.0,
    abstract: tuple[float, float] = (0.0, 0.1),
    step_rate: float = 1.0,
) -> Frame:
    """Return a frame with robots at rest on the plane: their positions with status."""
    instant = Instant(step, step * 10_000_000, step / 100, (angle, 0.0), (reference,), abstract, abstract)
    shown = [ShownRobot((place,), (0.0,), (0.0,), status) for place, status in robots]
    identities = [RobotIdentity(n + 1, Kind.SINGLE_INTEGRATOR, ()) for n in range(len(shown))]
    return PRESENTER.frame(instant, shown, identities, step_rate)


class Served(NamedTuple):
    """A view that is served by a process."""

    url: str
    run: Path
    process: subprocess.Popen[str]

    @property
    def port(self) -> int:
        return int(self.url.rstrip("/").rpartition(":")[2])


@contextmanager
def serving(run: Path, port: int = 0) -> Iterator[Served]:
    """Serve a bag, as a user would, until the end of the block."""
    with subprocess.Popen(
        [*COMMAND, str(run), "--port", str(port)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().strip()
            assert url.startswith("http://127.0.0.1:"), f"no address but {url!r}"
            yield Served(url, run, process)
        finally:
            process.kill()


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a short run in which robots die and leave; not to be changed."""
    return record(tmp_path_factory.mktemp("view") / "run", "pd_het_4", *CHANGES)


@pytest.fixture(scope="session")
def served(run: Path) -> Iterator[Served]:
    """Serve that run."""
    with serving(run) as view:
        yield view


def chromium() -> str:
    """Return the browser's program; skip, and say so, where there is none."""
    for name in ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"):
        found = shutil.which(name)
        if found:
            return found
    pytest.skip("no Chromium on this machine: apt-get install chromium")


def browser_arguments() -> list[str]:
    """Return what Chromium needs here: root has no sandbox."""
    return ["--no-sandbox"] if os.geteuid() == 0 else []


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    program = chromium()
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=program, args=browser_arguments())
        yield found
        found.close()


@pytest.fixture
def faults() -> list[str]:
    return []


@pytest.fixture
def page(browser: Browser, faults: list[str]) -> Iterator[Page]:
    """Yield an empty page; a test in which the page complains of anything fails."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    made = context.new_page()
    made.on("pageerror", lambda error: faults.append(str(error)))
    made.on("console", lambda said: faults.append(said.text) if said.type in {"error", "warning"} else None)
    made.on("request", lambda asked: faults.append(asked.url) if "//127.0.0.1:" not in asked.url else None)
    yield made
    context.close()
    assert not faults


def load(page: Page, served: Served) -> None:
    page.goto(served.url)
    expect(page.locator("#step")).to_have_attribute("value", "0")


def number(page: Page, name: str) -> float:
    """Return the number that the page shows, as exact as it has it."""
    return float(page.locator(f"#{NUMBERS.get(name, name)}").get_attribute("value") or "nan")


def seek(page: Page, step: int) -> None:
    """Put the slider somewhere, as a hand would."""
    page.locator("#scrub").evaluate(
        "(slider, step) => { slider.value = step; slider.dispatchEvent(new Event('input')); }", step
    )
    expect(page.locator("#step")).to_have_attribute("value", str(step))


class PageServer:
    """What the page, whose files come from a real server, takes for the server's connection.

    A test says what comes, and sees what the page says.
    """

    def __init__(self, page: Page, url: str) -> None:
        self.refusing = 0
        self._page, self._url = page, url
        self.first: tuple[Message, ...] = ()
        self._sockets: list[WebSocketRoute] = []
        self._heard: list[dict[str, Any]] = []
        # It says nothing by itself, for longer than a real server may: the page shall not wait for it.
        page.add_init_script("window.setInterval = () => 0;")
        page.route_web_socket(re.compile("/socket$"), self._connect)

    def open(self, *messages: Message, hash_: str = "") -> None:
        """Have the page opened; each connection begins with two robots of a run, and with these messages."""
        robots = [robot_info(n, mass=0.1 * n) for n in (1, 2)]
        hello = HELLO.model_copy(update={"source": "run", "period": 0.01, "robots": robots})
        frame = frame_of(3, 0.1, [(0.1, "active"), (-0.1, "dead")], step_rate=100.0)
        self.first = (hello, *messages, frame, State(phase="running", text=""))
        self._page.goto(self._url + hash_)
        expect(self._page.locator("#step")).to_have_attribute("value", "3")

    def _connect(self, socket: WebSocketRoute) -> None:
        if self.refusing:
            socket.close(code=self.refusing)
            return
        self._sockets.append(socket)
        socket.on_message(lambda text: self._heard.append(json.loads(text)))
        for message in self.first:
            socket.send(message.model_dump_json())

    def send(self, message: Message) -> None:
        self._sockets[-1].send(message.model_dump_json())

    def close(self, code: int = 1011) -> None:
        self._sockets[-1].close(code=code)

    def heard(self, kind: str) -> list[dict[str, Any]]:
        """Return what the page has said of a kind."""
        return [message for message in self._heard if message["type"] == kind]


@pytest.fixture
def page_server(page: Page, served: Served) -> PageServer:
    """Return a server of which a test says what it sends."""
    return PageServer(page, served.url)


def curves(first: int, last: int, scale: float = 1.0) -> Curves:
    """Return points of the curves, one each 0.1 s."""
    steps = range(first, last)
    values = [scale * (0.5 - step % 7) for step in steps]
    zeros = [0.0 for _ in steps]
    rows = [values, zeros, zeros, values, values, zeros, zeros]  # of the state, reference, abstract and desired
    return Curves(replace=first == 0, time=[step * 0.1 for step in steps], values=rows)
