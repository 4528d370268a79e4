"""Programs that do not belong to a run: forged messages end it and are named, and ports of others do not block it."""

import os
import re
import socket
import subprocess
import sys
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from tests.system import helpers as runs

from swarmabs_run.orchestration.network import udp_ports
from swarmabs_run.orchestration.run_files import environment_of_run

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]


def test_ports_of_a_stranger_do_not_block_runs_that_are_steered(folder: Path) -> None:
    """He holds the first ports that tools would take, in every domain that a run might claim next."""
    with ExitStack() as stack:
        for domain in range(5, 60, 5):
            for participant in (4, 5):
                for port in udp_ports(domain, (participant,))[1:]:
                    stranger = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                    with suppress(OSError):  # another run has it
                        stranger.bind(("127.0.0.1", port))
        outcome = runs.lockstep(folder, "pd_het_4", runs.seconds(0.5), steered=True)
    assert outcome.status == "ok", outcome.reason


def test_forged_messages_end_the_run(folder: Path) -> None:
    strangers: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        command = [sys.executable, Path(__file__).with_name("stranger.py")]
        strangers.append(subprocess.Popen(command, env={**os.environ, **environment_of_run(folder)}))

    try:
        outcome = runs.lockstep(folder, "pd_het_4", runs.FOREVER, on_progress=runs.at({1: start}))
    finally:
        for stranger in strangers:
            stranger.kill()
            stranger.wait()
    assert strangers
    assert outcome.status == "failed"
    reason = "swarm/abstract_state: two different messages of step .*; is a second swarm in this namespace"
    assert re.search(reason, str(outcome.reason))
