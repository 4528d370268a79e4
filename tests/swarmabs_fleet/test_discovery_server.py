"""The discovery server tells systemd that it is ready, and goes on telling."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from swarmabs_run.orchestration.network import FIRST_FREE, claimed_domain, dds_environment, profile_xml


@pytest.mark.system
@pytest.mark.timeout(60)
def test_it_says_that_it_is_ready_and_alive_and_that_it_ends(tmp_path: Path, nothing_survives: str) -> None:
    listener = tmp_path / "notify"
    with claimed_domain() as domain, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(str(listener))
        channel.settimeout(30.0)
        profile = tmp_path / "dds.xml"
        profile.write_text(profile_xml(domain, participant=FIRST_FREE), encoding="utf-8")
        environment = {**os.environ, **dds_environment(domain, str(profile)), "NOTIFY_SOCKET": str(listener)}
        environment["ROS_LOG_DIR"] = str(tmp_path / "logs")
        command = [sys.executable, "-m", "swarmabs_fleet.discovery_server"]
        with subprocess.Popen(command, env=environment) as process:
            try:
                assert [channel.recv(100) for _ in range(3)] == [b"READY=1", b"WATCHDOG=1", b"WATCHDOG=1"]
                process.send_signal(signal.SIGTERM)
                assert process.wait(timeout=15) == 0
            finally:
                process.kill()
