"""Processes that keep the machine busy: there are as many as said, and none is left."""

from __future__ import annotations

import os

import psutil
import pytest
from benchmarks.start import busy_machine, busy_processes


def children() -> set[int]:
    return {child.pid for child in psutil.Process().children()}


@pytest.mark.usefixtures("nothing_survives")
def test_the_machine_is_busy_within_the_block_only() -> None:
    before = children()
    with busy_machine():
        assert len(children() - before) == busy_processes() == 2 * (os.cpu_count() or 1)
    assert children() == before
