"""Who hears whom where each robot sums up the swarm by itself: from diagnostics to the page."""

from playwright.sync_api import Page, expect
from tests.swarmabs_view.conftest import PageServer

from swarmabs_config.graph import SILENCE
from swarmabs_core.hearing import Hearing
from swarmabs_core.nodes import agent_name
from swarmabs_view.linked_robots import INTERVAL, DiagnosedLinks
from swarmabs_view.protocol import LinkedRobot, Links

LONG = "agent_" + "9" * 5000
MINORITY = "robot 4 hears 0 of 3 neighbours, a minority, so it stops"


def linked(robot: int, *hears: int, neighbours: int = 3, lacks: tuple[int, ...] = (), **other: bool) -> LinkedRobot:
    known = {"silent": False, "majority": True, "oldest": 4} | other
    return LinkedRobot.model_validate(
        {"id": robot, "hears": list(hears), "neighbours": neighbours, "lacks": list(lacks), **known}
    )


def silent(robot: int) -> LinkedRobot:
    return linked(robot, neighbours=0, silent=True, majority=False).model_copy(update={"oldest": None})


def told(*hears: int, lacks: tuple[int, ...] = ()) -> dict[str, str]:
    """Return the diagnostics of a robot with three neighbours, whose oldest useful state has an age of 4 steps."""
    ages = dict.fromkeys(hears, 4) | dict.fromkeys(lacks, 90)
    return dict(Hearing(hears, 3, dict(sorted(ages.items())), lacks, majority=True).values())


def robots(links: DiagnosedLinks, now: float) -> list[LinkedRobot]:
    message = links.message(now)
    assert message is not None
    return message.robots


def test_other_nodes_and_nonsense_tell_nothing() -> None:
    links = DiagnosedLinks()
    for node in (
        "recorder",
        "agent_",
        "agent_1",
        "agent_00001",
        "agent_x01",
        "agent_\u0660\u0660\u0661",
        LONG,
    ):
        links.hear(node, told(2), 0.0)
    links.hear("agent_001", told(2) | {"neighbours": "many"}, 0.0)
    links.hear("agent_001", {"status": "ACTIVE"}, 0.0)
    assert links.message(0.0) is None


def test_robots_are_shown_by_id_and_once_an_interval() -> None:
    links = DiagnosedLinks()
    links.hear("agent_010", told(2), 0.0)
    links.hear("agent_002", told(3, 10, lacks=(4,)), 0.1)
    first = links.message(0.2)
    assert first is not None
    assert first.robots == [linked(2, 3, 10, lacks=(4,)), linked(10, 2)], "3 and 4 may not have spoken yet"
    links.hear("agent_010", told(), 0.3)
    assert links.message(0.19 + INTERVAL) is first
    assert robots(links, 0.2 + INTERVAL)[1].hears == []


def test_robots_that_fall_silent_or_never_spoke_are_shown_unless_all_know_that_they_left() -> None:
    links = DiagnosedLinks()
    for robot in (1, 2, 3, 5):
        links.hear(agent_name(robot), told(4), 0.0)
    end = 0.5 + SILENCE
    links.hear("agent_001", told(3, lacks=(2,)), end)
    links.hear("agent_003", told(1, 4), end)
    assert robots(links, end) == [linked(1, 3, lacks=(2,)), silent(2), linked(3, 1, 4), silent(4)]
    assert robots(links, 2 * end + 1.0) == [silent(robot) for robot in (1, 2, 3, 5)]


def test_of_few_robots_all_have_labels_and_a_row_each(page: Page, page_server: PageServer) -> None:
    page_server.open()
    panel, graph = page.locator("#links-panel"), page.locator("#links")
    expect(panel).to_be_hidden()
    found = [
        linked(1, 2, 4, lacks=(3,)),
        linked(2, 1).model_copy(update={"oldest": 1}),
        silent(3),
        linked(4, lacks=(1, 2, 3), majority=False),
    ]
    page_server.send(Links(robots=found))
    expect(panel.locator("tbody tr")).to_have_text(
        [
            "12 of 34 steps, 0.04 s3yes",
            "21 of 31 step, 0.01 s–yes",
            "3is silent–––",
            "40 of 34 steps, 0.04 s1, 2, 3no, it stops",
        ]
    )
    expect(panel.locator("tr.bad th")).to_have_text(["3", "4"])
    expect(graph.locator("text")).to_have_text(["1", "2", "3", "4"])
    expect(graph.locator("text.bad")).to_have_text(["3", "4"])
    expect(graph.locator("circle.silent title")).to_have_text("robot 3 is silent")
    expect(graph.locator("path.minority title")).to_have_text(MINORITY)
    expect(graph.locator("line.one title")).to_have_text("robot 1 hears robot 4, which does not hear it")
    assert (graph.locator("path.both").get_attribute("d") or "").count("M") == 1
    expect(graph).to_have_attribute(
        "aria-label",
        "of 4 robots, pairs that hear each other: 1; pairs of which only one hears the other: 1; robot 3 is silent; "
        + MINORITY,
    )
    expect(page.locator("#links-left-out")).to_be_hidden()
    for width in (390, 1280):
        page.set_viewport_size({"width": width, "height": 844})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        expect(panel.locator(".scroll + .more")).to_be_hidden()


def test_of_many_robots_the_table_has_the_worst(page: Page, page_server: PageServer) -> None:
    page_server.open()
    many = [linked(n, *((n + k) % 200 + 1 for k in (0, 1, 197, 198)), neighbours=4) for n in range(1, 201)]
    many[149] = silent(150)
    many[99] = linked(100, 101, neighbours=4, lacks=tuple(range(1, 60)), majority=False)
    many[6] = linked(7, 8, 9, 5, neighbours=4, lacks=(150,))
    page_server.send(Links(robots=many))
    rows = page.locator("#linked tbody tr")
    expect(rows).to_have_count(20)
    expect(page.locator("#linked tbody th").nth(0)).to_have_text("150")
    expect(rows.nth(1)).to_have_text("1001 of 44 steps, 0.04 s1, 2, 3, 4, 5, 6, 7, 8 and 51 moreno, it stops")
    expect(page.locator("#linked tbody th").nth(2)).to_have_text("7")
    expect(page.locator("#links-left-out")).to_have_text("and 180 more robots")
    expect(page.locator("#links circle")).to_have_count(199)
    expect(page.locator("#links text")).to_have_count(0)
    expect(page.locator("#links line.one")).to_have_count(8)
