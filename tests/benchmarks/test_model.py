"""The cost of a step by the number of robots, and what is derived from it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from benchmarks.model import ROUND_TRIP, Cost, Line, Model, costs, fitted, model, spread_out
from benchmarks.tables import tables
from scipy.optimize import nnls
from tests.benchmarks.results import document, repeat

ROBOTS = (4, 20, 64, 200)


def test_a_line_is_found_again() -> None:
    line = Line(0.3, 0.1)
    found = fitted([(robots, line.at(robots)) for robots in ROBOTS])
    assert (found.a, found.b) == pytest.approx((0.3, 0.1))


@pytest.mark.parametrize(
    "costs_ms", [(0.8, 2.1, 6.5, 31.2), (0.1, 2.0, 8.0, 40.0), (5.0, 5.0, 4.0, 3.0)], ids=["both", "slope", "constant"]
)
def test_relative_errors_are_least_among_lines_that_are_nowhere_negative(costs_ms: tuple[float, ...]) -> None:
    matrix = np.array([[1.0 / cost, robots / cost] for robots, cost in zip(ROBOTS, costs_ms, strict=True)])
    expected, _ = nnls(matrix, np.ones(len(ROBOTS)))
    found = fitted(list(zip(ROBOTS, costs_ms, strict=True)))
    assert (found.a, found.b) == pytest.approx(tuple(expected))


def two_sizes() -> dict[str, Any]:
    small, large = document(repeat(100.0)), document(repeat(20.0), robots=24)
    return {**small, "product": [*small["product"], *large["product"]]}


def test_costs_are_ms_of_a_step_by_role() -> None:
    small, large = costs(two_sizes()["product"])
    assert (small.robots, small.step, large.step) == (4, 10.0, 50.0)
    # The results made by hand have 100 steps in 2 s: a whole core is 20 ms of each.
    assert small.cpu == pytest.approx(
        {"plane": 2.0, "observer": 4.0, "controller": 1.0, "recorder": 6.0, "agents": 20.0}
    )
    assert small.coordinators == pytest.approx(13.0)


def test_the_tables_say_what_was_fitted() -> None:
    cost, hosts = tables(two_sizes())[-2:]
    assert (cost.name, hosts.name) == ("model", "hosts")
    assert "2 ms + 2000 us per robot" in cost.caption
    assert cost.rows[0][:3] == ("4", "10", "10")
    assert hosts.caption.startswith("derived, not measured")
    assert all(len(row) == len(table.headings) for table in (cost, hosts) for row in table.rows)


def test_one_number_of_robots_makes_no_line() -> None:
    assert model(costs(document(repeat(100.0), repeat(90.0))["product"])) is None
    assert model([]) is None


KNOWN = Model(
    Line(1.0, 1.0),
    {
        "agents": Line(0.0, 0.2),
        "plane": Line(0.1, 0.01),
        "observer": Line(0.2, 0.02),
        "controller": Line(0.3, 0.0),
        "recorder": Line(0.0, 0.03),
    },
)


def test_robots_on_hosts_by_hand() -> None:
    # 100 robots per host on 2 cores: 10 ms; the recorder takes 1,000 states: 30 ms; the controller 0.3 ms.
    assert spread_out(KNOWN, 1000, 10, 2, relays=False) == pytest.approx(10.0 + 30.0 + 0.3 + ROUND_TRIP)
    # A relay takes 100 states: 2 ms; the observer takes 10 messages: 0.4 ms.
    assert spread_out(KNOWN, 1000, 10, 2, relays=True) == pytest.approx(10.0 + 2.0 + 0.4 + 0.3 + ROUND_TRIP)
    # A robot alone uses one core of its host.
    assert spread_out(KNOWN, 10, 10, 2, relays=False) == pytest.approx(0.2 + 0.4 + 0.3 + ROUND_TRIP)


def test_what_was_too_short_to_look_at_twice_is_left_out() -> None:
    found = two_sizes()
    for row in found["product"]:
        for results in row["repeats"]:
            results["product"] = {**results["product"], "load": None}
    assert costs(found["product"]) == []
    assert Cost(4, 1.0, {"agents": 2.0}).coordinators == 0.0
