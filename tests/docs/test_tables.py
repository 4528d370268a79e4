"""Tables that describe code are what the code says."""

import re

import pytest
from tests.docs.pages import NAMES, read, rows, script, section

from swarmabs_analysis.sweep.evaluate import OUTCOMES
from swarmabs_analysis.sweep.study import RESULTS, Distribution, Range, Sweep
from swarmabs_bag.recorder.recording import Recording
from swarmabs_config.graph import GRAPH
from swarmabs_config.scenarios import builtin_scenarios, find_scenario
from swarmabs_core.membership import ChangeKind
from swarmabs_core.messages import TOPICS
from swarmabs_run.run import Outcome
from swarmabs_run.summary import Times, summarise
from swarmabs_view.visualization.node import PARAMETERS
from swarmabs_view.visualization.ros_messages import VISUAL_TOPICS

pytestmark = pytest.mark.timeout(300)  # the first of these tests imports the whole system, and draws it


def test_what_is_written_by_the_script_is_up_to_date_and_a_changed_default_noticed() -> None:
    tables = script("docs/tables.py")
    written = tables.all_tables()
    pages = {name: read(name) for name in NAMES if name.startswith("docs/")}
    assert [name for name, text in pages.items() if tables.renewed(text, written) != text] == [], "run docs/tables.py"
    assert tables.VIEW_SCHEMA.read_text(encoding="utf-8") == tables.view_schema(), "run docs/tables.py"
    marked = re.findall(r"<!-- table: ([a-z_ ]+) -->", "".join(read(name) for name in NAMES))
    assert sorted(marked) == sorted(written)
    text = read("docs/reference/parameters.md")
    changed = text.replace("| `stall_timeout` | `5.0`", "| `stall_timeout` | `6.0`")
    assert changed != text, "no default to change"
    assert tables.renewed(changed, written) == text


def test_topics_scenarios_and_changes_of_membership_are_those_of_the_code() -> None:
    table = rows(section(read("docs/reference/topics.md"), "Topics and messages"))[: len(GRAPH)]
    named = [
        (name.strip("`"), kind)
        for row in table
        for name, kind in zip(*(cell.split(", ") for cell in row[:2]), strict=True)
    ]
    assert sorted(named) == sorted((topic.name, topic.type_name) for topic in TOPICS)
    assert set(re.findall(r"`((?:pd|arise)_\w+)`", read("docs/reference/scenario.md"))) == set(builtin_scenarios())
    changes = {
        name
        for row in rows(section(read("docs/reference/faults.md"), "Membership and faults"))
        for name in re.findall(r"`([a-z]+)`", row[0])
    }
    assert changes >= {kind.value for kind in ChangeKind}


def test_fields_of_the_summary() -> None:
    scenario = find_scenario("pd_het_4")
    figures = Recording(scenario, None, driver="test").figures()
    summary = summarise(scenario, Outcome("ok", None, figures), Times(1.0))
    text = section(read("docs/reference/results.md"), "Results")
    described = [name for row in rows(text) for name in re.findall(r"`([a-z_]+)`", row[0])]
    assert set(described) == set(summary)


def test_topics_and_parameters_for_rviz_and_foxglove() -> None:
    table = rows(section(read("docs/how-to/ros_tools.md"), "On topics of ROS"))
    cells = [[cell.strip("`") for cell in row] for row in table]
    assert [row[:3] for row in cells if len(row) == 4] == [
        [t.name, t.ros_type.replace("/msg/", "/"), f"{t.qos.reliability} {t.qos.durability} {t.qos.depth}"]
        for t in VISUAL_TOPICS
    ]
    assert [row[:2] for row in cells if len(row) == 3] == [
        [each.name, repr(each.default).lower() if isinstance(each.default, bool) else repr(each.default)]
        for each in PARAMETERS
    ]


def test_keys_results_and_outcomes_of_sweeps_are_described() -> None:
    keys = [key for model in (Sweep, Range, Distribution) for key in model.key_names()]
    page = read("docs/how-to/sweep.md")
    assert [name for name in (*keys, *RESULTS, *OUTCOMES) if f"`{name}`" not in page] == []
