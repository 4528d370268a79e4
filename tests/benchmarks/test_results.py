"""Medians, ratios, tables, chart and comparison of results."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path

import pytest
from benchmarks.common import spread
from benchmarks.product import summary as product_summary
from benchmarks.results import CHART, DOCUMENT, LARGE_CHART, TABLES, read_result, write_result
from benchmarks.tables import comparison, markdown, shown, tables
from tests.benchmarks.results import document, of_large, of_starts, repeat

from swarmabs_core.errors import InputError

REPEATS = (
    repeat(80.0, rclpy_best_effort=100.0, rclpy_reliable=70.0, zeromq=160.0),
    repeat(30.0, rclpy_best_effort=40.0, rclpy_reliable=90.0, zeromq=60.0),
    repeat(90.0, rclpy_best_effort=120.0, rclpy_reliable=80.0, zeromq=300.0),
)


def test_a_spread_has_median_and_bounds_and_there_is_none_of_nothing() -> None:
    assert spread([3.0, 1.0, 2.0, 10.0]) == {"median": 2.5, "smallest": 1.0, "largest": 10.0}
    assert spread([]) is None


def test_the_floor_is_the_better_form_and_ratios_are_within_a_repeat() -> None:
    summary = product_summary(list(REPEATS))
    assert summary["floor"] == "rclpy_best_effort"  # its median is 100, the other's 80
    assert summary["ratio_to_floor"] == {"median": 0.75, "smallest": 0.75, "largest": 0.8}
    assert summary["ratio_to_zeromq"] == {"median": 0.5, "smallest": 0.3, "largest": 0.5}
    assert summary["steps_per_second"]["product"]["median"] == 80.0


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (None, "-"),
        ({"median": 1234.4, "smallest": 1000.0, "largest": 2000.0}, "1234 (1000-2000)"),
        ({"median": 0.75, "smallest": 0.75, "largest": 0.75}, "0.75"),
    ],
)
def test_a_spread_is_shown_in_three_digits(given: dict[str, float] | None, text: str) -> None:
    assert shown(given) == text


def test_tables_show_the_suites_that_were_measured() -> None:
    speed, cost = tables(document(*REPEATS))
    assert speed.rows[0][:2] == ("4", "80 (30-90)")
    assert speed.rows[0][-4::2] == ("0.75 (0.75-0.8)", "0.5 (0.3-0.5)")
    assert [row[1] for row in cost.rows] == ["swarm run", "swarm run --packed", "bare rclpy", "ZeroMQ"]
    assert all(len(row) == len(table.headings) for table in (speed, cost) for row in table.rows)
    assert markdown(speed).splitlines()[0].startswith("| robots | swarm run | ")


def test_packed_broadcasts_are_measured_beside_the_others() -> None:
    (speed, *_) = tables(document(repeat(10.0, packed=15.0, rclpy_reliable=20.0, zeromq=30.0)))
    row = dict(zip(speed.headings, speed.rows[0], strict=True))
    assert (row["swarm run --packed"], row["packed of rclpy"], row["packed of ZeroMQ"]) == ("15", "0.75", "0.5")


def test_a_result_without_packed_broadcasts_is_still_shown(tmp_path: Path) -> None:
    old = deepcopy(document(*REPEATS))
    summary = old["product"][0]["summary"]
    for key in ("packed_ratio_to_floor", "packed_ratio_to_zeromq"):
        del summary[key]
    for one in (summary["steps_per_second"], *old["product"][0]["repeats"]):
        del one["packed"]
    speed, cost = tables(old)
    assert dict(zip(speed.headings, speed.rows[0], strict=True))["packed of rclpy"] == "-"
    assert [row[1] for row in cost.rows] == ["swarm run", "bare rclpy", "ZeroMQ"]
    write_result(old, tmp_path)


def test_a_result_is_written_and_read_again(tmp_path: Path) -> None:
    made = document(*REPEATS)
    write_result(made, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {DOCUMENT, TABLES, CHART}
    assert "| 4 | 80 (30-90) |" in (tmp_path / TABLES).read_text(encoding="utf-8")
    assert read_result(tmp_path) == read_result(tmp_path / DOCUMENT) == made


@pytest.mark.parametrize("text", ["no JSON", "[]", json.dumps({"schema": 1})])
def test_what_is_no_result_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / DOCUMENT).write_text(text)
    with pytest.raises(InputError, match=r"bench\.json is no result of swarm bench"):
        read_result(tmp_path)


def test_a_result_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        read_result(tmp_path)


def test_a_comparison_tells_changes_from_noise() -> None:
    old = document(repeat(50.0, zeromq=100.0), repeat(60.0, zeromq=110.0))
    new = document(repeat(90.0, zeromq=105.0), repeat(100.0, zeromq=112.0))
    rows = {row[2]: row for row in comparison(old, new).rows}
    assert rows["product"] == ("product", "4", "product", "55 (50-60)", "95 (90-100)", "1.73", "")
    assert rows["zeromq"][-1] == "within the spread"


def test_only_what_both_have_is_compared() -> None:
    assert not comparison(document(*REPEATS), document(*REPEATS, robots=20)).rows


def test_starts_are_counted_and_those_that_failed_have_no_time() -> None:
    found = of_starts(9.0, 30.0, 10.0, failures=("a run did not make its first step",), retried=1)
    table = next(table for table in tables(found) if table.name == "start")
    assert table.rows[0][:4] == ("200", "3 of 4", "3", "10 (9-30)")
    assert int(table.rows[0][-1]) > 0
    assert all(len(row) == len(table.headings) for row in table.rows)


def test_no_clean_start_is_a_result_too(tmp_path: Path) -> None:
    found = of_starts(failures=("no",))
    write_result(found, tmp_path)
    assert "| 200 | 0 of 1 | 0 | - | - |" in (tmp_path / TABLES).read_text(encoding="utf-8")
    assert not [row for row in comparison(found, of_starts(1.0)).rows if row[0] == "start"]


def test_clean_starts_are_compared() -> None:
    rows = {row[2]: row for row in comparison(of_starts(1.0, 1.0), of_starts(2.0, failures=("no",))).rows}
    assert rows["clean starts"] == ("start", "200", "clean starts", "2 of 2", "1 of 2", "0.50", "")
    assert rows["start_seconds"][5] == "2.00"


def test_a_result_from_before_starts_were_counted_is_still_shown_and_compared() -> None:
    old = of_starts(1.0)
    for key in ("starts", "clean", "retried", "busy_processes", "failures"):
        del old["start"][0][key]
    table = next(table for table in tables(old) if table.name == "start")
    assert table.rows[0] == ("200", "-", "-", "1", "0.5", "-")
    assert [row[2] for row in comparison(old, of_starts(3.0)).rows if row[0] == "start"] == [
        "start_seconds",
        "shut_down_seconds",
    ]


@pytest.mark.parametrize(("speed", "shown_speed", "failed"), [(8.0, "8", "0"), (None, "-", "1")])
def test_large_simulations_are_shown_and_drawn(
    tmp_path: Path, speed: float | None, shown_speed: str, failed: str
) -> None:
    found = of_large(speed)
    (row,) = next(table for table in tables(found) if table.name == "large").rows
    assert (row[:2], row[3], row[-1]) == (("2000", "50"), shown_speed, failed)
    write_result(found, tmp_path)
    assert (tmp_path / LARGE_CHART).is_file()


def test_large_simulations_are_compared() -> None:
    rows = {row[2]: row for row in comparison(of_large(8.0), of_large(12.0)).rows if row[0] == "large"}
    assert rows["steps_per_second"][1:] == ("2000", "steps_per_second", "8", "12", "1.50", "")
    assert not [row for row in comparison(of_large(8.0), of_large(None)).rows if row[0] == "large"]
