"""Claims on ROS domains."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack

import pytest

from swarmabs_config.ports import DOMAIN_GAIN, GUARD_OFFSET, LARGEST_DOMAIN, PORT_BASE, SPACING, metatraffic_port
from swarmabs_core.errors import RunError
from swarmabs_run.orchestration import network
from swarmabs_run.orchestration.network import claimed_domain

HOLDER = """
import sys
from swarmabs_run.orchestration.network import claimed_domain
with claimed_domain() as domain:
    print(domain, flush=True)
    sys.stdin.read()
"""


def guard_is_free(claimed: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        try:
            probe.bind(("127.0.0.1", PORT_BASE + DOMAIN_GAIN * claimed + GUARD_OFFSET))
        except OSError:
            return False
    return True


def test_claims_differ_and_are_five_apart() -> None:
    with ExitStack() as stack:
        domains = [stack.enter_context(claimed_domain()) for _ in range(5)]
        assert len(set(domains)) == 5
        assert all(claimed % SPACING == 0 and 0 < claimed <= LARGEST_DOMAIN for claimed in domains)
        assert not any(guard_is_free(claimed) for claimed in domains)
    assert all(guard_is_free(claimed) for claimed in domains)


def test_a_claim_over_many_ports_keeps_others_out_of_all_of_them() -> None:
    with claimed_domain(3 * SPACING) as wide, claimed_domain() as narrow:
        assert not wide <= narrow < wide + 3 * SPACING


def test_a_claim_over_many_ports_needs_them_all() -> None:
    with claimed_domain(4 * SPACING) as first:
        pass
    taken = first + 2 * SPACING
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as foreign:
        foreign.bind(("127.0.0.1", PORT_BASE + DOMAIN_GAIN * taken + GUARD_OFFSET))
        with claimed_domain(4 * SPACING) as second:
            assert not second <= taken < second + 4 * SPACING


def test_the_block_that_fails_gives_its_claim_up() -> None:
    with pytest.raises(KeyError), claimed_domain() as claimed:
        raise KeyError
    assert guard_is_free(claimed)


def test_a_claim_ends_with_its_holder_however_that_ends() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        claimed = int(holder.stdout.readline())
        with claimed_domain() as mine:
            assert mine != claimed
        assert not guard_is_free(claimed)
        os.kill(holder.pid, signal.SIGKILL)
        holder.wait()
    assert guard_is_free(claimed)


def test_no_domain_left_is_named_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "_claim", lambda _: [])
    with pytest.raises(RunError, match=r"no ROS domain is free on this machine: .* end other runs"), claimed_domain():
        pytest.fail("a domain was claimed")


def test_all_ports_are_below_those_that_linux_gives_away_by_default() -> None:
    assert metatraffic_port(LARGEST_DOMAIN - SPACING, 203) + 1 < 32768
