"""What units ask before they start a node."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["127.0.0.1"], 0, ""),
        (["192.0.2.77"], 1, "192.0.2.77: Cannot assign requested address; is its interface up?"),
        ([], 1, "give one address"),
    ],
)
def test_an_address_is_this_hosts_or_not(arguments: list[str], code: int, words: str) -> None:
    command = [sys.executable, "-m", "swarmabs_fleet.own_address", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, words in done.stderr) == (code, True)
