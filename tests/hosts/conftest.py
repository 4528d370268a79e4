"""Tests of the test hosts themselves. They skip, and say why, where the kernel gives no hosts."""

from functools import cache

import pytest
from tests.hosts.namespaces import why_no_hosts

_why_no_hosts = cache(why_no_hosts)


@pytest.fixture
def possible(nothing_survives: str) -> str:
    """Skip where there can be no hosts; return the mark of the test's processes."""
    if reason := _why_no_hosts():
        pytest.skip(reason)
    return nothing_survives
