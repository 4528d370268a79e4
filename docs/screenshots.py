"""Take the screenshots of the view and of a report in docs/images with a browser: python docs/screenshots.py [FOLDER].

It records and serves runs like a user, the example `payload` among them, and needs Chromium and the packages of the
tests.
"""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image
from playwright.sync_api import sync_playwright

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser, Page

IMAGES = Path(__file__).parent / "images"
EXAMPLE = Path(__file__).parents[1] / "examples" / "payload"
SWARM = (sys.executable, "-m", "swarmabs_cli")
FAULTS = "faults=[{at: 0.6, kind: kill, agent: 2}, {at: 3, until: 5, kind: disturbance, torque: 0.1}]"
LIVE = "100000"
"""Duration of the live run, s; it is stopped earlier."""


@contextmanager
def page_of(folder: Path, *arguments: str, said: str = "") -> Iterator[str]:
    """Start a command that serves a page, in a folder, and yield the address of the page, printed after `said`."""
    words = [*SWARM, *arguments]
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            lines = iter(process.stdout or ())
            yield next(line for line in lines if line.startswith(f"{said}http://")).removeprefix(said).strip()
        finally:
            process.terminate()
            for _ in lines:
                pass


def opened(browser: Browser, url: str, size: tuple[int, int], scheme: str) -> Page:
    """Return the page in a window with a size and a colour scheme."""
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]}, color_scheme="dark" if scheme == "dark" else "light"
    )
    page = context.new_page()
    page.goto(url)
    page.wait_for_selector("#step[value]:not([value=''])", timeout=60_000)
    return page


def seek(page: Page, step: int) -> None:
    """Show a step of a bag."""
    page.locator("#scrub").evaluate("(s, step) => { s.value = step; s.dispatchEvent(new Event('input')); }", step)
    page.wait_for_selector(f"#step[value='{step}']", state="attached")
    page.wait_for_timeout(500)


def keep(page: Page, file: Path, *, whole: bool = False) -> None:
    """Save the visible part of the page, or all of it, and close it."""
    Image.open(io.BytesIO(page.screenshot(full_page=whole))).convert("RGB").save(file, lossless=True, method=6)
    page.context.close()


def own_system(browser: Browser, runs: Path, folder: Path) -> None:
    """Write the view of a parent system of a package, the example `payload`."""
    shutil.copytree(EXAMPLE, runs / "payload")  # pip leaves files there
    target = str(runs / "packages")
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--target", target]
    subprocess.run([*install, "./payload"], cwd=runs, check=True)
    os.environ["PYTHONPATH"] = os.pathsep.join([*filter(None, [os.environ.get("PYTHONPATH")]), target])
    simulate = [*SWARM, "simulate", str(EXAMPLE / "payload.yaml"), "-o", "flown"]
    subprocess.run(simulate, cwd=runs, check=True, capture_output=True)
    with page_of(runs, "view", "flown") as url:
        page = opened(browser, url, (1280, 720), "light")
        seek(page, 1100)
        keep(page, folder / "view_payload.webp")


def report(browser: Browser, runs: Path, file: Path) -> None:
    """Write the first part of the report of a run that is disturbed and loses a robot."""
    faults = "faults=[{at: 8, kind: kill, agent: 2}, {at: 15, until: 20, kind: disturbance, torque: 0.05}]"
    for words in (("simulate", "pd_het_4", "--set", faults, "-o", "reported"), ("report", "reported")):
        subprocess.run([*SWARM, *words], cwd=runs, check=True, capture_output=True)
    page = browser.new_page(viewport={"width": 1180, "height": 1500}, color_scheme="light")
    page.goto((runs / "reported" / "report.html").as_uri())
    page.screenshot(path=file)
    page.close()


def main() -> int:
    """Take all screenshots."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        sys.stderr.write("Chromium is not installed: run apt-get install chromium\n")
        return 1
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory() as runs, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=sandbox)
        here = Path(runs)
        report(browser, here, folder / "report.png")
        made = [*SWARM, "simulate", "pd_het_4", "--duration", "10", "--set", FAULTS]
        subprocess.run(made, cwd=here, check=True, capture_output=True)
        with page_of(here, "view", "runs/pd_het_4-001") as url:
            page = opened(browser, url, (1280, 960), "light")
            seek(page, 40)
            keep(page, folder / "view.webp")
            page = opened(browser, url, (1280, 960), "dark")
            seek(page, 120)
            page.keyboard.press("z")
            page.wait_for_timeout(300)
            keep(page, folder / "view_dark.webp")
            page = opened(browser, url, (390, 844), "light")
            seek(page, 40)
            keep(page, folder / "view_phone.webp")
            page = opened(browser, url, (1280, 720), "light")
            page.keyboard.press("p")
            seek(page, 420)
            keep(page, folder / "view_presenter.webp")
        own_system(browser, here, folder)
        with page_of(here, "run", "arise_het_20", "--duration", LIVE, "--view", said="view: ") as url:
            page = opened(browser, url, (1280, 900), "light")
            page.wait_for_selector("#processes tbody tr", timeout=60_000)
            page.wait_for_timeout(12_000)
            page.get_by_text("20 of 20").wait_for(timeout=60_000)  # when the view has read the beginning
            keep(page, folder / "view_live.webp", whole=True)
        steered = ("run", "pd_het_4", "--duration", LIVE, "--view", "--steer", "--rate", "1")
        with page_of(here, *steered, said="view, to steer: ") as url:
            page = opened(browser, url, (1280, 960), "light")
            page.get_by_label("Reference offset, rad").fill("0.05")
            page.get_by_role("button", name="Set reference").click()
            page.get_by_text("reference 0.05: from step").wait_for()
            page.wait_for_timeout(4000)
            page.get_by_label("Robot", exact=True).select_option("robot 2")
            page.get_by_role("button", name="Kill").click()
            page.get_by_text("kill robot 2: from step").wait_for()
            page.wait_for_timeout(2000)
            keep(page, folder / "view_steering.webp")
        browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
