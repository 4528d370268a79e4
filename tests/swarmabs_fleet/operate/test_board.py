"""The board of a swarm's health, with a clock of the test's own."""

from __future__ import annotations

from swarmabs_fleet.operate.board import SILENT, SILENT_AFTER, Board, in_order

HOSTS = {"plane_sim": "base", "agent_001": "cart-1", "agent_002": "cart-2"}


def test_nodes_are_shown_in_their_order_and_strangers_behind_them() -> None:
    board = Board(HOSTS)
    for node in ("agent_009", "agent_002", "plane_sim"):
        board.hear(node, 0, "fine", {"x": "1"}, 10.0)
    rows = board.rows(10.5)
    assert [(row.node, row.host, row.level) for row in rows] == [
        ("plane_sim", "base", "OK"),
        ("agent_001", "cart-1", SILENT),
        ("agent_002", "cart-2", "OK"),
        ("agent_009", "unknown", "OK"),
    ]
    assert rows[0].values == {"x": "1"}
    assert not board.complete()
    assert not in_order(rows)


def test_a_node_that_falls_silent_is_no_longer_believed() -> None:
    board = Board({"agent_001": "cart-1"})
    board.hear("agent_001", 0, "follows the broadcasts", {}, 10.0)
    assert in_order(board.rows(10.0 + SILENT_AFTER))
    (row,) = board.rows(10.1 + SILENT_AFTER)
    assert row.level == SILENT
    assert row.text == "not heard for 3 s; then: follows the broadcasts"
    board.hear("agent_001", 0, "follows the broadcasts", {}, 14.0)
    assert in_order(board.rows(14.0))


def test_a_warning_is_in_order_and_an_error_or_an_unknown_level_is_not() -> None:
    board = Board({"agent_001": "cart-1"})
    verdicts = []
    for level in (0, 1, 2, 3, 77):
        board.hear("agent_001", level, "", {}, 1.0)
        verdicts.append(in_order(board.rows(1.0)))
    assert verdicts == [True, True, False, False, False]
