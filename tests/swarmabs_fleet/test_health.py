"""The monitor of a swarm's health, with a clock of the test's own."""

from __future__ import annotations

from swarmabs_fleet.operate import SILENT, SILENT_AFTER, HealthMonitor, in_order

HOSTS = {"plane_sim": "base", "agent_001": "cart-1", "agent_002": "cart-2"}


def test_nodes_are_shown_in_their_order_and_strangers_behind_them() -> None:
    monitor = HealthMonitor(HOSTS)
    for node in ("agent_009", "agent_002", "plane_sim"):
        monitor.hear(node, 0, "fine", {"x": "1"}, 10.0)
    rows = monitor.rows(10.5)
    assert [(row.node, row.host, row.level) for row in rows] == [
        ("plane_sim", "base", "OK"),
        ("agent_001", "cart-1", SILENT),
        ("agent_002", "cart-2", "OK"),
        ("agent_009", "unknown", "OK"),
    ]
    assert rows[0].values == {"x": "1"}
    assert not monitor.complete()
    assert not in_order(rows)


def test_a_node_that_falls_silent_is_no_longer_believed() -> None:
    monitor = HealthMonitor({"agent_001": "cart-1"})
    monitor.hear("agent_001", 0, "follows the broadcasts", {}, 10.0)
    assert in_order(monitor.rows(10.0 + SILENT_AFTER))
    (row,) = monitor.rows(10.1 + SILENT_AFTER)
    assert row.level == SILENT
    assert row.text == "not heard for 3 s; then: follows the broadcasts"
    monitor.hear("agent_001", 0, "follows the broadcasts", {}, 14.0)
    assert in_order(monitor.rows(14.0))


def test_a_warning_is_in_order_and_an_error_or_an_unknown_level_is_not() -> None:
    monitor = HealthMonitor({"agent_001": "cart-1"})
    verdicts = []
    for level in (0, 1, 2, 3, 77):
        monitor.hear("agent_001", level, "", {}, 1.0)
        verdicts.append(in_order(monitor.rows(1.0)))
    assert verdicts == [True, True, False, False, False]
