"""Tables that describe code are what the code says."""

from __future__ import annotations

import importlib.util
import re
from typing import TYPE_CHECKING, Any

import pytest
from tests.docs.pages import NAMES, ROOT, read, rows, section

from swarmabs_bag.recorder.recording import Recording
from swarmabs_config.scenarios import builtin_scenarios, find_scenario
from swarmabs_core.membership import ChangeKind
from swarmabs_core.messages import TOPICS
from swarmabs_run.run import Outcome
from swarmabs_run.summary import Times, summarise

if TYPE_CHECKING:
    from types import ModuleType


def load_tables() -> ModuleType:
    spec = importlib.util.spec_from_file_location("docs_tables", ROOT / "docs" / "tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def tables() -> ModuleType:
    return load_tables()


@pytest.fixture(scope="module")
def written(tables: Any) -> dict[str, str]:
    return tables.all_tables()  # type: ignore[no-any-return]


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("docs/")])
def test_written_tables_are_up_to_date(name: str, tables: Any, written: dict[str, str]) -> None:
    text = read(name)
    assert tables.renewed(text, written) == text, "run: python docs/tables.py"


def test_every_table_stands_somewhere(written: dict[str, str]) -> None:
    marked = re.findall(r"<!-- table: ([a-z_ ]+) -->", "".join(read(name) for name in NAMES))
    assert sorted(marked) == sorted(written)


def test_a_changed_default_is_noticed(tables: Any, written: dict[str, str]) -> None:
    text = read("docs/ros.md")
    changed = text.replace("| `stall_timeout` | `5.0`", "| `stall_timeout` | `6.0`")
    assert changed != text
    assert tables.renewed(changed, written) == text


def test_topics_are_those_of_the_code() -> None:
    table = rows(section(read("docs/design.md"), "Topics and messages"))
    assert [f"`{topic.name}`" for topic in TOPICS] == [row[0] for row in table[: len(TOPICS)]]


def test_fields_of_the_summary() -> None:
    scenario = find_scenario("pd_het_4")
    figures = Recording(scenario, None, driver="test").figures()
    summary = summarise(scenario, Outcome("ok", None, figures), Times(1.0))
    text = section(read("docs/design.md"), "Results")
    described = [name for row in rows(text) for name in re.findall(r"`([a-z_]+)`", row[0])]
    assert sorted(set(described) & set(summary)) == sorted(summary)
    assert set(described) - set(summary) == set()


def test_built_in_scenarios_are_all_named() -> None:
    text = section(read("docs/design.md"), "Scenario")
    assert set(re.findall(r"`((?:pd|arise)_\w+)`", text)) == set(builtin_scenarios())


def test_kinds_of_membership_changes_are_described() -> None:
    table = rows(section(read("docs/design.md"), "Membership and faults"))
    described = {name for row in table for name in re.findall(r"`([a-z]+)`", row[0])}
    assert described >= {kind.value for kind in ChangeKind}
