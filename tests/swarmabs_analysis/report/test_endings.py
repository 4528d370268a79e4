"""Bags of runs that end early, of large swarms and of imperfect worlds have a report; what is no bag has none."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_analysis.report.conftest import Page, messages, write

from swarmabs_analysis.report import make_report
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.messages import AgentState, PlaneState, SwarmEvent
from swarmabs_run.simulated_run import simulate_run

pytestmark = pytest.mark.timeout(60)


def texts(page: Page) -> str:
    return " ".join(text for _, text in page.texts)


def test_failed_run(tmp_path: Path) -> None:
    scenario = find_scenario("arise_si_4", ["duration=1.0", "plane.angle=1.4", "plane.angular_velocity=3.0"])
    outcome = simulate_run(scenario.resolved(), new_run_folder(tmp_path / "run"))
    assert outcome.status == "failed" and outcome.reason
    report = make_report(tmp_path / "run")
    assert (report.numbers["status"], report.numbers["reason"]) == ("failed", outcome.reason)
    page = Page(report.html)
    assert ("span", "failed") in page.texts
    assert any(outcome.reason in text for _, text in page.texts)
    assert page.rows["RMS error"][1] == pytest.approx(float(outcome.figures["rms_error"] or 0.0), abs=0)


def test_bag_without_its_end(tmp_path: Path) -> None:
    file = write(tmp_path / "bag", messages(40)) / "bag_0.mcap"
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    report = make_report(file)
    assert report.numbers["status"] == "damaged"
    assert "the bag has lost its end" in str(report.numbers["reason"])
    assert 0 < report.numbers["steps"] <= 40
    Page(report.html)


def test_bag_without_its_end_and_a_topic(tmp_path: Path) -> None:
    """Nothing of a topic came before the end was lost."""
    file = write(tmp_path / "bag", [m for m in messages(40) if not isinstance(m, AgentState)]) / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-200])
    report = make_report(file)
    assert (report.numbers["status"], report.numbers["agents"], report.numbers["steps"]) == ("damaged", 0, 40)


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_or_one_step_recorded(tmp_path: Path, count: int) -> None:
    write(tmp_path / "bag", messages(0)[: 7 * count], aborted="interrupted")
    report = make_report(tmp_path / "bag")
    assert report.numbers["status"] == "interrupted"
    assert report.numbers["steps"] == 0
    assert "nothing to draw" in texts(Page(report.html))
    assert "<svg" not in report.html
    assert report.png.startswith(b"\x89PNG")


def test_numbers_that_no_picture_can_show(tmp_path: Path) -> None:
    def broken(message: object) -> object:
        if isinstance(message, PlaneState) and message.step == 3:
            return message._replace(angle=math.inf)
        if isinstance(message, AgentState) and message.step > 5:
            return message._replace(position=-1e300, velocity=math.nan)
        return message

    run = [broken(message) for message in messages(40)]
    report = make_report(write(tmp_path / "bag", run))  # type: ignore[arg-type]
    Page(report.html)
    assert report.numbers["rms_error"] is None


def test_two_hundred_robots(tmp_path: Path) -> None:
    record(tmp_path / "run", "arise_het_200", "duration=0.5")
    report = make_report(tmp_path / "run")
    page = Page(report.html)
    assert len(report.html) < 600_000
    assert "Where the mass of the robots is" in page.labels()
    assert "positions of 200 robots" in page.labels()["Positions of the robots"]
    assert any(tag == "image" for tag, _ in page.tags)


def test_imperfect_world_says_what_is_shown(tmp_path: Path) -> None:
    settings = ("observer.type=parent_response", "plane.sensor.noise=[0.001, 0.001]", "swarm.sensor.noise=[0.001, 0]")
    record(tmp_path / "run", "pd_het_4", *settings)
    page = Page(make_report(tmp_path / "run").html)
    found = texts(page)
    assert "what the plane's sensor says" in found
    assert "the true states; each robot's own law used what its sensor said" in found
    assert "from the robots' states: from" in page.labels()["Torque τ of the swarm, desired and actual"]


def test_many_events_share_rows(tmp_path: Path) -> None:
    limits = [SwarmEvent(step * 10_000_000, step, 1 + step % 2, 7, step / 8, "limited") for step in range(41)]
    more = [SwarmEvent(0, 0, 7, 6, float(step), "loss") for step in range(40)]
    page = Page(make_report(write(tmp_path / "bag", [*messages(40), *limits, *more])).html)
    cells = [text for tag, text in page.texts if tag in {"td", "th"}]
    at = [place for place, text in enumerate(cells) if text == "limit hit"]
    assert [cells[place + 1 : place + 6] for place in at] == [
        ["1", "21", "0 s", "0.4 s", "0 to 5"],
        ["2", "20", "0.01 s", "0.39 s", "0.125 to 4.875"],
        ["7", "1", "0.03 s", "0.03 s", "0.3333"],
    ]


def test_refused_bags(tmp_path: Path) -> None:
    with pytest.raises(NotABagError, match="holds no bag"):
        make_report(tmp_path)
    strange = [m._replace(kind=9) if isinstance(m, AgentState) and m.step == 4 else m for m in messages(40)]
    with pytest.raises(DamagedBagError, match="agent 1 at step 4: 9 is no kind of robot"):
        make_report(write(tmp_path / "strange", strange))
    file = write(tmp_path / "flipped", messages(40)) / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 0xFF
    file.write_bytes(content)
    with pytest.raises(DamagedBagError, match="can be read"):
        make_report(file)


def test_who_lies_is_named_where_positions_are_shown(tmp_path: Path) -> None:
    lie = "faults=[{kind: lie, agent: 2, position_offset: 0.1}]"
    report = make_report(record(tmp_path / "run", "pd_het_4", lie))
    assert report.html.count("Robot 2 lies by an injected fault: positions and masses are the published ones") == 3
    honest = make_report(record(tmp_path / "honest", "pd_het_4"))
    assert "injected fault: positions" not in honest.html
