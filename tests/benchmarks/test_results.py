"""Results of benchmarks, made by hand: medians, tables, charts, comparison, what is derived, and the page."""

import importlib
import json
import sys
from copy import deepcopy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks import page, product
from benchmarks.baseline_programs import BASELINES, FOLDER, BaselineResult
from benchmarks.bench import bench, compare
from benchmarks.common import Settings, spread
from benchmarks.model import ROUND_TRIP, Line, Model, costs, fitted, model, spread_out
from benchmarks.processes import Load, Memory
from benchmarks.product import summary
from benchmarks.results import CHART, DOCUMENT, LARGE_CHART, TABLES, read_result, write_result
from benchmarks.start import LaunchResult, start_row
from benchmarks.tables import Table, comparison, markdown, missing, notes, shown, tables
from scipy.optimize import nnls

from swarmabs_cli import main
from swarmabs_core.errors import InputError, RunError

LOAD = {
    "seconds": 2.0,
    "steps": 100,
    "cpu_ms_per_step": 16.5,
    "switches_per_agent_step": 4.2,
    "other_load": 0.1,
    "cpu_share": {"plane": 0.1, "observer": 0.2, "controller": 0.05, "recorder": 0.3, "agents": 1.0},
}


def repeat(product: float, **baselines: float) -> dict[str, Any]:
    """Return the results of one repeat: speeds of the product and of baselines; those that are not named make 1."""
    speeds = {**dict.fromkeys(BASELINES, 1.0), "packed": product, **baselines, "product": product}
    return {name: {"steps_per_second": speed, "load": LOAD} for name, speed in speeds.items()}


def document(*repeats: dict[str, Any], robots: int = 4) -> dict[str, Any]:
    return {
        "schema": 1,
        "created": "2026-01-01T00:00:00+00:00",
        "machine": {"usable_cores": 2, "cores": 2, "processor": "some", "kernel": "6.1", "load_before": 0.1},
        "settings": {"repeat": len(repeats), "window": 6.0},
        "product": [{"robots": robots, "summary": summary(list(repeats)), "repeats": list(repeats)}],
    }


def of_starts(*seconds: float, failures: tuple[str, ...] = (), retried: int = 0) -> dict[str, Any]:
    """Return a result of the suite `start`: clean starts of 200 robots that took these times, and failed ones."""
    results = [LaunchResult(second, 0.5, Memory(1, 1, {}, 1), retried) for second in seconds]
    return {**document(repeat(1.0)), "start": [start_row(200, results, failures, busy=True)]}


def of_large(speed: float | None) -> dict[str, Any]:
    """Return a result of the suite `large`: a run of 2,000 robots with this speed, or one that failed."""
    failures, speeds = (["it stalled"], []) if speed is None else ([], [speed])
    measures = ("start_seconds", "steps_per_second", "total_bytes", "cpu_ms_per_step")
    row = {"robots": 2000, "agents_per_process": 50, "failures": failures, "repeats": []}
    row["summary"] = {name: spread(speeds) for name in measures}
    return {**document(repeat(1.0)), "large": [row]}


REPEATS = (
    repeat(80.0, rclpy_best_effort=100.0, rclpy_reliable=70.0, zeromq=160.0),
    repeat(30.0, rclpy_best_effort=40.0, rclpy_reliable=90.0, zeromq=60.0),
    repeat(90.0, rclpy_best_effort=120.0, rclpy_reliable=80.0, zeromq=300.0),
)


def table_of(found: dict[str, Any], name: str) -> Table:
    """Return a table of a result, in which every row fits the headings."""
    (table,) = (table for table in tables(found) if table.name == name)
    assert all(len(row) == len(table.headings) for row in table.rows)
    return table


def compared(old: dict[str, Any], new: dict[str, Any], suite: str) -> dict[str, tuple[str, ...]]:
    """Return the rows of a comparison that belong to a suite, by measure."""
    return {row[2]: row for row in comparison(old, new).rows if row[0] == suite}


def test_a_spread_has_median_and_bounds_and_is_shown_in_three_digits() -> None:
    for values, median, text in (
        ([3.0, 1.0, 2.0, 10.0], 2.5, "2.5 (1-10)"),
        ([1234.4, 1000.0, 2000.0], 1234.4, "1234 (1000-2000)"),
        ([0.75], 0.75, "0.75"),
    ):
        assert spread(values) == {"median": median, "smallest": min(values), "largest": max(values)}
        assert shown(spread(values)) == text
    assert (spread([]), shown(None)) == (None, "-")


def test_the_baseline_is_the_better_form_and_ratios_are_within_a_repeat() -> None:
    found = summary(list(REPEATS))
    assert found["floor"] == "rclpy_best_effort"  # its median is 100, the other's 80
    assert found["ratio_to_floor"] == {"median": 0.75, "smallest": 0.75, "largest": 0.8}
    assert found["ratio_to_zeromq"] == {"median": 0.5, "smallest": 0.3, "largest": 0.5}
    assert found["steps_per_second"]["product"]["median"] == 80.0


def test_a_measurement_that_fails_is_tried_again_and_then_marked_and_the_others_stay(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tried: list[str] = []
    good = BaselineResult(100.0, 0.5, Load(**LOAD))

    def baseline(name: str, robots: int, **_: float) -> BaselineResult:
        tried.append(name)
        if name == "zeromq" or (name == "datagrams" and tried.count(name) == 1):
            raise RunError(f"baseline {name} with {robots} robots: no step in 3 s")
        return good

    monkeypatch.setattr(product, "measure_baseline", baseline)
    monkeypatch.setattr(product, "measure_run", lambda *_, **__: good)
    (row,) = product.measure(Settings(robots=(20,), repeat=1, window=3.0))["product"]
    assert (tried.count("zeromq"), tried.count("datagrams"), tried.count("rclpy_reliable")) == (2, 2, 1)
    found = {**document(repeat(1.0)), "product": [row]}
    speed = table_of(found, "speed")
    cells = dict(zip(speed.headings, speed.rows[0], strict=True))
    assert (cells["ZeroMQ"], cells["of ZeroMQ"], cells["of rclpy"]) == ("-", "-", "1")
    assert [line for line in notes(found) if "not measured" in line] == [
        "not measured: ZeroMQ with 20 robots: baseline zeromq with 20 robots: no step in 3 s"
    ]
    assert missing(found) == [(20, "ZeroMQ", "baseline zeromq with 20 robots: no step in 3 s")]
    assert capsys.readouterr().err.count("once more") == 2


def test_a_late_agent_does_not_make_the_zeromq_baseline_forget_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Resent broadcasts keep the others from sending again, so what they have sent must be kept."""
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setitem(sys.modules, "zmq", SimpleNamespace(Again=TimeoutError, Context=list, Socket=list))
    baseline = importlib.import_module("zeromq_baseline")
    monkeypatch.delitem(sys.modules, "zeromq_baseline")
    monkeypatch.setattr(baseline, "step_of", lambda _: 7)
    monkeypatch.setattr(baseline, "agent_of", lambda number: number)
    heard = iter([1, 2, None, 3])

    def recv() -> int:
        number = next(heard)
        if number is None:
            raise TimeoutError
        return number

    seen: set[int] = set()
    gathered = [baseline.gather(SimpleNamespace(recv=recv), 3, 7, seen) for _ in range(2)]
    assert (gathered, seen) == ([False, True], set())


def test_tables_show_the_suites_that_were_measured() -> None:
    found = document(*REPEATS)
    speed, cost = table_of(found, "speed"), table_of(found, "cost")
    assert [table.name for table in tables(found)] == ["speed", "cost"]
    assert speed.rows[0][:2] == ("4", "80 (30-90)")
    assert speed.rows[0][-4::2] == ("0.75 (0.75-0.8)", "0.5 (0.3-0.5)")
    assert [row[1] for row in cost.rows] == ["swarm run --no-packed", "swarm run --packed", "bare rclpy", "ZeroMQ"]
    assert markdown(speed).splitlines()[0].startswith("| robots | swarm run --no-packed | ")


def test_a_result_without_packed_broadcasts_is_written_and_read_and_what_is_none_refused(tmp_path: Path) -> None:
    speed = table_of(document(repeat(10.0, packed=15.0, rclpy_reliable=20.0, zeromq=30.0)), "speed")
    row = dict(zip(speed.headings, speed.rows[0], strict=True))
    assert (row["swarm run --packed"], row["packed of rclpy"], row["packed of ZeroMQ"]) == ("15", "0.75", "0.5")
    old = deepcopy(document(*REPEATS))
    result = old["product"][0]
    del result["summary"]["packed_ratio_to_floor"], result["summary"]["packed_ratio_to_zeromq"]
    for one in (result["summary"]["steps_per_second"], *result["repeats"]):
        del one["packed"]
    assert table_of(old, "speed").rows[0][-3] == "-"
    assert [row[1] for row in table_of(old, "cost").rows] == ["swarm run --no-packed", "bare rclpy", "ZeroMQ"]
    write_result(old, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {DOCUMENT, TABLES, CHART}
    assert "| 4 | 80 (30-90) |" in (tmp_path / TABLES).read_text(encoding="utf-8")
    assert read_result(tmp_path) == read_result(tmp_path / DOCUMENT) == old
    for text in ("no JSON", "[]", '{"schema": 1}'):
        (tmp_path / DOCUMENT).write_text(text)
        with pytest.raises(InputError, match=r"bench\.json is not a result of swarm bench"):
            read_result(tmp_path)
    with pytest.raises(InputError, match="No such file"):
        read_result(tmp_path / "nothing")


def test_a_comparison_tells_changes_from_noise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old = document(repeat(50.0, zeromq=100.0), repeat(60.0, zeromq=110.0))
    new = document(repeat(90.0, zeromq=105.0), repeat(100.0, zeromq=112.0))
    rows = compared(old, new, "product")
    assert rows["product"] == ("product", "4", "product", "55 (50-60)", "95 (90-100)", "1.73", "")
    assert rows["zeromq"][-1] == "within the spread"
    assert not comparison(old, document(*REPEATS, robots=20)).rows, "only what both have"
    for name, result in (("old", old), ("new", new)):
        (tmp_path / name).mkdir()
        (tmp_path / name / DOCUMENT).write_text(json.dumps(result), encoding="utf-8")
    paths = [str(tmp_path / name) for name in ("old", "new")]
    compare(paths, as_json=False)
    assert "1.73" in capsys.readouterr().out
    compare(paths, as_json=True)
    assert {row["measure"]: row["new/old"] for row in json.loads(capsys.readouterr().out)}["product"] == "1.73"


def test_starts_are_counted_and_those_that_failed_have_no_time() -> None:
    found = of_starts(9.0, 30.0, 10.0, failures=("a run did not make its first step",), retried=1)
    (row,) = table_of(found, "start").rows
    assert row[:4] == ("200", "3 of 4", "3", "10 (9-30)")
    assert int(row[-1]) > 0
    none = of_starts(failures=("no",))
    assert table_of(none, "start").rows[0][:5] == ("200", "0 of 1", "0", "-", "-")
    assert not compared(none, of_starts(1.0), "start")
    rows = compared(of_starts(1.0, 1.0), of_starts(2.0, failures=("no",)), "start")
    assert rows["clean starts"] == ("start", "200", "clean starts", "2 of 2", "1 of 2", "0.50", "")
    assert rows["start_seconds"][5] == "2.00"


def test_large_simulations_are_shown_compared_and_drawn_also_if_one_failed(tmp_path: Path) -> None:
    for speed, shown_speed, failed in ((8.0, "8", "0"), (None, "-", "1")):
        (row,) = table_of(of_large(speed), "large").rows
        assert (row[:2], row[3], row[-1]) == (("2000", "50"), shown_speed, failed)
    rows = compared(of_large(8.0), of_large(12.0), "large")
    assert rows["steps_per_second"][1:] == ("2000", "steps_per_second", "8", "12", "1.50", "")
    assert not compared(of_large(8.0), of_large(None), "large")
    write_result(of_large(None), tmp_path)
    assert (tmp_path / LARGE_CHART).is_file()


@pytest.mark.parametrize(
    "costs_ms", [(0.8, 2.1, 6.5, 31.2), (0.1, 2.0, 8.0, 40.0), (5.0, 5.0, 4.0, 3.0), (0.7, 2.3, 6.7, 20.3)]
)
def test_relative_errors_are_least_among_lines_that_are_nowhere_negative(costs_ms: tuple[float, ...]) -> None:
    points = list(zip((4, 20, 64, 200), costs_ms, strict=True))
    expected, _ = nnls(np.array([[1.0 / cost, robots / cost] for robots, cost in points]), np.ones(len(points)))
    found = fitted(points)
    assert (found.a, found.b, found.at(100)) == pytest.approx((*expected, expected @ [1.0, 100.0]))


def two_sizes() -> dict[str, Any]:
    small, large = document(repeat(100.0)), document(repeat(20.0), robots=24)
    return {**small, "product": [*small["product"], *large["product"]]}


def test_costs_are_ms_of_a_step_by_role_and_the_tables_say_what_was_fitted() -> None:
    small, large = costs(two_sizes()["product"])
    assert (small.robots, small.step, large.step) == (4, 10.0, 50.0)
    # The results made by hand have 100 steps in 2 s: a whole core is 20 ms of each.
    shares = {"plane": 2.0, "observer": 4.0, "controller": 1.0, "recorder": 6.0, "agents": 20.0}
    assert small.cpu == pytest.approx(shares)
    assert small.coordinators == pytest.approx(13.0)
    cost, hosts = (table_of(two_sizes(), name) for name in ("model", "hosts"))
    assert "2 ms + 2000 us per robot" in cost.caption
    assert cost.rows[0][:3] == ("4", "10", "10")
    assert hosts.caption.startswith("derived, not measured")
    # One number of robots, or runs too short to look at twice, make no line.
    found = document(repeat(100.0), repeat(90.0))["product"]
    assert model(costs(found)) is model([]) is None
    for results in found[0]["repeats"]:
        results["product"] = {**results["product"], "load": None}
    assert costs(found) == []


def test_robots_on_hosts_by_hand() -> None:
    coordinators = {"plane": (0.1, 0.01), "observer": (0.2, 0.02), "controller": (0.3, 0.0), "recorder": (0.0, 0.03)}
    lines = {name: Line(*line) for name, line in {"agents": (0.0, 0.2), **coordinators}.items()}
    known = Model(Line(1.0, 1.0), lines)
    # 100 robots per host on 2 cores: 10 ms; the recorder takes 1,000 states: 30 ms; the controller 0.3 ms.
    assert spread_out(known, 1000, 10, 2, relays=False) == pytest.approx(10.0 + 30.0 + 0.3 + ROUND_TRIP)
    # A relay takes 100 states: 2 ms; the observer takes 10 messages: 0.4 ms.
    assert spread_out(known, 1000, 10, 2, relays=True) == pytest.approx(10.0 + 2.0 + 0.4 + 0.3 + ROUND_TRIP)
    # A robot alone uses one core of its host.
    assert spread_out(known, 10, 10, 2, relays=False) == pytest.approx(0.2 + 0.4 + 0.3 + ROUND_TRIP)


PAGE = "# Page\n\n<!-- bench: speed -->\nold\n<!-- end -->\n\n<!-- bench: memory -->\nkept\n<!-- end -->\n"


def test_page_is_renewed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for name, file in (("CHART", "chart.svg"), ("LARGE_CHART", "large.svg")):
        monkeypatch.setattr(page, name, tmp_path / file)
    monkeypatch.setattr(page, "PAGES", (tmp_path / "page.md",))
    (tmp_path / "page.md").write_text(PAGE, encoding="utf-8")
    assert page.main([]) == 2
    assert "python -m benchmarks.page RESULT" in capsys.readouterr().err
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == PAGE
    (tmp_path / DOCUMENT).write_text(json.dumps({**of_large(8.0), **document(repeat(80.0))}), encoding="utf-8")
    assert page.main([str(tmp_path)]) == 0
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert [part in text for part in ("| 4 | 80 |", "old", "kept")] == [True, False, True]
    assert (tmp_path / "chart.svg").is_file() and (tmp_path / "large.svg").is_file()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--robots", "4,x"], "'4,x' is not a list such as 4,20"),
        (["--robots", "1"], "a swarm has at least 2 robots"),
        (["--suite", "all the rest"], "is not one of"),
        (["--starts", "0"], "0 is out of range: give at least 1"),
        (["--large", "1"], "a swarm has at least 2 robots"),
        (["--window", "0"], "0.0 is out of range: give at least 0.1"),
    ],
)
def test_bad_arguments(capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], reason: str) -> None:
    assert main(["bench", *arguments, "-o", str(tmp_path / "result")]) == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "result").exists()


def test_a_missing_package_is_named_with_its_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.bench.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pyzmq is missing, .*; start with \./scripts/swarm bench"):
        bench(Settings(suites=("product",)), tmp_path / "result", as_json=True)
    assert not (tmp_path / "result").exists()
