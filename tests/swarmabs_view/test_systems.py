"""What pages and terminal show of parent systems other than the plane, from messages to drawings."""

import json
import re
from collections.abc import Iterator, Sequence
from io import StringIO
from itertools import count
from math import cos, nan, sin
from pathlib import Path
from typing import Any

import pytest
import rclpy
from playwright.sync_api import Page, expect
from rich.console import Console
from tests.processes import until
from tests.swarmabs_bag.test_systems import LIFT, SHEET, bag_of, simulated
from tests.swarmabs_view.conftest import HELLO, PageServer, number, told

from swarmabs_bag.recorder.swarm_summary import SwarmSummary
from swarmabs_bag.shown.swarm_state import Instant, RobotIdentity, ShownRobot, SwarmState
from swarmabs_cli import main as swarm_command
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.cdr import encode
from swarmabs_core.messages import (
    SYSTEM,
    SYSTEM_FAMILY,
    TOPIC_OF,
    EventKind,
    Kind,
    Message,
    Mode,
    ParentState,
    RobotState,
    Status,
    SwarmAbstract,
    SwarmDesired,
    SwarmEvent,
    SystemDescription,
)
from swarmabs_core.systems.interface import SYSTEMS, NamedSystem, SystemTables
from swarmabs_core.systems.kinds import KINDS, RobotKind
from swarmabs_ros.endpoints import advertise
from swarmabs_ros.start import SwarmNode, initialise
from swarmabs_run.run import Progress
from swarmabs_view import protocol
from swarmabs_view.listener import Listener
from swarmabs_view.live import LiveSession, LiveView
from swarmabs_view.playback import PlaybackSession, open_recording
from swarmabs_view.presenter import BANDS, Presenter
from swarmabs_view.terminal import RunPanel, describe

PERIOD = 10_000_000
SIZES = {"beam": (2, 2, 1, 3), "sheet": (4, 5, 2, 2), "lift": (4, 2, 1, 3)}
"""Numbers in the state of the parent, rows, coordinates and constants."""


def numbers(count: int, seed: float) -> tuple[float, ...]:
    """Return different numbers."""
    return tuple(seed + n / 7 for n in range(count))


def step_of(name: str, step: int, robots: int = 3) -> Iterator[Message]:
    """Return the messages of a step, whose numbers are all different."""
    n, k, d, c = SIZES[name]
    head = (step * PERIOD, step, NamedSystem(name).hash)
    for robot in range(1, robots + 1):
        status = Status.LIMITED if robot == 2 else Status.ACTIVE
        place, moves = numbers(d, 0.1 * robot + step), numbers(d, 0.2 * robot)
        yield RobotState(
            *head, step, robot, Kind.FIRST_ORDER_LAG, status, place, moves, numbers(d, 0.3), numbers(c, robot)
        )
    yield ParentState(*head, numbers(n, 0.01 * step))
    yield SwarmAbstract(*head, robots, numbers(k, step), numbers(k, 0.5))
    yield SwarmDesired(*head, Mode.RUN, numbers(k, step + 0.5), *(numbers(k, 0.6) for _ in range(4)))


def heard(name: str, steps: int, robots: int = 3) -> list[Message]:
    """Return what is heard of a run: its description, and some steps."""
    named = NamedSystem(name)
    described = SystemDescription(0, 0, named.hash, named.description)
    return [described, *(message for step in range(steps + 1) for message in step_of(name, step, robots))]


def view_of(messages: list[Message]) -> LiveView:
    view = LiveView(HELLO, SwarmState())
    for message in messages:
        view.add(message)
    view.refresh(0.0)
    return view


def first_messages(view: LiveView) -> list[protocol.Message]:
    return LiveSession(view).poll(0.0)


@pytest.mark.usefixtures("systems")
@pytest.mark.parametrize("name", list(SIZES))
def test_a_page_gets_names_with_units_once_and_numbers_in_their_order(name: str) -> None:
    n, k, d, c = SIZES[name]
    said = first_messages(view_of(heard(name, 20)))
    kinds = [type(message).__name__ for message in said]
    assert kinds == ["Hello", "Curves", "Positions", "Events", "Frame", "State"]
    (hello,) = told(said, protocol.Hello)
    system = hello.system
    assert [(robot.id, robot.kind) for robot in hello.robots] == [(robot, "first_order_lag") for robot in (1, 2, 3)]
    tables = json.loads(NamedSystem(name).description)
    assert system.name == name
    followed = [one for t in tables["tracked"] for one in tables["parent"] if one["name"] == t["name"]]
    roles = {"parent": tables["parent"], "reference": followed, "abstract": tables["abstract"]}
    roles["desired"] = tables["abstract"]
    rows = [(role, one["name"], one["unit"], one["scale"]) for role, found in roles.items() for one in found]
    assert [(row.role, row.name, row.unit, row.scale) for row in system.rows[: len(rows)]] == rows
    others = [("robot", one) for one in tables["robot"]] + [("constant", one) for one in tables["constants"]]
    further = [(role, one["name"], one["unit"]) for role, one in others]
    assert [(row.role, row.name, row.unit) for row in system.rows[len(rows) :]] == further
    assert [robot.constants for robot in hello.robots] == [list(numbers(c, robot)) for robot in (1, 2, 3)]
    (frame,) = told(said, protocol.Frame)
    unknown = [None] * len(followed)  # whoever only hears a swarm does not know its reference
    assert frame.values == [*numbers(n, 0.2), *unknown, *numbers(k, 20), *numbers(k, 20.5)]
    assert frame.robots.coordinates == [list(numbers(d, 0.1 * robot + 20)) for robot in (1, 2, 3)]
    assert frame.robots.status == ["active", "limited", "active"]
    (curves,) = told(said, protocol.Curves)
    assert (len(curves.values), curves.time) == (len(rows), [step / 100 for step in range(21)])
    assert [line[7] for line in curves.values] == [*numbers(n, 0.07), *unknown, *numbers(k, 7), *numbers(k, 7.5)]
    (positions,) = told(said, protocol.Positions)
    assert positions.labels == ["robot 1", "robot 2", "robot 3"]
    lines = [[numbers(d, 0.1 * robot + step)[axis] for step in range(21)] for axis in range(d) for robot in (1, 2, 3)]
    assert positions.lines == lines


@pytest.mark.usefixtures("systems")
def test_kinds_of_robots_have_words_a_symbol_and_the_units_of_their_commands() -> None:
    presenter = Presenter(SystemTables.read(NamedSystem("sheet").description))
    assert [(kind.name, kind.words, kind.legend, kind.shape) for kind in presenter.system.kinds] == [
        ("single_integrator", "velocity (SI)", "velocity-driven (SI)", "circle"),
        ("double_integrator", "force (DI)", "force-driven (DI)", "square"),
        ("first_order_lag", "lag", "with lag", "diamond"),
    ]
    assert [kind.commands for kind in presenter.system.kinds] == [["m/s"] * 2, ["N"] * 2, ["m"] * 2]


@pytest.mark.usefixtures("systems")
def test_a_kind_of_robot_has_a_unit_for_each_number_of_its_command_on_systems_that_it_fits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Steered(RobotKind):
        coordinates = ("m", "m")

        def command_units(self, units: Sequence[str]) -> tuple[str, ...]:
            along, _ = units
            return f"{along}/s", "rad/s"

    monkeypatch.setitem(KINDS, Kind.FIRST_ORDER_LAG, Steered())
    units = {name: Presenter(SystemTables.read(NamedSystem(name).description)).system.kinds for name in SIZES}
    assert {name: kinds[2].commands for name, kinds in units.items()} == {
        "beam": [],
        "sheet": ["m/s", "rad/s"],
        "lift": [],
    }


def test_the_page_speaks_of_no_plane_before_it_knows_the_parent() -> None:
    text = (Path(protocol.__file__).parent / "static" / "index.html").read_text(encoding="utf-8")
    shown = re.sub(r"<[^>]*>", " ", re.sub(r"<li [^>]*hidden>.*?</li>", "", text))
    assert "plane" not in " ".join([shown, *re.findall(r'aria-label="([^"]*)"', text)]).lower()


@pytest.mark.usefixtures("systems")
def test_bands_of_many_robots_are_those_of_each_coordinate() -> None:
    (positions,) = told(first_messages(view_of(heard("sheet", 2, robots=30))), protocol.Positions)
    assert (positions.bands, positions.labels) == (True, list(BANDS))
    ends = [positions.lines[row][-1] for row in (0, 6, 14, 20)]
    assert ends == pytest.approx([2.1, 5.0, 2.1 + 1 / 7, 5.0 + 1 / 7])


def test_a_system_draws_itself_and_others_are_drawn_at_their_coordinates(systems: Any) -> None:
    frame = told(first_messages(view_of(heard("beam", 5))), protocol.Frame)[0]
    angle = 0.05
    places = [0.1 * robot + 5 for robot in (1, 2, 3)]
    assert frame.robots.position == [pytest.approx([p * cos(angle), p * sin(angle), angle]) for p in places]
    ends = [1.5 * cos(angle), 1.5 * sin(angle)]
    assert frame.outline == [[pytest.approx([-ends[0], -ends[1]]), pytest.approx(ends)]]
    (hello,) = told(first_messages(view_of(heard("beam", 5))), protocol.Hello)
    assert hello.system.placed
    assert [robot.body[0][2] for robot in hello.robots] == [
        pytest.approx([0.03, 0.02 + 0.01 * robot]) for robot in (1, 2, 3)
    ]
    frame = told(first_messages(view_of(heard("sheet", 5))), protocol.Frame)[0]
    assert frame.outline == []
    assert frame.robots.position == frame.robots.coordinates
    messages = heard("beam", 5)
    (systems / "systems_of_tests-1.5.dist-info" / "entry_points.txt").unlink()
    SYSTEMS.forget()
    presented = first_messages(view_of(messages))
    frame, hello = told(presented, protocol.Frame)[0], told(presented, protocol.Hello)[0]
    assert (hello.system.placed, [robot.body for robot in hello.robots], frame.outline) == (False, [[], [], []], [])
    assert frame.robots.position == [[p] for p in places]


@pytest.mark.usefixtures("systems")
def test_robots_without_constants_are_placed_and_drawn_by_their_system_too() -> None:
    presenter = Presenter(SystemTables.read(NamedSystem("faulty", {"fault": "no_constants"}).description))
    robots = [RobotIdentity(1, Kind.SINGLE_INTEGRATOR, ())]
    (told_robot,) = presenter.robots(robots)
    assert told_robot.body == [[[0.0, 0.0], [0.1, 0.0]]]
    instant = Instant(0, 0, 0.0, (0.5, 0.0), (), (), ())
    frame = presenter.frame(instant, [ShownRobot((2.0,), (0.0,), (0.0,), "active")], robots, None)
    assert frame.robots.position == [pytest.approx([2.0 * cos(0.5), 2.0 * sin(0.5), 0.5])]


@pytest.mark.usefixtures("systems")
def test_what_is_unknown_is_not_drawn_and_a_foreign_description_changes_nothing() -> None:
    view = view_of(heard("beam", 0))
    system = NamedSystem("beam").hash
    lost = RobotState(PERIOD, 1, system, 0, 1, 3, Status.ACTIVE, (nan,), (0.0,), (0.0,), (0.1, 0.0, 0.1))
    view.add(lost)
    view.add(ParentState(PERIOD, 1, system, (nan, 0.0)))
    view.add(SwarmAbstract(PERIOD, 1, system, 3, (1.0, nan), (0.0, 0.0)))
    view.add(SwarmDesired(PERIOD, 1, system, Mode.RUN, (1.0, 2.0), *((0.0, 0.0) for _ in range(4))))
    frame = view.frame(0.0)
    assert frame is not None
    assert frame.values == [None, 0.0, None, 1.0, None, 1.0, 2.0]
    assert (frame.outline, frame.robots.position) == ([], [None, None, None])
    unnamed = [{"name": 7, "unit": "m", "scale": 1.0}]
    strange = (view_text(parent=[]), view_text(abstract=unnamed), view_text(tracked=[{"name": "x", "tolerance": 1.0}]))
    for text in ("", "[]", '{"name": 1}', *strange):
        foreign = view_of([SystemDescription(0, 0, 1, text), *step_of("beam", 0)])
        assert foreign.frame(0.0) is None, text
        assert foreign.hello().system.name == "plane", text


def view_text(**changes: Any) -> str:
    """Return the description of a beam with other tables."""
    return json.dumps({**json.loads(NamedSystem("beam").description), **changes})


@pytest.mark.usefixtures("systems")
def test_who_joins_and_dies_is_told_with_its_constants() -> None:
    view = view_of(heard("beam", 3, robots=2))
    session = LiveSession(view)
    session.poll(0.0)
    dead = SwarmEvent(4 * PERIOD, 4, 1, EventKind.DEAD, 0.1, "kill")
    for message in (dead, *step_of("beam", 4, robots=3)):
        view.add(message)
    said = session.poll(0.1)
    assert [len(robot.constants) for robot in told(said, protocol.Hello)[0].robots] == [3, 3, 3]
    frame = told(said, protocol.Frame)[0]
    assert frame.robots.status == ["dead", "limited", "active"]
    assert (frame.robots.coordinates[0], frame.robots.velocities[0], frame.robots.command[0]) == ([0.1], [0.0], [])


@pytest.mark.usefixtures("systems")
def test_values_of_events_have_the_units_of_the_system_where_it_states_them() -> None:
    presenter = Presenter(SystemTables.read(NamedSystem("lift").description))
    cases = {
        "N": (EventKind.DEAD, 1, "kill"),
        "m": (EventKind.STEERING, 0, "reference"),
        "": (EventKind.STEERING, 0, "disturbance"),
        "command": (EventKind.LIMIT_HIT, 1, "command limited"),
    }
    for unit, (kind, robot, detail) in cases.items():
        assert presenter.event(SwarmEvent(0, 0, robot, kind, 0.5, detail), 0.0).unit == unit


def open_page(server: PageServer, name: str, robots: int = 3) -> list[protocol.Message]:
    """Have the page opened, and show it the plane first, then this system; return the messages on that."""
    said = first_messages(view_of(heard(name, 20, robots)))
    server.open()
    for message in said:
        server.send(message)
    return said


def values_of(page: Page, column: str) -> list[float]:
    """Return the numbers in a column of the table of robots."""
    cells = page.locator(f"#robots [data-field={column}]")
    return [float(value) for value in cells.evaluate_all("(cells) => cells.map((cell) => cell.value)")]


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("systems")
def test_the_page_shows_the_numbers_of_a_system_with_names_and_units(page: Page, page_server: PageServer) -> None:
    (frame,) = told(open_page(page_server, "sheet"), protocol.Frame)
    expect(page.locator("#plane-title")).to_have_text("Sheet and robots")
    expect(page.locator("#numbers dt")).to_have_count(22)
    shown = dict(zip(page.locator("#numbers dt").all_inner_texts(), page.locator("#numbers data").all(), strict=True))
    for label, value in {"al rate, rad/s": frame.values[2], "desired inertia xy, kg m²": frame.values[-1]}.items():
        assert float(shown[label].get_attribute("value") or "nan") == value
    assert shown["be reference, rad"].get_attribute("value") == shown["be error, rad"].get_attribute("value") == ""
    head = ["robot", "kind", "status", "x, m", "y, m", "rate of x, m/s", "rate of y, m/s"]
    head += ["command x, m", "command y, m", "mass, kg", "damping, N s/m"]
    expect(page.locator("#robots th[scope=col]")).to_have_text(head)
    expect(page.locator("#robots tbody tr").nth(1)).to_contain_text("limited")
    assert values_of(page, "coordinates-1") == [place[1] for place in frame.robots.coordinates]
    assert values_of(page, "command-0") == [command[0] for command in frame.robots.command]
    titles = ["al, rad", "be, rad", "tracking error, rad", "al rate, be rate, rad/s", "moment x, N m", "moment y, N m"]
    titles += ["inertia xx, kg m²", "inertia yy, kg m²", "inertia xy, kg m²", "x, m"]
    expect(page.locator(".u-title")).to_have_text(titles)
    page.get_by_label("Robots by").select_option("y, m")
    expect(page.locator(".u-title").last).to_have_text("y, m")
    legend = page.locator(".legend li").filter(visible=True)
    kinds = ["with lag", "limited", "safe stop", "dead", "silent", "area proportional to mass"]
    expect(legend).to_have_text([*kinds, "actual", "desired"])
    expect(page.locator("#zoom")).to_be_hidden()


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("systems")
def test_any_two_rows_make_the_picture_and_one_row_makes_none(page: Page, page_server: PageServer) -> None:
    open_page(page_server, "sheet")
    picture = page.locator("#abstract")
    expect(picture).to_have_attribute("aria-label", re.compile("moment x 20.00 N m, desired 20.50; moment y 20.14 N m"))
    page.get_by_label("Across").select_option("inertia xx")
    page.get_by_label("up", exact=True).select_option("inertia yy")
    said = re.compile("inertia xx 20.29 kg m.2, desired 20.79; inertia yy 20.43 kg m.2, desired 20.93")
    expect(picture).to_have_attribute("aria-label", said)
    said_of = view_of(heard("sheet", 20)).hello()
    one = [row for row in said_of.system.rows if row.role not in {"abstract", "desired"} or row.name == "moment_x"]
    other = said_of.system.model_copy(update={"name": "other", "rows": one})
    page_server.send(said_of.model_copy(update={"system": other}))
    expect(picture).to_be_hidden()
    expect(page.locator("#chart-4")).to_have_attribute("aria-label", "moment x, N m over time")


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("systems")
@pytest.mark.parametrize("name", ["beam", "sheet", "lift"])
def test_robots_are_where_the_system_draws_them_and_the_plane_comes_back(
    page: Page, page_server: PageServer, name: str, faults: list[str]
) -> None:
    open_page(page_server, name)
    expect(page.locator("#plane-title")).to_have_text(f"{name.capitalize()} and robots")
    expect(page.locator("#step")).to_have_attribute("value", "20")
    page.get_by_role("button", name="Fit to swarm").click()
    expect(page.locator("#fit")).to_have_text("Whole picture")
    for _ in range(2):
        page.evaluate("() => new Promise(requestAnimationFrame)")
    found: dict[str, list[float]] = page.locator("#plane").evaluate(POINTED)
    coordinate = "thrust" if name == "lift" else "x" if name == "sheet" else "position"
    assert {text.partition(",")[0] for text in found} == {"robot 1: active", "robot 2: limited", "robot 3: active"}
    places = [next(at for text, at in found.items() if text.startswith(f"robot {robot}")) for robot in (1, 2, 3)]
    assert all(f"{coordinate} 20." in text for text in found)
    assert places[0][0] < places[1][0] < places[2][0]  # as their first coordinates
    assert (places[0][1] < places[2][1]) is (name == "lift")  # in its own lane, or higher with a larger coordinate
    page_server.close()  # the page of the plane, once the connection is back
    expect(page.locator("#plane-title")).to_have_text("Plane and robots", timeout=10_000)
    expect(page.locator("#robots th[scope=col]")).to_have_text(PLANE_COLUMNS)
    expect(page.locator(".u-title").first).to_have_text("angle, rad")
    assert number(page, "angle") == 0.1
    assert not faults


POINTED = """
(canvas) => {
  const [found, pointed, box] = [{}, document.getElementById("pointed"), canvas.getBoundingClientRect()];
  for (let x = 0; x < box.width; x += 4) {
    for (let y = 0; y < box.height; y += 4) {
      canvas.dispatchEvent(new PointerEvent("pointermove", { clientX: box.x + x, clientY: box.y + y }));
      if (!pointed.hidden) {
        found[pointed.textContent] ??= [x, y];
      }
    }
  }
  return found;
}
"""
"""Returns what is told of robots to which the pointer is moved, with the first place of each."""
PLANE_COLUMNS = ["robot", "kind", "status", "position, m", "velocity, m/s", "command, m/s"]
PLANE_COLUMNS += ["mass, kg", "damping, N s/m"]


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("systems")
def test_the_page_of_a_bag_stays_what_it_was_while_it_connects_again(
    page: Page, page_server: PageServer, faults: list[str]
) -> None:
    hello, *said = open_page(page_server, "sheet")
    played = hello.model_copy(update={"source": "bag", "playback": True, "period": 0.01, "last_step": 40})
    for message in (played, *said):
        page_server.send(message)
    expect(page.locator("#plane-title")).to_have_text("Sheet and robots")
    page_server.first = (played,)  # what follows it is on its way
    page_server.close()
    expect(page.get_by_role("alert")).to_be_visible()
    expect(page.get_by_role("alert")).to_be_hidden(timeout=10_000)
    page.keyboard.press("t")  # all is drawn again
    for _ in range(2):
        page.evaluate("() => new Promise(requestAnimationFrame)")
    expect(page.locator("#plane-title")).to_have_text("Sheet and robots")
    expect(page.locator("#step")).to_have_attribute("value", "20")
    assert not faults


@pytest.fixture
def sheet(systems: Path, tmp_path: Path) -> Path:
    """Return the bag of a run on a sheet, in which a robot joins, one dies and one leaves."""
    del systems
    return bag_of(*simulated(SHEET), tmp_path / "bag")


def test_every_frame_of_a_bag_is_what_the_messages_say(sheet: Path) -> None:
    recording = open_recording(sheet)
    session = PlaybackSession(recording)
    said = session.poll(0.0)
    names = ["Hello", "Curves", "Positions", "Events", "Frame", "State"]
    assert [type(message).__name__ for message in said] == names
    (hello,) = told(said, protocol.Hello)
    assert [robot.constants for robot in hello.robots] == [[0.7, 0.0], [1.1, 0.0], [1.0, 0.0], [0.9, 0.0], [1.1, 0.2]]
    _, steps = simulated(SHEET)
    said_events = [m for one in steps for m in (r.message for r in one.records) if isinstance(m, SwarmEvent)]
    begins = {(m.agent_id, EventKind(m.kind).name): m.step for m in said_events}
    last: dict[int, Any] = {}
    for step, one in enumerate(steps):
        messages = {type(record.message): record.message for record in one.records}
        last |= {m.agent_id: m for m in (record.message for record in one.records) if isinstance(m, RobotState)}
        frame = recording.frame(recording.row_at(step))
        parent, abstract, desired = (messages[kind] for kind in (ParentState, SwarmAbstract, SwarmDesired))
        reference = [0.2 * sin(0.4 * step / 100), 0.2 * sin(0.25 * step / 100)]
        assert frame.values == pytest.approx([*parent.state, *reference, *abstract.value, *desired.value], abs=1e-15)
        assert frame.values[:4] == list(parent.state)
        status = ["active", "active", "dead" if step >= begins[4, "DEAD"] else "active"]
        status += ["left" if step >= begins[5, "LEFT"] else "active", "active" if step >= begins[7, "JOINED"] else None]
        assert frame.robots.status == status
        for place, robot in enumerate((1, 3, 4, 5, 7)):
            there = status[place] not in {None, "left"}
            assert frame.robots.coordinates[place] == (list(last[robot].coordinates) if there else [])
            assert frame.robots.position[place] == (list(last[robot].coordinates) if there else None)
    (curves,) = told(said, protocol.Curves)
    assert [len(line) for line in curves.values] == [41] * 16
    (positions,) = told(said, protocol.Positions)
    assert [len(positions.labels), len(positions.lines)] == [5, 10]
    assert positions.lines[4][:10] == [None] * 10
    assert positions.lines[8][35] is None  # robot 5 has left, also along y
    events = told(said, protocol.Events)[0].events
    assert [(event.agent, event.kind) for event in events if event.kind in {"JOINED", "DEAD", "LEFT"}] == [
        *((7, "JOINED"), (4, "DEAD"), (5, "LEFT"))
    ]


@pytest.mark.usefixtures("systems", "ros")
def test_who_listens_later_still_hears_which_system_it_is() -> None:
    initialise("view", ["--ros-args", "--disable-external-lib-logs", "-r", "__ns:=/some/system"])
    try:
        node = SwarmNode("hearer")
        writers = {topic: advertise(node, topic) for topic in (SYSTEM, *SYSTEM_FAMILY.main)}
        description, *_ = heard("beam", 0)
        writers[SYSTEM].publish(encode(description))
        listener, view, steps = Listener(node, 3), LiveView(HELLO, SwarmState()), count()

        def shown() -> bool:
            for message in step_of("beam", next(steps)):
                writers[TOPIC_OF[type(message)]].publish(encode(message))
            for one in listener.poll():
                view.add(one.message)
            frame = view.frame(0.0)
            return frame is not None and frame.robots.status == ["active", "limited", "active"]

        until(shown, "the system is shown with its robots", 15.0)
        node.destroy_node()  # type: ignore[no-untyped-call]
    finally:
        rclpy.try_shutdown()


@pytest.mark.usefixtures("systems")
def test_the_terminal_names_what_is_tracked_and_counts_the_limited() -> None:
    scenario = parse_scenario(LIFT)
    seen = SwarmSummary({"A": 2, "M": 1, "D": 1}, "AMAD", [], ["step 3: robot 4 dead"])
    shown = Progress("running", 8, 8, 12, 30, 250.0, 0.5, -0.25, seen)
    assert describe(shown, scenario) == (
        "lift: step 12 of 30; 250 steps/s, 2.5 x real time; z +0.5000 m, error -0.2500 m"
    )
    panel = RunPanel(scenario)
    panel.take(shown)
    stream = StringIO()
    Console(file=stream, width=90, height=20, no_color=True).print(panel)
    text = stream.getvalue()
    for line in ("z        +0.5000 m, reference +0.2500 m, error -0.2500 m", "robots  2 active, 1 limited, 1 dead"):
        assert " ".join(line.split()) in " ".join(text.split())
    assert "0.2500 m" in next(line for line in text.splitlines() if "error" in line and "reference" not in line)
    panel = RunPanel(parse_scenario(SHEET))  # two numbers are tracked: the error is that of both
    panel.take(shown)
    stream = StringIO()
    Console(file=stream, width=90, height=20, no_color=True).print(panel)
    assert "al      +0.5000 rad, error -0.2500 rad" in stream.getvalue()


@pytest.mark.usefixtures("systems")
@pytest.mark.parametrize("option", ["--markers", "--foxglove"])
def test_scenes_of_other_systems_are_refused_before_a_folder_is_made(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "lift.yaml", tmp_path / "out"
    path.write_text(LIFT, encoding="utf-8")
    assert swarm_command(["run", str(path), "-o", str(out), option]) == 2
    assert f"error: {option} supports only the plane, not the parent system 'lift'" in capsys.readouterr().err
    assert not out.exists()
