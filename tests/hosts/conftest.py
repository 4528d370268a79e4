"""Tests of the test hosts themselves. They skip, and say why, where the kernel gives no hosts."""

import os
from functools import cache
from pathlib import Path

import pytest
from tests.hosts.namespaces import why_no_hosts

_why_no_hosts = cache(why_no_hosts)


@pytest.fixture
def possible(nothing_survives: str) -> str:
    """Skip where there can be no hosts; return the mark of the test's processes."""
    if reason := _why_no_hosts():
        pytest.skip(reason)
    return nothing_survives


def _prefix(variable: str, what: str) -> Path:
    """Return the prefix of libraries that a variable names; skip where it is not set."""
    prefix = os.environ.get(variable)
    if not prefix:
        pytest.skip(f"{variable} names no prefix with {what}; Fast DDS of the wheels has no DDS Security")
    assert (found := Path(prefix, "lib", "librmw_fastrtps_cpp.so")).is_file(), f"{variable}: {found} is missing"
    return Path(prefix)


@pytest.fixture(scope="session")
def secured() -> Path:
    """The prefix of a Fast DDS 2.14 with DDS Security, and of rmw_fastrtps with it."""
    return _prefix("SWARMABS_SECURE_PREFIX", "a Fast DDS that has security plugins")


@pytest.fixture(scope="session")
def unchecked() -> Path:
    """The same, whose plugins grant their own participant everything, and believe all others: what an attacker uses."""
    return _prefix("SWARMABS_ATTACKER_PREFIX", "a Fast DDS that does not check itself")
